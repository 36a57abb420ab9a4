"""The main job end to end: the real node beside a simulated joint, over DDS, with a log that is read back."""

# mypy: disallow-untyped-calls=False

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from hd_diag.config.configuration import dump, resolve
from hd_diag.demo.display import Display, Reading, Step
from hd_diag.demo.log import LogSummary, summarize
from hd_diag.demo.process import Child, DemoError
from hd_diag.demo.replay_and_diagnose import Aftermath, look_back
from hd_diag.model import compiled

__all__ = ["DemoError", "run"]

ECCENTRICITIES = (0.0, 5.0, 10.0, 18.0, 23.0)
"""What the node's model is told, one after the other [um]."""

TRUE_ECCENTRICITY = 18.0
"""Of the simulated joint [um]."""

_JOINT = "joint_1"
_NODE = "hd_diag"
_MAGNITUDE = f"{_JOINT}.eccentricity.magnitude"
_REFUSED = (f"{_JOINT}.circular_spline_teeth", 203)  # an odd difference: no ellipse can mesh there
_RATE = 250.0  # of the joint [Hz]: the node follows even without a compiled model, while a map is built
_REPORTS = 4.0  # diagnostics per second [Hz]
_START_LIMIT = 60.0  # for the processes to start, which a busy machine can make long [s]
_DISCOVERY_LIMIT = 10.0  # for them to be discovered over DDS and the first samples to arrive [s]
_DEAF = (
    f"node and joint run but were not discovered over DDS within {_DISCOVERY_LIMIT:g} s: does a firewall or "
    "container stop UDP or shared memory on this machine? FASTDDS_BUILTIN_TRANSPORTS=UDPv4 may help"
)
_EXPECTED_TOPICS = (
    "/diagnostics",
    "/parameter_events",
    f"/{_NODE}/transmission_error",
    f"/{_NODE}/measured_transmission_error",
    f"/{_NODE}/residual",
    f"/{_NODE}/{_JOINT}/backlash",
    f"/{_NODE}/{_JOINT}/load",
)
_ANSWER_LIMIT = 10.0  # for a parameter to be answered, and to show in the diagnostics [s]


_CAME: list[int] = []  # signals that are to end it


