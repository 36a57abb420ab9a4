"""Places of fields in a CDR message, from the definition of its type."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from hd_diag.arrays import Bytes, Integers
from hd_diag.messages.field_path import DTYPES, TEXT, Path, holds_texts, is_array
from hd_diag.messages.schemas import check_begin

_SIZES = {name: int(code[1]) for name, code in DTYPES.items()}


class Walk:
    """Walks through a CDR message; places count from its first byte, alignment from the end of its header.

    All methods raise ValueError if the message is malformed. `fixed` holds begin and end of the bytes that
    determine places: lengths, and texts that identify elements. `names` holds these texts.
    """

    def __init__(self, data: bytes, store: Typestore) -> None:
        check_begin(data)
        self.data, self._store = data, store
        self._uint32 = struct.Struct("<I" if data[1] else ">I").unpack_from
        self.fixed: list[tuple[int, int]] = []
        self.names: list[str] = []

    def message(self, type_name: str, begin: int) -> tuple[dict[str, tuple[Any, int]], int]:
        """Description and begin of each field of a message, and the end of the message."""
        fields = {}
        for name, description in self._store.fielddefs[type_name][1]:
            fields[name] = description, begin
            begin = self._end(description, begin)
        return fields, begin

    def place(self, type_name: str, path: Path, begin: int = 4) -> tuple[int, str] | None:
        """Place and type of the number at a path; None if no element has the name."""
        (field, index), rest = path[0], path[1:]
        fields, _ = self.message(type_name, begin)
        description, begin = fields[field]
        number = 0
        if is_array(description[0]):
            description, count, begin = self.elements(description, begin)
            found = (
                index
                if isinstance(index, int)
                else self._named(str(index), fields, description, count, begin)
            )
            if found is None:
                return None
            if found >= count:
                raise ValueError(f"has {count} elements of {field}: none is {field}[{found}]")
            number = found
        if description[0] == Nodetype.NAME:
            for _ in range(number):
                begin = self._end(description, begin)
            return self.place(description[1], rest, begin)
        name = description[1][0]
        return aligned(begin, _SIZES[name]) + number * _SIZES[name], DTYPES[name]

    def _end(self, description: Any, begin: int) -> int:
        """End of a field."""
        kind, what = description
        if kind == Nodetype.NAME:
            return self.message(what, begin)[1]
        if kind == Nodetype.BASE:
            return self.text(begin)[1] if what[0] == "string" else self._numbers(what[0], 1, begin)
        element, count, begin = self.elements(description, begin)
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            return self._numbers(element[1][0], count, begin)
        if count > len(self.data) - begin:
            raise ValueError(f"is cut off: claims an array of {count}")
        for _ in range(count):
            begin = self._end(element, begin)
        return begin

    def _numbers(self, kind: str, count: int, begin: int) -> int:
        size = _SIZES.get(kind)
        if size is None:
            raise ValueError(f"has a {kind}, which is not supported")
        return self._within(aligned(begin, size) + count * size) if count else begin

    def elements(self, description: Any, begin: int) -> tuple[Any, int, int]:
        """Description, number and begin of the elements of an array."""
        element, count = description[1]
        if description[0] == Nodetype.SEQUENCE:
            count, begin = self._count(begin)
        return element, count, begin

    def _count(self, begin: int) -> tuple[int, int]:
        begin = aligned(begin, 4)
        end = self._within(begin + 4)
        self.fixed.append((begin, end))
        return int(self._uint32(self.data, begin)[0]), end

    def text(self, begin: int) -> tuple[int, int]:
        """Begin and end of the characters of a text."""
        size, begin = self._count(begin)
        return begin, self._within(begin + size)

    def _within(self, place: int) -> int:
        if place > len(self.data):
            raise ValueError("is cut off")
        return place

    def _known(self, begin: int) -> tuple[str, int]:
        """A text that identifies an element, and its end."""
        begin, end = self.text(begin)
        self.fixed.append((begin, end))
        self.names.append(self.data[begin:end].rstrip(b"\0").decode("utf-8", "replace"))
        return self.names[-1], end

    def _named(
        self, name: str, fields: Mapping[str, tuple[Any, int]], element: Any, count: int, begin: int
    ) -> int | None:
        """Index of the element with a name, from texts beside the array or the elements' own; else None."""
        for description, at in fields.values():
            if holds_texts(description):
                _, texts, at = self.elements(description, at)
                for number in range(texts):
                    text, at = self._known(at)
                    if text == name:
                        return number
        for number in range(count if element[0] == Nodetype.NAME else 0):
            own, end = self.message(element[1], begin)
            if own.get("name", (None, 0))[0] == TEXT and self._known(own["name"][1])[0] == name:
                return number
            begin = end
        return None


def aligned(place: int, size: int) -> int:
    """The next place that is aligned for a number of a size [byte]."""
    return (place - 4 + size - 1) // size * size + 4


def by_size(payload: Bytes | Sequence[bytes | memoryview]) -> Iterator[tuple[Bytes, Integers]]:
    """Messages grouped by size, shape (n, size), with their positions."""
    if isinstance(payload, np.ndarray):
        yield payload, np.arange(len(payload))
        return
    sizes: dict[int, list[int]] = {}
    for index, data in enumerate(payload):
        sizes.setdefault(len(data), []).append(index)
    for same in sizes.values():
        joined = b"".join(payload[i] for i in same)
        yield np.frombuffer(joined, np.uint8).reshape(len(same), -1), np.array(same)


def bad_stamp(nano: int) -> str:
    """Text on a stamp with too many nanoseconds."""
    return f"has a stamp with {nano} nanoseconds, 1e9 or more"
