import contextlib
import errno
import itertools
import os
import random
import re
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import yaml
from bag_samples import JOINT_STATE, MS, STRING, rows, string_cdr
from cli_runner import files_up_to
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from hd_diag.bag import RELIABLE, BagError, BagReader, BagWriter, recover, replaced
from hd_diag.messages.schemas import definition, jazzy

COMPRESSIONS = ("zstd", "lz4", "none")


def read_raw(path):
    with AnyReader([Path(path)]) as reader:
        return [(c.topic, t, bytes(d)) for c, t, d in reader.messages()]


def written(path, count=300, **options):
    """A bag with two topics; returns the writer and the messages written."""
    given = []
    with BagWriter(path, **options) as writer:
        for i, (row, stamp) in enumerate(zip(*rows(count), strict=True)):
            note = ("/note", STRING, string_cdr(f"n{i}"))
            for topic, kind, data in (("/joint_states", JOINT_STATE, row.tobytes()), note):
                writer.write(topic, kind, data, int(stamp))
                given.append((topic, int(stamp), data))
    return writer, given


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_other_libraries_read_what_was_written(tmp_path, compression):
    _, given = written(tmp_path / "a.mcap", 50, compression=compression, chunk_size=3000)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        seen = [(c.topic, m) for _, c, _, m in reader.iter_decoded_messages()]
        summary = reader.get_summary()
    assert sorted(read_raw(tmp_path / "a.mcap")) == sorted(given)
    positions = [list(m.position) for topic, m in seen if topic == "/joint_states"]
    assert positions == [[float(i), i + 0.1] for i in range(50)]
    assert [m.data for topic, m in seen if topic == "/note"] == [f"n{i}" for i in range(50)]
    assert summary.statistics.message_count == 100
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 49 * MS)
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 2
    assert all(set(c.message_index_offsets) for c in summary.chunk_indexes)