class Observer(Node):
    """The demo's own node: listens to the diagnostics and sets parameters of the node under show."""

    def __init__(self) -> None:
        super().__init__("hd_diag_demo")
        self._arrived: deque[Reading] = deque()
        self._samples = 0
        self._client = AsyncParameterClient(self, f"/{_NODE}")
        self._subscription = self.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, 10
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{_NODE}: {_JOINT}":
                self._arrived.append(Reading({entry.key: entry.value for entry in status.values}))
                self._samples = self._arrived[-1].samples

    def is_connected(self) -> bool:
        """Whether the node's services and diagnostics are discovered and samples have reached it."""
        ready = self._client.services_are_ready() and self.count_publishers("/diagnostics") > 0
        return bool(ready and self._samples > 0)

    def readings(self, seconds: float) -> Iterator[Reading]:
        """What arrives during the next seconds."""
        end = time.monotonic() + seconds
        self._arrived.clear()
        while (left := end - time.monotonic()) > 0.0:
            if _CAME:  # the exception was swallowed by a callback that ran just then
                raise KeyboardInterrupt
            rclpy.spin_once(self, timeout_sec=min(left, 0.1))
            while self._arrived:
                yield self._arrived.popleft()

    def wait_for_samples(self, number: int) -> None:
        """Give the node time to take all samples that were published."""
        for reading in self.readings(_ANSWER_LIMIT):
            if reading.samples >= number:
                return

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
        Schema ``hd_diag/demo/1``; ``complete`` is True if everything held, ``missing`` says what did not,
        ``signal`` which one has interrupted it.

    Raises
    ------
    DemoError
        If the folder cannot be used or a process does not start or is not discovered.
    """
    folder = _folder(folder)
    _isolate(folder)
    display = Display()
    if compiled.available():
        display.say("Preparing the model; the first time it is compiled, which can take a minute")
        compiled.warm_up()  # before both processes need it at the same time
    display.say(
        f"Starting the node and a simulated joint, each a process of its own; what they leave: {folder}"
    )
    steps: list[Step] = []
    refusal = ""
    interrupted = False
    with _processes(folder, seconds) as (node, joint):
        with _observer() as observer, display:
            try:
                _connect(observer, (node, joint))
                refusal = _show(observer, display, (node, joint), steps, seconds)
                joint.end()
                observer.wait_for_samples(_published(joint))
            except KeyboardInterrupt:
                interrupted = True
        display.say("Both processes are ended by SIGINT, the log is read back")
        codes = {"joint": joint.end(), "node": node.end()}
    published = _published(joint)
    log = summarize(folder / "log")
    missing = ["it was interrupted"] if interrupted else _missing(steps, refusal, codes, published, log)
    after = Aftermath()
    if not missing:
        display.say("The log is replayed, and asked what is wrong with the joint (hd-diag replay, diagnose)")
        try:
            after = look_back(folder)
        except KeyboardInterrupt:
            interrupted, missing = True, ["it was interrupted"]
    missing += after.problems
    summary = {
        "schema": "hd_diag/demo/1",
        "complete": not missing,
        "missing": missing,
        "signal": [*_CAME, signal.SIGINT][0] if interrupted else None,
        "folder": str(folder),
        "log": str(folder / "log"),
        "log_size": log.size,
        "exit_codes": codes,
        "published": published,
        "steps": [step.summary() for step in steps],
        "refused": {"parameter": _REFUSED[0], "value": _REFUSED[1], "reason": refusal},
        "topics": log.topics,
        "problems": log.problems,
        "replayed": after.replayed,
        "verdict": after.verdict.get("verdict", ""),
        "report": str(folder / "report.html"),
    }
    display.conclude(summary, TRUE_ECCENTRICITY)
    return summary


def _interrupt(number: int, frame: FrameType | None) -> None:
    _CAME.append(number)
    raise KeyboardInterrupt


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
    os.environ.setdefault(
        "ROS_DOMAIN_ID", str(1 + os.getpid() % 100)
    )  # up to 101 the ports are free everywhere
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
    with contextlib.ExitStack() as stack:
        for number in (signal.SIGINT, signal.SIGTERM):
            stack.callback(signal.signal, number, signal.signal(number, _interrupt))
        node = stack.enter_context(
            Child(
                "hd_diag.ros.node",
                ["--ros-args", "--params-file", str(folder / "node.yaml")],
                folder / "node.txt",
            )
        )
        joint = stack.enter_context(
            Child(
                "hd_diag.demo.simulated_joint",
                ["--config", str(folder / "joint.yaml"), "--seconds", length, "--rate", str(_RATE)],
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


def _connect(observer: Observer, children: Sequence[Child]) -> None:
    """Wait until both processes run and everybody has found everybody."""
    speaking = False
    deadline = time.monotonic() + _START_LIMIT
    while not observer.is_connected():
        rclpy.spin_once(observer, timeout_sec=0.1)
        for child in children:
            child.check()
        if not speaking and all(child.lines for child in children):
            speaking = True
            deadline = time.monotonic() + _DISCOVERY_LIMIT
        if time.monotonic() > deadline:
            raise DemoError(
                _DEAF if speaking else f"the processes have not started within {_START_LIMIT:g} s"
            )
    if observer.get_node_names().count(_NODE) > 1:
        domain = os.environ["ROS_DOMAIN_ID"]
        raise DemoError(f"another node /{_NODE} runs in ROS domain {domain}: set ROS_DOMAIN_ID to a free one")


def _show(
    observer: Observer, display: Display, children: Sequence[Child], steps: list[Step], seconds: float
) -> str:
    """Change the eccentricity step by step, with a value that cannot be between; why that is refused."""
    refusal = ""
    begin = time.monotonic()
    for number, eccentricity in enumerate(ECCENTRICITIES, start=1):
        if len(steps) == len(ECCENTRICITIES) // 2:
            refusal = observer.set_parameter(*_REFUSED)
            display.say(f"set {_REFUSED[0]} = {_REFUSED[1]}: {f'refused: {refusal}' if refusal else 'TAKEN'}")
        if reason := observer.set_parameter(_MAGNITUDE, eccentricity * 1e-6):
            raise DemoError(f"the node refuses {_MAGNITUDE} = {eccentricity}e-6: {reason}")
        display.say(f"set {_MAGNITUDE} = {eccentricity:g} um: in force")
        steps.append(Step(eccentricity))
        _observe(observer, display, steps, begin + seconds * number / len(ECCENTRICITIES))
        for child in children:
            child.check()
    return refusal


def _observe(observer: Observer, display: Display, steps: Sequence[Step], end: float) -> None:
    """Show the last step until a time of the monotonic clock [s], and at least its first reading."""
    for reading in observer.readings(end - time.monotonic()):
        if steps[-1].take(reading):
            display.show(steps)
    if not steps[-1].readings:
        for reading in observer.readings(_ANSWER_LIMIT):
            if steps[-1].take(reading):
                return display.show(steps)


def _published(joint: Child) -> int:
    """Number of messages that the joint says it has published; -1 where it says nothing."""
    try:
        return int(json.loads(joint.lines[-1])["published"])
    except (IndexError, KeyError, TypeError, ValueError):
        return -1


def _missing(
    steps: Sequence[Step], refusal: str, codes: Mapping[str, int], published: int, log: LogSummary
) -> list[str]:
    """What did not hold, one line each."""
    found = [f"the {name} ended with code {code}" for name, code in codes.items() if code != 0]
    silent = [f"{step.eccentricity:g}" for step in steps if not step.readings]
    if silent or len(steps) < len(ECCENTRICITIES):
        found.append(
            f"diagnostics came for {len(steps) - len(silent)} of {len(ECCENTRICITIES)} eccentricities"
        )
    peaks = [step.readings[-1].number("predicted_te_pp_arcsec") for step in steps if step.readings]
    if not all(before < after for before, after in itertools.pairwise(peaks)):
        found.append("the predicted transmission error did not grow with the eccentricity")
    if not refusal:
        found.append("the value that cannot be was not refused")
    states = {reading.values["log_state"] for step in steps for reading in step.readings}
    found += [f"the log was {state}" for state in sorted(states) if not state.startswith("writing")]
    logged = log.count("/joint_states")
    if logged != published or logged < 1:
        found.append(f"the joint published {published} samples, the log holds {logged}")
    found += [f"the log holds no {topic}" for topic in _EXPECTED_TOPICS if not log.count(topic)]
    return found + log.problems
