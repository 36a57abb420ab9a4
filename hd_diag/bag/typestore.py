"""Message types as a bag itself defines them."""

from __future__ import annotations

import re
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg
from rosbags.typesys.store import Typestore

from hd_diag.messages.schemas import Definition, jazzy

_NAME = re.compile(r"[A-Za-z]\w{0,99}/(msg|srv|action)/[A-Za-z]\w{0,99}", re.ASCII)
# The deserializer of rosbags is unrolled over fixed arrays: longer ones of anything but numbers are refused.
_MAX_UNROLLED = 1000
_MAX_TEXT = 128 << 10


class BagTypes:
    """Types of one bag: from its own definitions, from ROS 2 Jazzy where it has none."""

    def __init__(self) -> None:
        self._stores: dict[Definition, Typestore] = {}
        self._standard: dict[Definition | None, bool] = {}

    def store(self, type_name: str, known: Definition | None) -> Typestore:
        """Type store that has `type_name`.

        Raises
        ------
        ValueError
            Where the definition is missing or cannot be understood.
        """
        if known is None or not known.text or known.text == _own_text(type_name):
            if type_name not in jazzy().fielddefs:
                raise ValueError(f"type {type_name} is not defined in the bag, and not a type of ROS 2 Jazzy")
            return jazzy()
        if known not in self._stores:
            self._stores[known] = _register(known)
        return self._stores[known]

    def is_standard(self, type_name: str, known: Definition | None) -> bool:
        """Whether the bag means the same by `type_name` as ROS 2 Jazzy does, field by field."""
        if known not in self._standard:
            store = self.store(type_name, known)
            self._standard[known] = store is jazzy() or _same(store, jazzy(), type_name)
        return self._standard[known]


def _own_text(type_name: str) -> str | None:
    store = jazzy()
    return store.generate_msgdef(type_name, ros_version=2)[0] if type_name in store.fielddefs else None


def _register(known: Definition) -> Typestore:
    """A fresh store with a definition and what it uses."""
    is_msg = known.encoding == "ros2msg"
    text = _bare(known.text, "#" if is_msg else "//")
    if not _NAME.fullmatch(known.type_name) or len(text) > _MAX_TEXT:
        raise ValueError(f"definition of {known.type_name[:100]} is not usable")
    try:
        types = get_types_from_msg(text, known.type_name) if is_msg else get_types_from_idl(text)
        for name, (_, fields) in types.items():
            if not _NAME.fullmatch(name) or not all(_bounded(desc) for _, desc in fields):
                raise ValueError(f"type {name[:100]} is not usable")
        store = Typestore()
        store.register(types)
        store.get_msgdef(known.type_name)
    except (
        Exception
    ) as exc:  # rosbags raises many kinds on hostile text, RecursionError and AssertionError too
        raise ValueError(f"definition of {known.type_name} cannot be understood: {exc}") from exc
    return store


def _bare(text: str, comment: str) -> str:
    """Text without empty and comment lines: the parser's time grows with the square of their number."""
    lines = (line for line in text.splitlines() if line.strip())
    return "".join(line + "\n" for line in lines if not line.lstrip().startswith(comment))


def _bounded(desc: Any) -> bool:
    """Whether decoding takes work in proportion to the data: no long unrolled, and no empty, fixed arrays."""
    if desc[0] != Nodetype.ARRAY:
        return True
    element, length = desc[1]
    plain = element[0] == Nodetype.BASE and element[1][0] != "string"
    return int(length) > 0 and (plain or int(length) <= _MAX_UNROLLED)


def _same(store: Typestore, other: Typestore, type_name: str) -> bool:
    """Whether two stores agree on the fields of a type and of all that it uses."""
    if type_name not in store.fielddefs or type_name not in other.fielddefs:
        return False
    fields, others = store.fielddefs[type_name][1], other.fielddefs[type_name][1]
    return list(fields) == list(others) and all(
        _same(store, other, name) for _, desc in fields for name in _uses(desc)
    )


def _uses(desc: Any) -> list[str]:
    if desc[0] == Nodetype.NAME:
        return [str(desc[1])]
    return _uses(desc[1][0]) if desc[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else []
