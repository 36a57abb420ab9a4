import errno
import json
import os
import sqlite3
import struct
import sys
from contextlib import closing

import numpy as np
import pytest
import yaml
import zstandard
from bag_samples import (
    JOINT_STATE,
    MS,
    STRING,
    cut_end,
    peak_of,
    rosbag2_folder,
    rows,
    sealed,
    string_cdr,
    write_with_mcap,
)
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from hd_diag.bag import BagError, BagReader, BagWriter, recover
from hd_diag.bag.mcap_chunk import Content, OnDisk
from hd_diag.bag.mcap_scan import Scan
from hd_diag.messages.schemas import Definition


def messages(count=600):
    block, stamps = rows(count)
    return [("/j", JOINT_STATE, block[i].tobytes(), int(stamps[i])) for i in range(count)]


def read(path):
    with AnyReader([path]) as reader:
        return [(c.topic, t, bytes(d)) for c, t, d in reader.messages()]


def expected(given):
    return [(t, time, d) for t, _, d, time in given]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("indexes", [True, False])
def test_every_closed_chunk_is_saved_wherever_the_file_ends(tmp_path, compression, indexes):
    options = {"compression": compression, "indexes": indexes, "chunk_size": 6000}
    path = write_with_mcap(tmp_path / "a.mcap", messages(300), **options)
    sections, block = sections_of(path), expected(messages(300))
    for keep in range(1000, path.stat().st_size - 1000, 1777):
        report = recover(cut_end(path, tmp_path / "b.mcap", keep=keep), tmp_path / "c.mcap", overwrite=True)
        saved = read(tmp_path / "c.mcap") if report.counts else []
        assert saved == block[: len(saved)]
        least = max((s.end for s in sections if s.offset + s.size <= keep), default=-1)
        assert len(saved) * MS > least
        with BagReader(tmp_path / "b.mcap") as reader:
            times = [time for batch in reader.batches() for time in batch.log_time]
        assert least < len(times) * MS <= len(saved) * MS
        assert times == [time for _, time, _ in saved[: len(times)]]
        assert not report.complete
        lost, lines = report.files[0].unread, report.statement()
        assert not lost or f"b.mcap: {lost} of {keep} bytes could not be read" in lines
        assert json.loads(json.dumps(report.as_dict()))["files"][0]["unread"] == lost


@pytest.mark.parametrize("compression", ["lz4", "none", "zstd"])
def test_part_of_the_open_chunk(tmp_path, compression):
    """Chunks are compressed in blocks: all content up to one block before the cut is readable."""
    given = messages(20_000)
    path = write_with_mcap(tmp_path / "a.mcap", given, compression=compression, chunk_size=8 << 20)
    (section,) = sections_of(path)
    keep = section.offset + section.size * 6 // 10
    report = recover(cut_end(path, tmp_path / "b.mcap", keep=keep), tmp_path / "c.mcap")
    saved = read(tmp_path / "c.mcap")
    assert 1000 < len(saved) < 20_000
    assert saved == expected(given)[: len(saved)]
    assert any("cut off at byte" in p and str(len(saved)) in p for p in report.files[0].problems)


def sections_of(path):
    with path.open("rb") as file:
        return Scan(path, file).sections


def test_a_whole_bag_is_copied_and_what_it_counts_beside_is_lost(tmp_path):
    path = write_with_mcap(tmp_path / "a.mcap", messages(), chunk_size=4000)
    report = recover(path, tmp_path / "b.mcap")
    assert read(tmp_path / "b.mcap") == expected(messages())
    assert (report.complete, report.counts) == (True, {"/j": 600})
    assert (report.start, report.end) == (0, 599 * MS)
    told = ["saved 600 messages, the last at 0.599000000 s", "  /j: 600"]
    assert report.statement() == [*told, "nothing is missing"]
    data = path.read_bytes()
    (summary,) = struct.unpack("<Q", data[-28:-20])
    counted = data[summary:].replace(struct.pack("<Q", 600), struct.pack("<Q", 607))
    path.write_bytes(sealed(data[:summary] + counted))
    report = recover(path, tmp_path / "b.mcap", overwrite=True)
    assert (report.counts, report.complete) == ({"/j": 600}, False)
    assert report.statement()[-1] == "a.mcap: at least 7 messages are lost"


