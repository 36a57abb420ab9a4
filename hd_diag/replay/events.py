"""Events of a session, written to its log and read back: a log may be damaged or hostile."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hd_diag.messages.publications import LAST_TIME, read_string, string

_LONGEST = 4 << 20  # of an event that a session of a hundred joints writes: some hundred kilobytes


@dataclass(frozen=True)
class Configured:
    """Parameters by full name: all of them where a session begins (`new`), else those that changed.

    `topics` holds the names that the node's topics had when the session began, by their names in `messages`;
    `models` the content of the model files that came into force, by joint; `versions` those of the software
    that the session began with, None where absent, and nothing where the log does not tell.
    """

    new: bool
    parameters: Mapping[str, Any]
    topics: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str | None] = field(default_factory=dict)
    models: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class MapUsed:
    """From here on a joint is predicted by its map, which was built up to a torque [N m]."""

    joint: str
    torque_limit: float


@dataclass(frozen=True)
class Reported:
    """A report: header stamp [ns], what the surroundings knew, how long each joint had been silent [s].

    Silence goes by a clock that no other message holds; logs of before do not tell it.
    """

    stamp: int
    facts: Mapping[str, str]
    silence: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ClockSetBack:
    """The clock of the stamps was set back: those later than a stamp [ns] are of before."""

    stamp: int


@dataclass(frozen=True)
class CarriedOn:
    """A log that goes on where another ended: what the monitor knew by then (see `monitor.carried`)."""

    monitor: Mapping[str, Any]


@dataclass(frozen=True)
class Paced:
    """From here on a share of the per-tooth arrays and drawings is published: the node cannot keep up."""

    share: float


Event = Configured | MapUsed | Reported | ClockSetBack | CarriedOn | Paced

_KINDS: dict[str, type[Event]] = {
    "configuration": Configured,
    "map": MapUsed,
    "report": Reported,
    "clock": ClockSetBack,
    "state": CarriedOn,
    "pace": Paced,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def write_event(event: Event) -> bytes:
    """CDR of a std_msgs/String with an event as a JSON object; what is empty is left out."""
    known = {name: value for name, value in vars(event).items() if value or name not in _OPTIONAL}
    return string(json.dumps({"event": _NAMES[type(event)], **known}))


def read_event(data: bytes) -> Event | None:
    """Event from the CDR of a std_msgs/String; None for a kind that later versions may add.

    Raises
    ------
    ValueError
        Saying what it lacks.
    """
    if len(data) > _LONGEST:
        raise ValueError(f"it has {len(data)} bytes")
    try:
        content = json.loads(read_string(data))
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error
    if not isinstance(content, dict) or not isinstance(content.get("event"), str):
        raise ValueError("it does not say its kind")
    kind = _KINDS.get(content["event"])
    if kind is None:
        return None
    given = {"new": False, **content} if kind is Configured else content
    names = [name for name in kind.__dataclass_fields__ if name in given or name not in _OPTIONAL]
    return kind(**{name: _checked(name, given.get(name)) for name in names})


def _checked(name: str, value: Any) -> Any:
    is_right, what = _FIELDS[name]
    if not is_right(value):
        raise ValueError(f"its {name} {what}")
    return value


def _texts(value: Any, kind: Any = str) -> bool:
    return isinstance(value, dict) and all(isinstance(text, kind) for text in value.values())


def _number(value: Any) -> bool:
    return isinstance(value, float) and 0.0 <= value < math.inf


_FIELDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "new": (lambda value: isinstance(value, bool), "is neither true nor false"),
    "parameters": (lambda value: isinstance(value, dict), "are missing"),
    "topics": (_texts, "are no texts"),
    "models": (_texts, "are no texts"),
    "versions": (lambda value: _texts(value, str | None), "are no texts"),
    "joint": (lambda value: isinstance(value, str), "is missing"),
    "torque_limit": (lambda value: _number(value) and value > 0.0, "is no positive number"),
    "stamp": (lambda value: type(value) is int and abs(value) <= LAST_TIME, "is no ROS time"),
    "facts": (_texts, "are no texts"),
    "silence": (
        lambda value: isinstance(value, dict) and all(map(_number, value.values())),
        "is not a number of seconds",
    ),
    "share": (lambda value: _number(value) and 0.0 < value <= 1.0, "is no share"),
    "monitor": (lambda value: isinstance(value, dict), "is missing"),
}
_OPTIONAL = {"topics", "models", "versions", "silence"}
