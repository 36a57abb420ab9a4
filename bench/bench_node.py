"""The node's CPU per message beside an empty rclpy node's, in one run; load from a process of its own.

    python bench/bench_node.py [--joints 1 7] [--sections 1 5] [--rate HZ] [--seconds S] [--json FILE]

All joints come in one message, with effort, at the given rate. The benchmark subscribes only to the
diagnostics; per-tooth arrays keep their default rate. For each number of sections above one, the node with a
log runs once more with coned cups. CPU is that of the whole process with its DDS threads. It is counted from
the end of the warm-up round, with maps in use, until the last report has arrived. The empty nodes do nothing:
a SingleThreadedExecutor with a typed callback, as in most rclpy nodes, and an EventsExecutor with a raw one.
"""

# ruff: noqa: D102, D103, T201

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from hd_diag.messages.encoding import encode_joint_states

DEPTH = 2000
CUP = {"face_width": 0.011, "cup_length": 0.04}  # dimensions of the paper's cup [m]
WARM_UP = 1.0  # [s]
LIMIT = 120.0  # for start, maps and answers [s]
TICK = os.sysconf("SC_CLK_TCK")
PAUSE = 1.0  # time without new data after which all messages count as arrived [s]


def names(joints):
    return [name for k in range(1, joints + 1) for name in (f"joint_{k}_motor", f"joint_{k}")]


def messages(joints, count, rate):
    """Serialised messages of joints that swing under a swinging torque."""
    time_ = np.arange(count) / rate
    angle = 20.0 * np.sin(time_)
    torque = 30.0 * np.cos(0.3 * time_)
    position = np.stack([column for _ in range(joints) for column in (angle, angle / 100.0)], axis=1)
    effort = np.stack([column for _ in range(joints) for column in (0.0 * torque, torque)], axis=1)
    stamp = time.time_ns() + (1e9 / rate * np.arange(count)).astype(np.int64)
    return [row.tobytes() for row in encode_joint_states(names(joints), stamp, position, None, effort)]


def generate(joints, rate, counts):
    """Publish one of the given counts of messages for each line on standard input."""
    rclpy.init()
    node = rclpy.create_node("load")
    publisher = node.create_publisher(JointState, "joint_states", DEPTH)
    waiting = messages(joints, sum(counts), rate)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    for count in counts:
        sys.stdin.readline()
        begin = time.perf_counter()
        for i in range(count):
            publisher.publish(waiting.pop(0))
            time.sleep(max(0.0, begin + (i + 1) / rate - time.perf_counter()))
        print(time.perf_counter() - begin, flush=True)
    sys.stdin.readline()


def empty(kind):
    """A node that counts its messages."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    node, count = rclpy.create_node("empty"), [0]

    def callback(_):
        count[0] += 1

    events = kind == "events"
    node.create_subscription(JointState, "joint_states", callback, QoSProfile(depth=DEPTH), raw=events)
    executor = EventsExecutor() if events else SingleThreadedExecutor()
    executor.add_node(node)
    while not ended:
        executor.spin_once(timeout_sec=0.05)
    print(count[0])


def cpu(process):
    """CPU time of all threads of a process [s]."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