def test_damaged_chunk_costs_only_itself(tmp_path):
    path = write_with_mcap(tmp_path / "a.mcap", messages(), chunk_size=6000)
    section = sections_of(path)[3]
    data = bytearray(path.read_bytes())
    data[section.offset + section.size // 2] ^= 0x10
    path.write_bytes(data)
    with BagReader(path) as reader, pytest.raises(BagError, match="damaged"):
        list(reader.batches())
    report = recover(path, tmp_path / "b.mcap")
    survivors = [m for m in expected(messages()) if not section.start <= m[1] <= section.end]
    lost = 600 - len(survivors)
    assert (report.files[0].lost, report.counts["/j"]) == (lost, 600 - lost)
    assert lost > 10
    assert read(tmp_path / "b.mcap") == survivors
    assert f"a.mcap: at least {lost} messages are lost" in report.statement()


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_chunks_behind_a_damaged_length_are_found(tmp_path, compression):
    path = write_with_mcap(tmp_path / "a.mcap", messages(), chunk_size=6000, compression=compression)
    sections = sections_of(path)
    data = bytearray(path.read_bytes())
    head = sections[3].offset - len(sections[3].compression) - 49
    assert data[head] == 6
    data[head + 1 : head + 9] = (2**60).to_bytes(8, "little")
    path.write_bytes(data)
    with BagReader(path) as reader:
        assert f"damaged at byte {head}" in reader.problems[0]
        assert reader.message_count == sum(m[1] <= sections[2].end for m in expected(messages()))
    recover(path, tmp_path / "b.mcap")
    survivors = [m for m in expected(messages()) if not sections[3].start <= m[1] <= sections[3].end]
    saved = read(tmp_path / "b.mcap")
    # An uncompressed or partly readable chunk may itself yield messages.
    assert [m for m in saved if m in survivors] == survivors
    assert saved == [m for m in expected(messages()) if m in saved]


def test_folder_with_damaged_metadata_and_a_file_that_is_no_bag(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/n", STRING, string_cdr("x"), 7)
    (tmp_path / "bag" / "metadata.yaml").write_text("{")
    (tmp_path / "bag" / "bag_1.mcap").write_text("rubbish")
    report = recover(tmp_path / "bag", tmp_path / "saved.mcap")
    assert report.counts == {"/n": 1}
    assert "is not rosbag2 metadata" in report.problems[0]
    assert report.files[1].problems == ["is not an MCAP file"]
    assert report.files[1].unread == 7


def changed_by(update, folder):
    with closing(sqlite3.connect(folder / f"{folder.name}.db3")) as db:
        db.execute(update)
        db.commit()
    return folder


def test_messages_of_a_database_that_belong_to_no_topic(tmp_path):
    bag = changed_by("UPDATE messages SET topic_id = 9", rosbag2_folder(tmp_path / "bag", messages(50)))
    report = recover(bag / "bag.db3", tmp_path / "saved.mcap")
    assert (report.complete, report.out, report.files[0].lost) == (False, [], 50)
    assert report.files[0].problems == ["50 messages belong to no topic with a known definition"]


def test_compressed_files_are_recovered(tmp_path, scratch):
    rosbag2_folder(tmp_path / "bag", [("/n", STRING, string_cdr("x"), 1)], compression="file")
    assert recover(tmp_path / "bag", tmp_path / "saved.mcap").counts == {"/n": 1}
    chance = np.random.default_rng(4)
    given = [("/n", STRING, string_cdr(chance.bytes(1000).hex()), i) for i in range(600)]
    whole = write_with_mcap(tmp_path / "a.mcap", given, compression="none", chunk_size=6000)
    packed = zstandard.compress(whole.read_bytes())
    (tmp_path / "b.mcap.zstd").write_bytes(packed[: len(packed) * 2 // 3])
    seen = []
    report = recover(tmp_path / "b.mcap.zstd", tmp_path / "c.mcap", progress=lambda *at: seen.append(at))
    saved = read(tmp_path / "c.mcap")
    assert 100 < len(saved) < 600
    assert saved == expected(given)[: len(saved)]
    assert not report.complete
    assert all(done <= total for done, total in seen)
    assert list(scratch.iterdir()) == []


def test_a_compressed_message_that_is_damaged_costs_only_itself(tmp_path):
    given = messages(20)
    bag = rosbag2_folder(tmp_path / "bag", given, compression="message")
    report = recover(
        changed_by("UPDATE messages SET data = x'00112233' WHERE id IN (3, 7)", bag), tmp_path / "saved.mcap"
    )
    assert read(tmp_path / "saved.mcap") == expected(given[:2] + given[3:6] + given[7:])
    assert report.files[0].problems == ["2 compressed messages are damaged"]
    assert report.files[0].lost == 2


def test_offers_times_and_unknown_types_are_kept(tmp_path):
    """QoS profiles written as numbers before version 9 become names."""
    infinite = {"sec": 9223372036, "nsec": 854775807}
    same = {"depth": 7, "deadline": {"sec": 1, "nsec": 2}, "avoid_ros_namespace_conventions": False}
    same |= {"lifespan": infinite, "liveliness_lease_duration": infinite}
    old = same | {"history": 1, "reliability": 2, "durability": 1, "liveliness": 1}
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("my_msgs/msg/Load", "ros2msg", b"float64 mass\n")
        extra = {"offered_qos_profiles": yaml.safe_dump([old]), "topic_type_hash": "RIHS01_" + "0" * 64}
        channel = writer.register_channel("/load", "cdr", schema, extra)
        writer.add_message(channel, 3, b"\0\1\0\0" + bytes(8), 2)
        writer.finish()
    recover(tmp_path / "a.mcap", tmp_path / "saved")
    with BagReader(tmp_path / "saved") as reader:
        (topic,), (batch,) = reader.topics, reader.batches()
    assert topic.definition == Definition(topic.type_name, "float64 mass\n", "ros2msg", "RIHS01_" + "0" * 64)
    assert (batch.log_time.tolist(), batch.publish_time.tolist()) == ([3], [2])
    new = {"history": "keep_last", "reliability": "best_effort", "durability": "transient_local"}
    assert yaml.safe_load(topic.offers) == [same | new | {"liveliness": "automatic"}]


@pytest.mark.parametrize("name", ["c.mcap", "c"])
@pytest.mark.parametrize("keep", [0, 5, 60])
def test_where_nothing_can_be_saved_nothing_is_left(tmp_path, name, keep):
    path = write_with_mcap(tmp_path / "a.mcap", messages(3))
    report = recover(cut_end(path, tmp_path / "b.mcap", keep=keep), tmp_path / name)
    assert report.statement()[0] == "saved 0 messages"
    assert not report.complete
    assert report.out == []
    assert {p.name for p in tmp_path.iterdir()} == {"a.mcap", "b.mcap"}
    recover(path, tmp_path / name)  # an older result stays
    recover(tmp_path / "b.mcap", tmp_path / name, overwrite=True)
    assert read(tmp_path / name) == expected(messages(3))


def test_a_whole_bag_without_messages_stays_one(tmp_path):
    with BagWriter(tmp_path / "a.mcap"):
        pass
    report = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert report.complete
    with BagReader(tmp_path / "b.mcap") as reader:
        assert (reader.problems, reader.message_count) == ([], 0)


def test_messages_without_a_declared_topic_are_counted(tmp_path):
    """The chunk with the schemas is damaged, and no summary repeats them."""
    path = write_with_mcap(tmp_path / "a.mcap", messages(), chunk_size=6000)
    data = bytearray(path.read_bytes())
    data[sections_of(path)[0].offset + 20] ^= 1
    path.write_bytes(data)
    report = recover(cut_end(path, tmp_path / "b.mcap"), tmp_path / "c.mcap")
    assert report.counts == {}
    assert 500 < report.files[0].lost < 600  # the damaged chunk's count is unknown
    assert not (tmp_path / "c.mcap").exists()
    assert any("no topic" in p for p in report.files[0].problems)


def test_a_bag_that_does_not_read_back_is_an_error(tmp_path, monkeypatch):
    path = write_with_mcap(tmp_path / "a.mcap", messages(20))
    original, calls = BagWriter.write, []

    def careless(self, *message):
        calls.append(message)
        if len(calls) != 7:
            original(self, *message)

    monkeypatch.setattr(BagWriter, "write", careless)
    with pytest.raises(BagError, match="holds 19 messages instead of 20"):
        recover(path, tmp_path / "b.mcap")
    with BagReader(tmp_path / "b.mcap") as reader:
        assert reader.problems  # the copy must not pass as whole


def full_after(size, monkeypatch):
    """Simulate a disk with limited room for each file [byte]."""
    write = os.write

    def limited(fd, data):
        if os.fstat(fd).st_size + len(data) > size:
            write(fd, data[: max(0, size - os.fstat(fd).st_size)])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(fd, data)

    monkeypatch.setattr(os, "write", limited)


@pytest.mark.parametrize("name", ["b.mcap", "b"])
def test_a_full_disk_leaves_nothing_that_passes_for_whole(tmp_path, monkeypatch, name):
    """The copy is incomplete even if the end of the file fits afterwards; an older result stays."""
    path, old = write_with_mcap(tmp_path / "a.mcap", messages(20_000)), tmp_path / "old.mcap"
    write_with_mcap(old, messages(3))
    before = old.read_bytes()
    with monkeypatch.context() as patch:
        full_after(60_000, patch)
        with pytest.raises(BagError, match="No space left"):
            recover(path, tmp_path / name)
        with pytest.raises(BagError, match=r"old\.mcap: No space left .*; what was there before is kept"):
            recover(path, old, overwrite=True)
    with BagReader(tmp_path / name) as reader:
        assert reader.problems
    assert not recover(tmp_path / name, tmp_path / "c.mcap").complete
    assert old.read_bytes() == before
    assert recover(path, old, overwrite=True).out == [old]
    assert len(read(old)) == 20_000
    # On a busy machine, a chunk closed by its age may fit on the disk.
    assert {p.name for p in tmp_path.iterdir()} - {"c.mcap"} == {"a.mcap", name, "old.mcap"}


@pytest.mark.parametrize("chunked", [True, False])
def test_a_message_with_an_impossible_time_costs_only_itself(tmp_path, chunked):
    given = messages(90)
    given[40] = (*given[40][:3], 2**64 - 1)
    path = write_with_mcap(tmp_path / "a.mcap", given, chunk_size=6000, chunked=chunked)
    with pytest.raises(BagError, match="beyond the year 2262"), BagReader(path) as reader:
        list(reader.batches())
    report = recover(path, tmp_path / "b.mcap")
    assert read(tmp_path / "b.mcap") == expected(given[:40] + given[41:])
    assert (report.files[0].messages, report.files[0].lost) == (89, 1)
    assert report.statement()[2:4] == [
        "a.mcap: 1 messages have a time beyond the year 2262",
        "a.mcap: at least 1 messages are lost",
    ]


def test_a_damaged_summary_is_told(tmp_path):
    """Any bit of it may be damaged: here one in a topic's name, and one in a count."""
    path = write_with_mcap(tmp_path / "a.mcap", messages(50), chunk_size=4000)
    data = path.read_bytes()
    (summary,) = struct.unpack("<Q", data[-28:-20])
    for place in (data.index(b"/j", summary), data.index(struct.pack("<Q", 50), summary)):
        changed = bytearray(data)
        changed[place] ^= 1
        path.write_bytes(changed)
        report = recover(path, tmp_path / "b.mcap", overwrite=True)
        assert report.counts == {"/j": 50}
        assert report.files[0].problems == ["is damaged: the checksum of its summary is wrong"]
        with BagReader(path) as reader:
            assert reader.problems == ["a.mcap: is damaged: the checksum of its summary is wrong"]
            assert [(t.name, t.count) for t in reader.topics] == [("/j", 50)]


def test_what_stands_before_the_messages_holds_beside_a_damaged_summary(tmp_path):
    """The summary lost its end and its checksum, and it names no encoding for the topic."""
    path = write_with_mcap(tmp_path / "a.mcap", messages(50), chunked=False)
    data = bytearray(path.read_bytes())
    (summary,) = struct.unpack("<Q", data[-28:-20])
    encoding = data.index(b"cdr", summary)
    data[encoding : encoding + 3] = bytes(3)
    path.write_bytes(data[:-40])
    recover(path, tmp_path / "b.mcap")
    for bag in (path, tmp_path / "b.mcap"):
        with BagReader(bag) as reader:
            assert [(t.name, t.type_name, t.count) for t in reader.topics] == [("/j", JOINT_STATE, 50)]


def test_what_no_checksum_covers_is_unverified(tmp_path):
    write_with_mcap(tmp_path / "a.mcap", messages(50), chunked=False)
    rosbag2_folder(tmp_path / "b", messages(50))
    for bag, file in (("a.mcap", "a.mcap"), ("b", "b.db3")):
        report = recover(tmp_path / bag, tmp_path / "out.mcap", overwrite=True)
        assert report.complete
        unverified = f"{file}: unverified: 50 messages have no checksum"
        assert report.statement()[-2:] == [unverified, "nothing is known to be missing"]
        assert report.as_dict()["files"][0]["unverified"] == 50


def test_a_definition_that_cannot_be_understood_is_unverified(tmp_path):
    known = Definition("own_msgs/msg/Own", "%%%\n")
    with BagWriter(tmp_path / "a.mcap") as writer:
        writer.write("/own", known.type_name, b"\0\1\0\0", 5, known=known)
    report = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert (report.counts, report.as_dict()["unknown"]) == ({"/own": 1}, ["/own"])
    assert report.statement()[-2:] == [
        "/own: unverified: its definition cannot be understood",
        "nothing is known to be missing",
    ]


LONG = 14 << 20  # [byte]


@pytest.fixture(scope="module")
def long_message():
    """A String as long as an image, which no compression shrinks to a thousandth."""
    return string_cdr(np.random.default_rng(LONG).integers(32, 96, LONG, np.uint8).tobytes().decode())


def with_long_messages(long, path, storage):
    """A bag with two long messages among small ones: its path and its messages."""
    given = messages(300)
    given[200:200] = [("/image", STRING, long, 199 * MS), ("/image", STRING, long, 200 * MS)]
    if storage in ("sqlite", "message"):
        return rosbag2_folder(path, given, compression=storage.replace("sqlite", "none")), given
    chunk = 3 * LONG if storage == "together" else 4000
    kind = storage if storage in ("lz4", "none") else "zstd"
    options = {"compression": kind, "chunk_size": chunk, "chunked": storage != "no chunks"}
    return write_with_mcap(path.with_suffix(".mcap"), given, **options), given


@pytest.mark.parametrize("storage", ["zstd", "lz4", "none", "together", "no chunks", "sqlite", "message"])
def test_long_messages_are_copied_bit_by_bit(tmp_path, long_message, storage):
    """Long messages are not held while another topic is read; `peak_of` does not see SQLite's memory."""
    path, given = with_long_messages(long_message, tmp_path / "bag", storage)
    report, most = peak_of(lambda: recover(path, tmp_path / "saved.mcap"))
    assert report.complete
    assert read(tmp_path / "saved.mcap") == expected(given)
    with BagReader(path) as reader:
        found, peak = peak_of(lambda: sum(len(batch) for batch in reader.batches(["/j"])))
        assert (found, reader.problems) == (300, [])
    if hasattr(sqlite3.Connection, "blobopen") or "mcap" in path.suffix:  # Python 3.10 reads rows whole
        assert max(most, peak) < LONG
    with BagReader(tmp_path / "saved.mcap") as reader:
        assert [bytes(d) for b in reader.batches(["/image"]) for d in b.messages()] == [long_message] * 2


def test_a_long_message_in_a_chunk_that_is_cut_off(tmp_path, long_message):
    """Messages that are complete before the cut are saved, and the rest is reported."""
    path, given = with_long_messages(long_message, tmp_path / "bag", "together")
    keep = path.stat().st_size * 7 // 10
    report = recover(cut_end(path, tmp_path / "b.mcap", keep=keep), tmp_path / "saved.mcap")
    assert not report.complete
    assert read(tmp_path / "saved.mcap") == expected(given)[:201]


def test_a_disk_that_is_full_in_a_long_message(tmp_path, monkeypatch, long_message):
    """Earlier chunks stay whole; the unfinished one is removed."""
    with BagWriter(tmp_path / "a.mcap", compression="none", chunk_size=1 << 20) as writer:
        writer.write("/n", STRING, string_cdr("before"), 1)
        writer.flush()
        size = (tmp_path / "a.mcap").stat().st_size
        with monkeypatch.context() as patch:
            full_after(size + LONG // 2, patch)
            with pytest.raises(BagError, match="No space left"):
                writer.write("/n", STRING, long_message, 2)
        assert (tmp_path / "a.mcap").stat().st_size == size
    assert recover(tmp_path / "a.mcap", tmp_path / "b.mcap").counts == {"/n": 1}


def test_a_message_that_no_reader_would_take_is_lost_and_told(tmp_path, monkeypatch, long_message):
    monkeypatch.setattr(sys.modules["hd_diag.bag.recover"], "MAX_MESSAGE", LONG)
    path, _ = with_long_messages(long_message, tmp_path / "bag", "sqlite")
    report = recover(path, tmp_path / "saved.mcap")
    assert (report.complete, report.files[0].lost, report.counts) == (False, 2, {"/j": 300})


def test_a_chunk_on_disk_is_taken_piece_by_piece():
    content = np.random.default_rng(0).bytes(1_000_000)
    disk = OnDisk(Content(iter([content]), len(content)))
    disk.skip(300_000)
    assert [disk.take(400_000), disk.take(400_000), disk.take(1)] == [
        content[300_000:700_000],
        content[700_000:],
        b"",
    ]
