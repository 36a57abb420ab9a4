"""Hostile bags always lead to BagError, in bounded time and memory."""

import itertools
import random
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from bag_samples import STRING, accepts, consume, corpus, damaged, peak_of, rosbag2_folder, string_cdr
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from hd_diag.bag import BagError, BagReader, BagWriter, recover
from hd_diag.bag.mcap_chunk import MAX_CHUNK, MESSAGE
from hd_diag.bag.mcap_scan import MAGIC
from hd_diag.messages.schemas import definition


def record(opcode, content):
    return bytes([opcode]) + struct.pack("<Q", len(content)) + content


def packed(*records):
    builder = RecordBuilder()
    for r in records:
        r.write(builder)
    return builder.end()


def chunk(content, compression="", size=None, stored=None, checksum=None):
    stored = content if stored is None else stored
    size = len(content) if size is None else size
    checksum = zlib.crc32(content) if checksum is None else checksum
    record_of = {"uncompressed_size": size, "uncompressed_crc": checksum}
    return packed(Chunk(compression, stored, 9, 0, **record_of))


def message(channel=1, data=None, log_time=1):
    data = string_cdr("x") if data is None else data
    return MESSAGE.pack(5, 22 + len(data), channel, 0, log_time, 0) + data


def topic(name="/n", kind=STRING, text=None, schema_encoding="ros2msg", **metadata):
    text = definition(STRING).text if text is None else text
    return packed(Schema(1, text.encode(), schema_encoding, kind), Channel(1, name, "cdr", metadata, 1))


def bag(*parts):
    return MAGIC + packed(Header("ros2", "")) + b"".join(parts)


def test_the_parts_make_a_bag(tmp_path):
    path = tmp_path / "a.mcap"
    content = topic() + message()
    stream = zstandard.ZstdCompressor().compressobj()  # omits the size from the frame
    streamed = chunk(content, "zstd", stored=stream.compress(content) + stream.flush())
    zstd = chunk(content, "zstd", stored=zstandard.compress(content))
    path.write_bytes(bag(chunk(content), zstd, message()))
    assert consume(path) == 3
    path.write_bytes(bag(chunk(content, "lz4", stored=lz4.frame.compress(content)), streamed))
    assert consume(path) == 2


def bomb(size):
    return zstandard.ZstdCompressor(level=19).compress(bytes(size))


def odd(text="", kind="x_msgs/msg/X", data=None, **options):
    return bag(chunk(topic(kind=kind, text=text, **options) + message(data=data)))


EMPTY_ARRAY = f"x_msgs/E[] x\n{'=' * 80}\nMSG: x_msgs/E\nfloat64[0] y\n"
HOSTILE = {
    "huge chunk record": lambda: bag(topic(), b"\x06" + struct.pack("<Q", 2**60) + bytes(100)),
    "huge size": lambda: bag(topic(), chunk(b"", "zstd", size=2**60, stored=zstandard.compress(b""))),
    "size beyond the limit": lambda: bag(
        chunk(topic(), "zstd", size=(1 << 30) + 1, stored=zstandard.compress(topic()))
    ),
    "size larger than content": lambda: bag(chunk(topic() + message(), size=1 << 29)),
    "zstd bomb": lambda: bag(chunk(topic(), "zstd", stored=bomb(1 << 28))),
    "zstd bomb as declared too large": lambda: bag(chunk(b"", "zstd", size=1 << 40, stored=bomb(1 << 26))),
    "lz4 bomb": lambda: bag(chunk(topic(), "lz4", stored=lz4.frame.compress(bytes(1 << 27)))),
    "rubbish as zstd": lambda: bag(chunk(topic(), "zstd", stored=b"rubbish")),
    "rubbish as lz4": lambda: bag(chunk(topic(), "lz4", stored=b"rubbish")),
    "nothing as zstd": lambda: bag(chunk(topic(), "zstd", stored=b"")),
    "unknown compression": lambda: bag(chunk(topic(), "bz2")),
    "wrong checksum": lambda: bag(chunk(topic() + message(), checksum=1)),
    "record longer than the chunk": lambda: bag(
        chunk(topic() + b"\x05" + struct.pack("<Q", 2**62) + bytes(30))
    ),
    "cut record in a chunk": lambda: bag(chunk(topic() + message() + b"\x05\x01")),
    "message without times": lambda: bag(chunk(topic() + record(5, b"abc"))),
    "short message after others": lambda: bag(chunk(topic() + message() + record(5, b"abc") + message())),
    "message before 1970": lambda: bag(chunk(topic() + message(log_time=2**64 - 1))),
    "undeclared channel": lambda: bag(chunk(topic() + message(channel=7))),
    "unknown type": odd,
    "schema that is no schema": lambda: odd("§ $ %"),
    "schema that is no IDL": lambda: odd("module {", schema_encoding="ros2idl"),
    "schema that contains itself": lambda: odd("x_msgs/X x\n"),
    "schema with an empty array": lambda: odd(EMPTY_ARRAY, data=b"\0\1\0\0\xff\xff\xff\x7f"),
    "schema with a huge array": lambda: odd("string[1000000000] x\n"),
    "schema with a type that is missing": lambda: odd("y_msgs/Y y\n"),
    "type name with code": lambda: odd("float64 x\n", kind="x:\n import os\nclass Y"),
}


