import os
import re
import shutil
import sqlite3
import struct
import zlib
from contextlib import closing, suppress
from unittest import mock

import numpy as np
import pytest
import yaml
import zstandard
from bag_samples import (
    JOINT_STATE,
    MS,
    NAMES,
    STRING,
    cut_end,
    joint_state_cdr,
    peak_of,
    rosbag2_folder,
    rows,
    sealed,
    string_cdr,
    write_with_mcap,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from numpy.testing import assert_array_equal
from rosbags.rosbag2 import StoragePlugin

from hd_diag.bag import BagError, BagReader, BagWriter, recover
from hd_diag.messages.schemas import definition


def sample(count=400, disorder=0):
    """Two alternating topics; `disorder` moves log times by up to that many places."""
    block, stamps = rows(count)
    messages = [("/joint_states", JOINT_STATE, block[i].tobytes(), int(stamps[i])) for i in range(count)]
    messages += [("/note", STRING, string_cdr(f"n{i}" * (i % 3)), int(stamps[i])) for i in range(count)]
    messages.sort(key=lambda m: m[3])
    chance = np.random.default_rng(3)
    return [m for _, m in sorted(enumerate(messages), key=lambda p: p[0] + chance.integers(0, disorder + 1))]


def in_order(messages):
    return [(m[0], m[3], m[2]) for m in sorted(messages, key=lambda m: m[3])]


def read(path, *args, **keywords):
    with BagReader(path) as reader:
        return [
            (b.topic.name, int(t), bytes(m))
            for b in reader.batches(*args, **keywords)
            for t, m in zip(b.log_time, b.messages(), strict=True)
        ]


def taken_at_once(patch, size):
    """Load and release content in pieces of a size."""
    for name in ("mcap_chunk.PIECE", "mcap_storage.PIECE", "mcap_scan.LARGE"):
        patch.setattr(f"hd_diag.bag.{name}", size)


@pytest.fixture(params=[1 << 20, 700])
def stretch(request, monkeypatch):
    """Sizes at which content is loaded and released: small ones exercise the merge on small bags."""
    taken_at_once(monkeypatch, request.param)


COMPRESSIONS, ENDS = ("zstd", "lz4", "none"), ("whole", "without summary", "cut off")


@pytest.mark.usefixtures("stretch")
@pytest.mark.parametrize(
    ("chunk_size", "compression", "end"),
    [
        (size, compression, ENDS[(i + j) % 3])  # covers every pair
        for i, size in enumerate((200, 5000, 0))
        for j, compression in enumerate(COMPRESSIONS)
    ],
)
def test_any_chunking(tmp_path, compression, chunk_size, end):
    """Files with and without indexes, summary and end; chunk size 0 means no chunks."""
    options = dict.fromkeys(("indexes", "summary"), end != "without summary") | {"chunked": bool(chunk_size)}
    messages = sample(100, disorder=30)
    path = tmp_path / "a.mcap"
    write_with_mcap(path, messages, compression=compression, chunk_size=chunk_size, **options)
    path = cut_end(path, tmp_path / "b.mcap") if end == "cut off" else path
    assert read(path) == in_order(messages)
    with BagReader(path) as reader:
        assert [p[:8] for p in reader.problems] == ["b.mcap: "] * (end == "cut off")
        assert {t.name: t.count for t in reader.topics} == {"/joint_states": 100, "/note": 100}


@pytest.mark.usefixtures("stretch")
def test_grouped_batches_keep_the_order_of_each_topic(tmp_path):
    messages = sample(300, disorder=20)
    path = write_with_mcap(tmp_path / "a.mcap", messages, chunk_size=2000)
    with BagReader(path) as reader:
        lengths = [len(b) for b in reader.batches(grouped=True)]
        assert len(lengths) < len(list(reader.batches()))
    grouped = read(path, grouped=True)
    for topic in ("/joint_states", "/note"):
        own = [m for m in in_order(messages) if m[0] == topic]
        assert [m for m in grouped if m[0] == topic] == own == read(path, [topic])


@settings(max_examples=30)
@given(
    st.lists(st.integers(0, 60), min_size=1, max_size=200),
    st.integers(100, 2000),
    st.booleans(),
    st.booleans(),
)
def test_order_is_that_of_a_stable_sort(tmp_path_factory, times, chunk_size, indexes, chunked):
    messages = [("/n", STRING, string_cdr(f"{i}"), t) for i, t in enumerate(times)]
    path = tmp_path_factory.mktemp("order") / "a.mcap"
    write_with_mcap(path, messages, chunk_size=chunk_size, indexes=indexes, chunked=chunked)
    assert read(path) == in_order(messages)
    with pytest.MonkeyPatch.context() as patch:
        taken_at_once(patch, 1)
        assert read(path) == in_order(messages)


@pytest.mark.parametrize(("kind", "version"), [("MCAP", 8), ("MCAP", 9), ("SQLITE3", 8), ("SQLITE3", 9)])
def test_rosbag2_folders(tmp_path, kind, version):
    messages = sample(50, disorder=10)
    rosbag2_folder(tmp_path / "bag", messages, plugin=StoragePlugin[kind], version=version)
    if (kind, version) in (("MCAP", 9), ("SQLITE3", 8)):
        (tmp_path / "bag" / "metadata.yaml").unlink()
    assert sorted(read(tmp_path / "bag")) == sorted(in_order(messages))
    with BagReader(tmp_path / "bag") as reader:
        assert {(t.name, t.count) for t in reader.topics} == {("/joint_states", 50), ("/note", 50)}
        assert (reader.start, reader.end) == (0, 49 * MS)
        states = [reader.joint_states(b)[0][0] for b in reader.batches(["/joint_states"])]
    assert states[0].names == NAMES


NOTES = [("/n", i * MS, string_cdr(f"n{i}" * 100)) for i in range(300)]


def notes_folder(folder, *, plugin=StoragePlugin.SQLITE3, compressed=False, notes=NOTES):
    messages = [(topic, STRING, data, time) for topic, time, data in notes]
    return rosbag2_folder(folder, messages, plugin=plugin, compression="file" if compressed else "none")


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def crashed(folder, out, mode, before, *, spilled=()):
    """Copy of a folder to which a killed process added `NOTES`; only the first `before` have a checkpoint."""
    shutil.copytree(folder, out.with_suffix(".live"))
    with closing(sqlite3.connect(out.with_suffix(".live") / "bag.db3")) as db:
        db.execute("PRAGMA cache_size=1")
        db.execute(f"PRAGMA journal_mode={mode}")
        insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"
        for rows, checkpoint in ((NOTES[:before], True), (NOTES[before:], False)):
            db.executemany(insert, [(time + 1000 * MS, data) for _, time, data in rows])
            db.commit()
            if checkpoint:
                db.execute("PRAGMA wal_checkpoint(FULL)")
        db.executemany(insert, spilled)
        shutil.copytree(out.with_suffix(".live"), out)
    return out


SPILLED = [(i, bytes(4000)) for i in range(500)]


@pytest.mark.parametrize(
    ("mode", "before", "spilled"), [("WAL", 0, ()), ("WAL", 150, ()), ("DELETE", 150, SPILLED)]
)
def test_a_database_that_a_crash_left(tmp_path, scratch, mode, before, spilled):
    """A log or journal beside the file counts or is rolled back; nothing changes or remains."""
    bag = notes_folder(tmp_path / "bag", notes=NOTES[:1])
    bag = crashed(bag, tmp_path / "left", mode, before, spilled=spilled)
    (bag / "bag.db3-shm").unlink(missing_ok=True)
    given = contents(bag)
    (beside,) = given.keys() - {"bag.db3", "metadata.yaml"}
    assert len(given["bag.db3"]) > 100_000 if spilled else len(given[beside]) > len(given["bag.db3"])
    with BagReader(bag) as reader:
        assert reader.message_count == 301
        assert list(scratch.iterdir())
    assert read(bag) == NOTES[:1] + [(topic, time + 1000 * MS, data) for topic, time, data in NOTES]
    assert contents(bag) == given
    assert list(scratch.iterdir()) == []


def test_a_database_in_wal_mode_that_was_closed(tmp_path):
    """SQLite itself would create files beside the database to read it."""
    bag = notes_folder(tmp_path / "bag")
    with closing(sqlite3.connect(bag / "bag.db3")) as db:
        db.execute("PRAGMA journal_mode=WAL")
    given = contents(bag)
    with BagReader(bag):
        assert contents(bag) == given
    assert read(bag) == NOTES
    assert contents(bag) == given


def test_a_database_that_changes_while_it_is_copied(tmp_path, scratch, monkeypatch):
    bag = crashed(notes_folder(tmp_path / "bag"), tmp_path / "left", "WAL", 0)
    copy = shutil.copyfile

    def disturbed(source, out):
        copy(source, out)
        os.utime(bag / "bag.db3")

    monkeypatch.setattr(shutil, "copyfile", disturbed)
    with pytest.raises(BagError, match=r"bag\.db3: is being written"):
        BagReader(bag)
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_files_compressed_as_a_whole(tmp_path, scratch, plugin):
    bag = notes_folder(tmp_path / "bag", plugin=plugin, compressed=True)
    (file,) = bag.glob("bag.*.zstd")
    given = contents(bag)
    for path in (bag, file):
        assert read(path) == NOTES
    with BagReader(bag) as reader:
        assert (reader.paths, reader.problems) == ([file], [])
    assert contents(bag) == given
    (bag / "metadata.yaml").unlink()
    assert read(bag) == NOTES
    assert list(scratch.iterdir()) == []


def test_a_compressed_file_that_was_decompressed_since_or_by_another_way(tmp_path):
    """The metadata still names the compressed file; two files with the same content count once."""
    bag = notes_folder(tmp_path / "bag", compressed=True)
    file = bag / "bag.db3.zstd"
    (bag / "bag.db3").write_bytes(zstandard.ZstdDecompressor().stream_reader(file.read_bytes()).read())
    for _ in range(2):
        assert read(bag) == NOTES
        with BagReader(bag) as reader:
            assert reader.problems == []
        file.unlink(missing_ok=True)
    with BagReader(bag) as reader:
        assert reader.paths == [bag / "bag.db3"]
    info = bag / "metadata.yaml"
    info.write_text(info.read_text().replace("bag.db3.zstd", "bag.db3.lz4"))
    (bag / "bag.db3").rename(bag / "bag.db3.lz4")
    with pytest.raises(BagError, match="not by zstd: decompress them first"):
        BagReader(bag)


def test_a_compressed_file_that_is_cut_off(tmp_path, scratch):
    bag = notes_folder(tmp_path / "bag", plugin=StoragePlugin.MCAP, compressed=True)
    chance = np.random.default_rng(2)
    with BagWriter(tmp_path / "a.mcap", compression="none", chunk_size=20_000) as writer:
        for i in range(200):
            writer.write("/n", STRING, string_cdr(chance.bytes(2000).hex()), i)
    packed = zstandard.compress((tmp_path / "a.mcap").read_bytes())
    for rest, told in ((b"", ".*cut off"), (b"\xff" * 200_000, "its compression is damaged")):
        (bag / "bag.mcap.zstd").write_bytes(packed[: len(packed) // 2] + rest)
        with BagReader(bag) as reader:
            assert 50 < reader.message_count < 150
            assert re.match(rf"bag\.mcap\.zstd: {told}", reader.problems[0])
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("raised", [KeyboardInterrupt, RuntimeError])
def test_what_was_unpacked_is_deleted_after_errors(tmp_path, scratch, monkeypatch, raised):
    bag = notes_folder(tmp_path / "bag", compressed=True)
    left = crashed(notes_folder(tmp_path / "x" / "bag"), tmp_path / "left", "WAL", 0)
    for path in (bag, left):
        with suppress(raised), BagReader(path):
            assert list(scratch.iterdir())
            raise raised
        assert list(scratch.iterdir()) == []
    monkeypatch.setattr("hd_diag.bag.sqlite_file._topics", mock.Mock(side_effect=raised))
    for path in (bag, left):
        with pytest.raises(raised):
            BagReader(path)
        assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("damaged", [{0}, {1}, {2}, {0, 2}, {0, 1, 2}])
def test_a_torn_database_costs_only_itself(tmp_path, damaged):
    whole = (notes_folder(tmp_path / "whole") / "whole.db3").read_bytes()
    (bag := tmp_path / "bag").mkdir()
    for i in range(3):
        (bag / f"bag_{i}.db3").write_bytes(whole[: len(whole) // 2] if i in damaged else whole)
    if len(damaged) == 3:
        reason = r"bag_\d\.db3: SQLite: .*malformed; .sqlite3 bag_\d\.db3 \.recover"
        for path in (bag, bag / "bag_0.db3"):
            with pytest.raises(BagError, match=reason):
                BagReader(path)
        return
    with BagReader(bag) as reader:
        assert reader.message_count == 300 * (3 - len(damaged))
        told = [re.match(r"bag_(\d)\.db3: is left out: SQLite: .* \.recover", p)[1] for p in reader.problems]
        assert told == [str(i) for i in sorted(damaged)]
        assert sum(len(b) for b in reader.batches()) == reader.message_count


@pytest.mark.parametrize("value", ["'soon'", "NULL", "1.5", "-7"])
def test_times_that_are_none_are_told(tmp_path, value):
    file = notes_folder(tmp_path / "bag") / "bag.db3"
    with closing(sqlite3.connect(file)) as db:
        db.executescript(
            "ALTER TABLE messages RENAME TO old; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id,"
            " timestamp, data); INSERT INTO messages SELECT * FROM old;"
            f" UPDATE messages SET timestamp={value} WHERE id % 7 = 0"
        )
    with pytest.raises(BagError, match=r"topic or time is not a number; .sqlite3"):
        BagReader(file)


def test_a_split_folder_with_wrong_metadata_is_read_in_order(tmp_path):
    """Unlisted files are read, missing ones are reported, and no file outside the folder is opened."""
    block, stamps = rows(1200)
    for path, split in ((tmp_path / "secret.mcap", 0.0), (tmp_path / "bag", 0.1)):
        with BagWriter(path, max_duration=split) as writer:
            writer.write_many("/j", JOINT_STATE, block, stamps)
    info = tmp_path / "bag" / "metadata.yaml"
    content = yaml.safe_load(info.read_text())
    named = ["bag_0.mcap", "bag_1.mcap", "bag_77.mcap", "../secret.mcap"]
    content["rosbag2_bagfile_information"]["relative_file_paths"] = named
    info.write_text(yaml.safe_dump(content))
    with BagReader(tmp_path / "bag") as reader:
        assert "bag_77.mcap: is named in metadata.yaml but missing" in reader.problems
        assert [p.name for p in reader.paths] == [f"bag_{i}.mcap" for i in range(12)]
        times = np.concatenate([b.log_time for b in reader.batches()])
    assert_array_equal(times, stamps)


def test_types_come_from_the_file(tmp_path):
    """A type unknown to ROS, and a JointState with an additional field."""
    text = "float64 mass\nstring[] labels\n"
    longer = definition(JOINT_STATE).text.replace("[] effort\n", "[] effort\nfloat64 voltage\n", 1)
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        own = writer.register_schema("my_msgs/msg/Load", "ros2msg", text.encode())
        changed = writer.register_schema(JOINT_STATE, "ros2msg", longer.encode())
        load = writer.register_channel("/load", "cdr", own)
        joints = writer.register_channel("/joint_states", "cdr", changed)
        writer.add_message(load, 1, b"\0\1\0\0" + np.float64(2.5).tobytes() + bytes(4), 1)
        state = joint_state_cdr(("a",), 5 * MS, (1.5,), (), (2.5,))
        writer.add_message(joints, 2, state + np.float64(24.0).tobytes(), 2)
        writer.finish()
    with BagReader(tmp_path / "a.mcap") as reader:
        first, second = reader.batches()
        ((_, message),) = reader.deserialize(first)[0]
        assert (message.mass, message.labels) == (2.5, [])
        ((columns,), rejected) = reader.joint_states(second)
        with pytest.raises(BagError, match="not sensor_msgs"):
            reader.joint_states(first)
    assert (columns.names, columns.velocity, rejected) == (("a",), None, [])
    assert (columns.position.tolist(), columns.effort.tolist()) == ([[1.5]], [[2.5]])


def test_views_in_a_database_are_not_queried(tmp_path):
    with closing(sqlite3.connect(tmp_path / "a.db3")) as db:
        db.executescript(
            "CREATE TABLE topics(id, name, type, serialization_format); CREATE VIEW messages AS "
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT i AS id, 1 AS topic_id, i AS timestamp, 'x' AS data FROM n"
        )
    with pytest.raises(BagError, match="not a rosbag2 database"):
        BagReader(tmp_path / "a.db3")


def in_chunks_of_20(path, times):
    with BagWriter(path) as writer:
        for block, part in zip(np.split(rows(2000)[0], 100), np.split(times, 100), strict=True):
            writer.write_many("/j", JOINT_STATE, block, part)
            writer.flush()
    return path


def test_what_is_held_back_for_sorting_is_bounded(tmp_path, monkeypatch):
    """Every chunk spans the whole time, so no message can be released before the last chunk is read."""
    times = MS // 10 * np.random.default_rng(5).permutation(2000)
    path = in_chunks_of_20(tmp_path / "a.mcap", times)
    for size in (1 << 20, 1):
        taken_at_once(monkeypatch, size)
        assert [m[1] for m in read(path)] == sorted(times.tolist())
    taken_at_once(monkeypatch, 4000)
    monkeypatch.setattr("hd_diag.bag.mcap_storage._MAX_HELD", 100_000)
    with pytest.raises(BagError, match="too disordered"):
        read(path)


def test_stragglers_do_not_keep_their_chunks_in_memory(tmp_path, monkeypatch):
    """One late message in each chunk waits alone, without the buffer of its chunk."""
    times = MS // 10 * np.arange(2000)
    times[::20] += 2 * 10**8  # [ns]; more would be a clock set back
    path = in_chunks_of_20(tmp_path / "a.mcap", times)
    taken_at_once(monkeypatch, 1)
    monkeypatch.setattr("hd_diag.bag.mcap_storage._MAX_HELD", 40_000)
    assert [m[1] for m in read(path)] == sorted(times.tolist())


def test_endless_queries_are_stopped(tmp_path, monkeypatch):
    rosbag2_folder(tmp_path / "bag", [("/n", STRING, string_cdr(f"{i}"), i) for i in range(2000)])
    assert len(read(tmp_path / "bag")) == 2000
    monkeypatch.setattr("hd_diag.bag.sqlite_file._STEPS_PER_BYTE", 0)
    monkeypatch.setattr("hd_diag.bag.sqlite_file._STEPS_PER_TURN", 1)
    with pytest.raises(BagError, match="interrupted"):
        BagReader(tmp_path / "bag")


def test_messages_from_before_the_start_that_their_chunk_declares(tmp_path, monkeypatch):
    """Old writers gave a chunk the time of its first message instead of the earliest."""
    given = [("/n", STRING, string_cdr("x" * 300), time) for time in (5, 6, 8, 7, 4)]
    path = write_with_mcap(tmp_path / "a.mcap", given, chunk_size=500)
    path.write_bytes(sealed(path.read_bytes().replace(struct.pack("<QQ", 4, 7), struct.pack("<QQ", 7, 7))))
    monkeypatch.setattr("hd_diag.bag.mcap_storage.PIECE", 1)
    with pytest.raises(BagError, match="before its declared start"):
        read(path)


# Large chunks ---


def digest(path):
    """Checksums of the topics, times and contents of a bag, in reading order."""
    sums = [0, 0, 0]
    with BagReader(path) as reader:
        for batch in reader.batches():
            topics = batch.topic.name.encode() * len(batch)
            parts = topics, batch.log_time.tobytes(), b"".join(batch.payload)
            sums = [zlib.crc32(part, before) for part, before in zip(parts, sums, strict=True)]
    return sums


def write_large(path, chunk_size, compression="zstd"):
    """5,000 messages of 4 kB and one of 6 MB among them."""
    block = np.random.default_rng(3).integers(0, 256, (5000, 4000), np.uint8)
    times = np.arange(5000)
    with BagWriter(path, chunk_size=chunk_size, flush_period=1e9, compression=compression) as writer:
        writer.write_many("/n", STRING, block[:2000], times[:2000])
        writer.write("/large", STRING, bytes(6_000_000), 2000)
        writer.write_many("/n", STRING, block[2000:], times[2000:])
    return path


@pytest.mark.parametrize(
    "compression", ["lz4", *(pytest.param(c, marks=pytest.mark.slow) for c in ("zstd", "none"))]
)
def test_a_large_chunk_is_read_in_parts(tmp_path, compression):
    """The result is the same as with several chunks, whether the file is finished or not."""
    one = write_large(tmp_path / "one.mcap", 1 << 30, compression)
    expected = digest(write_large(tmp_path / "many.mcap", 1 << 20))
    assert digest(one) == expected
    assert digest(cut_end(one, tmp_path / "cut.mcap")) == expected
    assert recover(one, tmp_path / "again.mcap").complete
    assert digest(tmp_path / "again.mcap") == expected


@pytest.fixture
def large():
    """40 MB of incompressible messages."""
    return np.random.default_rng(3).integers(0, 256, (10_000, 4000), np.uint8)


@pytest.mark.parametrize("step", [1, -1])
def test_a_large_chunk_takes_the_memory_of_its_parts(tmp_path, large, step):
    """A whole chunk would need its size three times: stored, decompressed in pieces, and joined.

    A chunk with decreasing times is sorted.
    """
    with BagWriter(tmp_path / "a.mcap", chunk_size=1 << 30, flush_period=1e9) as writer:
        writer.write_many("/n", STRING, large, np.arange(10_000)[::step])
    with BagReader(tmp_path / "a.mcap") as reader:
        heads, peak = peak_of(lambda: [batch.payload[:, :8].copy() for batch in reader.batches()])
    assert_array_equal(np.concatenate(heads), large[::step, :8])
    assert peak < 0.8 * large.size


def test_a_large_chunk_of_one_topic_after_the_other_takes_no_more(tmp_path, large, monkeypatch):
    """The chunk is unpacked to disk, because its parts are not read in stored order."""
    with BagWriter(tmp_path / "a.mcap", chunk_size=1 << 30, flush_period=1e9) as writer:
        for topic, times in (("/a", np.arange(0, 10_000, 2)), ("/b", np.arange(1, 10_000, 2))):
            writer.write_many(topic, STRING, large[times], times)

    def times_and_heads():
        with BagReader(tmp_path / "a.mcap") as reader:
            return [(b.log_time, b.payload[:, :8].copy()) for b in reader.batches(grouped=True)]

    found, peak = peak_of(times_and_heads)
    times, heads = map(np.concatenate, zip(*found, strict=True))
    assert_array_equal(heads[np.argsort(times)], large[:, :8])
    assert peak < 0.8 * large.size
    full = mock.Mock(side_effect=OSError(28, "no space"))
    monkeypatch.setattr("hd_diag.bag.mcap_chunk.TemporaryFile", full)
    with pytest.raises(BagError, match=r"cannot be sorted in .* no space"):
        times_and_heads()


def test_a_large_chunk_that_is_cut_off_gives_what_is_there(tmp_path):
    one = write_large(tmp_path / "one.mcap", 1 << 30, "none")
    cut_end(one, tmp_path / "cut.mcap", keep=20_000_000)
    counts = recover(tmp_path / "cut.mcap", tmp_path / "again.mcap").counts
    assert counts["/large"] == 1
    assert counts["/n"] == (20_000_000 - 6_001_000) // 4031  # without schemas and the other message


def test_damage_in_a_large_chunk_is_found_before_any_of_it_is_used(tmp_path):
    one = write_large(tmp_path / "one.mcap", 13 << 20, "none")
    content = bytearray(one.read_bytes())
    content[-3_000_000] ^= 1
    one.write_bytes(content)
    report = recover(one, tmp_path / "again.mcap")
    assert "its checksum is wrong" in report.files[0].problems[0]
    assert sum(report.counts.values()) > 2000
    with BagReader(one) as reader:
        batches, read = reader.batches(), 0
        while read < 1500:
            read += len(next(batches))
        with pytest.raises(BagError, match="its checksum is wrong"):
            list(batches)


def test_large_messages_of_a_database_are_read_a_few_at_a_time(tmp_path):
    folder = rosbag2_folder(tmp_path / "bag", [("/large", STRING, bytes(2_000_000), i) for i in range(20)])
    with BagReader(folder) as reader:
        sizes, peak = peak_of(lambda: [len(batch) for batch in reader.batches()])
    assert sum(sizes) == 20
    assert peak < 20e6
