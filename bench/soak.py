"""The node for an hour with seven joints at 1 kHz while all around it changes (`make soak`).

    python bench/soak.py [--seconds S] [--rate HZ] [--joints N] [--folder DIR] [--json FILE] [--markdown FILE]

The node and the publishers are separate processes, connected over DDS. During the run parameters change, the
publisher restarts, its clock is set ahead and back, the node splits its log and deletes files by age, and
the disk fills up for a while. RLIMIT_FSIZE of the running node (prlimit) simulates the full disk: it needs no
privileges and ends every write as a full disk does. ~/start_log starts the log. At times the log stops, and
memory alone keeps everything for some seconds, until ~/snapshot writes it. Every twelfth of the run, five
minutes of an hour, ~/diagnose is called. Each message has a unique stamp; at the end the stamps sent are
compared with those in all bags. Ctrl-C ends the run with the result so far. Exit code 0 if all checks hold, 1
if one fails, 130 after Ctrl-C.
"""

# ruff: noqa: D102, D103

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_DOMAIN_ID", str(100 - os.getpid() % 20))  # tests count theirs up from 1
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)

import numpy as np
import rclpy
import yaml
from bench_node import cpu
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.table import Table
from soak_result import HEAD, RETENTION, STEPS, Observed, cells, heading, markdown, result
from std_msgs.msg import String
from std_srvs.srv import Trigger

from hd_diag.bag import BagReader

START_LIMIT, END_LIMIT = 300.0, 60.0  # [s]
AHEAD, BACK = 3600.0, -1800.0  # steps of the publisher's clock [s]
LEAST_STEP = 8.0  # shortest time between steps [s]
LEAST_DIAGNOSES = 60.0  # shortest time between calls of ~/diagnose; otherwise a twelfth of the run [s]
BEFORE, AFTER = 30.0, 2.0  # what a snapshot holds and a diagnosis reads [s]
PHASE = 5.0  # samples go to memory only, and again until the log starts [s]
LEAST_AGE = 60.0  # shortest age for the deletion of files; otherwise a tenth of the run [s]
CHANGE = 2.0  # time between changes of a parameter [s]
QUIET = 3.0  # without new samples in the reports for so long, the node has taken all [s]
LOOK = 1.0  # time between measurements of memory [s]
PAUSE = 60.0  # time between lines without a terminal [s]


class Publisher:
    """A publisher's process, and the file of what it sent."""

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
        """Terminate the publisher and wait until the node has received everything."""
        self.process.terminate()
        self.process.wait(2.0 * END_LIMIT)


# The run ---


