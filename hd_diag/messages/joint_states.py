"""JointState messages as columns: many messages of one shape at once, one message in microseconds.

CDR puts the same things at the same places in every message that has the same names and array lengths. Such
a layout is worked out once from one message; the others are compared with it in all bytes but stamps and
values.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Bytes
from hd_diag.streams.columns import JointStates

JOINT_STATE = "sensor_msgs/msg/JointState"

# Number of layouts per decoder that are remembered; one topic rarely has more than one or two.
_REMEMBERED = 64
# A batch with more layouts than this is decoded message by message.
_MAX_LAYOUTS = 16
_NANOSECONDS = 1_000_000_000


class Rejection(NamedTuple):
    """A message that cannot be used: its position in the batch, and why."""

    row: int
    reason: str


@dataclass(frozen=True)
class Layout:
    """Where things are in messages of one shape: byte order ('<' or '>'), names, frame, and places [byte].

    `arrays` are the places of position, velocity and effort, 0 for an empty one; `fixed` the ranges that are
    the same in all messages, with their content.
    """

    order: str
    names: tuple[str, ...]
    frame_id: str
    arrays: tuple[int, int, int]
    fixed: tuple[tuple[int, int, bytes], ...]


def layout_of(data: bytes) -> Layout:
    """Layout of a JointState message.

    Raises
    ------
    ValueError
        Where it is malformed; the message says how.
    """
    if len(data) < 16 or data[0] != 0 or data[1] > 1:
        raise ValueError("is not a CDR message")
    walk = _Walk(data, "<" if data[1] else ">")
    frame_id = walk.string()
    count = walk.uint32()
    if count > walk.left // 4:
        raise ValueError(f"claims {count} names")
    names = tuple(walk.string() for _ in range(count))
    fixed, arrays, begin = [(0, 4, data[0:4])], [], 12
    for what in ("position", "velocity", "effort"):
        length = walk.uint32()
        if length > walk.left // 8:
            raise ValueError(f"is cut off: claims {length} values of {what}")
        if length not in (0, count):
            raise ValueError(f"has {length} values of {what} for {count} names")
        fixed.append((begin, walk.position, data[begin : walk.position]))
        arrays.append(walk.doubles(length))
        begin = walk.position
    # What follows is padding, as rclpy adds where the last array is empty: readers ignore it.
    return Layout(walk.order, names, frame_id, (arrays[0], arrays[1], arrays[2]), tuple(fixed))


class _Walk:
    """Reads CDR from a message; positions count from its first byte, alignment from the end of its header."""

    def __init__(self, data: bytes, order: str) -> None:
        self.data, self.order, self.position = data, order, 12
        self._uint32 = struct.Struct(order + "I").unpack_from

    @property
    def left(self) -> int:
        return len(self.data) - self.position

    def uint32(self) -> int:
        self.position = (self.position + 3) & -4
        if self.left < 4:
            raise ValueError("is cut off")
        (value,) = self._uint32(self.data, self.position)
        self.position += 4
        return int(value)

    def string(self) -> str:
        size = self.uint32()
        if size > self.left:
            raise ValueError(f"is cut off: claims a string of {size} bytes")
        text = self.data[self.position : self.position + size]
        self.position += size
        if size and text[-1]:
            raise ValueError("has a string without a terminator")
        try:
            return text[:-1].decode() if size else ""
        except UnicodeDecodeError as exc:
            raise ValueError("has a name that is not UTF-8") from exc

    def doubles(self, length: int) -> int:
        """Place of `length` doubles; 0 where there are none, which are not aligned either."""
        if not length:
            return 0
        self.position = start = (self.position + 3) // 8 * 8 + 4
        if self.left < 8 * length:
            raise ValueError("is cut off")
        self.position += 8 * length
        return start


class JointStateDecoder:
    """Decoder that remembers the layouts it has seen; one per topic is best."""

    def __init__(self) -> None:
        self._layouts: dict[int, list[Layout]] = {}

    def decode(self, data: bytes | memoryview) -> JointStates:
        """Columns, n = 1, of one message; ValueError says how it is malformed."""
        if not isinstance(data, bytes):
            data = bytes(data)
        layout = self._layout(data)
        second, nano = _STAMPS[layout.order](data, 4)
        if nano >= _NANOSECONDS:
            raise ValueError(_bad_nanoseconds(nano))
        count, value = len(layout.names), _DOUBLES[layout.order]
        values = [
            np.frombuffer(data, value, count, place).reshape(1, count).astype(np.float64, copy=False)
            if place
            else None
            for place in layout.arrays
        ]
        stamp = np.array([second * _NANOSECONDS + nano])
        return JointStates(_FIRST, stamp, layout.names, layout.frame_id, *values)

    def _layout(self, data: bytes) -> Layout:
        for layout in self._layouts.get(len(data), ()):
            for start, stop, content in layout.fixed:
                if data[start:stop] != content:
                    break
            else:
                return layout
        layout = layout_of(data)
        if sum(map(len, self._layouts.values())) >= _REMEMBERED:
            self._layouts.clear()
        self._layouts.setdefault(len(data), []).append(layout)
        return layout


_FIRST = np.zeros(1, np.int64)
_STAMPS = {order: struct.Struct(order + "iI").unpack_from for order in "<>"}
_DOUBLES = {"<": np.dtype("<f8"), ">": np.dtype(">f8")}


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
    columns: list[JointStates] = []
    rejected: list[Rejection] = []
    if isinstance(payload, np.ndarray):
        _decode_rows(payload, np.arange(len(payload)), columns, rejected)
        return columns, sorted(rejected)
    sizes: dict[int, list[int]] = {}
    for index, data in enumerate(payload):
        sizes.setdefault(len(data), []).append(index)
    for same in sizes.values():
        rows = np.frombuffer(b"".join(payload[i] for i in same), np.uint8).reshape(len(same), -1)
        _decode_rows(rows, np.array(same), columns, rejected)
    return sorted(columns, key=lambda c: int(c.row[0])), sorted(rejected)


def _decode_rows(
    rows: Bytes, index: npt.NDArray[np.int64], columns: list[JointStates], rejected: list[Rejection]
) -> None:
    """Decode messages of one size; all that share the layout of the first are done at once, and so on."""
    for _ in range(_MAX_LAYOUTS):
        if not len(rows):
            return
        try:
            layout = layout_of(rows[0].tobytes())
        except ValueError as exc:
            rejected.append(Rejection(int(index[0]), str(exc)))
            rows, index = rows[1:], index[1:]
            continue
        same = _matches(layout, rows)
        if same.all():
            _take(layout, rows, index, columns, rejected)
            return
        _take(layout, rows[same], index[same], columns, rejected)
        rows, index = rows[~same], index[~same]
    _decode_singly(rows, index, columns, rejected)


def _decode_singly(
    rows: Bytes, index: npt.NDArray[np.int64], columns: list[JointStates], rejected: list[Rejection]
) -> None:
    for row, number in zip(rows, index, strict=True):
        try:
            layout = layout_of(row.tobytes())
        except ValueError as exc:
            rejected.append(Rejection(int(number), str(exc)))
        else:
            _take(layout, row[None], np.array([number]), columns, rejected)


def _matches(layout: Layout, rows: Bytes) -> npt.NDArray[np.bool_]:
    """Which rows have this layout, shape (n,)."""
    same = np.ones(len(rows), bool)
    for start, stop, content in layout.fixed:
        if stop > start:  # as texts of one length, which numpy compares at once
            same &= _column(rows, start, stop - start, f"S{stop - start}")[:, 0] == content
    return same


def _take(
    layout: Layout,
    rows: Bytes,
    index: npt.NDArray[np.int64],
    columns: list[JointStates],
    rejected: list[Rejection],
) -> None:
    time = _column(rows, 4, 8, layout.order + "u4").astype(np.int64)
    nano = time[:, 1]
    if int(nano.max()) >= _NANOSECONDS:
        bad = nano >= _NANOSECONDS
        rejected += [
            Rejection(int(i), _bad_nanoseconds(int(n))) for i, n in zip(index[bad], nano[bad], strict=True)
        ]
        rows, index, time, nano = rows[~bad], index[~bad], time[~bad], nano[~bad]
        if not len(rows):
            return
    second = time[:, 0].astype(np.uint32).view(np.int32).astype(np.int64)
    size = 8 * len(layout.names)
    values = [
        _column(rows, place, size, layout.order + "f8").astype(np.float64, copy=False) if place else None
        for place in layout.arrays
    ]
    columns.append(JointStates(index, second * _NANOSECONDS + nano, layout.names, layout.frame_id, *values))


def _column(rows: Bytes, place: int, size: int, kind: str) -> npt.NDArray[Any]:
    return np.ascontiguousarray(rows[:, place : place + size]).view(kind)


def _bad_nanoseconds(nano: int) -> str:
    return f"has a stamp with {nano} nanoseconds, 1e9 or more"
