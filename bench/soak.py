"""The node for an hour with seven joints at 1 kHz while all around it changes (`make soak`).

    python bench/soak.py [--seconds S] [--rate HZ] [--joints N] [--folder DIR] [--json FILE] [--markdown FILE]

The node and the publishers are processes of their own, over DDS. Meanwhile parameters change, the publisher
is restarted, its clock is set ahead and back, the node's log is split, and the disk under it is full for a
while: as RLIMIT_FSIZE of the running node (prlimit), which needs no rights and ends every write as a full
disk does. Each message has a stamp of its own; those sent are compared with those logged. Of files of the log
that are finished stamps are kept, not the files. Ctrl-C ends it with the result so far. Exit code 0 where all
holds, 1 where something does not, 130 after Ctrl-C.
"""

# ruff: noqa: D102, D103

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("ROS_DOMAIN_ID", str(100 - os.getpid() % 20))  # tests take theirs from 1 on
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)

import numpy as np
import rclpy
import yaml
from bench_node import cpu
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.table import Table
from soak_result import HEAD, STEPS, Observed, cells, heading, markdown, result

from hd_diag.bag import BagReader

START_LIMIT, END_LIMIT = 300.0, 60.0  # [s]
AHEAD, BACK = 3600.0, -1800.0  # of the publisher's clock [s]
LEAST_STEP = 8.0  # between these [s]
CHANGE = 2.0  # between changes of a parameter [s]
QUIET = 3.0  # without another sample in the reports, after which the node has taken all [s]
LOOK = 1.0  # between looks at memory [s]
PAUSE = 60.0  # between lines where there is no terminal [s]


class Publisher:
    """A publisher's process, and what it has sent."""

    def __init__(self, folder: Path, number: int, options: argparse.Namespace) -> None:
        self.file = folder / f"sent_{number}.bin"
        own = str(Path(__file__).with_name("soak_publisher.py"))
        given = (number, options.joints, options.rate, self.file)
        command = [sys.executable, own, *map(str, given)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, start_new_session=True)

    def set_clock(self, seconds: float) -> None:
        assert self.process.stdin is not None
        print(seconds, file=self.process.stdin, flush=True)

    def end(self) -> None:
        """End it when the node has everything."""
        self.process.terminate()
        self.process.wait(2.0 * END_LIMIT)


# The run ---


