"""Encodes columns as CDR messages of constant size, byte for byte like ROS 2 (little endian)."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Bytes, Integers, Times
from hd_diag.messages.joint_states import JointStateDecoder, decode_joint_states, kernel

HEADER = b"\0\1\0\0"
"""Header of a little-endian CDR message."""

_ARRAYS = ("position", "velocity", "effort")
_NOTHING = np.empty((0, 0))
_UINT32 = struct.Struct("<I")


def encode_joint_states(
    names: Sequence[str],
    stamps: npt.ArrayLike,
    position: npt.ArrayLike | None,
    velocity: npt.ArrayLike | None = None,
    effort: npt.ArrayLike | None = None,
    frame_id: str = "",
) -> Bytes:
    """JointState messages, shape (n, size).

    Parameters
    ----------
    names : sequence of str
        The k joints; the same tuple each time is fastest.
    stamps : array_like of int, shape (n,)
        Time of the header [ns].
    position, velocity, effort : array_like, shape (n, k), or None
        [rad], [rad/s], [N m]; None writes an empty array.
    frame_id : str, optional

    Raises
    ------
    ValueError
        If shapes do not agree or a stamp does not fit into a ROS time.
    """
    time = np.ascontiguousarray(stamps, np.int64).reshape(-1)
    shape, values, present = (time.size, len(names)), [_NOTHING] * 3, []
    for number, given in enumerate((position, velocity, effort)):
        if given is not None:
            values[number] = value = np.ascontiguousarray(given, np.float64)
            present.append(number)
            if value.shape != shape:
                raise ValueError(f"{_ARRAYS[number]}: shape {shape} is needed, got {value.shape}")
    template, places = _joint_state(tuple(names), frame_id, tuple(present))
    rows = np.empty((time.size, template.size), np.int32)
    if not kernel().write(rows, template, time, *values, places):
        raise _beyond(time)
    return rows.view(np.uint8)


def encode_headers(stamps: npt.ArrayLike, frame_id: str) -> Bytes:
    """std_msgs/Header messages, shape (n, size), with stamps [ns] (n,) and a frame.

    Raises ValueError if a stamp does not fit into a ROS time.
    """
    time = np.asarray(stamps, np.int64)
    parts = np.stack(np.divmod(time, 1_000_000_000), axis=1)
    if np.any(parts != parts.astype(np.int32)):
        raise _beyond(time)
    head = HEADER + bytes(8) + text(frame_id, 1)
    rows = np.tile(np.frombuffer(head, np.uint8), (time.size, 1))
    rows[:, len(HEADER) : len(HEADER) + 8] = parts.astype(np.int32).view(np.uint8)
    return rows


def _beyond(time: Times) -> ValueError:
    return ValueError(f"stamps: seconds beyond 32 bits, from {time.min()} to {time.max()} ns")


def warm_up() -> None:
    """Compile now, or load from the disk, the code that writes and reads JointState messages."""
    rows = encode_joint_states(["a"], [0], [[0.0]])
    decode_joint_states(rows)
    JointStateDecoder().decode(rows[0].tobytes())  # read-only bytes need their own machine code


def encode_float64_multiarray(dims: Sequence[tuple[str, int]], data: npt.ArrayLike) -> Bytes:
    """Float64MultiArray messages, shape (n, size).

    Parameters
    ----------
    dims : sequence of (str, int)
        Labels and lengths of the m dimensions, the slowest first; the strides follow from them.
    data : array_like, shape (n, *lengths)
        The values.

    Raises
    ------
    ValueError
        If shapes do not agree.
    """
    values = np.ascontiguousarray(data, "<f8")
    if values.shape[1:] != tuple(size for _, size in dims):
        lengths = ", ".join(str(size) for _, size in dims)
        raise ValueError(f"data: shape (n, {lengths}) is needed, got {values.shape}")
    head = np.frombuffer(_multiarray(tuple(dims)), np.uint8)
    rows = np.empty((len(values), len(head) + values[:1].nbytes), np.uint8)
    rows[:, : len(head)] = head
    rows[:, len(head) :] = values.reshape(len(values), -1).view(np.uint8) if values.size else 0
    return rows


@functools.lru_cache(maxsize=256)
def _joint_state(
    names: tuple[str, ...], frame_id: str, present: tuple[int, ...]
) -> tuple[npt.NDArray[np.int32], Integers]:
    """4-byte words of a message with zero stamp and values; places of the three arrays, 0 if empty."""
    body, places = bytearray(8) + text(frame_id) + _UINT32.pack(len(names)), [0, 0, 0]
    body += b"".join(map(text, names))
    for number in range(3):
        count = len(names) if number in present else 0
        body += _UINT32.pack(count)
        if count:
            body += bytes(-len(body) % 8)
            places[number] = (len(HEADER) + len(body)) // 4
            body += bytes(8 * count)
    return np.frombuffer(HEADER + body, np.int32), np.array(places)


@functools.lru_cache(maxsize=256)
def _multiarray(dims: tuple[tuple[str, int], ...]) -> bytes:
    """Bytes of a message before its values."""
    lengths = [size for _, size in dims]
    body = _UINT32.pack(len(dims))
    for i, (label, size) in enumerate(dims):
        body += text(label) + struct.pack("<II", size, math.prod(lengths[i:]))
    body += struct.pack("<II", 0, math.prod(lengths))
    return HEADER + body + bytes(-len(body) % 8 if math.prod(lengths) else 0)


def text(value: str, alignment: int = 4) -> bytes:
    """A string in CDR, padded to an alignment [byte] for the next value."""
    data = value.encode() + b"\0"
    return _UINT32.pack(len(data)) + data + bytes(-len(data) % alignment)
