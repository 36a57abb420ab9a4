"""The main job end to end: the real node beside a simulated joint, over DDS, with a log that is read back."""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

import contextlib
import json
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from hd_diag.config import dump, resolve
from hd_diag.demo_display import Display, Reading, Step
from hd_diag.demo_log import LogSummary, summarize
from hd_diag.demo_process import Child, DemoError

__all__ = ["DemoError", "run"]

ECCENTRICITIES = (0.0, 5.0, 10.0, 18.0, 23.0)
"""What the node's model is told, one after the other [um]."""

TRUE_ECCENTRICITY = 18.0
"""Of the simulated joint [um]."""

_JOINT = "joint_1"
_NODE = "hd_diag"
_MAGNITUDE = f"{_JOINT}.eccentricity.magnitude"
_REFUSED = (f"{_JOINT}.circular_spline_teeth", 203)  # an odd difference: no ellipse can mesh there
_REPORTS = 4.0  # diagnostics per second [Hz]
_START_LIMIT = 20.0  # for the processes to start [s]
_DISCOVERY_LIMIT = 10.0  # for them to be discovered over DDS and the first samples to arrive [s]
_ANSWER_LIMIT = 10.0  # for a parameter to be answered, and to show in the diagnostics [s]


class Observer(Node):
    """The demo's own node: listens to the diagnostics and sets parameters of the node under show."""

    def __init__(self) -> None:
        super().__init__("hd_diag_demo")
        self.reading: Reading | None = None
        self._client = AsyncParameterClient(self, f"/{_NODE}")
        self._subscription = self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{_NODE}: {_JOINT}":
                self.reading = Reading({entry.key: entry.value for entry in status.values})

    def is_connected(self) -> bool:
        """Whether the node's services and diagnostics are discovered and samples have reached it."""
        ready = self._client.services_are_ready() and self.count_publishers("/diagnostics") > 0
        return bool(ready and self.reading is not None and self.reading.samples > 0)

    def readings(self, seconds: float) -> Iterator[Reading]:
        """What arrives during the next seconds."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.reading = None
            rclpy.spin_once(self, timeout_sec=min(left, 0.1))
            if self.reading is not None:
                yield self.reading

    def set_parameter(self, name: str, value: float | int) -> str:
        """Set a parameter of the node over DDS.

        Returns
        -------
        str
            Why the node refuses it; empty where it is in force.

        Raises
        ------
        DemoError
            If no answer comes.
        """
        future = self._client.set_parameters_atomically([Parameter(name, value=value)])
        rclpy.spin_until_future_complete(self, future, timeout_sec=_ANSWER_LIMIT)
        if not future.done():
            raise DemoError(f"the node has not answered within {_ANSWER_LIMIT:g} s that {name} is set")
        result = future.result().result
        return "" if result.successful else str(result.reason)


def run(folder: Path | None, seconds: float) -> dict[str, Any]:
    """Run node and joint together, change the eccentricity, read the log back.

    Parameters
    ----------
    folder : Path or None
        Where parameter files, log and outputs of the processes are left; a new one without.
    seconds : float
        How long the eccentricity is changed [s]; start and end come on top.

    Returns
    -------
    dict
        Schema ``hd_diag/demo/1``; ``complete`` is True if everything held, ``missing`` says what did not.

    Raises
    ------
    DemoError
        If the folder cannot be used or a process does not start or is not discovered.
    """
    folder = _folder(folder)
    _isolate(folder)
    display = Display(seconds)
    display.say(f"Starting the node and a simulated joint as processes of their own; all they leave: {folder}")
    steps: list[Step] = []
    refusal = ""
    interrupted = False
    with _processes(folder, seconds) as (node, joint):
        with _observer() as observer, display:
            try:
                _connect(observer, node, joint)
                refusal = _show(observer, display, (node, joint), steps, seconds)
            except KeyboardInterrupt:
                interrupted = True
        display.say("Ending both processes by SIGINT and reading the log back")
        codes = {"joint": joint.end(), "node": node.end()}
    published = _published(joint)
    log = summarize(folder / "log")
    missing = ["it was interrupted"] if interrupted else []
    missing += _missing(steps, refusal, codes, published, log)
    summary = {
        "schema": "hd_diag/demo/1",
        "complete": not missing,
        "missing": missing,
        "folder": str(folder),
        "log": str(folder / "log"),
        "exit_codes": codes,
        "published": published,
        "steps": [step.summary() for step in steps],
        "refused": {"parameter": _REFUSED[0], "value": _REFUSED[1], "reason": refusal},
        "topics": log.topics,
        "problems": log.problems,
    }
    display.conclude(summary, TRUE_ECCENTRICITY)
    return summary


def _folder(folder: Path | None) -> Path:
    try:
        if folder is None:
            return Path(tempfile.mkdtemp(prefix="hd_diag_demo_"))
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / "log").exists():
            raise DemoError(f"{folder / 'log'} exists already: name another folder")
        (folder / "node.yaml").touch()
    except OSError as error:
        raise DemoError(f"{error.filename}: {error.strerror}") from error
    return folder.absolute()


def _isolate(folder: Path) -> None:
    """Let this process and its children see none but each other, unless the user has chosen otherwise."""
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))  # up to 101 the ports are free everywhere
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_LOG_DIR"] = str(folder / "ros_log")


@contextlib.contextmanager
def _processes(folder: Path, seconds: float) -> Iterator[tuple[Child, Child]]:
    """Node and joint, running; whatever happens, both have ended afterwards."""
    named = {"joints": [_JOINT], "diagnostics_rate": _REPORTS, "log.path": str(folder / "log")}
    (folder / "node.yaml").write_text(dump(resolve(named)), encoding="utf-8")
    true = {"joints": [_JOINT], _MAGNITUDE: TRUE_ECCENTRICITY * 1e-6}
    (folder / "joint.yaml").write_text(dump(resolve(true)), encoding="utf-8")
    length = str(seconds + len(ECCENTRICITIES) * _ANSWER_LIMIT)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.ExitStack() as stack:
        stack.callback(signal.signal, signal.SIGTERM, before)
        node = stack.enter_context(
            Child("hd_diag.node", ["--ros-args", "--params-file", str(folder / "node.yaml")], folder / "node.txt")
        )
        joint = stack.enter_context(
            Child(
                "hd_diag.simulated_joint",
                ["--config", str(folder / "joint.yaml"), "--seconds", length],
                folder / "joint.txt",
            )
        )
        yield node, joint


@contextlib.contextmanager
def _observer() -> Iterator[Observer]:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield Observer()
    finally:
        try_shutdown()


def _connect(observer: Observer, *children: Child) -> None:
    """Wait until everybody has found everybody."""
    started = time.monotonic()
    limit = _START_LIMIT + _DISCOVERY_LIMIT
    while not observer.is_connected():
        rclpy.spin_once(observer, timeout_sec=0.1)
        for child in children:
            child.check()
        if time.monotonic() - started > limit:
            raise DemoError("; ".join(_undiscovered(observer, limit)))
    if observer.get_node_names().count(_NODE) > 1:
        domain = os.environ["ROS_DOMAIN_ID"]
        raise DemoError(f"another node /{_NODE} runs in ROS domain {domain}: set ROS_DOMAIN_ID to a free one")