@contextlib.contextmanager
def running(*command, **streams):
    process = subprocess.Popen([sys.executable, *command], text=True, **streams)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def measured(process, options, joints, done):
    """CPU [s] and wall time [s] of the second round; messages sent in both rounds, and in the second."""
    counts = [int(options.rate * WARM_UP), int(options.rate * options.seconds)]
    own = [__file__, "--role", "generate", "--joints", str(joints), "--rate", str(options.rate)]
    own += ["--counts", *map(str, counts)]
    with running(*own, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as load:
        for _ in counts:
            before = cpu(process)
            print(file=load.stdin, flush=True)
            wall = float(load.stdout.readline())
            done()
            used = cpu(process) - before
        return used, wall, sum(counts), counts[-1]


def empty_case(kind, joints, options):
    with running(__file__, "--role", kind, stdout=subprocess.PIPE) as process:
        used, wall, sent, count = measured(process, options, joints, lambda: time.sleep(PAUSE))
        process.send_signal(signal.SIGTERM)
        received = int(process.stdout.readline())
    label = {"single": "empty, SingleThreadedExecutor", "events": "empty, EventsExecutor, raw"}[kind]
    return row(label, joints, used, wall, sent - received, count)


class Reports:
    """Listens to the node's diagnostics."""

    def __init__(self):
        self.node = rclpy.create_node("reports")
        self.values = []
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def _take(self, array):
        self.values = [{pair.key: pair.value for pair in status.values} for status in array.status]

    def until(self, condition):
        end = time.monotonic() + LIMIT
        while not condition(self.values):
            rclpy.spin_once(self.node, timeout_sec=0.1)
            if time.monotonic() > end:
                sys.exit(f"the node did not get so far within {LIMIT} s")

    def settled(self):
        """Spin until the sample counts in the reports stop rising."""
        last, since = None, time.monotonic()
        while time.monotonic() - since < 2.0 * PAUSE:
            rclpy.spin_once(self.node, timeout_sec=0.1)
            samples = [values["samples"] for values in self.values]
            if samples != last:
                last, since = samples, time.monotonic()


def node_case(folder, joints, log, sections, options):
    every = [f"joint_{k}" for k in range(1, joints + 1)]
    given = {"joints": every}
    if sections > 1:
        given |= {joint: CUP | {"sections": sections} for joint in every}
    if log:
        given["log.path"] = str(folder / f"log_{joints}_{sections}.mcap")
    file = folder / "parameters.yaml"
    file.write_text(yaml.safe_dump({"hd_diag": {"ros__parameters": given}}))
    reports = Reports()
    command = ["-m", "hd_diag.ros.node", "--ros-args", "--params-file", str(file), "--log-level", "warn"]
    with running(*command) as process:
        reports.until(lambda v: len(v) == joints and all(s["prediction"] == "map" for s in v))
        used, wall, sent, count = measured(process, options, joints, reports.settled)
        lost = max(sent - int(values["samples"]) for values in reports.values)
        process.send_signal(signal.SIGTERM)
        if process.wait(LIMIT):
            sys.exit(f"the node ended with {process.returncode}")
    reports.node.destroy_node()
    told = f", {sections} sections" if sections > 1 else ""
    return row(f"hd_diag, log {'on' if log else 'off'}{told}", joints, used, wall, lost, count)


def row(label, joints, used, wall, lost, count):
    """One result; CPU after the sending (reports until all settles) counts as a cost of the messages."""
    return {
        "node": label,
        "joints": joints,
        "sent": count,
        "rate": count / wall,
        "lost": lost,
        "cpu_per_message_us": used / count * 1e6,
        "share_of_core": used / wall,
    }


def bench(options):
    rclpy.init()
    print(
        f"{'node':<32}{'joints':>7}{'Hz':>7}{'lost':>6}{'us/message':>12}{'of a core':>11}{'over empty':>14}"
    )
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for joints in options.joints:
            cases = [lambda k=kind, n=joints: empty_case(k, n, options) for kind in ("single", "events")]
            nodes = [(False, 1), *((True, sections) for sections in options.sections)]
            cases += [lambda c=case, n=joints: node_case(Path(folder), n, *c, options) for case in nodes]
            first = None
            for case in cases:
                found = case()
                first = first or found["cpu_per_message_us"]
                found["beside_empty"] = found["cpu_per_message_us"] / first
                rows.append(found)
                print(
                    f"{found['node']:<32}{joints:>7}{found['rate']:>7.0f}{found['lost']:>6}"
                    f"{found['cpu_per_message_us']:>12.0f}{100.0 * found['share_of_core']:>10.1f}%"
                    f"{found['beside_empty']:>14.2f}",
                    flush=True,
                )
    rclpy.try_shutdown()
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--joints", type=int, nargs="+", default=[1, 7])
    parser.add_argument("--sections", type=int, nargs="+", default=[1])
    parser.add_argument("--rate", type=float, default=1000.0, help="messages per second")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--role", choices=["generate", "single", "events"], help=argparse.SUPPRESS)
    parser.add_argument("--counts", type=int, nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role == "generate":
        generate(options.joints[0], options.rate, options.counts)
    elif options.role:
        empty(options.role)
    else:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        os.environ.setdefault("ROS_DOMAIN_ID", "101")
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
        rows = bench(options)
        if options.json:
            options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
