"""What a watcher knows of running nodes: last report of every joint, nodes in the graph, what is missing."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hd_diag.formatting import json_ready, listed

PREFIX = "hd_diag: "
"""What the names of this package's statuses begin with; the joint follows."""

LEVELS = ("ok", "warn", "error", "stale")
"""Names of the levels of a diagnostic_msgs/DiagnosticStatus."""

DEFAULT_TOPIC = "/diagnostics"

_HISTORY = 240  # residuals kept of a joint, for its curve
_PERIODS = 20  # times between reports whose median is the usual one
_SILENT_PERIODS = 3.0  # usual periods without a report after which a joint is silent
_SILENT = 3.0  # and the least such time [s]
# What a hostile sender can make this process keep.
_MOST_JOINTS = 1024
_MOST_OTHERS = 32
_MOST_VALUES = 256
_LONGEST = 2000  # of a text [characters]
_LONGEST_WHOLE = 16  # digits, and one, that every reader of JSON keeps
_NAMES_SHOWN = 5


class ReportedStatus(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus: name, level, message, values, and whose it is."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]
    hardware_id: str = ""

    @property
    def joint(self) -> str:
        """What follows the prefix in the name."""
        return self.name[len(PREFIX) :]

    @property
    def node(self) -> str:
        """The node that the hardware_id, ``<node>/<joint>``, names; empty where it names none."""
        tail = f"/{self.joint}"
        return self.hardware_id.removesuffix(tail) if self.hardware_id.endswith(tail) else ""

    def bounded(self) -> ReportedStatus:
        """The same with long texts cut and surplus values dropped."""
        values = {_cut(key): _cut(value) for key, value in list(self.values.items())[:_MOST_VALUES]}
        return ReportedStatus(_cut(self.name), self.level, _cut(self.message), values, _cut(self.hardware_id))


class NodeSeen(NamedTuple):
    """A node of this package in the ROS graph: name with namespace, topic of its diagnostics, joints.

    The joints are those that its topics name; none where they are remapped.
    """

    name: str
    topic: str
    joints: frozenset[str] = frozenset()


class JointView(NamedTuple):
    """A joint at one moment.

    The nodes that may report it are several where no hardware_id tells them apart. `age` is the time since
    the last status [s]; the joint is silent where no report came for far longer than usual. `residuals` are
    the rms residuals of the last reports [arcsec].
    """

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
        return as_number(self.text(key))

    @property
    def level(self) -> int:
        """As in DiagnosticStatus: 0 where nothing is wrong."""
        return self.status.level

    @property
    def code(self) -> str:
        """Fault code; of one who reports none, the name of the level."""
        return self.text("fault_code") or level_name(self.level).upper()

    @property
    def is_stale(self) -> bool:
        """Whether its numbers are old: no report comes, or the node itself gets no samples."""
        return self.is_silent or "STALE" in self.text("fault_codes", self.code).split()


@dataclass
class _Reports:
    """State of a joint between its reports: the last status, when it came, periods and residuals."""

    status: ReportedStatus
    arrived: float
    periods: deque[float] = field(default_factory=lambda: deque(maxlen=_PERIODS))
    residuals: deque[float] = field(default_factory=lambda: deque(maxlen=_HISTORY))

    def is_silent(self, now: float) -> bool:
        usual = statistics.median(self.periods) if self.periods else 0.0
        return now - self.arrived > max(_SILENT, _SILENT_PERIODS * usual)


@dataclass
class Watch:
    """State of a watcher, of joints and of nodes in or below namespaces; where none is asked for, of all.

    The nodes are all in the graph now, `others` are names of statuses that are not this package's, `messages`
    counts the DiagnosticArrays that came, `answers` are those of nodes that were asked for a diagnosis.
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

    def wanted_nodes(self) -> list[NodeSeen]:
        """Nodes asked for that are in the graph."""
        return [node for node in self.nodes if self._is_wanted(node.name)]

    def view(self, now: float) -> list[JointView]:
        """The joints asked for that were reported, by node and name, at a time [s]."""
        views = []
        for (topic, _, joint), reports in self._reports.items():
            nodes = tuple(self._senders(topic, reports.status))
            is_wanted = not self.namespaces or any(map(self._is_wanted, nodes))
            if is_wanted and (not self.joints or joint in self.joints):
                age, residuals = max(0.0, now - reports.arrived), tuple(reports.residuals)
                views.append(
                    JointView(joint, topic, nodes, reports.status, age, reports.is_silent(now), residuals)
                )
        return sorted(views, key=lambda view: (view.nodes, view.topic, view.name, view.status.hardware_id))

    def missing(self) -> list[str]:
        """Joints that are asked for, or that a node asked for has, and that were not reported yet."""
        views = self.view(0.0)
        names = {view.name for view in views}
        if self.joints:
            return [joint for joint in self.joints if joint not in names]
        reported = {(name, view.topic, view.name) for view in views for name in view.nodes}
        return [
            f"{node.name} {joint}" if joint in names else joint
            for node in self.wanted_nodes()
            for joint in sorted(node.joints)
            if (node.name, node.topic, joint) not in reported
        ]

    def explanation(self) -> list[str]:
        """What was seen instead of what was asked for, one sentence each."""
        there, wanted = (_listed(node.name for node in nodes) for nodes in (self.nodes, self.wanted_nodes()))
        found = [f"{wanted} is there" if wanted else "no hd_diag node is in the ROS graph"]
        if there and not wanted:
            found = [f"no hd_diag node in {_listed(self.namespaces)}; there is {there}"]
        if self.joints and self._reports:
            found.append(f"joints reported: {_listed({joint for _, _, joint in self._reports})}")
        if self.others:
            found.append(f"other diagnostics: {_listed(self.others)}")
        elif not self.messages:
            found.append("no diagnostics at all")
        return found

    def _take_joint(self, topic: str, status: ReportedStatus, now: float) -> None:
        key = topic, status.hardware_id, status.joint
        reports = self._reports.get(key)
        if reports is not None:
            reports.periods.append(now - reports.arrived)
            reports.status, reports.arrived = status, now
        elif len(self._reports) < _MOST_JOINTS:
            reports = self._reports[key] = _Reports(status, now)
        else:
            return
        reports.residuals.append(as_number(status.values.get("residual_rms_arcsec", "")))

    def _is_wanted(self, name: str) -> bool:
        below = [f"/{namespace.strip('/')}/".replace("//", "/") for namespace in self.namespaces]
        return not below or name.startswith(tuple(below))

    def _senders(self, topic: str, status: ReportedStatus) -> list[str]:
        """Names of the nodes that may have sent a status: the one it names, or all that the graph leaves."""
        if status.node:
            return [status.node]
        on_topic = [node for node in self.nodes if node.topic == topic]
        return sorted(node.name for node in on_topic if not node.joints or status.joint in node.joints)


def as_number(text: str) -> float:
    """A text as a number; nan where it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def level_name(level: int) -> str:
    """Name of a DiagnosticStatus's level."""
    return LEVELS[level] if level < len(LEVELS) else f"level {level}"


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _listed(names: Iterable[str]) -> str:
    return listed(list(names) if isinstance(names, (list, tuple)) else sorted(names), _NAMES_SHOWN)


def as_json(watch: Watch, now: float) -> dict[str, Any]:
    """Everything that is known at a time [s], schema ``hd_diag/watch/1``; what looks like a number is one."""
    wanted = watch.wanted_nodes()
    content = {
        "schema": "hd_diag/watch/1",
        "nodes": [{"node": n.name, "topic": n.topic, "joints": sorted(n.joints)} for n in wanted],
        "joints": list(map(_joint_json, watch.view(now))),
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
        "level": level_name(view.level),
        "fault_code": view.code,
        "message": view.status.message,
        "stale": view.is_stale,
        "age": round(view.age, 3),
        "values": {key: _json_value(text) for key, text in view.status.values.items()},
        "residual_rms_arcsec": view.residuals,
    }


def _json_value(text: str) -> Any:
    if text in ("true", "false"):
        return text == "true"
    if len(text) < _LONGEST_WHOLE and text.isascii() and text.isdigit():
        return int(text)
    try:
        return float(text)
    except ValueError:
        return text
