"""What a watcher knows of running nodes: the last report of every joint, and what is missing."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hd_diag.formatting import json_ready, listed

PREFIX = "hd_diag: "
"""Start of the names of this package's statuses; the joint follows."""

_LEVELS = dict(enumerate(("ok", "warn", "error", "stale")))  # of a diagnostic_msgs/DiagnosticStatus
_SILENT_PERIODS, _SILENT = 3.0, 3.0  # a joint is silent after so many periods and seconds
_MOST_JOINTS, _MOST_VALUES, _LONGEST = 1024, 256, 2000  # a hostile sender cannot fill memory
_WHOLE_DIGITS, _NAMES_SHOWN = 15, 5  # digits that every reader of JSON keeps; names listed


class JointView(NamedTuple):
    """The last DiagnosticStatus of a joint, with texts turned into numbers, and its `age` when viewed [s].

    Reports of a silent joint have stopped. A stale one is silent, or its node gets no samples.
    """

    joint: str
    node: str
    hardware_id: str
    topic: str
    level: str
    fault_code: str
    message: str
    values: Mapping[str, bool | int | float | str]
    age: float = 0.0
    silent: bool = False
    stale: bool = False

    def number(self, key: str) -> float:
        """A value that is a number; nan if there is none."""
        value = self.values.get(key)
        return float(value) if isinstance(value, (int, float)) else math.nan


@dataclass
class Watch:
    """Reports of all joints and nodes, or of some, in so many `messages`; `answers` of nodes to requests."""

    joints: Collection[str] = ()
    namespaces: Collection[str] = ()
    messages: int = 0
    answers: dict[str, str] = field(default_factory=dict)
    # By topic, hardware_id and joint: the last report, its level, its time, the time since the one before.
    _seen: dict[tuple[str, str, str], tuple[JointView, int, float, float]] = field(default_factory=dict)

    def take(self, topic: str, array: Any, now: float) -> None:
        """Take a DiagnosticArray that came on a topic at a time [s]."""
        self.messages += 1
        for status in array.status:
            joint, hardware = status.name.removeprefix(PREFIX)[:_LONGEST], status.hardware_id[:_LONGEST]
            key, (level,) = (topic, hardware, joint), status.level
            if status.name.startswith(PREFIX) and (key in self._seen or len(self._seen) < _MOST_JOINTS):
                values = {v.key[:_LONGEST]: _value(v.value[:_LONGEST]) for v in status.values[:_MOST_VALUES]}
                node, named = hardware.removesuffix(f"/{joint}"), _LEVELS.get(level, f"level {level}")
                code, text = str(values.get("fault_code") or named.upper()), status.message[:_LONGEST]
                view = JointView(joint, node or topic, hardware, topic, named, code, text, values)
                period = now - self._seen[key][2] if key in self._seen else 0.0
                self._seen[key] = view, level, now, period

    def view(self, now: float) -> list[JointView]:
        """The chosen joints that were reported, as of a time [s]: the worst first, then by node and name."""
        below = tuple(f"/{namespace.strip('/')}/".replace("//", "/") for namespace in self.namespaces)
        views = []
        for view, level, arrived, period in self._seen.values():
            if (not below or view.node.startswith(below)) and (not self.joints or view.joint in self.joints):
                age = max(0.0, now - arrived)
                silent = age > max(_SILENT, _SILENT_PERIODS * period)
                codes = str(view.values.get("fault_codes", view.fault_code)).split()
                seen = view._replace(age=age, silent=silent, stale=silent or "STALE" in codes)
                views.append((-level, view.node, view.topic, view.joint, seen))
        return [view for *_, view in sorted(views, key=lambda row: row[:-1])]

    def missing(self) -> list[str]:
        """Chosen joints that were not reported yet."""
        return [joint for joint in self.joints if joint not in {view.joint for view in self.view(0.0)}]

    def lack(self, until: str) -> str:
        """Text on missing reports and those that came, `until` a time in words; empty if none is missing."""
        missing, seen = self.missing(), [f"{view.node} {view.joint}" for view, *_ in self._seen.values()]
        none = "only diagnostics of others came" if self.messages else "no diagnostics: same ROS_DOMAIN_ID?"
        there = f"there is {listed(seen, _NAMES_SHOWN)}" if seen else none
        words = f"no report of {', '.join(missing) or 'an hd_diag node'} {until}: {there}"
        return words if missing or not self.view(0.0) else ""

    def as_json(self, now: float) -> dict[str, Any]:
        """Everything known at a time [s], schema ``hd_diag/watch/1``."""
        joints = [view._asdict() for view in self.view(now)]
        return dict(json_ready({"schema": "hd_diag/watch/1", "joints": joints, "missing": self.missing()}))


def _value(text: str) -> bool | int | float | str:
    with contextlib.suppress(ValueError):
        return int(text) if text.isdecimal() and len(text) <= _WHOLE_DIGITS else float(text)
    return {"true": True, "false": False}.get(text, text)