class Run:
    """The node, its publishers, and the events of the run."""

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        self.seen, self._folder, self._options = Observed(), folder, options
        self._log = folder / "log"
        joints = [f"joint_{k}" for k in range(1, options.joints + 1)]
        given = {
            "joints": joints,
            "log": {
                "path": str(self._log),
                "mode": "snapshot",
                "before": BEFORE,
                "after": AFTER,
                "topics": "inputs",
                "split_duration": max(10.0, options.seconds / 60.0),
                "max_age": max(LEAST_AGE, options.seconds / 10.0),
            },
        }
        self.seen.max_age = given["log"]["max_age"]
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
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(String, "/hd_diag/verdict", self._take_verdict, latched)
        names = ("start_log", "stop_log", "snapshot", "diagnose")
        self._services = {name: self._node.create_client(Trigger, f"/hd_diag/{name}") for name in names}
        self._asked: tuple[float, Any, Callable[[Any], None]] | None = None
        self._state = self._diagnosis = ""
        self._diagnosed = 0.0
        self._phase: list[str] = []
        self._due: dict[str, float] = {}
        self._steps, self._step = 0, 0.0

    def _take(self, array: DiagnosticArray) -> None:
        self.seen.values = [{pair.key: pair.value for pair in status.values} for status in array.status]
        state = self.seen.values[0]["log_state"].partition(" ")[0].rstrip(":")
        self.seen.failures += state == "failed" != self._state
        self.seen.returns += self._state == "failed" != state
        self._state = state
        diagnosis = self.seen.values[0]["diagnosis_state"]
        if diagnosis.startswith("failed") and diagnosis != self._diagnosis:
            self.seen.failed_diagnoses.append(diagnosis)
        if diagnosis.startswith(("waits", "diagnoses")):
            self._diagnosed = time.monotonic()
        self._diagnosis = diagnosis

    def _take_verdict(self, _: String) -> None:
        self.seen.counts["verdict"] += 1

    def _spin(self) -> None:
        rclpy.spin_once(self._node, timeout_sec=0.02)
        if self.process.poll() is not None:
            raise RuntimeError(f"the node ended with {self.process.returncode}")

    def prepare(self) -> None:
        """Wait until predictions come from maps and the log has started."""
        end = time.monotonic() + START_LIMIT
        asked, joints = 0, self._options.joints
        while asked <= joints or self._asked or not self._is_ready:
            self._spin()
            self._answer()
            if asked <= joints and self._asked is None and self._client.services_are_ready():
                if asked < joints:
                    self._change()  # gives each joint a map of its own
                elif self._services["start_log"].service_is_ready():
                    self._ask("start_log")
                asked += 1
            if time.monotonic() > end:
                raise RuntimeError(f"the node was not ready within {START_LIMIT:g} s")
        self.seen.answers.clear()

    @property
    def _is_ready(self) -> bool:
        return self._state == "writing" and all(v["prediction"] == "map" for v in self.seen.values)

    @property
    def _is_calm(self) -> bool:
        """Whether no event is under way: no full disk, no pause of the log, no open request."""
        is_usual = self._due["free"] == self._due["phase"] == float("inf") and self._state == "writing"
        return is_usual and self._asked is None

    def go(self) -> Iterator[float]:
        """Run the schedule; yields the time since the start [s] now and then."""
        seconds, begin = self._options.seconds, time.monotonic()
        self._step = max(LEAST_STEP, seconds / 40.0)
        used, waited = cpu(self.process), waiting(self.process)
        actions = {
            "free": self._free_disk,
            "phase": self._go_on,
            "change": self._change_one,
            "diagnose": self._diagnose,
            "step": self._do_step,
        }
        self._due = dict.fromkeys(actions, float("inf"))
        self._due |= {"step": self._step, "change": CHANGE, "diagnose": self._between_diagnoses}
        look = 0.0
        self._start_publisher()
        while (now := time.monotonic() - begin) < seconds or not self._is_calm:
            self._spin()
            self._answer()
            if now >= look:
                look = now + LOOK
                self.seen.take(now, self.process.pid, self._log)
                self.seen.cpu = cpu(self.process) - used
                self.seen.waited = waiting(self.process) - waited
                if self._asked is None:  # otherwise the answer would have to wait
                    self._read_files(spare=2)
                yield now
            for name, action in actions.items():
                if now >= self._due[name]:
                    action(now)
            if seconds + END_LIMIT < now:
                return

    @property
    def _between_diagnoses(self) -> float:
        return max(LEAST_DIAGNOSES, self._options.seconds / 12.0)

    def _free_disk(self, now: float) -> None:
        self._due["free"] = float("inf")
        self._limit(resource.RLIM_INFINITY)

    def _go_on(self, now: float) -> None:
        """Write a snapshot, or restart the log once the snapshot is written."""
        if self._asked is not None or (self._phase[0] == "start_log" and self._state != "keeping"):
            return
        self._ask(self._phase.pop(0))
        self._due["phase"] = now + PHASE if self._phase else float("inf")

    def _change_one(self, now: float) -> None:
        if self._asked is None and now < self._options.seconds:
            self._due["change"] = now + CHANGE
            self._change()

    def _diagnose(self, now: float) -> None:
        if self._is_calm and now < self._options.seconds:
            self._due["diagnose"] = now + self._between_diagnoses
            self._ask("diagnose")

    def _do_step(self, now: float) -> None:
        """Start the next event, unless an earlier one is still under way."""
        if not self._is_calm or now >= self._options.seconds - 2.0 * LEAST_STEP:
            return
        self._due["step"] = now + self._step
        what = STEPS[self._steps % len(STEPS)]
        self._steps += 1
        self.seen.counts[what] += 1
        if what == "publisher restarted":
            self._restart_publisher()
        elif what == "disk full":
            self._limit(1)
            self._due["free"] = now + 0.5 * self._step
        elif what == "snapshot":
            self._ask("stop_log")
            self._phase, self._due["phase"] = ["snapshot", "start_log"], now + PHASE
        else:
            self._publishers[-1].set_clock(AHEAD if what == "clock set ahead" else BACK)

    def end(self) -> np.ndarray:
        """End all processes; returns stamps and send times of all messages (n, 2) [ns]."""
        self._limit(resource.RLIM_INFINITY)
        for one in self._publishers:
            if one.process.poll() is None:
                one.end()
        until, taken = time.monotonic() + QUIET, -1
        while time.monotonic() < until and self.process.poll() is None:
            rclpy.spin_once(self._node, timeout_sec=0.05)
            if self.seen.used != taken:  # on a busy machine the node may be behind
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
        """Limit the size of the node's files [byte]."""
        if size == 1:
            self.seen.full.append([time.time_ns(), 0])
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    def _change(self) -> None:
        number = self.seen.counts["parameter changed"]
        self.seen.counts["parameter changed"] += 1
        joint, size = f"joint_{1 + number % self._options.joints}", 1e-6 * (number % 11)
        value = Parameter(f"{joint}.eccentricity.magnitude", value=float(size))
        self._asked = time.monotonic(), self._client.set_parameters([value]), self._take_change

    def _take_change(self, answer: Any) -> None:
        self.seen.refused += [one.reason for one in answer.results if not one.successful]

    def _ask(self, service: str) -> None:
        future = self._services[service].call_async(Trigger.Request())
        self._asked = time.monotonic(), future, partial(self._take_answer, service)

    def _take_answer(self, service: str, answer: Any) -> None:
        """Count the answer; a diagnosis may be refused while another one runs."""
        if service == "diagnose":
            self.seen.counts["diagnosis begun" if answer.success else "diagnosis refused"] += 1
        elif not answer.success:
            self.seen.refused.append(f"~/{service}: {answer.message}")

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
        begin, future, take = self._asked
        if future.done():
            self._asked = None
            self.seen.answers.append(time.monotonic() - begin)
            take(future.result())

    def _read_files(self, spare: int) -> None:
        """Read the stamps of all but the last `spare` log files, before files may be deleted by age."""
        written = {path: path.stat().st_mtime for path in self._files()}
        found = sorted(written, key=lambda path: written[path])
        if time.monotonic() - self._diagnosed > RETENTION:  # files that a diagnosis reads stay until it ends
            oldest = min(written.values(), default=time.time())
            self.seen.oldest = max(self.seen.oldest, time.time() - oldest)
        self.seen.deleted = len(self._read - {*found})
        for path in found[: len(found) - spare]:
            if path not in self._read:
                self._read.add(path)
                self._read_file(path)

    def _files(self) -> Iterator[Path]:
        for path in self._log.glob("*/*.mcap"):
            with contextlib.suppress(FileNotFoundError):
                path.stat()
                yield path

    def _read_file(self, path: Path) -> None:
        with BagReader(path) as reader:
            for batch in reader.batches(["/joint_states"]):
                columns, _ = reader.joint_states(batch)
                self.seen.logged += [states.stamp for states in columns]
            self.seen.unfinished += bool(reader.problems)
        self.seen.files += 1


def waiting(process: subprocess.Popen[bytes]) -> float:
    """Time for which a process's main thread was ready to run but had no core [s]."""
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
