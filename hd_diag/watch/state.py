"""What a watcher knows of running nodes: last reports of every joint, nodes in the graph, what is missing."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

from hd_diag.formatting import json_ready, listed

PREFIX = "hd_diag: "
"""Start of the names of this package's statuses; the joint follows."""
DEFAULT_TOPIC = "/diagnostics"

_LEVELS = ("ok", "warn", "error", "stale")  # of a diagnostic_msgs/DiagnosticStatus
_HISTORY = 240  # reports kept of a joint, for its curve
_PERIODS = 20  # last times between reports; their median is the usual one
_SILENT_PERIODS, _SILENT = 3.0, 3.0  # a joint is silent after so many usual periods and seconds
_MOST_JOINTS, _MOST_OTHERS, _MOST_VALUES, _LONGEST = (
    1024,
    32,
    256,
    2000,
)  # a hostile sender cannot fill memory
_LARGEST_WHOLE = 1e15  # every reader of JSON keeps such a whole number
_NAMES_SHOWN = 5


class ReportedStatus(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]
    hardware_id: str = ""

    @property
    def joint(self) -> str:
        """The part of the name after the prefix."""
        return self.name[len(PREFIX) :]

    @property
    def node(self) -> str:
        """The node named by the hardware_id ``<node>/<joint>``; empty where it names none."""
        tail = f"/{self.joint}"
        return self.hardware_id.removesuffix(tail) if self.hardware_id.endswith(tail) else ""

    def bounded(self) -> ReportedStatus:
        """The same with long texts cut and surplus values dropped."""
        values = {_cut(key): _cut(value) for key, value in list(self.values.items())[:_MOST_VALUES]}
        return ReportedStatus(_cut(self.name), self.level, _cut(self.message), values, _cut(self.hardware_id))


class NodeSeen(NamedTuple):
    """A node of this package in the ROS graph; its topics name its joints unless they are remapped."""

    name: str
    topic: str
    joints: frozenset[str] = frozenset()


class JointView(NamedTuple):
    """A joint at one moment: nodes that may report it, age of its last status [s], rms residuals [arcsec]."""

    name: str
    topic: str
    nodes: tuple[str, ...]
    status: ReportedStatus
    age: float
    is_silent: bool
    residuals: tuple[float, ...]

    def text(self, key: str, default: str = "") -> str:
        """A value of the diagnostics."""
        return self.status.values.get(key, default)

    def number(self, key: str) -> float:
        """A value as a number; nan where there is none."""
        return _number(self.text(key))

    @property
    def level(self) -> int:
        """Level of a DiagnosticStatus; 0 means that nothing is wrong."""
        return self.status.level

    @property
    def code(self) -> str:
        """Fault code, or else the level's name."""
        return self.text("fault_code") or _level_name(self.level).upper()

    @property
    def is_stale(self) -> bool:
        """Whether its numbers are old: no report comes, or the node itself gets no samples."""
        return self.is_silent or "STALE" in self.text("fault_codes", self.code).split()


class _Reports(NamedTuple):
    """Last status of a joint, and of every report its arrival [s] and rms residual [arcsec]."""

    status: ReportedStatus
    history: deque[tuple[float, float]]

    def age(self, now: float) -> float:
        return max(0.0, now - self.history[-1][0])

    def is_silent(self, now: float) -> bool:
        arrivals = [arrived for arrived, _ in self.history][-_PERIODS - 1 :]
        usual = statistics.median(b - a for a, b in pairwise(arrivals)) if len(arrivals) > 1 else 0.0
        return self.age(now) > max(_SILENT, _SILENT_PERIODS * usual)


