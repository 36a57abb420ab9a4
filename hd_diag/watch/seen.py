"""What a watcher knows of running nodes: the last report of every joint, who is there, what is missing."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hd_diag.formatting import json_ready

PREFIX = "hd_diag: "
"""What the names of this package's statuses begin with; the joint follows."""

LEVELS = ("ok", "warn", "error", "stale")
"""Names of the levels of a diagnostic_msgs/DiagnosticStatus."""

DEFAULT_TOPIC = "/diagnostics"

_HISTORY = 240  # residuals kept of a joint, for its curve
_PERIODS = 20  # times between reports from which the usual one is taken
_SILENT_PERIODS = 3.0  # usual periods without a report after which a joint is stale
_SILENT = 3.0  # and the least such time [s]
# What a hostile sender can make this process keep.
_MOST_JOINTS = 1024
_MOST_OTHERS = 32
_MOST_VALUES = 256
_LONGEST = 2000  # of a text [characters]
_LONGEST_WHOLE = 16  # digits, and one, that every reader of JSON keeps
_NAMES_TOLD = 5


class Message(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus: name, level, text, values, and whose it is."""

    name: str
    level: int
    text: str
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


@dataclass(frozen=True)
class NodeSeen:
    """A node of this package in the ROS graph.

    Attributes
    ----------
    name : str
        With its namespace.
    topic : str
        Where it publishes diagnostics.
    joints : frozenset of str
        By its topics; empty where they are remapped.
    """

    name: str
    topic: str
    joints: frozenset[str] = frozenset()


@dataclass(frozen=True)
class JointView:
    """A joint at one moment.

    Attributes
    ----------
    name, topic, hardware_id, message : str
    nodes : tuple of str
        Who reports it; several where there is no hardware_id to tell them apart.
    level : int
        As in DiagnosticStatus.
    values : mapping of str to str
        The diagnostics' KeyValues.
    age : float
        Since the last report [s].
    is_silent : bool
        No report came for far longer than usual.
    residuals : tuple of float
        Rms residuals of the last reports [arcsec].
    """

    name: str
    topic: str
    hardware_id: str
    nodes: tuple[str, ...]
    level: int
    message: str
    values: Mapping[str, str]
    age: float
    is_silent: bool
    residuals: tuple[float, ...]

    def number(self, key: str) -> float:
        """A value as a number; nan where there is none."""
        return number(self.values.get(key, ""))

    @property
    def code(self) -> str:
        """Fault code; of one who reports none, the name of the level."""
        return self.values.get("fault_code") or level_name(self.level).upper()

    @property
    def is_faulty(self) -> bool:
        """Whether anything is wrong with it."""
        return self.level != 0

    @property
    def is_stale(self) -> bool:
        """Whether its numbers are old: no report comes, or the node itself gets no samples."""
        return self.is_silent or "STALE" in self.values.get("fault_codes", self.code).split()


@dataclass
class _Known:
    """What is carried of a joint from report to report."""

    message: Message
    arrived: float
    periods: deque[float] = field(default_factory=lambda: deque(maxlen=_PERIODS))
    residuals: deque[float] = field(default_factory=lambda: deque(maxlen=_HISTORY))

    def take(self, message: Message, now: float) -> None:
        self.periods.append(now - self.arrived)
        self.message, self.arrived = message, now

    def is_silent(self, now: float) -> bool:
        usual = statistics.median(self.periods) if self.periods else 0.0
        return now - self.arrived > max(_SILENT, _SILENT_PERIODS * usual)


@dataclass
class Watch:
    """State of a watcher.

    Attributes
    ----------
    joints : collection of str
        Joints asked for; empty = all.
    namespaces : collection of str
        Namespaces of the nodes asked for, with what is below them; empty = all.
    nodes : sequence of NodeSeen
        In the graph now, those not asked for too.
    others : list of str
        Names of statuses that are not this package's.
    messages : int
        DiagnosticArrays that came.
    """

    joints: Collection[str] = ()
    namespaces: Collection[str] = ()
    nodes: Sequence[NodeSeen] = ()
    others: list[str] = field(default_factory=list)
    messages: int = 0
    _known: dict[tuple[str, str, str], _Known] = field(default_factory=dict)

    def take(self, topic: str, statuses: Iterable[Message], now: float) -> None:
        """Take a DiagnosticArray that came on a topic at a time [s]."""
        self.messages += 1
        for status in statuses:
            if not status.name.startswith(PREFIX):
                self._note(_cut(status.name))
            else:
                self._take_joint(topic, _bounded(status), now)

    def wanted_nodes(self) -> list[NodeSeen]:
        """Nodes asked for that are in the graph."""
        return [node for node in self.nodes if self._is_wanted(node.name)]

    def view(self, now: float) -> list[JointView]:
        """The joints asked for that were reported, by node and name, at a time [s]."""
        views = [self._view(topic, known, now) for (topic, _, _), known in self._known.items()]
        shown = [view for view in views if view is not None]
        return sorted(shown, key=lambda view: (view.nodes, view.topic, view.name, view.hardware_id))

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
        found: list[str] = []
        if not self.nodes:
            found.append("no hd_diag node is in the ROS graph")
        elif not self.wanted_nodes():
            found.append(f"no hd_diag node in {_listed(self.namespaces)}; there is {_names(self.nodes)}")
        else:
            found.append(f"{_names(self.wanted_nodes())} is there")
        if self.joints and self._known:
            names = {known.message.joint for known in self._known.values()}
            found.append(f"joints reported: {_listed(sorted(names))}")
        if self.others:
            found.append(f"other diagnostics: {_listed(self.others)}")
        elif not self.messages:
            found.append("no diagnostics at all")
        return found

    def _note(self, name: str) -> None:
        if name not in self.others and len(self.others) < _MOST_OTHERS:
            self.others.append(name)

    def _take_joint(self, topic: str, status: Message, now: float) -> None:
        key = topic, status.hardware_id, status.joint
        known = self._known.get(key)
        if known is not None:
            known.take(status, now)
        elif len(self._known) < _MOST_JOINTS:
            known = self._known[key] = _Known(status, now)
        else:
            return
        known.residuals.append(number(status.values.get("residual_rms_arcsec", "")))

    def _is_wanted(self, name: str) -> bool:
        below = [f"/{namespace.strip('/')}/".replace("//", "/") for namespace in self.namespaces]
        return not below or any(name.startswith(namespace) for namespace in below)

    def _senders(self, topic: str, message: Message) -> list[str]:
        """Names of the nodes that may have sent a status: the one it names, or all that the graph leaves."""
        if message.node:
            return [message.node]
        on_topic = [node for node in self.nodes if node.topic == topic]
        return sorted(node.name for node in on_topic if not node.joints or message.joint in node.joints)

    def _view(self, topic: str, known: _Known, now: float) -> JointView | None:
        """The joint; None where it is not asked for."""
        joint = known.message.joint
        if self.joints and joint not in self.joints:
            return None
        senders = self._senders(topic, known.message)
        if self.namespaces and not any(map(self._is_wanted, senders)):
            return None
        return JointView(
            name=joint,
            topic=topic,
            hardware_id=known.message.hardware_id,
            nodes=tuple(senders),
            level=known.message.level,
            message=known.message.text,
            values=known.message.values,
            age=max(0.0, now - known.arrived),
            is_silent=known.is_silent(now),
            residuals=tuple(known.residuals),
        )


def number(text: str) -> float:
    """A text as a number; nan where it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def level_name(level: int) -> str:
    """Name of a DiagnosticStatus's level."""
    return LEVELS[level] if 0 <= level < len(LEVELS) else f"level {level}"


def as_json(watch: Watch, now: float) -> dict[str, Any]:
    """Everything that is known at a time [s], for ``--json``.

    Returns
    -------
    dict
        Schema ``hd_diag/watch/1``: ``nodes``, ``joints`` with the diagnostics' ``values``, ``missing``, and
        ``others``, names of statuses of other packages. Values that are finite numbers are numbers, those
        that are not finite are null.
    """
    return {
        "schema": "hd_diag/watch/1",
        "nodes": [
            {"node": node.name, "topic": node.topic, "joints": sorted(node.joints)}
            for node in watch.wanted_nodes()
        ],
        "joints": [_joint_json(view) for view in watch.view(now)],
        "missing": watch.missing(),
        "others": list(watch.others),
    }


def _joint_json(view: JointView) -> dict[str, Any]:
    return {
        "joint": view.name,
        "hardware_id": view.hardware_id,
        "nodes": list(view.nodes),
        "topic": view.topic,
        "level": level_name(view.level),
        "fault_code": view.code,
        "message": view.message,
        "stale": view.is_stale,
        "age": round(view.age, 3),
        "values": {key: _json_value(value) for key, value in view.values.items()},
        "residual_rms_arcsec": json_ready(view.residuals),
    }


def _json_value(text: str) -> Any:
    if text in ("true", "false"):
        return text == "true"
    if len(text) < _LONGEST_WHOLE and text.isascii() and text.isdigit():
        return int(text)
    try:
        value = float(text)
    except ValueError:
        return text
    return value if math.isfinite(value) else None


def _bounded(status: Message) -> Message:
    """What is kept of a status."""
    values = {_cut(key): _cut(value) for key, value in list(status.values.items())[:_MOST_VALUES]}
    return Message(_cut(status.name), status.level, _cut(status.text), values, _cut(status.hardware_id))


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


def _listed(names: Iterable[str]) -> str:
    every = list(names)
    more = f" and {len(every) - _NAMES_TOLD} more" if len(every) > _NAMES_TOLD else ""
    return ", ".join(every[:_NAMES_TOLD]) + more


def _names(nodes: Iterable[NodeSeen]) -> str:
    return _listed(sorted(node.name for node in nodes))
