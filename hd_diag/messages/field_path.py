"""Paths to numbers in messages, such as ``interface_values[joint_1].values[position]``.

A path consists of field names separated by dots. An array has an index, which is a number or a name. A name
is looked up in an array of texts of the same message (``name`` beside ``position``), or among the elements'
own ``name`` fields.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from hd_diag.streams.signals import Signal, nearest

_STEP = re.compile(r"([A-Za-z]\w*)(?:\[([^\[\]]+)\])?(\.(?=.)|$)", re.ASCII)
TEXT = (Nodetype.BASE, ("string", 0))
"""Description of a text field."""

_TIME = "builtin_interfaces/msg/Time"
_HEADER = "std_msgs/msg/Header"

DTYPES = {
    **{f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)},
    **{"float32": "f4", "float64": "f8", "bool": "u1", "byte": "u1", "char": "u1"},
}
"""numpy's names of the number types of fields."""


class PathStep(NamedTuple):
    """A field and, if it is an array, the index or name of an element."""

    field: str
    element: int | str | None = None


Path = tuple[PathStep, ...]


def is_array(kind: Any) -> bool:
    """Whether a field is an array of fixed or variable length."""
    return kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)


def holds_texts(description: Any) -> bool:
    """Whether a field is an array of texts."""
    kind, what = description
    return is_array(kind) and what[0][0] == Nodetype.BASE and what[0][1][0] == "string"


def parsed(text: str) -> Path:
    """A path from its text; ValueError if the text is no path."""
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
    """Path to a signal's number in messages of a type; the signal's name is the index of arrays without one.

    Raises
    ------
    ValueError
        If there is none; the message names the nearest field.
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
    """Description of a field, or of an element of an array, and the element's index."""
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
    """Path to a message's time, in its header or in a time field; None if it has no time."""
    for field, (kind, what) in store.fielddefs[type_name][1]:
        if kind == Nodetype.NAME and what in (_HEADER, _TIME):
            return (PathStep(field), *([PathStep("stamp")] if what == _HEADER else []))
    return None
