"""The publisher of bench/soak.py, in a process of its own.

    python bench/soak_publisher.py NUMBER JOINTS RATE FILE

Publishes until SIGTERM; the file gets the stamp of each message and when it was sent [ns]. A line on the
standard input sets its clock by so many seconds.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from bench_node import DEPTH, names
from rclpy.duration import Duration
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from hd_diag.messages.encoding import encode_joint_states

LATE = 0.1  # what is made up for where the machine kept it waiting [s]
ERROR, NOISE = 2e-5, 2e-6  # of the outputs: amplitude of order 2 of the input, standard deviation [rad]
END_LIMIT = 60.0  # for the node to have all [s]


def publish(joints: int, rate: float, number: int, file: Path) -> None:
    """Publish until SIGTERM; the file gets the stamp of each message and when it was sent [ns].

    A line on the standard input sets the clock by so many seconds.
    """
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    clock: list[float] = []
    threading.Thread(target=lambda: [clock.append(float(line)) for line in sys.stdin], daemon=True).start()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    publisher = rclpy.create_node("robot").create_publisher(JointState, "joint_states", DEPTH)
    while not publisher.get_subscription_count() and not ended:
        time.sleep(0.01)
    step, offset, last, sent = round(1e9 / rate), 0, 0, 0
    with file.open("wb") as record:
        while not ended:
            if clock:
                offset, last = offset + round(clock.pop() * 1e9), 0
                number += 1000  # no stamp is given twice
            begin, first = time.perf_counter(), time.time_ns() + offset
            first = max(first - first % step + number % step, last + step)
            rows, stamps = block(joints, sent, first, step)
            done = []
            for i, row in enumerate(rows):
                time.sleep(max(0.0, begin + i * step * 1e-9 - time.perf_counter()))
                if ended or time.perf_counter() > begin + i * step * 1e-9 + LATE:
                    break
                publisher.publish(row)
                done.append((stamps[i], time.time_ns()))
            last, sent = done[-1][0] if done else last, sent + len(done)
            record.write(np.array(done, np.int64).tobytes())
            record.flush()
    publisher.wait_for_all_acked(Duration(seconds=END_LIMIT))


def block(joints: int, sent: int, first: int, step: int, size: int = 250) -> tuple[list[bytes], list[int]]:
    """Messages of joints that swing, with an error that repeats and noise, and their stamps."""
    stamp = first + step * np.arange(size)
    time_ = step * 1e-9 * (sent + np.arange(size))
    angle, torque = 20.0 * np.sin(time_), 30.0 * np.cos(0.3 * time_)
    noise = np.random.default_rng(sent).normal(0.0, NOISE, (joints, size))
    output = angle / 100.0 + ERROR * np.sin(2.0 * angle) + noise
    position = np.stack([column for own in output for column in (angle, own)], axis=1)
    effort = np.stack([0.0 * torque, torque] * joints, axis=1)
    rows = encode_joint_states(names(joints), stamp, position, None, effort)
    return [row.tobytes() for row in rows], stamp.tolist()


if __name__ == "__main__":
    publish(int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[1]), Path(sys.argv[4]))
