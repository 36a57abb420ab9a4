"""Speed of a full replay against real time, beside reading the same bag with `rosbags` and `mcap_ros2`.

    python bench/bench_replay.py [--seconds S] [--rate HZ] [--apart] [--json FILE]

A joint of the example drive at 1 kHz with output angle and torque; the replay writes everything that the node
publishes: transmission errors, residuals, per-tooth arrays at 20 Hz, diagnostics. The best of several, by CPU
time of the process (user and system, of all its threads) and by the clock, which needs two idle cores to mean
something; the map of the torsion is built anew each time and counted.
"""

# ruff: noqa: D103, T201

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from hd_diag.bag import BagReader, BagWriter
from hd_diag.config.configuration import resolve
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.replay.map_builder import map_of
from hd_diag.replay.replay import replay

JOINT_STATE = "sensor_msgs/msg/JointState"
START = 1_700_000_000_000_000_000


def simulated(path, seconds, rate, apart):
    """A joint that turns to and fro; with `apart` input and output come in messages of their own."""
    count = int(seconds * rate)
    stamps = START + np.round(1e9 / rate * np.arange(count)).astype(np.int64)
    time_, noise = np.arange(count) / rate, np.random.default_rng(0).normal(0.0, 1e-6, count)
    angle, torque = 40.0 * np.sin(0.3 * time_), 30.0 * np.sin(0.07 * time_)
    output = angle / 100.0 + 2e-5 * np.sin(2.0 * angle) + noise
    nothing = np.full(count, np.nan)
    with BagWriter(path) as writer:
        if not apart:
            values = np.column_stack((angle, output)), None, np.column_stack((nothing, torque))
            rows = encode_joint_states(("joint_1_motor", "joint_1"), stamps, *values)
            writer.write_many("/joint_states", JOINT_STATE, rows, stamps)
            return count
        inputs = encode_joint_states(("joint_1_motor",), stamps, angle[:, None])
        outputs = encode_joint_states(("joint_1",), stamps, output[:, None], None, torque[:, None])
        for i, stamp in enumerate(stamps.tolist()):
            writer.write("/joint_states", JOINT_STATE, inputs[i].tobytes(), stamp)
            writer.write("/joint_states", JOINT_STATE, outputs[i].tobytes(), stamp + 1000)
    return 2 * count


def read_rosbags(path):
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)


def read_mcap_ros2(path):
    with path.open("rb") as file:
        for _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            pass


def read_columns(path):
    with BagReader(path) as reader:
        for batch in reader.batches():
            reader.joint_states(batch)


def cpu_and_clock_time(action, repeats=3):
    """Least of each [s]."""
    times = []
    for _ in range(repeats):
        begin = time.process_time(), time.perf_counter()
        action()
        times.append((time.process_time() - begin[0], time.perf_counter() - begin[1]))
    return tuple(map(min, zip(*times, strict=True)))


def cpu_time(action, repeats=3):
    return cpu_and_clock_time(action, repeats)[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--apart", action="store_true", help="input and output in messages of their own")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    config = resolve({})
    with tempfile.TemporaryDirectory() as folder:
        bag, out = Path(folder) / "bag.mcap", Path(folder) / "out.mcap"
        count = simulated(bag, options.seconds, options.rate, options.apart)
        ways = {
            "rosbags": cpu_time(lambda: read_rosbags(bag), 1),
            "mcap_ros2": cpu_time(lambda: read_mcap_ros2(bag), 1),
            "hd_diag, columns": cpu_time(lambda: read_columns(bag)),
        }
        table = cpu_time(lambda: map_of(config.joints[0]))
        took, clock = cpu_and_clock_time(lambda: replay(bag, out, config, overwrite=True), 5)
        written = replay(bag, out, config, overwrite=True).written
        size = out.stat().st_size
    result = {
        "seconds": options.seconds,
        "messages": count,
        "written": written,
        "output_bytes": size,
        "replay_cpu_seconds": took,
        "replay_clock_seconds": clock,
        "times_real_time": options.seconds / took,
        "times_real_time_by_the_clock": options.seconds / clock,
        "times_real_time_without_map": options.seconds / (took - table),
        "map_cpu_seconds": table,
        "messages_per_second": count / took,
        "reading_messages_per_second": {name: count / seconds for name, seconds in ways.items()},
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    print(f"{count} messages of {options.seconds:g} s")
    for name, rate in result["reading_messages_per_second"].items():
        print(f"read with {name:18s} {rate / 1e3:8.0f} k messages/s")
    print(
        f"replay {result['messages_per_second'] / 1e3:8.0f} k messages/s, {written} written: "
        f"{result['times_real_time']:.0f} times real time by CPU time, "
        f"{result['times_real_time_without_map']:.0f} beside the map ({table:.2f} s); "
        f"{result['times_real_time_by_the_clock']:.0f} times by the clock; "
        f"peak memory {result['peak_memory_mb']:.0f} MB"
    )
    if options.json:
        Path(options.json).write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
