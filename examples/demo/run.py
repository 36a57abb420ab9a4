"""The whole work flow: the real node with a simulated joint over DDS, its log, replay and verdict."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from demo.log import Log, read_log
from demo.observer import ANSWER_LIMIT, Observer
from demo.process import Child, DemoError
from demo.steps import Step, table
from hd_diag.cli.lines import tell
from hd_diag.config.configuration import dump, resolve
from hd_diag.messages.publications import published_topics, resolved
from hd_diag.replay.preparation import prepare
from hd_diag.ros.stop_signals import noted_signals

__all__ = ["DemoError", "run"]

ECCENTRICITIES = (0.0, 5.0, 10.0, 18.0, 23.0)
"""Eccentricities set in the node's model, one after the other [µm]."""

TRUE_ECCENTRICITY = 18.0
"""Eccentricity of the simulated joint [µm]."""

_JOINT = "joint_1"
_NODE = "hd_diag"
_MAGNITUDE = f"{_JOINT}.eccentricity.magnitude"
_REFUSED = (f"{_JOINT}.circular_spline_teeth", 203)  # an odd difference: no ellipse can mesh there
_RATE = 250.0  # of the joint [Hz]: leaves a slow machine time for the rest
_REPORTS = 4.0  # diagnostics per second [Hz]
_START_LIMIT = 300.0  # for the processes to start, even on a busy machine [s]
_MAP_LIMIT = 30.0  # for the map of an eccentricity, even on a busy machine [s]
_DISCOVERY_LIMIT = 20.0  # for their discovery over DDS and the first samples [s]
_LINE_PERIOD = 1.0  # between lines that show a report [s]
_VERB_LIMIT = 300.0  # for a verb of the command line to end, on a busy machine [s]
_DEAF = (
    f"node and joint run but were not discovered over DDS within {_DISCOVERY_LIMIT:g} s: does a firewall or "
    "container stop UDP or shared memory on this machine? FASTDDS_BUILTIN_TRANSPORTS=UDPv4 may help"
)


def run(folder: Path | None, seconds: float) -> dict[str, Any]:
    """Run node and joint together, change the eccentricity, replay and diagnose the log.

    Parameters
    ----------
    folder : Path or None
        Folder for parameter files, log and outputs of the processes; None makes a new one.
    seconds : float
        Duration of the changes of the eccentricity [s], without start and end.

    Returns
    -------
    dict
        Schema ``hd_diag/demo/1``; ``complete`` is True if everything held, ``missing`` says what did not,
        ``signal`` is the one that has interrupted the demo.

    Raises
    ------
    DemoError
        If the folder cannot be used or a process does not start or is not discovered.
    """
    folder = _prepared(folder)
    _say("Preparing the model; the first time it is compiled, which can take a minute")
    prepare(resolve({}))  # before both processes need it at the same time
    _say(f"Starting the node and a simulated joint, each a process of its own; what they leave: {folder}")
    steps: list[Step] = []
    refusals: list[str] = []
    replayed, verdict = 0, ""
    with noted_signals() as stopped:
        with _processes(folder, seconds) as (node, joint):
            with contextlib.suppress(KeyboardInterrupt), _observing(stopped) as observer:
                _connect(observer, (node, joint))
                _change_eccentricity(observer, (node, joint), steps, refusals, seconds)
                joint.end()
                _wait_for_samples(observer, _published(joint))
            _say("", *table(steps), "", "Both processes are ended by SIGINT, the log is read back")
            codes = {"joint": joint.end(), "node": node.end()}
        published, log = _published(joint), read_log(folder / "log")
        missing = _missing(steps, refusals, codes, published, log)
        if not stopped and not missing:
            _say("The log is replayed, and asked what is wrong with the joint (hd-diag replay, diagnose)")
            with contextlib.suppress(KeyboardInterrupt):
                replayed, verdict = _replay_and_diagnose(folder, log, missing, stopped)
        missing = ["it was interrupted"] if stopped else missing
    summary = {
        "schema": "hd_diag/demo/1",
        "complete": not missing,
        "missing": missing,
        "signal": stopped[0] if stopped else None,
        "folder": str(folder),
        "log": str(folder / "log"),
        "log_size": sum(path.stat().st_size for path in (folder / "log").glob("*.mcap")),
        "exit_codes": codes,
        "published": published,
        "steps": [step.summary() for step in steps],
        "refused": {"parameter": _REFUSED[0], "value": _REFUSED[1], "reason": "".join(refusals)},
        "topics": [{"topic": t, "type": log.types[t], "count": n} for t, n in sorted(log.counts.items())],
        "problems": log.problems,
        "replayed": replayed,
        "verdict": verdict,
        "report": str(folder / "report.html"),
    }
    _conclude(summary)
    return summary