LIMITED = """
import resource, sys
sys.path.insert(0, {test!r})
from test_bag_hostile import HOSTILE, accepts, peak_of
resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))
for name in HOSTILE:
    with open({path!r}, "wb") as file:
        file.write(bytes.fromhex(sys.stdin.readline()))
    found, peak = peak_of(lambda: accepts({path!r}))
    print(name, found, peak < 100 << 20, sep=": ")
"""


def test_hostile_files_are_refused_or_read_in_part_in_little_memory(tmp_path):
    """1 GiB of address space suffices; Python and its libraries use most of it."""
    script = LIMITED.format(test=str(Path(__file__).parent), limit=1 << 30, path=str(tmp_path / "a.mcap"))
    lines = "".join(make().hex() + "\n" for make in HOSTILE.values())
    command = [sys.executable, "-c", script]
    result = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=60)
    found = {name: 0 if name == "huge chunk record" else None for name in HOSTILE}
    assert result.stdout.splitlines() == [f"{name}: {count}: True" for name, count in found.items()]
    assert result.stderr == ""


def test_deep_and_large_schemas(tmp_path):
    path = tmp_path / "a.mcap"
    deep = "".join(f"x_msgs/L{i} x\n{'=' * 80}\nMSG: x_msgs/L{i}\n" for i in range(3000)) + "float64 x\n"
    wanting = ("float64 x\n" * 200_000, *(many + "y_msgs/Y y\n" for many in ("\n" * 10**6, "#\n" * 500_000)))
    for text in (deep, *wanting):
        path.write_bytes(odd(text, data=bytes(8)))
        assert accepts(path) is None


