"""Paths to numbers in messages, such as ``interface_values[joint_1].values[position]``.

A path is names of fields with dots between. An array has an index: a number, or a name that stands at that
place in an array of texts of the same message (``name`` beside ``position``), or that is the element's own
``name``.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from hd_diag.streams.signals import Signal, nearest

_STEP = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?(\.(?=.)|$)", re.ASCII)
TEXT = (Nodetype.BASE, ("string", 0))
"""A field with a text."""

_TIME = "builtin_interfaces/msg/Time"
_HEADER = "std_msgs/msg/Header"

DTYPES = {
    **{f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)},
    **{"float32": "f4", "float64": "f8", "bool": "u1", "byte": "u1", "char": "u1"},
}
"""numpy's names of the numbers that fields can be."""


class PathStep(NamedTuple):
    """A field, and which element of it where it is an array."""

    field: str
    element: int | str | None = None


Path = tuple[PathStep, ...]


def is_array(kind: Any) -> bool:
    """Whether a field is an array of a fixed or any length."""
    return kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)


def holds_texts(description: Any) -> bool:
    """Whether a field is an array of texts."""
    kind, what = description
    return is_array(kind) and what[0][0] == Nodetype.BASE and what[0][1][0] == "string"


def parsed(text: str) -> Path:
    """A path from its text; ValueError where it is none."""
    steps: list[PathStep] = []
    place = 0
    while place < len(text) or not steps:
        found = _STEP.match(text, place)
        if found is None:
            raise ValueError(f"{text!a} is not a path such as position[2] or states[joint_1].angle")
        index = found[2]
        steps.append(PathStep(found[1], int(index) if index and index.isdecimal() else index))
        place = found.end()
    return tuple(steps)


def path_in(store: Typestore, type_name: str, signal: Signal) -> Path:
    """Path to a signal's number in messages of a type; arrays without an index get the signal's name as one.

    Raises
    ------
    ValueError
        Where there is none; it names the nearest field that there is.
    """
    path: list[PathStep] = []
    owner, steps = type_name, parsed(signal.field)
    for number, (field, given) in enumerate(steps, start=1):
        fields = dict(store.fielddefs[owner][1])
        if field not in fields:
            near = nearest(field, fields)
            told = f"the nearest is {near!r}, of" if near else "it has"
            raise ValueError(f"{owner} has no field {field!a}; {told} {', '.join(fields)}")
        (kind, what), index = _element(store, owner, PathStep(field, given), signal.name)
        path.append(PathStep(field, index))
        is_last = number == len(steps)
        if kind == Nodetype.NAME and not is_last:
            owner = what
        elif kind == Nodetype.NAME:
            inner = ", ".join(name for name, _ in store.fielddefs[what][1])
            raise ValueError(f"{field} of {owner} is not a number; it has {inner}")
        elif not is_last or what[0] not in DTYPES:
            raise ValueError(f"{field} of {owner} " + ("is not a number" if is_last else "has no fields"))
    return tuple(path)


def _element(store: Typestore, owner: str, step: PathStep, name: str) -> tuple[Any, int | str | None]:
    """What a field is, or an element of it, and the index of that."""
    field, index = step
    fields = dict(store.fielddefs[owner][1])
    what: Any
    kind, what = fields[field]
    if not is_array(kind):
        if index is not None:
            raise ValueError(f"{field} of {owner} is not an array")
        return (kind, what), None
    element: Any
    element, length = what
    own: Any = dict(store.fielddefs[element[1]][1]) if element[0] == Nodetype.NAME else {}
    has_names = any(map(holds_texts, fields.values())) or own.get("name") == TEXT
    index = name if index is None and has_names and name else index
    if index is None or (isinstance(index, str) and not has_names):
        raise ValueError(f"{field} of {owner} is an array without names: {field}[0] is its first element")
    if isinstance(index, int) and kind == Nodetype.ARRAY and index >= length:
        raise ValueError(f"{field} of {owner} has {length} elements, the last is {field}[{length - 1}]")
    return element, index


def stamp_path(store: Typestore, type_name: str) -> Path | None:
    """Place of a message's time: in its header, or a time of its own; None without."""
    for field, (kind, what) in store.fielddefs[type_name][1]:
        if kind == Nodetype.NAME and what in (_HEADER, _TIME):
            return (PathStep(field), *([PathStep("stamp")] if what == _HEADER else []))
    return None