def _prepared(folder: Path | None) -> Path:
    """Make the folder, and an environment in which this process and its children see only each other.

    A ROS domain and a discovery range that the user has chosen stay.
    """
    try:
        if folder is None:
            folder = Path(tempfile.mkdtemp(prefix="hd_diag_demo_"))
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / "log").exists():
            raise DemoError(f"{folder / 'log'} exists already: name another folder")
        (folder / "node.yaml").touch()
    except OSError as error:
        raise DemoError(f"{error.filename}: {error.strerror}") from error
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))  # ports up to 101 are free everywhere
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ["ROS_LOG_DIR"] = str(folder.absolute() / "ros_log")
    return folder.absolute()


@contextlib.contextmanager
def _processes(folder: Path, seconds: float) -> Iterator[tuple[Child, Child]]:
    """Run node and joint; both have ended afterwards in any case."""
    node, joint = folder / "node.yaml", folder / "joint.yaml"
    of_node = {
        "joints": [_JOINT],
        "diagnostics_rate": _REPORTS,
        "log.path": str(folder / "log"),
        "log.overwrite": True,
    }
    node.write_text(dump(resolve(of_node)), encoding="utf-8")
    of_joint = {"joints": [_JOINT], _MAGNITUDE: TRUE_ECCENTRICITY * 1e-6}
    joint.write_text(dump(resolve(of_joint)), encoding="utf-8")
    length = str(seconds + len(ECCENTRICITIES) * (ANSWER_LIMIT + _MAP_LIMIT))
    of_ros = ["-m", "hd_diag.ros.node", "--ros-args", "--params-file", str(node)]
    script = str(Path(__file__).resolve().with_name("simulated_joint.py"))
    of_motion = [script, "--config", str(joint), "--seconds", length, "--rate", str(_RATE)]
    with Child(of_ros, folder / "node.txt") as first, Child(of_motion, folder / "joint.txt") as second:
        yield first, second


@contextlib.contextmanager
def _observing(stopped: Sequence[int]) -> Iterator[Observer]:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield Observer(_NODE, _JOINT, stopped)
    finally:
        try_shutdown()


def _connect(observer: Observer, children: Sequence[Child]) -> None:
    """Wait until both processes run and have discovered each other."""
    has_started = False
    deadline = time.monotonic() + _START_LIMIT
    while not observer.is_connected():
        observer.wait(0.1)
        for child in children:
            child.check_running()
        if not has_started and all(child.lines for child in children):
            has_started = True
            deadline = time.monotonic() + _DISCOVERY_LIMIT
        if time.monotonic() > deadline:
            late = f"the processes have not started within {_START_LIMIT:g} s"
            raise DemoError(_DEAF if has_started else late)
    if observer.get_node_names().count(_NODE) > 1:
        domain = os.environ["ROS_DOMAIN_ID"]
        raise DemoError(f"another node /{_NODE} runs in ROS domain {domain}: set ROS_DOMAIN_ID to a free one")


def _change_eccentricity(
    observer: Observer, children: Sequence[Child], steps: list[Step], refusals: list[str], seconds: float
) -> None:
    """Set one eccentricity after the other, and a value that must be refused; show a report a second."""
    _say(*table([]))
    begin = shown = time.monotonic()
    for number, eccentricity in enumerate(ECCENTRICITIES, start=1):
        if len(steps) == len(ECCENTRICITIES) // 2:
            refusals.append(observer.set_parameter(*_REFUSED))
            _say(f"set {_REFUSED[0]} = {_REFUSED[1]}: refused: {refusals[0]}")
        if reason := observer.set_parameter(_MAGNITUDE, eccentricity * 1e-6):
            raise DemoError(f"the node refuses {_MAGNITUDE} = {eccentricity}e-6: {reason}")
        _say(f"set {_MAGNITUDE} = {eccentricity:g} µm: in force")
        steps.append(Step(eccentricity))
        end = begin + seconds * number / len(ECCENTRICITIES)
        last = time.monotonic() + _MAP_LIMIT  # wait for the map, which the residual needs
        for report in observer.reports(max(end, last) - time.monotonic()):
            if steps[-1].take(report) and time.monotonic() >= shown:
                shown = time.monotonic() + _LINE_PERIOD
                _say(table([Step(eccentricity, [report])])[-1])
            # In the window of one report the joint may stand still: its residual is then only noise.
            if len(steps[-1].residuals) > 1 and time.monotonic() >= end:
                break
        for child in children:
            child.check_running()


def _published(joint: Child) -> int:
    """Number of messages that the joint says it has published; -1 if it says nothing."""
    try:
        return int(json.loads(joint.lines[-1])["published"])
    except (IndexError, KeyError, TypeError, ValueError):
        return -1


def _wait_for_samples(observer: Observer, number: int) -> None:
    """Give the node time to take all samples that were published."""
    for report in observer.reports(ANSWER_LIMIT):
        if report.number("samples") >= number:
            return


