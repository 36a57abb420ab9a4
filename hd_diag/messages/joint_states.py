"""JointState messages as columns: many messages of one shape at once, one message in microseconds.

In CDR, messages with the same names and array lengths have the same fields at the same places. Such a layout
is worked out once, from one message; other messages are compared with it in all bytes except for stamps and
values.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Bytes, Integers, Times
from hd_diag.config.configured_signals import JOINT_STATE as JOINT_STATE
from hd_diag.messages.cdr import Walk, aligned, bad_stamp, by_size
from hd_diag.messages.field_path import path_in
from hd_diag.messages.schemas import jazzy
from hd_diag.streams.columns import BLOCKS, JointStates
from hd_diag.streams.signals import Signal

# Most layouts that a decoder keeps; one topic rarely has more than one or two.
_REMEMBERED = 64
# A batch with more layouts than this is decoded message by message.
_MAX_LAYOUTS = 16
_FRAME = 12  # place of the frame's name, after the stamp
_FIRST = np.zeros(1, np.int64)


class Rejection(NamedTuple):
    """A message that cannot be used: its position in the batch, and why."""

    row: int
    reason: str


class Layout(NamedTuple):
    """Layout of messages of one shape: byte order ('<' or '>'), names, frame, and places [byte].

    `lengths` are those of position, velocity and effort, `places` the begins of those that are not empty.
    `fixed` (m, 2) are the byte ranges in which all messages equal the `template`.
    """

    order: str
    names: tuple[str, ...]
    frame_id: str
    lengths: tuple[int, ...]
    places: Integers
    template: Bytes
    fixed: Integers


def layout_of(data: bytes) -> Layout:
    """Layout of a JointState message.

    Raises
    ------
    ValueError
        If it is malformed; the error's message says how.
    """
    walk = Walk(data, jazzy())
    if len(data) < 16:
        raise ValueError("is not a CDR message")
    fields, _ = walk.message(JOINT_STATE, 4)  # readers ignore padding after it, as from rclpy
    frame_id, _ = _text(walk, _FRAME)
    _, count, begin = walk.elements(*fields["name"])
    names = []
    for _ in range(count):
        name, begin = _text(walk, begin)
        names.append(name)
    fixed, places, lengths, begin = [(0, 4)], [], [], _FRAME
    for what in BLOCKS:
        _, length, start = walk.elements(*fields[what])
        fixed.append((begin, start))
        lengths.append(length)
        places += [aligned(start, 8)] if length else []
        begin = places[-1] + 8 * length if length else start
    template = np.frombuffer(data, np.uint8)
    return Layout(
        "<" if data[1] else ">",
        tuple(names),
        frame_id,
        tuple(lengths),
        np.array(places, np.int64),
        template,
        np.array(fixed),
    )


def _text(walk: Walk, begin: int) -> tuple[str, int]:
    """A text and its end."""
    begin, end = walk.text(begin)
    if begin < end and walk.data[end - 1]:
        raise ValueError("has a string without a terminator")
    try:
        return walk.data[begin:end][:-1].decode(), end
    except UnicodeDecodeError as exc:
        raise ValueError("has a name that is not UTF-8") from exc


class JointStateDecoder:
    """Decoder that keeps the layouts it has seen; one decoder per topic is best."""

    def __init__(self) -> None:
        self._layouts: dict[int, list[Layout]] = {}

    def decode(self, data: bytes | memoryview) -> JointStates:
        """Columns, n = 1, of one message; ValueError says how it is malformed."""
        columns: list[JointStates] = []
        rejected: list[Rejection] = []
        self._rows(np.frombuffer(data, np.uint8).reshape(1, -1), _FIRST, columns, rejected)
        if rejected:
            raise ValueError(rejected[0].reason)
        return columns[0]

    def columns(
        self, payload: Bytes | Sequence[bytes | memoryview]
    ) -> tuple[list[JointStates], list[Rejection]]:
        """Columns of messages, as `decode_joint_states`."""
        columns: list[JointStates] = []
        rejected: list[Rejection] = []
        for rows, index in by_size(payload):
            self._rows(rows, index, columns, rejected)
        return sorted(columns, key=_first_row) if len(columns) > 1 else columns, sorted(rejected)

    def _rows(self, rows: Bytes, index: Times, columns: list[JointStates], rejected: list[Rejection]) -> None:
        """Decode messages of one size, of known and of new layouts."""
        known = self._layouts.setdefault(rows.shape[1], []) if len(rows) else []
        for layout in [*known]:
            rows, index = _take(layout, rows, index, columns, rejected)
            if not len(rows):
                return
        found = 0
        while len(rows):
            try:
                layout = layout_of(rows[0].tobytes())
            except ValueError as exc:
                same = (rows == rows[0]).all(axis=1)  # a file of some kilobytes may hold millions of them
                rejected += [Rejection(row, str(exc)) for row in index[same].tolist()]
                rows, index = rows[~same], index[~same]
                continue
            found += 1
            if found <= _MAX_LAYOUTS:
                if sum(map(len, self._layouts.values())) >= _REMEMBERED:
                    self._layouts.clear()
                self._layouts.setdefault(rows.shape[1], []).append(layout)
                rows, index = _take(layout, rows, index, columns, rejected)
            else:
                _take(layout, rows[:1], index[:1], columns, rejected)
                rows, index = rows[1:], index[1:]


class JointStateReader:
    """Reads joint states of a topic, and signals that are mapped to them with other names or units.

    Parameters
    ----------
    signals : mapping of str to Signal
        Signals by the keys of their columns.

    Raises
    ------
    ValueError
        If a signal's path is not in position, velocity or effort.
    """

    def __init__(self, signals: Mapping[str, Signal]) -> None:
        self._decoder = JointStateDecoder()
        self._by_reception = any(signal.by_reception for signal in signals.values())
        self._signals = {key: (*_place(signal), signal.unit) for key, signal in signals.items()}

    def columns(
        self, payload: Bytes | Sequence[bytes | memoryview], received: Times
    ) -> tuple[list[JointStates], list[Rejection]]:
        """Columns of messages, as `decode_joint_states`; reception times [ns] (n,) replace zero stamps."""
        found: list[JointStates] = []
        columns, rejected = self._decoder.columns(payload)
        for states in columns:
            try:
                whole = self._with_signals(states) if self._signals else states
            except ValueError as error:
                rejected += [Rejection(row, str(error)) for row in states.row.tolist()]
            else:
                found += whole.stamped(received, self._by_reception)
        return found, sorted(rejected)

    def one(self, data: bytes, received: Times) -> JointStates:
        """Columns, n = 1, of one message; ValueError says how it is malformed."""
        states = self._decoder.decode(data)
        (found,) = (self._with_signals(states) if self._signals else states).stamped(
            received, self._by_reception
        )
        return found

    def _with_signals(self, states: JointStates) -> JointStates:
        found = {}
        for key, (number, index, unit) in self._signals.items():
            block = states.blocks[number]
            column = index if isinstance(index, int) else _column_of(states.names, index)
            if isinstance(index, str) and column >= 0 and (text := states.misfit(number)):
                raise ValueError(text)
            if block is not None and 0 <= column < block.shape[1]:
                found[key] = block[:, column] * unit.factor + unit.offset
        signals = np.stack([*found.values()], axis=1) if found else None
        return states._replace(signals=signals, keys=tuple(found))


def _column_of(names: tuple[str, ...], name: str) -> int:
    return names.index(name) if name in names else -1


def _place(signal: Signal) -> tuple[int, int | str]:
    """Index of a signal's block (position, velocity, effort), and the signal's index or name there."""
    (field, index), *more = path_in(jazzy(), JOINT_STATE, signal)
    if more or field not in JointStates._fields[4:7] or index is None:
        raise ValueError(f"{signal.field!a} of {JOINT_STATE} is not one of position, velocity, effort")
    return JointStates._fields[4:7].index(field), index


def decode_joint_states(
    payload: Bytes | Sequence[bytes | memoryview],
) -> tuple[list[JointStates], list[Rejection]]:
    """Columns of JointState messages.

    Parameters
    ----------
    payload : ndarray of uint8, shape (n, size), or sequence of bytes
        CDR messages with their 4-byte headers, of either byte order.

    Returns
    -------
    columns : list of JointStates
        One for each set of names and arrays, in the order of first appearance.
    rejected : list of Rejection
        Malformed messages, in order.
    """
    return JointStateDecoder().columns(payload)


def _take(
    layout: Layout, rows: Bytes, index: Times, columns: list[JointStates], rejected: list[Rejection]
) -> tuple[Bytes, Times]:
    """Decode the messages that have a layout; returns the others with their positions."""
    count, widths = len(rows), np.array([*filter(None, layout.lengths)], np.int64)
    stamp, values = np.empty(count, np.int64), np.empty((count, sum(layout.lengths)))
    fate, rest = np.zeros(count, np.uint8), (rows[:0], index[:0])
    known = layout.template, layout.fixed, layout.places, widths, layout.order == ">"
    if kernel().read(np.ascontiguousarray(rows), *known, stamp, values, fate):
        for row in np.flatnonzero(fate == kernel().BAD_STAMP).tolist():
            rejected.append(Rejection(int(index[row]), bad_stamp(stamp[row])))
        is_read, is_other = fate == kernel().READ, fate == kernel().OTHER
        rest = rows[is_other], index[is_other]
        stamp, values, index = stamp[is_read], values[is_read], index[is_read]
    if index.size:
        ends = itertools.accumulate(layout.lengths)
        position, velocity, effort = (
            values[:, end - length : end] if length else None
            for end, length in zip(ends, layout.lengths, strict=True)
        )
        own = layout.names, layout.frame_id
        columns.append(JointStates(index, stamp, *own, position, velocity, effort))
    return rest


def _first_row(states: JointStates) -> int:
    return int(states.row[0])


@functools.cache
def kernel() -> ModuleType:
    """The compiled module, imported when first needed."""
    from hd_diag.messages import kernel as compiled

    return compiled
