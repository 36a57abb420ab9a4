"""What a watcher knows of running nodes: the last report of every joint, and what is missing."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, NamedTuple

from hd_diag.formatting import json_ready, listed

PREFIX = "hd_diag: "
"""Start of the names of this package's statuses; the joint follows."""

_LEVELS = ("ok", "warn", "error", "stale")  # of a diagnostic_msgs/DiagnosticStatus
_SILENT_PERIODS, _SILENT = 3.0, 3.0  # a joint is silent after so many periods and seconds
_MOST_JOINTS, _MOST_VALUES, _LONGEST = 1024, 256, 2000  # a hostile sender cannot fill memory
_WHOLE_DIGITS, _NAMES_SHOWN = 15, 5  # every reader of JSON keeps such a whole number


class JointView(NamedTuple):
    """The last DiagnosticStatus of a joint: arrival and the period before it [s], seen at a time [s]."""

    joint: str
    topic: str
    hardware_id: str
    level: int
    message: str
    values: Mapping[str, str]
    arrived: float
    period: float
    now: float

    def text(self, key: str, default: str = "") -> str:
        """A value of the diagnostics."""
        return self.values.get(key, default)

    def number(self, key: str) -> float:
        """A value as a number; nan where there is none."""
        with contextlib.suppress(ValueError):
            return float(self.text(key))
        return math.nan

    @property
    def node(self) -> str:
        """The node, which the hardware_id ``<node>/<joint>`` names."""
        return self.hardware_id.removesuffix(f"/{self.joint}") or self.topic

    @property
    def code(self) -> str:
        """Fault code, or else the level's name."""
        return self.text("fault_code") or self.level_name.upper()

    @property
    def level_name(self) -> str:
        """Name of the level."""
        return _LEVELS[self.level] if self.level < len(_LEVELS) else f"level {self.level}"

    @property
    def age(self) -> float:
        """Time since the last report [s]."""
        return max(0.0, self.now - self.arrived)

    @property
    def is_silent(self) -> bool:
        """Whether reports have stopped."""
        return self.age > max(_SILENT, _SILENT_PERIODS * self.period)

    @property
    def is_stale(self) -> bool:
        """Whether its numbers are old: no report comes, or the node itself gets no samples."""
        return self.is_silent or "STALE" in self.text("fault_codes", self.code).split()


@dataclass
class Watch:
    """State of a watcher. It shows all joints and nodes, or those that are asked for.

    `messages` counts DiagnosticArrays, `answers` come from nodes that were asked for a diagnosis.
    """

    joints: Collection[str] = ()
    namespaces: Collection[str] = ()
    messages: int = 0
    answers: dict[str, str] = field(default_factory=dict)
    _views: dict[tuple[str, str, str], JointView] = field(default_factory=dict)

    def take(self, topic: str, statuses: Iterable[Any], now: float) -> None:
        """Take what came on a topic at a time [s]: name, level, message, values, hardware_id of statuses."""
        self.messages += 1
        for name, level, text, values, identifier in statuses:
            joint, message, hardware_id = (
                t[:_LONGEST] for t in (name.removeprefix(PREFIX), text, identifier)
            )
            key = topic, hardware_id, joint
            if name.startswith(PREFIX) and (key in self._views or len(self._views) < _MOST_JOINTS):
                kept = {k[:_LONGEST]: v[:_LONGEST] for k, v in islice(values.items(), _MOST_VALUES)}
                period = now - self._views[key].arrived if key in self._views else 0.0
                self._views[key] = JointView(
                    joint, topic, hardware_id, level, message, kept, now, period, now
                )

    def view(self, now: float) -> list[JointView]:
        """The joints asked for that were reported, by node and name, at a time [s]."""
        views = [view._replace(now=now) for view in self._views.values() if self._is_wanted(view.node)]
        views = [view for view in views if not self.joints or view.joint in self.joints]
        return sorted(views, key=lambda view: (view.node, view.topic, view.joint))

    def nodes(self) -> list[str]:
        """Names of the nodes that reported a joint asked for."""
        return sorted({view.node for view in self.view(0.0)})

    def missing(self) -> list[str]:
        """Joints that were asked for and not reported yet."""
        return [joint for joint in self.joints if joint not in {view.joint for view in self.view(0.0)}]

    def explanation(self) -> str:
        """What was seen instead of what was asked for."""
        reported = [f"{view.node} {view.joint}" for view in self._views.values()]
        none = "only diagnostics of others came" if self.messages else "no diagnostics came at all"
        return f"there is {listed(reported, _NAMES_SHOWN)}" if reported else none

    def _is_wanted(self, node: str) -> bool:
        below = [f"/{namespace.strip('/')}/".replace("//", "/") for namespace in self.namespaces]
        return not below or node.startswith(tuple(below))


def as_json(watch: Watch, now: float) -> dict[str, Any]:
    """Everything known at a time [s], schema ``hd_diag/watch/1``; numbers in texts become numbers."""
    joints = [
        {name: getattr(view, name) for name in ("joint", "node", "hardware_id", "topic", "message", "age")}
        | {"level": view.level_name, "fault_code": view.code, "stale": view.is_stale}
        | {"values": {key: _json_value(text) for key, text in view.values.items()}}
        for view in watch.view(now)
    ]
    return dict(json_ready({"schema": "hd_diag/watch/1", "joints": joints, "missing": watch.missing()}))


def _json_value(text: str) -> bool | int | float | str:
    if text in ("true", "false"):
        return text == "true"
    with contextlib.suppress(ValueError):
        return int(text) if text.isdecimal() and len(text) <= _WHOLE_DIGITS else float(text)
    return text
