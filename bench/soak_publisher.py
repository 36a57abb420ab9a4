"""The publisher of bench/soak.py, a separate process.

    python bench/soak_publisher.py NUMBER JOINTS RATE FILE

It publishes until SIGTERM. The file receives the stamp of each message and its send time [ns]. A line on
standard input shifts the clock by that many seconds.
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

LATE = 0.1  # largest delay to catch up with; beyond it the block is cut [s]
ERROR, NOISE = 2e-5, 2e-6  # of the outputs: amplitude of input order 2, standard deviation [rad]
END_LIMIT = 60.0  # for the node to acknowledge everything [s]


def publish(joints: int, rate: float, number: int, file: Path) -> None:
    """Publish until SIGTERM; write the stamp of each message and its send time to the file [ns].

    A line on standard input shifts the clock by that many seconds.
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
                number += 1000  # keeps every stamp unique
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
    """Messages of swinging joints with a periodic error and noise, and their stamps [ns]."""
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
