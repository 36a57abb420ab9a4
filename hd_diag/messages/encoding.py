"""Columns as CDR messages of constant size, byte for byte as ROS 2 serializes them (little endian)."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Bytes

_NANOSECONDS = 1_000_000_000
_HEADER = b"\0\1\0\0"
_ARRAYS = ("position", "velocity", "effort")


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
        Where shapes do not agree or a stamp does not fit into a ROS time.
    """
    time = np.atleast_1d(np.asarray(stamps, np.int64))
    values = {}
    for what, given in zip(_ARRAYS, (position, velocity, effort), strict=True):
        if given is not None:
            values[what] = value = np.asarray(given)
            if value.shape != (len(time), len(names)):
                raise ValueError(f"{what}: shape {(len(time), len(names))} is needed, got {value.shape}")
    template, layout = _joint_state(tuple(names), frame_id, tuple(values))
    second = time // _NANOSECONDS
    rows = np.frombuffer(bytearray(template * len(time)), layout)
    rows["second"], rows["nano"] = second, time - second * _NANOSECONDS
    if rows["second"].astype(np.int64).tobytes() != second.tobytes():
        raise ValueError(f"stamps: seconds beyond 32 bits, {int(second.min())} to {int(second.max())}")
    if names:
        for what, value in values.items():
            rows[what] = value
    return rows.view(np.uint8).reshape(len(time), len(template))


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
        Where shapes do not agree.
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
    names: tuple[str, ...], frame_id: str, present: tuple[str, ...]
) -> tuple[bytes, np.dtype[Any]]:
    """Message with zeros for stamp and values, and its layout (second, nano, the arrays)."""
    body = bytearray(8) + _string(frame_id)
    body += _padding(body, 4) + struct.pack("<I", len(names))
    for name in names:
        body += _padding(body, 4) + _string(name)
    fields: dict[str, tuple[Any, int]] = {"second": ("<i4", 4), "nano": ("<u4", 8)}
    for what in _ARRAYS:
        count = len(names) if what in present else 0
        body += _padding(body, 4) + struct.pack("<I", count)
        if count:
            body += _padding(body, 8)
            fields[what] = (("<f8", (count,)), len(_HEADER) + len(body))
            body += bytes(8 * count)
    template = _HEADER + bytes(body)
    formats, offsets = zip(*fields.values(), strict=True)
    spec = {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": len(template)}
    return template, np.dtype(spec)  # type: ignore[call-overload]


@functools.lru_cache(maxsize=256)
def _multiarray(dims: tuple[tuple[str, int], ...]) -> bytes:
    """Message up to its values."""
    lengths = [size for _, size in dims]
    body = bytearray(struct.pack("<I", len(dims)))
    for i, (label, size) in enumerate(dims):
        body += _padding(body, 4) + _string(label)
        body += _padding(body, 4) + struct.pack("<II", size, math.prod(lengths[i:]))
    body += _padding(body, 4) + struct.pack("<II", 0, math.prod(lengths))
    return _HEADER + bytes(body + (_padding(body, 8) if math.prod(lengths) else b""))


def _string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def _padding(body: bytearray, alignment: int) -> bytes:
    return bytes(-len(body) % alignment)