def test_records_are_those_of_rosbag2(tmp_path):
    written(tmp_path / "a.mcap", 3)
    records = list(StreamReader(str(tmp_path / "a.mcap"), validate_crcs=True).records)
    (header,) = [r for r in records if isinstance(r, Header)]
    assert header.profile == "ros2"
    channel = next(r for r in records if isinstance(r, Channel) and r.topic == "/joint_states")
    assert channel.message_encoding == "cdr"
    assert channel.metadata["topic_type_hash"] == jazzy().hash_rihs01(JOINT_STATE)
    (offer,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert (offer["reliability"], offer["history"], offer["depth"]) == ("reliable", "keep_last", 10)
    assert offer["lifespan"] == {"sec": 9223372036, "nsec": 854775807}
    schema = next(r for r in records if isinstance(r, Schema) and r.id == channel.schema_id)
    assert (schema.name, schema.encoding) == (JOINT_STATE, "ros2msg")
    assert schema.data.decode() == definition(JOINT_STATE).text
    last = [r for r in records if isinstance(r, Metadata)][-1]
    assert last.name == "rosbag2"
    assert yaml.safe_load(last.metadata["serialized_metadata"])["message_count"] == 6


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_rows_and_single_messages_give_the_same_bytes(tmp_path, compression):
    block, stamps = rows(500)
    texts = [string_cdr("x" * (i * 37 % 90)) for i in range(500)]
    given = (("/j", JOINT_STATE, [*map(bytes, block)], stamps), ("/n", STRING, texts, stamps // 3))
    parts = {"one": range(501), "some": [0, 1, 3, 7, 15, *range(22, 501, 20), 500, 500]}
    parts |= {"list": [0, 1, 250, 500, 500], "block": [0, 500]}
    written = []
    for name, edges in parts.items():
        (path := tmp_path / name / "a.mcap").parent.mkdir()
        with BagWriter(path, compression=compression, chunk_size=7000, flush_period=60.0) as writer:
            for (topic, kind, data, times), (a, b) in itertools.product(given, itertools.pairwise(edges)):
                if name == "one":
                    writer.write(topic, kind, data[a], int(times[a]))
                elif name == "some":
                    writer.write_some(topic, kind, data[a:b], times[a:b].tolist())
                elif name == "block" and topic == "/j":
                    writer.write_many(topic, kind, block, times)
                else:
                    writer.write_many(topic, kind, [*map(memoryview, data[a:b])], times[a:b])
        written.append(path.read_bytes())
    assert written[1:] == written[:1] * 3


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("name", ["bag", "b.mcap"])
def test_splits(tmp_path, many, name):
    """Splits by time and by size; a chunk with its index and the summary may exceed the size limit."""
    block, stamps = rows(1000)
    by = {"max_duration": 0.3} if name == "bag" else {"max_size": 40_000, "chunk_size": 4000}
    with BagWriter(tmp_path / name, compression="none", **by) as writer:
        if many:
            writer.write_many("/j", JOINT_STATE, block, stamps)
        else:
            for row, stamp in zip(block, stamps.tolist(), strict=True):
                writer.write("/j", JOINT_STATE, row.tobytes(), stamp)
    names, each = [p.name for p in writer.paths], [read_raw(p) for p in writer.paths]
    assert [d for part in each for _, _, d in part] == [row.tobytes() for row in block]
    if name == "bag":
        assert names == [f"bag_{i}.mcap" for i in range(4)]
        assert [*map(len, each)] == [300, 300, 300, 100]
    else:
        assert names[:3] == ["b.mcap", "b_1.mcap", "b_2.mcap"]
        assert all(40_000 <= p.stat().st_size < 60_000 for p in writer.paths[:-1])


@pytest.mark.parametrize("resumed", [False, True])
def test_files_that_are_finished_take_no_memory(tmp_path, resumed):
    """This holds for files of a split and for files ended by an error: a log may have thousands."""
    data, sizes = string_cdr("x" * 50_000), []
    with BagWriter(tmp_path / "bag", max_duration=0.0 if resumed else 1e-9) as writer:
        tracemalloc.start()
        for number in range(1, 20):
            writer.write("/x", STRING, data, number)
            if resumed:
                writer.resume()
            sizes.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert len(writer.paths) >= 19
    assert sizes[-1] - sizes[4] < 14 * 10_000


def test_metadata_yaml_of_a_folder(tmp_path):
    writer, _ = written(tmp_path / "bag", 100, max_duration=0.05)
    info = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (info["version"], info["storage_identifier"], info["ros_distro"]) == (9, "mcap", "jazzy")
    assert info["relative_file_paths"] == [p.name for p in writer.paths] == ["bag_0.mcap", "bag_1.mcap"]
    assert (info["message_count"], info["duration"]) == (200, {"nanoseconds": 99 * MS})
    starts = [each["starting_time"]["nanoseconds_since_epoch"] for each in (info, *info["files"])]
    assert starts == [0, 0, 50 * MS]
    topic = info["topics_with_message_count"][0]
    counts = [each["message_count"] for each in (topic, *info["files"])]
    assert counts == [100] * 3
    assert topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    assert topic["topic_metadata"]["offered_qos_profiles"][0]["durability"] == "volatile"
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 200


def test_of_metadata_that_a_disk_does_not_take_no_draft_is_left(tmp_path):
    with files_up_to(200), pytest.raises(BagError, match="File too large"):
        BagWriter(tmp_path / "bag")
    assert [*(tmp_path / "bag").iterdir()] == []


def test_overwrite_replaces_the_bag_and_nothing_else(tmp_path):
    written(tmp_path / "bag", 100, max_duration=0.02)
    (tmp_path / "bag" / "notes.txt").write_text("mine")
    (tmp_path / "bag" / "other.mcap").write_text("mine too")
    with BagWriter(tmp_path / "bag", overwrite=True) as writer:
        writer.write("/a", STRING, string_cdr("x"), 1)
    names = sorted(p.name for p in (tmp_path / "bag").iterdir())
    assert names == ["bag_0.mcap", "metadata.yaml", "notes.txt", "other.mcap"]
    written(tmp_path / "a.mcap", 500)
    _, given = written(tmp_path / "a.mcap", 2, overwrite=True)
    assert sorted(read_raw(tmp_path / "a.mcap")) == sorted(given)


def test_bad_arguments_concern_one_call_only(tmp_path):
    with BagWriter(tmp_path / "a.mcap") as writer:
        with pytest.raises(BagError, match="no known definition"):
            writer.write("/a", "no_msgs/msg/Such", b"", 1)
        for wrong in (-1, 2**63):
            with pytest.raises(BagError, match="out of range"):
                writer.write("/a", STRING, string_cdr("x"), wrong)
        with pytest.raises(BagError, match="times"):
            writer.write_many("/a", STRING, [string_cdr("x")] * 3, [1, 2])
        writer.write("/a", STRING, string_cdr("x"), 1)
        assert writer.error is None
    assert len(read_raw(tmp_path / "a.mcap")) == 1


@pytest.mark.parametrize(
    "bad", [{"compression": "gzip"}, {"chunk_size": 0}, {"max_size": -1}, {"flush_period": float("nan")}]
)
def test_bad_options_are_refused_before_a_file_is_made(tmp_path, bad):
    with pytest.raises(BagError, match=r"a\.mcap"):
        BagWriter(tmp_path / "a.mcap", **bad)
    assert list(tmp_path.iterdir()) == []


def test_messages_wait_no_longer_than_the_flush_period(tmp_path):
    writer = BagWriter(tmp_path / "a.mcap", flush_period=0.25)
    writer.write("/a", STRING, string_cdr("x"), 1)
    now = time.monotonic()
    assert not writer.flush_if_due(now)
    assert writer.flush_if_due(now + 0.25)
    assert not writer.flush_if_due(now + 9.0)
    with BagReader(tmp_path / "a.mcap") as reader:
        assert reader.message_count == 1
        assert "being written by another process" in reader.problems[0]
    writer.close()
    writer.close()
    with pytest.raises(BagError, match="closed"):
        writer.write("/a", STRING, string_cdr("x"), 1)
    assert not writer.flush_if_due()
    with BagWriter(tmp_path / "b.mcap", flush_period=0.0) as writer:
        for i in (2, 3):  # new messages flush old ones
            writer.write("/a", STRING, string_cdr("x"), i)
    kept = StreamReader(str(tmp_path / "b.mcap"), emit_chunks=True).records
    assert sum(isinstance(record, Chunk) for record in kept) == 2


# Writes in real time with a timer, as the node does; reports each message once the writer has it.
RECORD = """
import sys, time
sys.path.insert(0, {test!r})
from bag_samples import JOINT_STATE, rows
from hd_diag.bag import BagWriter
block, _ = rows(4000)
options = {{"flush_period": 0.25, "max_duration": {split}}}
writer = BagWriter({path!r}, compression={compression!r}, **options)
print("ready", flush=True)
for i in range(4000):
    now = time.time_ns()
    writer.write("/j", JOINT_STATE, block[i].tobytes(), now)
    sys.stdout.write(f"{{i}} {{now}}\\n")
    sys.stdout.flush()
    time.sleep(0.0005)
    if i % 50 == 49:
        pause = time.monotonic() + {pause}
        while time.monotonic() < pause:
            time.sleep(0.02)
            writer.flush_if_due(time.monotonic())
"""


@pytest.mark.parametrize("turn", [0, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in range(4, 10))])
def test_kill_loses_less_than_a_second(tmp_path, turn):
    chance = random.Random(turn)
    path = tmp_path / ("bag" if turn % 2 else "a.mcap")
    often = {"split": 0.3 * (turn % 4 == 3), "pause": 0.4 * (turn % 5 == 4)}
    own = {"path": str(path), "test": str(Path(__file__).parent), "compression": COMPRESSIONS[turn % 3]}
    script = RECORD.format(**own, **often)
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    time.sleep(chance.uniform(0.05, 1.2))
    process.send_signal(signal.SIGKILL)
    killed = time.time_ns()
    told = [tuple(map(int, m)) for m in re.findall(r"^(\d+) (\d+)\n", process.communicate()[0], re.MULTILINE)]
    report = recover(path, tmp_path / "saved.mcap")
    assert report.files[-1].problems
    block, _ = rows(4000)
    saved = read_raw(tmp_path / "saved.mcap") if report.out else []
    # Nothing is missing before the end, and all messages are unchanged.
    assert [d for _, _, d in saved] == [block[i].tobytes() for i in range(len(saved))]
    assert [t for _, t, _ in saved][: len(told)] == [t for _, t in told][: len(saved)]
    lost = [t for i, t in told if i >= len(saved)]
    assert all(killed - t < 1_000_000_000 for t in lost)


@pytest.mark.parametrize("whole", [0, 7])
def test_a_disk_that_is_full_for_one_write(tmp_path, monkeypatch, whole):
    """The file is whole and ends with the last chunk before the error, even if there is room again."""
    writer = BagWriter(tmp_path / "bag", chunk_size=2000)
    block, stamps = rows(600)
    writer.write_many("/j", JOINT_STATE, block[:60], stamps[:60])
    writer.flush()
    write, calls = os.write, []

    def full_once(fd, data):
        calls.append(1)
        if len(calls) == 1 + whole:
            write(fd, data[:10])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(fd, data)

    monkeypatch.setattr(os, "write", full_once)
    with pytest.raises(BagError, match="No space left"):
        writer.write_many("/j", JOINT_STATE, block[60:], stamps[60:])
    for again in (writer.flush, lambda: writer.write("/j", JOINT_STATE, block[0].tobytes(), 1)):
        with pytest.raises(BagError, match="No space left"):
            again()
    assert not writer.flush_if_due(time.monotonic() + 9)
    writer.close()
    in_a_chunk = -(-2000 // (block.shape[1] + 31))  # a header of 31 bytes precedes each message
    saved = 60 + in_a_chunk * whole
    assert writer.counts == {"/j": saved}
    assert [d for _, _, d in read_raw(tmp_path / "bag")] == [row.tobytes() for row in block[:saved]]
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == saved


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, OSError])
def test_an_error_leaves_a_file_without_its_end(tmp_path, monkeypatch, error):
    """An error of the caller, or of the disk at the end; Ctrl-C is no error."""

    def interrupted():
        with BagWriter(tmp_path / "a.mcap") as writer:
            writer.write("/a", STRING, string_cdr("x"), 20, 10, RELIABLE._replace(depth=3))
            with pytest.raises(BagError, match="being written by another"):
                BagWriter(tmp_path / "a.mcap", overwrite=True)
            writer.flush()
            if error is OSError:
                monkeypatch.setattr(os, "write", mock.Mock(side_effect=OSError(errno.ENOSPC, "full")))
                return
            raise error

    with pytest.raises(BagError if error is OSError else error):
        interrupted()
    with BagReader(tmp_path / "a.mcap") as reader:
        assert bool(reader.problems) == (error is not KeyboardInterrupt)
        (batch,) = reader.batches()
    assert (batch.log_time.tolist(), batch.publish_time.tolist()) == ([20], [10])
    assert "depth: 3" in batch.topic.offers


def test_an_interrupt_while_writing_loses_nothing(tmp_path, monkeypatch):
    block, stamps = rows(100)
    write = os.write

    def interrupted(fd, data):
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.1)
        return write(fd, data)

    def work():
        with BagWriter(tmp_path / "a.mcap", flush_period=60.0) as writer:
            writer.write_many("/j", JOINT_STATE, block, stamps)
            with monkeypatch.context() as patch:
                patch.setattr(os, "write", interrupted)
                writer.flush()

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # the tests' processes ignore it
    try:
        with pytest.raises(KeyboardInterrupt):
            work()
    finally:
        signal.signal(signal.SIGINT, before)
    assert [d for _, _, d in read_raw(tmp_path / "a.mcap")] == [row.tobytes() for row in block]


