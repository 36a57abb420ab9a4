"""Writes events of a session to its log and reads them back; a log may be damaged or hostile.

An event is a JSON object in a std_msgs/String, with its kind as ``event``:

configuration
    ``parameters`` by full name: all of them if a session begins (``new``), otherwise those that changed.
    ``topics`` maps the names of the node's topics in `messages` to their names at the session's start.
    ``models`` has the content of the model files that came into force, by joint. ``versions`` has the
    software versions at the session's start, null for absent software; it is empty if the log lacks them.
map
    From here on a ``joint`` is predicted with its map, which was built up to a ``torque_limit`` [N m].
report
    Header ``stamp`` [ns], ``facts`` from outside the monitor, and ``silence`` of each joint [s]. A clock that
    no other message contains measures the silence; older logs lack it.
clock
    The clock of the stamps was set back: stamps later than ``stamp`` [ns] are from before.
state
    State of the ``monitor`` where the log continues another one (see `monitor.carried`).
pace
    From here on only a ``share`` of the per-tooth arrays and drawings is published: the node cannot keep up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

from hd_diag.messages.publications import LAST_TIME, read_string, string

_LONGEST = 4 << 20  # longest event [byte]; a session of a hundred joints writes some hundred kilobytes

Event = dict[str, Any]


def write_event(event: str, **fields: Any) -> bytes:
    """CDR of a std_msgs/String with an event as a JSON object; empty optional mappings are left out."""
    known = {name: value for name, value in fields.items() if value or _USUAL.get(name) != {}}
    return string(json.dumps({"event": event, **known}))


def read_event(data: bytes) -> Event:
    """Event with all its fields from the CDR of a std_msgs/String; empty for an unknown, later kind.

    Raises
    ------
    ValueError
        If the event is invalid; the message says what it lacks.
    """
    if len(data) > _LONGEST:
        raise ValueError(f"it has {len(data)} bytes")
    try:
        content = json.loads(read_string(data))
    except RecursionError as error:
        raise ValueError("it is nested too deep") from error
    if not isinstance(content, dict) or not isinstance(content.get("event"), str):
        raise ValueError("it does not say its kind")
    if content["event"] not in _KINDS:
        return {}
    event = {"event": content["event"]}
    for name in _KINDS[content["event"]]:
        is_right, what = _FIELDS[name]
        event[name] = content.get(name, _USUAL.get(name))
        if not is_right(event[name]):
            raise ValueError(f"its {name} {what}")
    return event


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
_KINDS = {
    "configuration": ("new", "parameters", "topics", "versions", "models"),
    "map": ("joint", "torque_limit"),
    "report": ("stamp", "facts", "silence"),
    "clock": ("stamp",),
    "state": ("monitor",),
    "pace": ("share",),
}
_USUAL: Event = {"new": False, "topics": {}, "models": {}, "versions": {}, "silence": {}}