@dataclass
class Watch:
    """State of a watcher. It shows all joints and nodes, or those that are asked for.

    `nodes` are in the graph now, `others` are names of other statuses, `messages` counts DiagnosticArrays,
    `answers` come from nodes that were asked for a diagnosis.
    """

    joints: Collection[str] = ()
    namespaces: Collection[str] = ()
    nodes: Sequence[NodeSeen] = ()
    others: list[str] = field(default_factory=list)
    messages: int = 0
    answers: dict[str, str] = field(default_factory=dict)
    _reports: dict[tuple[str, str, str], _Reports] = field(default_factory=dict)

    def take(self, topic: str, statuses: Iterable[ReportedStatus], now: float) -> None:
        """Take a DiagnosticArray that came on a topic at a time [s]."""
        self.messages += 1
        for status in statuses:
            if status.name.startswith(PREFIX):
                self._take_joint(topic, status.bounded(), now)
            elif (name := _cut(status.name)) not in self.others and len(self.others) < _MOST_OTHERS:
                self.others.append(name)

    def _take_joint(self, topic: str, status: ReportedStatus, now: float) -> None:
        key = topic, status.hardware_id, status.joint
        if key in self._reports or len(self._reports) < _MOST_JOINTS:
            history = self._reports[key].history if key in self._reports else deque(maxlen=_HISTORY)
            history.append((now, _number(status.values.get("residual_rms_arcsec", ""))))
            self._reports[key] = _Reports(status, history)

    def wanted_nodes(self) -> list[NodeSeen]:
        """Nodes asked for that are in the graph."""
        return [node for node in self.nodes if self._is_wanted(node.name)]

    def view(self, now: float) -> list[JointView]:
        """The joints asked for that were reported, by node and name, at a time [s]."""
        views = []
        for (topic, _, joint), reports in self._reports.items():
            status, nodes = reports.status, tuple(self._senders(topic, reports.status))
            is_wanted = not self.namespaces or any(map(self._is_wanted, nodes))
            if is_wanted and (not self.joints or joint in self.joints):
                residuals = tuple(residual for _, residual in reports.history)
                age, is_silent = reports.age(now), reports.is_silent(now)
                views.append(JointView(joint, topic, nodes, status, age, is_silent, residuals))
        return sorted(views, key=lambda view: (view.nodes, view.topic, view.name, view.status.hardware_id))

    def missing(self) -> list[str]:
        """Joints that were asked for, or belong to a node asked for, and were not reported yet."""
        views = self.view(0.0)
        names = {view.name for view in views}
        if self.joints:
            return [joint for joint in self.joints if joint not in names]
        reported = {(name, view.topic, view.name) for view in views for name in view.nodes}
        wanted = [(node, joint) for node in self.wanted_nodes() for joint in sorted(node.joints)]
        absent = [(node.name, joint) for node, joint in wanted if (*node[:2], joint) not in reported]
        return [f"{node} {joint}" if joint in names else joint for node, joint in absent]

    def explanation(self) -> list[str]:
        """What was seen instead of what was asked for, one sentence each."""
        there, wanted = (_listed([n.name for n in nodes]) for nodes in (self.nodes, self.wanted_nodes()))
        found = [f"{wanted} is there" if wanted else "no hd_diag node is in the ROS graph"]
        if there and not wanted:
            found = [f"no hd_diag node in {_listed(self.namespaces)}; there is {there}"]
        if self.joints and self._reports:
            found.append(f"joints reported: {_listed(sorted({joint for _, _, joint in self._reports}))}")
        if self.others:
            found.append(f"other diagnostics: {_listed(self.others)}")
        return found if self.others or self.messages else [*found, "no diagnostics at all"]

    def _is_wanted(self, name: str) -> bool:
        below = [f"/{namespace.strip('/')}/".replace("//", "/") for namespace in self.namespaces]
        return not below or name.startswith(tuple(below))

    def _senders(self, topic: str, status: ReportedStatus) -> list[str]:
        """Nodes that may have sent a status: the one it names, or all on the topic with such a joint."""
        if status.node:
            return [status.node]
        on_topic = [node for node in self.nodes if node.topic == topic]
        return sorted(node.name for node in on_topic if not node.joints or status.joint in node.joints)


def as_json(watch: Watch, now: float) -> dict[str, Any]:
    """Everything known at a time [s], schema ``hd_diag/watch/1``; numbers in texts become numbers."""
    nodes = [{**node._asdict(), "joints": sorted(node.joints)} for node in watch.wanted_nodes()]
    content = {
        "schema": "hd_diag/watch/1",
        "nodes": [{"node": node.pop("name"), **node} for node in nodes],
        "joints": [_joint_json(view) for view in watch.view(now)],
        "missing": watch.missing(),
        "others": watch.others,
    }
    return dict(json_ready(content))


def _joint_json(view: JointView) -> dict[str, Any]:
    return {
        "joint": view.name,
        "hardware_id": view.status.hardware_id,
        "nodes": view.nodes,
        "topic": view.topic,
        "level": _level_name(view.level),
        "fault_code": view.code,
        "message": view.status.message,
        "stale": view.is_stale,
        "age": round(view.age, 3),
        "values": {key: _json_value(text) for key, text in view.status.values.items()},
        "residual_rms_arcsec": view.residuals,
    }


def _json_value(text: str) -> bool | int | float | str:
    if text in ("true", "false"):
        return text == "true"
    try:
        number = float(text)
    except ValueError:
        return text
    return int(number) if number.is_integer() and abs(number) < _LARGEST_WHOLE else number


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _level_name(level: int) -> str:
    return _LEVELS[level] if level < len(_LEVELS) else f"level {level}"


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _listed(names: Collection[str]) -> str:
    return listed(list(names), _NAMES_SHOWN)