def _missing(
    steps: Sequence[Step], refusals: Sequence[str], codes: Mapping[str, int], published: int, log: Log
) -> list[str]:
    """Expectations that did not hold, one line each."""
    found = [f"the {name} ended with code {code}" for name, code in codes.items() if code != 0]
    shown = [step for step in steps if step.reports]
    if len(shown) < len(ECCENTRICITIES):
        found.append(f"diagnostics came for {len(shown)} of {len(ECCENTRICITIES)} eccentricities")
    peaks = [step.number("predicted_te_pp_arcsec") for step in shown]
    if not all(before < after for before, after in itertools.pairwise(peaks)):
        found.append("the predicted transmission error did not grow with the eccentricity")
    if not any(refusals):
        found.append("the value that cannot be was not refused")
    states = {str(report.values.get("log_state", "")) for step in steps for report in step.reports}
    found += [f"the log was {state}" for state in sorted(states) if not state.startswith("writing")]
    logged = log.counts["/joint_states"]
    if logged != published or logged < 1:
        found.append(f"the joint published {published} samples, the log holds {logged}")
    expected = {resolved(topic) for topic in published_topics([_JOINT])} - {f"/{_NODE}/{_JOINT}/mesh"}
    expected.add("/parameter_events")
    found += [f"the log holds no {topic}" for topic in sorted(expected) if not log.counts[topic]]
    return found + log.problems


def _replay_and_diagnose(
    folder: Path, log: Log, missing: list[str], stopped: Sequence[int]
) -> tuple[int, str]:
    """Number of messages in the log's replay, and the verdict on the log; failures go to `missing`."""

    def ends_well(*arguments: object) -> bool:
        """Run a verb of the command line as a user would."""
        with Child(["-m", "hd_diag", *map(str, arguments)], folder / f"{arguments[0]}.txt") as verb:
            code = verb.finish(_VERB_LIMIT, stopped)
        if code:
            words = verb.lines[-1] if verb.lines else "nothing said"
            missing.append(f"hd-diag {arguments[0]} ended with code {code}: {words}")
        return code == 0

    replayed: dict[str, list[bytes]] = {}
    if ends_well("replay", folder / "log", "--out", folder / "replayed"):
        replayed = read_log(folder / "replayed").published
        topics = sorted(log.published.keys() | replayed.keys())
        different = [topic for topic in topics if log.published.get(topic) != replayed.get(topic)]
        missing += [f"the replay's {topic} differs from what was published" for topic in different]
    file, report = folder / "verdict.json", folder / "report.html"
    if not ends_well("diagnose", folder / "log", "--json", file, "--report", report):
        return 0, ""
    return sum(map(len, replayed.values())), str(json.loads(file.read_text(encoding="utf-8"))["verdict"])


def _conclude(summary: Mapping[str, Any]) -> None:
    """Say what the log holds, what it shows and what to do next."""
    steps = [step for step in summary["steps"] if step["fault_code"]]
    residuals = [(step["residual_rms_arcsec"], step["eccentricity_um"]) for step in steps]
    if residuals:
        least, eccentricity = min(residuals)
        _say(
            f"Measured and predicted error differ least, by {least:.1f} arcsec rms, with {eccentricity:g} µm "
            f"in the model; the simulated joint has {TRUE_ECCENTRICITY:g} µm."
        )
    _say("", "messages  topic in the log                       type")
    _say(*(f"{e['count']:8}  {e['topic']:37}  {e['type']}" for e in summary["topics"]), "")
    _say(f"Log: {summary['log']} ({summary['log_size'] / 1e6:.1f} MB; rosbag2 folder, MCAP)")
    if summary["verdict"]:
        equal = f"{summary['replayed']} messages, each equal to the byte to what the node published"
        _say(f"Replay: {equal}.", f"Verdict: {summary['verdict']}", f"Report: {summary['report']}")
    if not summary["complete"]:
        _say("NOT COMPLETE: " + "; ".join(summary["missing"]))
        return
    command, file = _command(), f"{summary['folder']}/node.yaml"
    _say(
        "Complete: both processes ended with code 0; every message was logged, decoded, replayed, diagnosed.",
        "Next:",
        f"  {command} mesh --config {file} --torque 14   every tooth at one moment",
        f"  {command} check {file}                       its values are yours to change",
        f"  {command} node --config {file}               beside your own robot's /joint_states",
    )


def _command() -> str:
    """Name of the command: its path if that is below the working directory, as in an environment of make."""
    place, here = Path(sys.argv[0]).absolute(), Path.cwd()
    is_below = place.name == "hd-diag" and place.is_relative_to(here)
    return str(place.relative_to(here)) if is_below else "hd-diag"


def _say(*lines: str) -> None:
    for line in lines:
        tell(line)
