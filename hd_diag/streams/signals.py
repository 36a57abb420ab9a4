"""Signals as robots publish them: message, field and unit of each quantity of a joint."""

from __future__ import annotations

import difflib
import functools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.streams.columns import JointStates

ROLES = ("input", "output", "torque", "temperature")
"""Roles of a joint's signals."""

_TURN = 2.0 * math.pi
_ANGLES = {"rad": 1.0, "deg": _TURN / 360.0, "turns": _TURN}
_COUNTS = re.compile(r"counts/(\d+(?:\.\d+)?)")
_ZERO_CELSIUS = 273.15  # [K]
_COUNTER = 2.0**16  # counts after which a small counter wraps
_ALIKE = 0.6  # difflib's ratio from which words are close
_SHORT = 3  # least letters of a beginning that may stand for a name
_LONGEST = 80  # characters of a name that are compared


class Unit(NamedTuple):
    """Conversion of a value: factor times value plus offset is in SI, or degree Celsius for temperatures.

    A rate is an angle per time. A current is in ampere, for users who know the N m per ampere.
    """

    factor: float
    offset: float = 0.0
    is_rate: bool = False
    is_counts: bool = False
    is_current: bool = False

    @property
    def counter(self) -> float:
        """Angle of 16 bits of counts [rad]; 0 if the unit is not counts."""
        return _COUNTER * abs(self.factor) * self.is_counts


_UNITS = {
    "angle": {
        **{name: Unit(factor) for name, factor in _ANGLES.items()},
        **{f"{name}/s": Unit(factor, is_rate=True) for name, factor in _ANGLES.items()},
        "rpm": Unit(_TURN / 60.0, is_rate=True),
    },
    "torque": {
        "N m": Unit(1.0),
        "N mm": Unit(1e-3),
        "A": Unit(1.0, is_current=True),
        "mA": Unit(1e-3, is_current=True),
    },
    "temperature": {"degC": Unit(1.0), "K": Unit(1.0, -_ZERO_CELSIUS)},
    "time": {"s": Unit(1.0), "ms": Unit(1e-3), "us": Unit(1e-6), "ns": Unit(1e-9)},
}


_OTHERWISE = {
    **dict.fromkeys(("°", "degree", "degrees"), "deg"),
    **dict.fromkeys(("turn", "rev"), "turns"),
    **dict.fromkeys(("Nm", "N·m", "N.m", "N*m"), "N m"),
    **dict.fromkeys(("°C", "C"), "degC"),
    "rad/sec": "rad/s",
    "deg/sec": "deg/s",
    "µs": "us",
}


def unit(role: str, text: str) -> Unit:
    """Unit of a quantity, one of `ROLES` or ``time``, by its name; a ValueError lists the known ones.

    Counts of an encoder have the unit ``counts/4096``, with the number of counts per turn.
    """
    text = _OTHERWISE.get(text, text)
    known = _UNITS["angle" if role in ("input", "output") else role]
    if role == "output":
        known = {name: each for name, each in known.items() if not each.is_rate}
    counts = _COUNTS.fullmatch(text) if "rad" in known else None
    if counts and float(counts[1]) > 0.0:
        return Unit(_TURN / float(counts[1]), is_counts=True)
    if text not in known:
        names = ", ".join([*known, *(["counts/N (N to the turn)"] if "rad" in known else [])])
        raise ValueError(f"{text!a} is not a unit of {role}; there are {names}")
    return known[text]


def is_unit(text: str) -> bool:
    """Whether a text is the name of any unit."""
    name = _OTHERWISE.get(text, text)
    return bool(_COUNTS.fullmatch(name)) or any(name in known for known in _UNITS.values())


@dataclass(frozen=True)
class Signal:
    """Place of a quantity in a message.

    `topic` is empty for any topic with joint states. `type_name` is ``package/msg/Name``. `field` is a path
    as in `hd_diag.messages.field_path`. `name` is the index of arrays that have none in the path. `unit`
    includes scale and sign. With `by_reception` the time of reception replaces the stamp.
    """

    topic: str
    type_name: str
    field: str
    name: str
    unit: Unit
    by_reception: bool = False


class JointSignals(NamedTuple):
    """Signals of a joint; None for a signal in its usual place."""

    input: Signal | None = None
    output: Signal | None = None
    torque: Signal | None = None
    temperature: Signal | None = None

    @property
    def is_current(self) -> bool:
        """Whether the torque is a motor's current times a constant."""
        return self.torque is not None and self.torque.unit.is_current

    @property
    def is_velocity(self) -> bool:
        """Whether the input is known by its velocity alone."""
        return self.input is not None and self.input.unit.is_rate


USUAL = JointSignals()


def key(joint: str, role: str) -> str:
    """Key of a signal's column."""
    return f"{joint}.{role}"


def temperatures(states: JointStates) -> dict[str, Floats]:
    """Temperature columns among the signals, by joint [degree Celsius]."""
    if states.signals is None:
        return {}
    end = key("", "temperature")
    return {k[: -len(end)]: states.signals[:, i] for i, k in enumerate(states.keys) if k.endswith(end)}


def temperature_changes(shapes: Sequence[JointStates]) -> Integers:
    """Rows where a temperature differs from the last message with the same signals."""
    rows = [
        states.row[np.concatenate(([True], np.diff(column) != 0.0))]
        for states in shapes
        for column in temperatures(states).values()
    ]
    return np.unique(np.concatenate(rows)) if rows else np.empty(0, np.int64)


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name that `name` may mean; empty if none is similar.

    Names with dots are compared part by part: first by all parts of `name`, then by its last part alone.
    """
    every, parts = [*known], name[:_LONGEST].casefold().split(".")
    likeness = functools.cache(_likeness)
    for wanted in (parts, parts[-1:]):
        found = {each: _fit(wanted, each.casefold().split("."), likeness) for each in every}
        best = max(found.values(), default=0.0)
        if best >= _ALIKE:
            equal = [each for each in every if found[each] == best]
            return max(equal, key=lambda each: likeness(".".join(parts), each.casefold()))
    return ""


def _fit(wanted: Sequence[str], parts: Sequence[str], likeness: Callable[[str, str], float]) -> float:
    """How well `wanted` matches consecutive parts: likeness of the worst pair, at the best place."""
    places = range(len(parts) - len(wanted) + 1)
    rows = (zip(wanted, parts[at:], strict=False) for at in places)
    return max((min(likeness(*pair) for pair in row) for row in rows), default=0.0)


def _likeness(one: str, other: str) -> float:
    """Likeness of a word and a name, 0 to 1; the word may be the beginning of the name."""
    begins = len(one) >= _SHORT and other.startswith(one)
    return max(difflib.SequenceMatcher(None, one, other).ratio(), _ALIKE * begins)
