"""Speed of the bag edge against `rosbags` and `mcap_ros2`, measured in one run on the same file.

    python bench/bench_bag.py [--messages N] [--joints K]

Prints messages/s of each way, best of three, and ratios to the faster of the two libraries.
"""

# ruff: noqa: D103, T201

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from hd_diag.bag import BagReader, BagWriter, recover
from hd_diag.messages.encoding import encode_float64_multiarray, encode_joint_states
from hd_diag.messages.joint_states import JointStateDecoder
from hd_diag.messages.schemas import definition

JOINT_STATE = "sensor_msgs/msg/JointState"
PERIOD = 1_000_000


def read_columns(path, grouped=False):
    count = 0
    with BagReader(path) as reader:
        for batch in reader.batches(["/joint_states"], grouped=grouped):
            columns, rejected = reader.joint_states(batch)
            assert not rejected
            count += sum(len(c.stamp) for c in columns)
    return count


def read_rosbags(path):
    count = 0
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/joint_states"]
        for connection, _, data in reader.messages(wanted):
            reader.deserialize(data, connection.msgtype)
            count += 1
    return count


def read_mcap_ros2(path):
    count = 0
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _ in reader.iter_decoded_messages(topics=["/joint_states"]):
            count += 1
    return count


def rate(action, count, repeats=3):
    """Items per second, the best of some runs."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin)
    return count / min(times)


def compare_reading(name, path, count):
    assert read_columns(path) == read_rosbags(path) == read_mcap_ros2(path) == count
    ours = rate(lambda: read_columns(path), count)
    rosbags = rate(lambda: read_rosbags(path), count)
    mcap_ros2 = rate(lambda: read_mcap_ros2(path), count, 1)
    best = max(rosbags, mcap_ros2)
    print(
        f"read {name:34s} {ours / 1e3:8.0f} k/s | rosbags {rosbags / 1e3:5.0f} k/s | "
        f"mcap_ros2 {mcap_ros2 / 1e3:5.0f} k/s | ratio {ours / best:5.1f}"
    )


def write_mcap(path, block, stamps):
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start("ros2")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition(JOINT_STATE).text.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for row, stamp in zip(block, stamps.tolist(), strict=True):
            writer.add_message(channel, stamp, row.tobytes(), stamp)
        writer.finish()


def write_singly(path, block, stamps):
    with BagWriter(path, overwrite=True) as writer:
        for row, stamp in zip(block, stamps.tolist(), strict=True):
            writer.write("/joint_states", JOINT_STATE, row.tobytes(), stamp)


def write_rows(path, block, stamps):
    with BagWriter(path, overwrite=True) as writer:
        writer.write_many("/joint_states", JOINT_STATE, block, stamps)


def write_like_the_node(path, block, stamps, other):
    """Two topics that alternate, a chunk each quarter of a second of log time."""
    with BagWriter(path, overwrite=True) as writer:
        for i, stamp in enumerate(stamps.tolist()):
            writer.write("/joint_states", JOINT_STATE, block[i].tobytes(), stamp)
            writer.write("/hd_diag/transmission_error", JOINT_STATE, other[i].tobytes(), stamp)
            if i % 250 == 249:
                writer.flush()


def single_messages(names, position):
    values = [position[None]] * 3
    data = encode_joint_states(names, [5], *values)[0].tobytes()
    decoder, turns = JointStateDecoder(), 20_000
    array, dims = np.zeros((1, 2, 200)), (("flank", 2), ("tooth", 200))
    ways = {
        "decode one JointState": lambda: decoder.decode(data),
        "encode one JointState": lambda: encode_joint_states(names, [5], *values),
        "encode one 2 x 200 Float64MultiArray": lambda: encode_float64_multiarray(dims, array),
    }
    for name, way in ways.items():
        print(f"{name:40s} {1e6 / rate(lambda way=way: [way() for _ in range(turns)], turns):6.2f} us")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=200_000)
    parser.add_argument("--joints", type=int, default=3)
    options = parser.parse_args()
    count, names = options.messages, tuple(f"joint_{i}" for i in range(options.joints))
    values = np.random.default_rng(0).normal(size=(3, count, options.joints))
    stamps = PERIOD * np.arange(count)
    block, other = (
        encode_joint_states(names, stamps, *values),
        encode_joint_states(names[:1], stamps, values[0, :, :1]),
    )
    print(f"{count} JointStates of {options.joints} joints, {block.shape[1]} bytes each")
    encoded = rate(lambda: encode_joint_states(names, stamps, *values), count)
    print(f"{'encode columns':40s} {encoded / 1e3:8.0f} k/s")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        base = rate(lambda: write_mcap(path, block, stamps), count, 1)
        for name, way in (("write one by one", write_singly), ("write rows", write_rows)):
            ours = rate(lambda way=way: way(path, block, stamps), count)
            print(f"{name:40s} {ours / 1e3:8.0f} k/s | mcap {base / 1e3:.0f} k/s | ratio {ours / base:.1f}")
        for compression in ("zstd", "lz4", "none"):
            with BagWriter(path, overwrite=True, compression=compression) as writer:
                writer.write_many("/joint_states", JOINT_STATE, block, stamps)
            compare_reading(f"one topic, {compression}", path, count)
        write_like_the_node(path, block, stamps, other)
        compare_reading("log of the node, its input", path, count)
        done = rate(lambda: recover(path, Path(folder) / "b.mcap", overwrite=True), 2 * count, 1)
        print(f"{'recover the log of the node':40s} {done / 1e3:8.0f} k/s")
    single_messages(names, values[0, 0])


if __name__ == "__main__":
    main()
