"""Decodes numbers in messages of any type as columns.

In CDR, messages with the same lengths have the same fields at the same places. The places of such a layout
are worked out once, from one message; other messages are compared with it in all bytes that matter.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys.store import Typestore

from hd_diag.arrays import Bytes, Integers, Times
from hd_diag.messages.cdr import Walk, bad_stamp, by_size
from hd_diag.messages.field_path import PathStep, path_in, stamp_path
from hd_diag.messages.joint_states import Rejection
from hd_diag.streams.columns import JointStates
from hd_diag.streams.signals import Signal

_REMEMBERED, _NAMES = 64, 256  # most layouts, most names
_FIRST = np.zeros(1, np.int64)
_NANOSECONDS = 1_000_000_000
_CODES = dict(zip(("i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"), "bhiqBHIQfd", strict=True))


class _Layout(NamedTuple):
    """Layout of messages of one size, which equal the `template` in the bytes at the places `fixed` (m,).

    `numbers` has places and types by key, `stamp` the places of seconds and nanoseconds. `known` are the
    template's bytes at `fixed`. `unpack` and `time` read the numbers and the two parts of the stamp.
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
        Store with the type.
    type_name : str
    signals : mapping of str to Signal
        Signals by the keys of their columns.

    Raises
    ------
    ValueError
        If the type has no number at a signal's path; the message names the nearest field.

    Attributes
    ----------
    names : list of str
        Names that were compared to find elements by name, in the last message of a new layout.
    """

    def __init__(self, store: Typestore, type_name: str, signals: Mapping[str, Signal]) -> None:
        self._store, self._type_name = store, type_name
        self._units = {key: signal.unit for key, signal in signals.items()}
        self._paths = {key: path_in(store, type_name, signal) for key, signal in signals.items()}
        self._stamp = stamp_path(store, type_name)
        self._by_reception = any(signal.by_reception for signal in signals.values())
        self._layouts: dict[int, list[_Layout]] = {}
        self.names: list[str] = []

    def columns(
        self, payload: Bytes | Sequence[bytes | memoryview], received: Times
    ) -> tuple[list[JointStates], list[Rejection]]:
        """Signals of messages; times of reception [ns] (n,) replace missing stamps."""
        columns: list[JointStates] = []
        rejected: list[Rejection] = []
        for rows, index in by_size(payload):
            for layout, chosen in self._by_layout(rows, index, rejected):
                for states in self._states(layout, rows[chosen], index[chosen], received, rejected):
                    columns += states.stamped(received, self._by_reception)
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
                raise ValueError(bad_stamp(nano))
            stamp = np.array([second * _NANOSECONDS + nano])
        signals = np.array([values]) if values else None
        states = JointStates(_FIRST, stamp, (), "", None, None, None, signals, tuple(layout.numbers))
        return states.stamped(received, self._by_reception)[0]

    def _by_layout(
        self, rows: Bytes, index: Integers, rejected: list[Rejection]
    ) -> Iterator[tuple[_Layout, Integers]]:
        """Yield layouts of messages of one size with their rows; malformed messages go to `rejected`."""
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
        walk = Walk(data, self._store)
        walk.message(self._type_name, 4)
        found = {key: walk.place(self._type_name, path) for key, path in self._paths.items()}
        numbers = {key: place for key, place in found.items() if place is not None}
        self.names = [*dict.fromkeys(walk.names)][:_NAMES]
        stamp: tuple[int, ...] = ()
        if self._stamp is not None:
            parts = [
                walk.place(self._type_name, (*self._stamp, PathStep(part))) for part in ("sec", "nanosec")
            ]
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
                rejected.append(Rejection(int(index[row]), bad_stamp(nano[row])))
            good = nano < _NANOSECONDS
            rows, index, stamp = rows[good], index[good], stamp[good]
        if not index.size:
            return
        values = [
            _column(rows, place, order + kind).astype(np.float64) * self._units[key].factor
            + self._units[key].offset
            for key, (place, kind) in layout.numbers.items()
        ]
        signals = np.stack(values, axis=1) if values else None
        yield JointStates(index, stamp, (), "", None, None, None, signals, tuple(layout.numbers))


def _column(rows: Bytes, place: int, dtype: str) -> Any:
    """Numbers at one place of all messages, shape (n,)."""
    return np.ascontiguousarray(rows[:, place : place + int(dtype[2])]).view(dtype)[:, 0]
