"""Messages and bags for the tests of reading and writing bags."""

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from hd_diag.bag import RELIABLE, BagError, BagReader
from hd_diag.bag.rosbag2 import dump_offers
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.schemas import definition, jazzy, serialize

JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
NAMES = ("joint_1_motor", "joint_1")
MS = 1_000_000


def joint_state(names, stamp=0, position=(), velocity=(), effort=(), frame_id=""):
    """JointState object of rosbags; stamp [ns]."""
    types = jazzy().types
    time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
    header = types["std_msgs/msg/Header"](time, frame_id)
    arrays = [np.array(a, np.float64) for a in (position, velocity, effort)]
    return types[JOINT_STATE](header, list(names), *arrays)


def joint_state_cdr(*args, little_endian=True, **keywords):
    message = joint_state(*args, **keywords)
    return bytes(jazzy().serialize_cdr(message, JOINT_STATE, little_endian=little_endian))


def string_cdr(text):
    return serialize(jazzy().types[STRING](text), STRING)


def rows(count, start=0, names=NAMES, period=MS):
    """`count` JointState messages, each with other positions; stamps from `start` [ns]."""
    stamps = start + period * np.arange(count)
    number = np.arange(count, dtype=float)[:, None]
    position = number + np.arange(len(names)) / 10
    return encode_joint_states(names, stamps, position, -position, None), stamps


def write_with_mcap(
    path, messages, *, compression="zstd", chunk_size=1 << 20, indexes=True, chunked=True, summary=True
):
    """Write (topic, type, data, log time) with the mcap library and the requested parts of a file."""
    kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
    with Path(path).open("wb") as file:
        writer = Writer(
            file,
            chunk_size=chunk_size,
            compression=kinds[compression],
            index_types=IndexType.ALL if indexes else IndexType.NONE,
            use_chunking=chunked,
            use_statistics=summary,
            repeat_channels=summary,
            repeat_schemas=summary,
            use_summary_offsets=summary,
        )
        writer.start("ros2")
        channels = {}
        for topic, kind, data, time in messages:
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", definition(kind).text.encode())
                offers = {"offered_qos_profiles": dump_offers([RELIABLE])}
                channels[topic] = writer.register_channel(topic, "cdr", schema, offers)
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return Path(path)


def rosbag2_folder(folder, messages, *, plugin=StoragePlugin.SQLITE3, version=9, compression="none"):
    """Write (topic, type, data, log time) with rosbags, as rosbag2 does."""
    writer = RosbagsWriter(folder, version=version, storage_plugin=plugin)
    writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for topic, kind, data, time in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=jazzy())
            writer.write(topics[topic], time, data)
    return Path(folder)


def cut_end(path, out, *, keep=None):
    """Copy of an MCAP file without its end: up to the data end record, or the first `keep` bytes."""
    data = Path(path).read_bytes()
    if keep is None:
        summary = struct.unpack("<Q", data[-28:-20])[0]
        keep = (summary or len(data) - 37) - 13
    Path(out).write_bytes(data[:keep])
    return Path(out)


def sealed(data):
    """MCAP file with a checksum that fits its present summary."""
    start, end = struct.unpack("<Q", data[-28:-20])[0], len(data) - 12
    return data[:end] + struct.pack("<I", zlib.crc32(data[start:end])) + data[-8:]


def consume(path):
    """Use everything that a bag offers."""
    with BagReader(path) as reader:
        for batch in reader.batches():
            if batch.topic.type_name == JOINT_STATE:
                reader.joint_states(batch)
            else:
                reader.deserialize(batch)
        return reader.message_count


def accepts(path):
    """Number of messages, or None if the bag is refused with a BagError."""
    try:
        return consume(path)
    except BagError as exc:
        if "\n" in str(exc) or len(str(exc)) > 900:
            raise AssertionError(f"not one short line: {exc}") from exc
        return None


def corpus(folder):
    """Small bags of each kind, as bytes."""
    block, stamps = rows(12)
    given = [("/j", JOINT_STATE, block[i].tobytes(), int(stamps[i])) for i in range(12)]
    given += [("/n", STRING, string_cdr(f"n{i}"), i) for i in range(5)]
    kinds = [{"compression": name} for name in ("zstd", "lz4", "none")] + [{"chunked": False}]
    return [
        write_with_mcap(folder / f"{i}.mcap", given, chunk_size=400, **options).read_bytes()
        for i, options in enumerate(kinds)
    ]


def damaged(data, chance):
    """Copy with some bytes flipped, cut out, repeated or overwritten by numbers that lengths might have."""
    data = bytearray(data or b"\0")
    for _ in range(chance.randint(1, 4)):
        place = chance.randrange(len(data))
        kind = chance.randrange(5)
        if kind == 0:
            data[place] ^= 1 << chance.randrange(8)
        elif kind == 1:
            data[place : place + chance.randint(1, 40)] = b""
        elif kind == 2:
            data[place:place] = data[place : place + chance.randint(1, 40)]
        elif kind == 3:
            value = chance.choice([0, 1, 2**31, 2**32 - 1, 2**40, 2**60, 2**63, 2**64 - 1])
            data[place : place + 8] = struct.pack("<Q", value)
        else:
            data = data[:place]
        if not data:
            data = bytearray(b"\0")
    return bytes(data)


def peak_of(action):
    """Result of the action and the additional memory that it takes at most [byte]."""
    tracemalloc.start()
    try:
        return action(), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
