"""Numbers of messages of any type as columns.

CDR puts the same things at the same places in every message with the same lengths. Places are worked out once
for each such layout, from one message; the others are compared with it in all bytes on which they depend.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from hd_diag.arrays import Bytes, Integers, Times
from hd_diag.messages.field_path import DTYPES, TEXT, Path, Step, holds_texts, is_array, path_in, stamp_path
from hd_diag.messages.joint_states import Rejection
from hd_diag.streams.columns import JointStates
from hd_diag.streams.signals import Signal

_REMEMBERED = 64  # layouts
_FIRST = np.zeros(1, np.int64)
_NANOSECONDS = 1_000_000_000
_CODES = dict(zip(("i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"), "bhiqBHIQfd", strict=True))
_SIZES = {name: int(code[1]) for name, code in DTYPES.items()}


class _Layout(NamedTuple):
    """Messages of one size: bytes (m,) that are as in the template; places and types of numbers by key.

    `known` are those bytes of the template; `unpack` and `time` read the numbers and the stamp's two.
    """

    fixed: Integers
    template: Bytes
    numbers: dict[str, tuple[int, str]]
    stamp: tuple[int, ...]
    known: bytes
    unpack: tuple[Callable[[bytes, int], tuple[Any, ...]], ...]
    time: tuple[Callable[[bytes, int], tuple[Any, ...]], ...]


class FieldReader:
    """Reads signals from messages of a topic.

    Parameters
    ----------
    store : Typestore
        In which the type is.
    type_name : str
    signals : mapping of str to Signal
        By the keys that their columns get.

    Raises
    ------
    ValueError
        Where the type has no number at a signal's path; it names the nearest field.
    """

    def __init__(self, store: Typestore, type_name: str, signals: Mapping[str, Signal]) -> None:
        self._store, self._type_name = store, type_name
        self._units = {key: signal.unit for key, signal in signals.items()}
        self._paths = {key: path_in(store, type_name, signal) for key, signal in signals.items()}
        self._stamp = stamp_path(store, type_name)
        self._layouts: dict[int, list[_Layout]] = {}

    def columns(
        self, payload: Bytes | Sequence[bytes | memoryview], received: Times
    ) -> tuple[list[JointStates], list[Rejection]]:
        """Signals of messages; times of reception [ns] (n,) stand for stamps where a message has none."""
        columns: list[JointStates] = []
        rejected: list[Rejection] = []
        for rows, index in _by_size(payload):
            for layout, chosen in self._by_layout(rows, index, rejected):
                columns += self._states(layout, rows[chosen], index[chosen], received, rejected)
        return sorted(columns, key=lambda states: int(states.row[0])), sorted(rejected)

    def one(self, data: bytes, received: Times) -> JointStates:
        """Signals, n = 1, of one message; ValueError says how it is malformed."""
        view = np.frombuffer(data, np.uint8)
        for layout in self._layouts.get(len(data), ()):
            if view[layout.fixed].tobytes() == layout.known:
                return self._one(layout, data, received)
        columns, rejected = self.columns([data], received)
        if rejected:
            raise ValueError(rejected[0].reason)
        return columns[0]

    def _one(self, layout: _Layout, data: bytes, received: Times) -> JointStates:
        values, stamp = [], received
        for (key, (place, _)), unpack in zip(layout.numbers.items(), layout.unpack, strict=True):
            unit = self._units[key]
            values.append(unpack(data, place)[0] * unit.factor + unit.offset)
        if layout.stamp:
            (second,), (nano,) = (
                unpack(data, p) for unpack, p in zip(layout.time, layout.stamp, strict=True)
            )
            if nano >= _NANOSECONDS:
                raise ValueError(_bad_stamp(nano))
            stamp = np.array([second * _NANOSECONDS + nano])
        signals = np.array([values]) if values else None
        return JointStates(_FIRST, stamp, (), "", None, None, None, signals, tuple(layout.numbers))

    def _by_layout(
        self, rows: Bytes, index: Integers, rejected: list[Rejection]
    ) -> Iterator[tuple[_Layout, Integers]]:
        """Layouts of messages of one size, with their positions among these."""
        left, known = np.arange(len(rows)), iter([*self._layouts.get(rows.shape[1], ())])
        while left.size:
            try:
                layout = next(known, None) or self._layout(rows[left[0]].tobytes())
            except ValueError as error:
                rejected.append(Rejection(int(index[left[0]]), str(error)))
                left = left[1:]
                continue
            fits = (rows[left][:, layout.fixed] == layout.template[layout.fixed]).all(axis=1)
            if fits.any():
                yield layout, left[fits]
                left = left[~fits]

    def _layout(self, data: bytes) -> _Layout:
        walk = _Walk(data, self._store)
        walk.message(self._type_name, 4)
        found = {key: walk.place(self._type_name, path) for key, path in self._paths.items()}
        numbers = {key: place for key, place in found.items() if place is not None}
        stamp: tuple[int, ...] = ()
        if self._stamp is not None:
            parts = [walk.place(self._type_name, (*self._stamp, Step(part))) for part in ("sec", "nanosec")]
            stamp = tuple(part[0] for part in parts if part is not None)
        fixed = np.unique(np.concatenate([np.arange(4), *(np.arange(*part) for part in walk.fixed)]))
        fixed, template = fixed.astype(np.int64), np.frombuffer(data, np.uint8)
        order = "<" if data[1] else ">"
        unpack, time = (
            tuple(struct.Struct(order + _CODES[kind]).unpack_from for kind in kinds)
            for kinds in ([kind for _, kind in numbers.values()], ["i4", "u4"] if stamp else [])
        )
        layout = _Layout(fixed, template, numbers, stamp, template[fixed].tobytes(), unpack, time)
        if sum(map(len, self._layouts.values())) >= _REMEMBERED:
            self._layouts.clear()
        self._layouts.setdefault(len(data), []).append(layout)
        return layout

    def _states(
        self, layout: _Layout, rows: Bytes, index: Integers, received: Times, rejected: list[Rejection]
    ) -> Iterator[JointStates]:
        order = "<" if layout.template[1] else ">"
        stamp = received[index]
        if layout.stamp:
            kinds = zip(layout.stamp, ("i4", "u4"), strict=True)
            second, nano = (_column(rows, place, order + kind) for place, kind in kinds)
            stamp = second.astype(np.int64) * _NANOSECONDS + nano
            for row in np.flatnonzero(nano >= _NANOSECONDS).tolist():
                rejected.append(Rejection(int(index[row]), _bad_stamp(nano[row])))
            good = nano < _NANOSECONDS
            rows, index, stamp = rows[good], index[good], stamp[good]
        if not index.size:
            return
        values = [
            _column(rows, place, order + kind) * self._units[key].factor + self._units[key].offset
            for key, (place, kind) in layout.numbers.items()
        ]
        signals = np.stack(values, axis=1) if values else None
        yield JointStates(index, stamp, (), "", None, None, None, signals, tuple(layout.numbers))


def _bad_stamp(nano: int) -> str:
    return f"has a stamp with {nano} nanoseconds, 1e9 or more"


def _by_size(payload: Bytes | Sequence[bytes | memoryview]) -> Iterator[tuple[Bytes, Integers]]:
    """Messages of each size, shape (n, size), with their positions."""
    if isinstance(payload, np.ndarray):
        yield payload, np.arange(len(payload))
        return
    sizes: dict[int, list[int]] = {}
    for index, data in enumerate(payload):
        sizes.setdefault(len(data), []).append(index)
    for same in sizes.values():
        joined = b"".join(payload[i] for i in same)
        yield np.frombuffer(joined, np.uint8).reshape(len(same), -1), np.array(same)


def _column(rows: Bytes, place: int, dtype: str) -> Any:
    """Numbers at a place of messages, shape (n,)."""
    return np.ascontiguousarray(rows[:, place : place + int(dtype[2])]).view(dtype)[:, 0]


class _Walk:
    """Reads a CDR message; places count from its first byte, alignment from the end of its header.

    All of it raises ValueError where the message is malformed. `fixed` holds begin and end of the bytes on
    which places depend: lengths, and texts by which elements are found.
    """

    def __init__(self, data: bytes, store: Typestore) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise ValueError("is not a CDR message")
        self._data, self._store = data, store
        self._uint32 = struct.Struct("<I" if data[1] else ">I").unpack_from
        self.fixed: list[tuple[int, int]] = []

    def message(self, type_name: str, begin: int) -> tuple[dict[str, tuple[Any, int]], int]:
        """Fields of a message with their descriptions and begins, and its end."""
        fields = {}
        for name, description in self._store.fielddefs[type_name][1]:
            fields[name] = description, begin
            begin = self._end(description, begin)
        return fields, begin

    def place(self, type_name: str, path: Path, begin: int = 4) -> tuple[int, str] | None:
        """Place and type of the number at a path; None where no element has the name."""
        (field, index), rest = path[0], path[1:]
        fields, _ = self.message(type_name, begin)
        description, begin = fields[field]
        number = 0
        if is_array(description[0]):
            description, count, begin = self._elements(description, begin)
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
        return _aligned(begin, _SIZES[name]) + number * _SIZES[name], DTYPES[name]

    def _end(self, description: Any, begin: int) -> int:
        """Where a field ends."""
        kind, what = description
        if kind == Nodetype.NAME:
            return self.message(what, begin)[1]
        if kind == Nodetype.BASE:
            return self._text(begin)[1] if what[0] == "string" else self._numbers(what[0], 1, begin)
        element, count, begin = self._elements(description, begin)
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            return self._numbers(element[1][0], count, begin)
        if count > len(self._data) - begin:
            raise ValueError(f"is cut off: claims an array of {count}")
        for _ in range(count):
            begin = self._end(element, begin)
        return begin

    def _numbers(self, kind: str, count: int, begin: int) -> int:
        size = _SIZES.get(kind)
        if size is None:
            raise ValueError(f"has a {kind}, which is not supported")
        return self._within(_aligned(begin, size) + count * size) if count else begin

    def _elements(self, description: Any, begin: int) -> tuple[Any, int, int]:
        """What the elements of an array are, how many, and where they begin."""
        element, count = description[1]
        if description[0] == Nodetype.SEQUENCE:
            count, begin = self._count(begin)
        return element, count, begin

    def _count(self, begin: int) -> tuple[int, int]:
        begin = _aligned(begin, 4)
        end = self._within(begin + 4)
        self.fixed.append((begin, end))
        return int(self._uint32(self._data, begin)[0]), end

    def _text(self, begin: int) -> tuple[int, int]:
        """Where the characters of a text begin and end."""
        size, begin = self._count(begin)
        return begin, self._within(begin + size)

    def _within(self, place: int) -> int:
        if place > len(self._data):
            raise ValueError("is cut off")
        return place

    def _known(self, begin: int) -> tuple[str, int]:
        """A text by which an element is found, and its end."""
        begin, end = self._text(begin)
        self.fixed.append((begin, end))
        return self._data[begin:end].rstrip(b"\0").decode("utf-8", "replace"), end

    def _named(
        self, name: str, fields: Mapping[str, tuple[Any, int]], element: Any, count: int, begin: int
    ) -> int | None:
        """Number of the element with a name: in texts beside the array, or one of its own."""
        for description, at in fields.values():
            if holds_texts(description):
                _, texts, at = self._elements(description, at)
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


def _aligned(place: int, size: int) -> int:
    """The next place at which a number of a size may stand."""
    return (place - 4 + size - 1) // size * size + 4