class Run:
    """Node, publishers, and what happens to them."""

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        self.seen, self._folder, self._options = Observed(), folder, options
        self._log = folder / "log"
        joints = [f"joint_{k}" for k in range(1, options.joints + 1)]
        given = {
            "joints": joints,
            "log": {"path": str(self._log), "split_duration": max(10.0, options.seconds / 60.0)},
        }
        file = folder / "parameters.yaml"
        file.write_text(yaml.safe_dump({"hd_diag": {"ros__parameters": given}}))
        ros = ["--ros-args", "--params-file", str(file), "--log-level", "fatal"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hd_diag.ros.node", *ros], start_new_session=True
        )
        self._publishers: list[Publisher] = []
        self._read: set[Path] = set()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("soak")
        self._client = AsyncParameterClient(self._node, "hd_diag")
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)
        self._asked: tuple[float, object] | None = None
        self._state = ""

    def _take(self, array: DiagnosticArray) -> None:
        self.seen.values = [{pair.key: pair.value for pair in status.values} for status in array.status]
        state = self.seen.values[0]["log_state"].partition(" ")[0].rstrip(":")
        self.seen.failures += state == "failed" != self._state
        self.seen.returns += self._state == "failed" != state
        self._state = state

    def _spin(self) -> None:
        rclpy.spin_once(self._node, timeout_sec=0.02)
        if self.process.poll() is not None:
            raise RuntimeError(f"the node ended with {self.process.returncode}")

    def prepare(self) -> None:
        """Wait until predictions come from maps."""
        end = time.monotonic() + START_LIMIT
        joints = self._options.joints
        asked = 0
        while asked < joints or self._asked or not all(v["prediction"] == "map" for v in self.seen.values):
            self._spin()
            self._answer()
            if asked < joints and self._asked is None and self._client.services_are_ready():
                asked += 1
                self._change()  # from here on each joint has a map of its own
            if time.monotonic() > end:
                raise RuntimeError(f"the node was not ready within {START_LIMIT:g} s")
        self.seen.answers.clear()

    def go(self) -> Iterator[float]:
        """Do it; gives the time since its begin now and then."""
        seconds = self._options.seconds
        step = max(LEAST_STEP, seconds / 40.0)
        begin, used, waited = time.monotonic(), cpu(self.process), waiting(self.process)
        due = {"step": step, "change": CHANGE, "look": 0.0, "free": float("inf")}
        steps = 0
        self._start_publisher()
        while (
            (now := time.monotonic() - begin) < seconds
            or due["free"] < float("inf")
            or self._state == "failed"
        ):
            self._spin()
            self._answer()
            if now >= due["look"]:
                due["look"] = now + LOOK
                self.seen.take(now, self.process.pid)
                self.seen.cpu = cpu(self.process) - used
                self.seen.waited = waiting(self.process) - waited
                if self._asked is None:  # else the answer would have to wait
                    self._read_files(spare=2)
                yield now
            if now >= due["free"]:
                due["free"] = float("inf")
                self._limit(resource.RLIM_INFINITY)
            if now >= due["change"] and self._asked is None and now < seconds:
                due["change"] = now + CHANGE
                self._change()
            if (
                now >= due["step"]
                and now < seconds - 2.0 * LEAST_STEP
                and due["free"] == float("inf")
                and self._state != "failed"
            ):
                due["step"] = now + step
                what = STEPS[steps % len(STEPS)]
                steps += 1
                self.seen.counts[what] += 1
                if what == "publisher restarted":
                    self._restart_publisher()
                elif what == "disk full":
                    self._limit(1)
                    due["free"] = now + 0.5 * step
                else:
                    self._publishers[-1].set_clock(AHEAD if what == "clock set ahead" else BACK)
            if seconds + END_LIMIT < now:
                return

    def end(self) -> np.ndarray:
        """End all; gives what was sent."""
        self._limit(resource.RLIM_INFINITY)
        for one in self._publishers:
            if one.process.poll() is None:
                one.end()
        until, taken = time.monotonic() + QUIET, -1
        while time.monotonic() < until and self.process.poll() is None:
            rclpy.spin_once(self._node, timeout_sec=0.05)
            if self.seen.used != taken:  # a busy machine's node may be behind
                until, taken = time.monotonic() + QUIET, self.seen.used
        self.process.send_signal(signal.SIGTERM)
        self.seen.code = self.process.wait(END_LIMIT)
        self._read_files(spare=0)
        for one in self.seen.full:
            one[1] = one[1] or time.time_ns()
        rclpy.try_shutdown()
        sent = [
            np.frombuffer(p.file.read_bytes(), np.int64).reshape(-1, 2)
            for p in self._publishers
            if p.file.exists()
        ]
        return np.concatenate([np.empty((0, 2), np.int64), *sent])

    def kill(self) -> None:
        for process in (self.process, *(one.process for one in self._publishers)):
            if process.poll() is None:
                process.kill()
                process.wait()

    def _start_publisher(self) -> None:
        self._publishers.append(Publisher(self._folder, len(self._publishers) + 1, self._options))

    def _restart_publisher(self) -> None:
        self._publishers[-1].process.terminate()
        while self._publishers[-1].process.poll() is None:
            self._spin()
            self._answer()
        self._start_publisher()

    def _limit(self, size: int) -> None:
        """Let the node's files be no larger than this [byte]."""
        if size == 1:
            self.seen.full.append([time.time_ns(), 0])
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    def _change(self) -> None:
        number = self.seen.counts["parameter changed"]
        self.seen.counts["parameter changed"] += 1
        joint, size = f"joint_{1 + number % self._options.joints}", 1e-6 * (number % 11)
        value = Parameter(f"{joint}.eccentricity.magnitude", value=float(size))
        self._asked = time.monotonic(), self._client.set_parameters([value])

    def _answer(self) -> None:
        if (
            self._state == "writing"
            and self.seen.full
            and not self.seen.full[-1][1]
            and self.seen.returns >= len(self.seen.full)
        ):
            self.seen.full[-1][1] = time.time_ns()
        if self._asked is None:
            return
        begin, future = self._asked
        if future.done():
            self._asked = None
            self.seen.answers.append(time.monotonic() - begin)
            self.seen.refused += [one.reason for one in future.result().results if not one.successful]

    def _read_files(self, spare: int) -> None:
        """Keep the stamps of the log's files but for the last ones."""
        found = sorted(self._log.glob("*/*.mcap"), key=lambda path: int(re.findall(r"\d+", path.stem)[-1]))
        for path in found[: len(found) - spare]:
            with BagReader(path) as reader:
                for batch in reader.batches(["/joint_states"]):
                    columns, _ = reader.joint_states(batch)
                    self.seen.logged += [states.stamp for states in columns]
                self.seen.unfinished += bool(reader.problems)
            self.seen.files += 1
            path.unlink()


def waiting(process: subprocess.Popen[bytes]) -> float:
    """How long a process's first thread could have run and had no core [s]."""
    return int(Path(f"/proc/{process.pid}/schedstat").read_text().split()[1]) * 1e-9


def soak(options: argparse.Namespace, folder: Path) -> int:
    console = Console(stderr=True)
    run, took, interrupted, told = Run(folder, options), 0.0, False, 0.0
    try:
        with console.status("the node prepares its maps") as status:
            try:
                run.prepare()
                for took in run.go():
                    text = f"{took:,.0f} of {options.seconds:,.0f} s, {run.seen.memory[-1][1]:.0f} MB"
                    status.update(text)
                    if not console.is_terminal and took - told >= PAUSE:
                        told = took
                        console.print(text)
            except KeyboardInterrupt:
                interrupted = True
            sent = run.end()
    finally:
        run.kill()
    rows, title = result(run.seen, sent, took), heading(run.seen, len(sent), took, options, interrupted)
    table = Table(*HEAD, title=title)
    for row in rows:
        table.add_row(*cells(row))
    Console(width=max(150, console.width)).print(table)
    if options.markdown:
        options.markdown.write_text(markdown(title, rows), encoding="utf-8")
    if options.json:
        found = [dict(zip(("what", "wanted", "seen", "holds"), row, strict=True)) for row in rows]
        content = {
            "schema": "hd_diag/soak/1",
            "run": title,
            "rows": found,
            "memory": run.seen.memory,
            "threads": run.seen.threads,
            "open_files": run.seen.open_files,
            "joints": run.seen.values,
        }
        options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return 130 if interrupted else int(not all(row[3] for row in rows))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="messages per second")
    parser.add_argument("--joints", type=int, default=7)
    parser.add_argument("--folder", type=Path, help="of the log; by default a temporary one")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path, help="the table for a page, such as docs/tables/soak.md")
    options = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with tempfile.TemporaryDirectory(prefix="hd_diag_soak_", dir=options.folder) as folder:
        return soak(options, Path(folder))


if __name__ == "__main__":
    sys.exit(main())
