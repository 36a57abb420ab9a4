"""Sections of bench/suite.py that start processes: bags from reading to diagnosis, and the node."""

# ruff: noqa: D103

from __future__ import annotations

import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from timing import median_time, one_core, wall_time

from hd_diag.bag import BagReader, BagWriter
from hd_diag.config.configuration import resolve
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.replay.replay import replay

ROOT = Path(__file__).resolve().parent.parent


class Skipped(Exception):
    """A section that cannot be measured here."""


HOUR = 3600.0  # [s]
RATE = 1000.0  # [Hz]
LOGGED, SECTIONS = "hd_diag, log on", (1, 3, 5)  # the node's label, and sections of its drives
DIAGNOSED = 120.0  # [s]
DIAGNOSED_RATE = 500.0  # [Hz]
JOINT_STATE = "sensor_msgs/msg/JointState"
START = 1_700_000_000_000_000_000  # [ns]


def bags(options):
    """Reading, replay and diagnosis, in CPU time per hour of a joint's record at 1 kHz."""
    seconds = options.seconds
    note = f"from {seconds:g} s"
    with tempfile.TemporaryDirectory() as folder:
        bag, out = Path(folder) / "bag.mcap", Path(folder) / "out.mcap"
        simulated(bag, seconds, RATE)
        rosbags = median_time(read_rosbags, bag)
        columns = median_time(read_columns, bag)
        config = resolve({})
        whole, watched = (
            timed(lambda: replay(bag, out, config, overwrite=True)) for timed in (median_time, wall_time)
        )
        per_hour = HOUR / seconds
        yield {
            "what": "reading with rosbags, per hour",
            "value": rosbags * per_hour,
            "unit": "s",
            "note": note,
        }
        yield {
            "what": "reading, per hour",
            **{"value": columns * per_hour, "unit": "s", "ratio": rosbags / columns, "against": "rosbags"},
            "note": note,
        }
        yield {
            "what": "replay, map included, per hour",
            **{"value": whole * per_hour, "unit": "s", "ratio": seconds / whole, "against": "real time"},
            **{"note": note, "aim": 300, "aim_unit": "x"},
        }
        yield {
            "what": "replay, map included, per hour, wall",
            **{"value": watched * per_hour, "unit": "s", "ratio": seconds / watched, "against": "real time"},
            **{"note": note, "aim": 300, "aim_unit": "x"},
        }
        yield from diagnosis(Path(folder))


def simulated(path, seconds, rate):
    """Write a bag of a joint that swings."""
    count = int(seconds * rate)
    stamps = START + np.round(1e9 / rate * np.arange(count)).astype(np.int64)
    time_, noise = np.arange(count) / rate, np.random.default_rng(0).normal(0.0, 1e-6, count)
    angle, torque = 40.0 * np.sin(0.3 * time_), 30.0 * np.sin(0.07 * time_)
    output = angle / 100.0 + 2e-5 * np.sin(2.0 * angle) + noise
    values = np.column_stack((angle, output)), None, np.column_stack((np.full(count, np.nan), torque))
    with BagWriter(path) as writer:
        rows = encode_joint_states(("joint_1_motor", "joint_1"), stamps, *values)
        writer.write_many("/joint_states", JOINT_STATE, rows, stamps)


def read_rosbags(path):
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)


def read_columns(path):
    with BagReader(path) as reader:
        for batch in reader.batches():
            reader.joint_states(batch)


def diagnosis(folder):
    """Diagnosis in a process of its own on one core, from the start of Python to its end."""
    bag, written = folder / "diagnosed.mcap", folder / "diagnosis.json"
    size = ("--duration", str(DIAGNOSED), "--rate", str(DIAGNOSED_RATE))
    truth = ("--eccentricity-um", "12", "--angle-noise-arcsec", "1")
    command("simulate", "--out", str(bag), *size, *truth)
    command("diagnose", str(bag))  # compiles what the disk cache lacks
    cpu, wall = command("diagnose", str(bag), "--json", str(written))
    if "verdict" not in json.loads(written.read_text()):
        raise AssertionError("no verdict")
    what = f"diagnosis of {DIAGNOSED:g} s at {DIAGNOSED_RATE:g} Hz, one core"
    yield {"what": f"{what}, CPU", "value": cpu, "unit": "s", "aim": 5, "aim_unit": "s"}
    yield {
        "what": f"{what}, wall",
        **{"value": wall, "unit": "s", "ratio": DIAGNOSED / cpu, "against": "real time, by CPU"},
    }
    per_hour = cpu * HOUR / DIAGNOSED * RATE / DIAGNOSED_RATE
    note = "as if it grew with the samples"
    yield {"what": "diagnosis, per hour of 1 kHz, at most", "value": per_hour, "unit": "s", "note": note}


def command(*arguments):
    """CPU and wall time [s] of one call of the command line on one core."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with one_core():
        run = [sys.executable, "-m", "hd_diag", *arguments]
        done = subprocess.run(run, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"hd-diag {arguments[0]} ended with {done.returncode}: {done.stderr[-500:]}")
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - start
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, wall


def node(options):
    """CPU of the node per message, compared with a node that does nothing (bench_node.py)."""
    if importlib.util.find_spec("rclpy") is None:
        raise Skipped("rclpy is not installed")
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "node.json"
        run = [sys.executable, str(ROOT / "bench/bench_node.py"), "--joints", "1", "7", "--seconds", "4"]
        run += ["--sections", *map(str, SECTIONS)]
        done = subprocess.run([*run, "--json", str(written)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"bench_node.py ended with {done.returncode}: {done.stderr[-500:]}")
        rows = json.loads(written.read_text())
    for row in rows:
        yield {
            "what": f"{row['node']}, {row['joints']} joint{'s' * (row['joints'] > 1)}, 1 kHz",
            **{"value": row["cpu_per_message_us"], "unit": "us", "ratio": row["beside_empty"]},
            **{"against": "empty rclpy node", "note": f"{row['lost']} lost" if row["lost"] else ""},
        }
    last = next(row for row in rows[::-1] if row["node"] == LOGGED)  # the row with the most joints
    for what, value, unit, aim in (
        ("part of the empty node's CPU", last["beside_empty"], "-", 0.7),
        ("share of a core", 100.0 * last["share_of_core"], "%", 30.0),
    ):
        label = f"{last['node']}, {last['joints']} joints, 1 kHz: {what}"
        yield {"what": label, "value": value, "unit": unit, "aim": aim, "aim_unit": unit}
    for row in rows:
        if row["node"].startswith(f"{LOGGED}, "):
            plane = next(r for r in rows if r["node"] == LOGGED and r["joints"] == row["joints"])
            yield {
                "what": f"{row['node']}, {row['joints']} joint{'s' * (row['joints'] > 1)}: share of a core",
                **{"value": 100.0 * row["share_of_core"], "unit": "%", "against": "one section"},
                "ratio": row["cpu_per_message_us"] / plane["cpu_per_message_us"],
            }


PROCESSES = {"bags": bags, "node": node}