def test_hostile_names_stay_on_one_line(tmp_path):
    name = "/\x1b[31m\n" + "a" * 1_000_000 + "\u202e"
    path = tmp_path / "a.mcap"
    path.write_bytes(bag(chunk(topic(name=name, text="§ $ %", kind="x_msgs/msg/X") + message())))
    with pytest.raises(BagError) as caught:
        consume(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 900


def recovered(path, out):
    """Check that a copy, if one is made, holds what the report says."""
    try:
        report = recover(path, out, overwrite=True)
    except BagError:
        return
    if not report.out:
        assert not report.counts
        return
    with BagReader(out) as reader:
        topics = [*reader.topics, *reader.foreign]
        assert {topic.name: topic.count for topic in topics if topic.count} == report.counts


@pytest.mark.parametrize("turns", [240, pytest.param(6000, marks=pytest.mark.slow)])
def test_damaged_bags_and_random_bytes(tmp_path, turns):
    chance, bags = random.Random(20), corpus(tmp_path)
    path, refused = tmp_path / "a.mcap", 0
    for turn in range(turns):
        path.write_bytes(damaged(bags[turn % len(bags)], chance))
        refused += accepts(path) is None
        if turn % 10 < 2:
            recovered(path, tmp_path / "b.mcap")
        content = chance.randbytes(chance.randrange(400))
        path.write_bytes([content, MAGIC + content, bag(content), bag(chunk(content))][turn % 4])
        accepts(path)
    assert turns / 12 < refused < turns


def test_damaged_databases(tmp_path):
    rosbag2_folder(tmp_path / "bag", [("/n", STRING, string_cdr(f"{i}"), i) for i in range(40)])
    data = (tmp_path / "bag" / "bag.db3").read_bytes()
    chance, path, refused = random.Random(23), tmp_path / "a.db3", 0
    for _ in range(50):
        path.write_bytes(data[:16] + damaged(data[16:], chance))
        refused += accepts(path) is None
    assert refused > 3


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_bombs_as_compressed_files(tmp_path, scratch, monkeypatch, suffix):
    """A file that only claims to be a bag does not fill the disk, and no temporary file remains."""
    monkeypatch.setattr("hd_diag.bag.folder._UNPACKED_LEAST", 1 << 20)
    path = tmp_path / f"a{suffix}.zstd"
    packed_zeros = bomb(1 << 26)
    for content in (packed_zeros, b"rubbish", b"", packed_zeros[:1000]):
        path.write_bytes(content)
        assert accepts(path) is None
        assert recover(path, tmp_path / "b.mcap").out == []
        assert list(scratch.iterdir()) == []
    path.write_bytes(packed_zeros)
    with pytest.raises(BagError, match="decompresses to more than 100 times its size"):
        BagReader(path)


def test_damaged_metadata(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/n", STRING, string_cdr("x"), 1)
    info = tmp_path / "bag" / "metadata.yaml"
    data, chance = info.read_bytes(), random.Random(24)
    for _ in range(30):
        info.write_bytes(damaged(data, chance))
        accepts(tmp_path / "bag")
    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(12)
    )
    own = "rosbag2_bagfile_information: {relative_file_paths: "
    nested = "x:\n  " + bomb.replace("\n", "\n  ") + f"\n{own}[*m], custom_data: {{a: *m}}}}"
    for text in (nested, "[" * 10**6, "- " * 10**6, own + "3}", "!!python/object:os.system {}", bomb):
        info.write_text(text)
        assert accepts(tmp_path / "bag") is None


def test_hostile_yaml_inside_a_file(tmp_path):
    """Deep nesting crashes libyaml's loader; repeated aliases grow without bound when written out."""
    pairs = itertools.pairwise("abcdefghijklmnopqrstuvwxyz")
    aliases = "- &a [x,x]\n" + "".join(f"- &{c} [*{b},*{b}]\n" for b, c in pairs)
    path = tmp_path / "a.mcap"
    repeated = f"- history: &a [1]\n  depth: {aliases!r}\n"
    for text in ("[" * 1_000_000, aliases, repeated, "- {history: [1]}", "- {history: 1, depth: .inf}"):
        own = packed(Metadata("rosbag2", {"serialized_metadata": text}))
        path.write_bytes(bag(own, chunk(topic(offered_qos_profiles=text) + message())))
        assert accepts(path) == 1
        assert recover(path, tmp_path / "b.mcap", overwrite=True).counts == {"/n": 1}


# Small files that claim large contents ---


@pytest.mark.parametrize("finished", [True, False])
def test_chunks_that_unpack_to_far_more_than_is_stored_are_not_unpacked(tmp_path, finished):
    """Each chunk states its true size; unpacked they hold 130 MB of messages."""
    content = topic() + message() * ((65 << 20) // len(message()))
    bomb = chunk(content, "zstd", stored=zstandard.compress(content))
    path = tmp_path / "a.mcap"
    path.write_bytes(bag(bomb, bomb, chunk(topic() + message())) if finished else bag(bomb, bomb))
    report, peak = peak_of(lambda: recover(path, tmp_path / "b.mcap"))
    told = [problem for problem in report.files[0].problems if "1000 times the" in problem]
    assert len(told) == 2
    assert all(f"it claims {len(content)} bytes" in problem for problem in told)
    assert report.counts == ({"/n": 1} if finished else {})
    assert peak < 20 << 20
    refused, peak = peak_of(lambda: accepts(path))
    assert refused is None
    assert peak < 20 << 20


def test_a_cut_chunk_is_not_unpacked_beyond_what_it_declares(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(bag(topic(), chunk(b"", "zstd", size=1000, stored=bomb(64 << 20))[:-9]))
    report, peak = peak_of(lambda: recover(path, tmp_path / "b.mcap"))
    assert (report.counts, peak < 20 << 20) == ({}, True)


def test_a_compressed_message_that_unpacks_to_far_more_is_refused(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/n", STRING, zstandard.compress(string_cdr("x" * (65 << 20))), 1)
    info = tmp_path / "bag" / "metadata.yaml"
    info.write_text(info.read_text().replace("compression_mode: ''", "compression_mode: message"))
    found, peak = peak_of(lambda: accepts(tmp_path / "bag"))
    assert found is None
    assert peak < 20 << 20


def test_a_chunk_of_records_that_are_none_takes_no_memory(tmp_path, monkeypatch):
    """Zeros are empty records of opcode 0. The reader skips unknown records, but only up to a limit."""
    path = tmp_path / "a.mcap"
    monkeypatch.setattr("hd_diag.bag.mcap_chunk._MAX_RECORDS", 50_000)
    for unknown, count in ((bytes(9), 10), (b"\x80" + bytes(8), 50_001), (message(data=b""), 50_001)):
        content = topic() + message() + unknown * count
        path.write_bytes(bag(chunk(content, "zstd", stored=zstandard.compress(content))))
        found, peak = peak_of(lambda: accepts(path))
        assert found is None
        assert peak < 3 * len(content) + (1 << 20)
    path.write_bytes(bag(chunk(topic() + message() + (b"\x80" + bytes(8)) * 1000 + message())))
    assert consume(path) == 2


def test_a_huge_message_outside_of_chunks_is_not_read(tmp_path):
    path = tmp_path / "a.mcap"
    content = bag(topic(), message(), b"\x05" + struct.pack("<Q", MAX_CHUNK + 1))
    path.write_bytes(content)
    with path.open("r+b") as file:
        file.truncate(len(content) + MAX_CHUNK + 1)  # sparse
    report, peak = peak_of(lambda: recover(path, tmp_path / "b.mcap"))
    assert report.counts == {"/n": 1}
    assert "it claims" in report.files[0].problems[0]
    assert peak < 150 << 20


def test_many_small_messages_take_little_memory_to_recover(tmp_path):
    """All messages have the same time, so reading in time order would hold all of them at once."""
    content = topic() + b"".join(message(data=bytes(4 + i % 2)) for i in range(60_000))
    path = tmp_path / "a.mcap"
    path.write_bytes(bag(chunk(content, "zstd", stored=zstandard.compress(content))))
    report, peak = peak_of(lambda: recover(path, tmp_path / "b.mcap"))
    assert report.counts == {"/n": 60_000}
    assert peak < 5.5 * len(content)
