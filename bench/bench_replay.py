"""Bags for bench/suite.py, and reading them with `rosbags` and with this package.

A joint of the example drive with output angle and torque. The best of several, by CPU time of the process.
"""

# ruff: noqa: D103

import time

import numpy as np
from rosbags.highlevel import AnyReader

from hd_diag.bag import BagReader, BagWriter
from hd_diag.messages.encoding import encode_joint_states

JOINT_STATE = "sensor_msgs/msg/JointState"
START = 1_700_000_000_000_000_000


def simulated(path, seconds, rate):
    """A joint that turns to and fro."""
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


def cpu_time(action, repeats=3):
    """Least of several, of all threads [s]."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return min(times)
