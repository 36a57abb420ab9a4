"""Events of a session as its log holds them: read back and checked, for a log may be damaged or hostile."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hd_diag.messages.publications import LAST_TIME, read_string

_LONGEST = 4 << 20  # of an event that a session of a hundred joints writes: some hundred kilobytes


@dataclass(frozen=True)
class Configured:
    """Parameters by full name: all of them where a session begins (`new`), else those that changed.

    `topics` holds the names that the node's topics had when the session began, by their names in `messages`;
    `models` the content of the model files that came into force, by joint; `versions` those of the software
    that the session began with, None where absent, and nothing where the log does not tell.
    """

    parameters: Mapping[str, Any]
    new: bool
    topics: Mapping[str, str] = field(default_factory=dict)
    models: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str | None] = field(default_factory=dict)


@dataclass(frozen=True)
class MapUsed:
    """From here on a joint is predicted by its map, which was built up to a torque [N m]."""

    joint: str
    torque_limit: float


@dataclass(frozen=True)
class Reported:
    """A report with its header stamp [ns] and what the surroundings knew."""

    stamp: int
    facts: Mapping[str, str]


@dataclass(frozen=True)
class ClockSetBack:
    """The clock of the stamps was set back: those later than a stamp [ns] are of before."""

    stamp: int


Event = Configured | MapUsed | Reported | ClockSetBack


def read_event(data: bytes) -> Event | None:
    """Event from the CDR of a std_msgs/String.

    Parameters
    ----------
    data : bytes

    Returns
    -------
    Configured, MapUsed, Reported, ClockSetBack or None
        None for a kind that later versions may add.

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
    except Exception as error:  # rosbags raises several kinds on a malformed message
        raise ValueError(str(error)) from error
    if not isinstance(content, dict) or not isinstance(content.get("event"), str):
        raise ValueError("it does not say its kind")
    reader = _READERS.get(content["event"])
    return reader(content) if reader else None


def _configured(content: Mapping[str, Any]) -> Configured:
    parameters, new = content.get("parameters"), content.get("new", False)
    if not isinstance(parameters, dict) or not isinstance(new, bool):
        raise ValueError("a configuration lacks its parameters")
    topics, models = (_texts(content.get(key, {}), key) for key in ("topics", "models"))
    return Configured(parameters, new, topics, models, _versions(content.get("versions", {})))


def _map_used(content: Mapping[str, Any]) -> MapUsed:
    joint, limit = content.get("joint"), content.get("torque_limit")
    if not isinstance(joint, str):
        raise ValueError("a map lacks its joint")
    if not isinstance(limit, float) or not 0.0 < limit < math.inf:
        raise ValueError("a map's torque_limit is no positive number")
    return MapUsed(joint, limit)


def _reported(content: Mapping[str, Any]) -> Reported:
    return Reported(_stamp(content, "a report"), _texts(content.get("facts"), "facts"))


def _clock_set_back(content: Mapping[str, Any]) -> ClockSetBack:
    return ClockSetBack(_stamp(content, "a clock"))


def _stamp(content: Mapping[str, Any], what: str) -> int:
    stamp = content.get("stamp")
    if not isinstance(stamp, int) or isinstance(stamp, bool) or not -LAST_TIME <= stamp <= LAST_TIME:
        raise ValueError(f"{what}'s stamp is no ROS time")
    return stamp


def _texts(value: Any, what: str) -> Mapping[str, str]:
    if not isinstance(value, dict) or not all(isinstance(text, str) for text in value.values()):
        raise ValueError(f"its {what} are no texts")
    return value


def _versions(value: Any) -> Mapping[str, str | None]:
    if not isinstance(value, dict) or not all(isinstance(text, str | None) for text in value.values()):
        raise ValueError("its versions are no texts")
    return value


_READERS: dict[str, Callable[[Mapping[str, Any]], Event]] = {
    "configuration": _configured,
    "map": _map_used,
    "report": _reported,
    "clock": _clock_set_back,
}