def test_next_file_that_cannot_be_made(tmp_path):
    """A failed split is an error of the writer, and the files before it are whole."""
    (tmp_path / "a_1.mcap").write_text("precious")
    block, stamps = rows(100)
    writer = BagWriter(tmp_path / "a.mcap", max_duration=0.05)
    with pytest.raises(BagError, match=r"a_1\.mcap: exists already"):
        writer.write_many("/j", JOINT_STATE, block, stamps)
    writer.close()
    assert (tmp_path / "a_1.mcap").read_text() == "precious"
    assert [d for _, _, d in read_raw(tmp_path / "a.mcap")] == [row.tobytes() for row in block[:50]]


# Replacement of an older bag ---


def old_bag(path):
    """Write a bag of three messages (a folder gets three files); returns the contents by name."""
    with BagWriter(path, max_duration=1e-9 if path.suffix == "" else 0.0) as writer:
        writer.write_many("/old", STRING, [string_cdr("old")] * 3, [1, 2, 3])
    if path.is_dir():
        (path / "notes.txt").write_text("mine")
    return lying(path.parent)


def lying(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", ["a.mcap", "a"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(errno.ENOSPC, "full"), ValueError("x"), None])
def test_an_older_bag_stays_until_the_new_one_is_whole(tmp_path, name, error):
    before = old_bag(tmp_path / name)

    def write():
        with replaced(tmp_path / name, overwrite=True) as place, BagWriter(place) as writer:
            writer.write("/new", STRING, string_cdr("new"), 1)
            writer.flush()
            assert before.items() <= lying(tmp_path).items()
            if error is not None:
                raise error

    with contextlib.suppress(KeyboardInterrupt, ValueError):
        write()
    if error is None:
        assert read_raw(tmp_path / name) == [("/new", 1, string_cdr("new"))]
        rest = {"a/a_0.mcap", "a/metadata.yaml", "a/notes.txt"} if name == "a" else {"a.mcap"}
        assert {str(path) for path in lying(tmp_path)} == rest
    else:
        assert lying(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_error_of_the_new_bag_names_the_place_it_is_for(tmp_path):
    old_bag(tmp_path / "a.mcap")
    kept = "; what was there before is kept"
    for path, told in ((None, f"a.mcap: is bad{kept}"), (tmp_path / "b.mcap", "b.mcap: is bad")):
        with (
            pytest.raises(BagError, match=f"^{tmp_path}/{told}$"),
            replaced(tmp_path / "a.mcap", overwrite=True) as place,
        ):
            raise BagError(path or place, "is bad")


def test_a_link_to_an_older_bag_stays_a_link(tmp_path):
    old_bag(tmp_path / "a.mcap")
    (tmp_path / "link.mcap").symlink_to("a.mcap")
    with replaced(tmp_path / "link.mcap", overwrite=True) as place, BagWriter(place) as writer:
        writer.write("/new", STRING, string_cdr("new"), 1)
    assert (tmp_path / "link.mcap").is_symlink()
    assert read_raw(tmp_path / "a.mcap") == [("/new", 1, string_cdr("new"))]


@pytest.mark.parametrize("name", ["a.mcap", "a"])
def test_a_bag_that_is_being_written_is_not_replaced(tmp_path, name):
    with BagWriter(tmp_path / name) as writer:
        writer.write("/old", STRING, string_cdr("old"), 1)
        with (
            pytest.raises(BagError, match="is being written by another process"),
            replaced(tmp_path / name, overwrite=True) as place,
        ):
            BagWriter(place).close()
    assert read_raw(tmp_path / name) == [("/old", 1, string_cdr("old"))]


def test_a_new_bag_is_written_in_its_place(tmp_path):
    """The bag grows under its final name, so it exists after a crash."""
    for name, overwrite in (("a.mcap", False), ("b", True)):
        with replaced(tmp_path / name, overwrite=overwrite) as place:
            assert place == tmp_path / name


def test_two_writers_at_once_do_not_share_a_compressor(tmp_path):
    """A node has a log and a snapshot: their threads compress at the same time."""
    content = np.random.default_rng(0).integers(0, 9, (40_000, 200)).astype(np.uint8)
    content[:, :4] = list(b"\0\1\0\0")
    times = 1000 * np.arange(len(content))
    paths = [tmp_path / f"{name}.mcap" for name in "ab"]
    with BagWriter(paths[0]) as one, BagWriter(paths[1]) as other:
        for first in range(0, len(content), 2000):
            part = slice(first, first + 2000)
            for writer in (one, other):
                writer.write_many("/text", "std_msgs/msg/String", content[part], times[part])
    for path in paths:
        with BagReader(path) as reader:
            found = [bytes(data) for batch in reader.batches(["/text"]) for data in batch.messages()]
        assert found == [row.tobytes() for row in content]
