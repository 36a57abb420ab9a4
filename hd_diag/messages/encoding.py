"""Columns as CDR messages of constant size, byte for byte as ROS 2 serializes them (little endian)."""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Bytes, Floats

_NANOSECONDS = 1_000_000_000
_STAMP, _UINT32 = struct.Struct("<iI"), struct.Struct("<I")
_FILL = (b"", bytes(3), bytes(2), bytes(1))
_HEADER = b"\0\1\0\0"


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
        The k joints.
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
    values = [None if v is None else np.asarray(v, np.float64) for v in (position, velocity, effort)]
    for what, value in zip(("position", "velocity", "effort"), values, strict=True):
        if value is not None and value.shape != (len(time), len(names)):
            raise ValueError(f"{what}: shape {(len(time), len(names))} is needed, got {value.shape}")
    template, places = _joint_state(tuple(names), frame_id, tuple(v is not None for v in values))
    second = time // _NANOSECONDS
    nano = time - second * _NANOSECONDS  # np.divmod takes many times as long
    if len(time) and not (int(second.min()) >= -(2**31) and int(second.max()) < 2**31):
        raise ValueError(f"stamps: seconds beyond 32 bits, {int(second.min())} to {int(second.max())}")
    rows = np.empty((len(time), len(template)), np.uint8)
    rows[:] = np.frombuffer(template, np.uint8)
    _put(rows, 4, second.astype("<i4"))
    _put(rows, 8, nano.astype("<u4"))
    for place, value in zip(places, values, strict=True):
        if value is not None:
            _put(rows, place, value.astype("<f8"))
    return rows


def encode_joint_state(
    names: tuple[str, ...],
    stamp: int,
    position: Floats | None,
    velocity: Floats | None = None,
    effort: Floats | None = None,
    frame_id: str = "",
) -> bytes:
    """One JointState message, the same bytes as `encode_joint_states` with n = 1, in a few microseconds.

    Parameters
    ----------
    names : tuple of str
        The k joints; the same tuple each time is fastest.
    stamp : int
        Time of the header [ns].
    position, velocity, effort : ndarray of float64, k values, or None
        [rad], [rad/s], [N m].
    frame_id : str, optional

    Raises
    ------
    ValueError
        Where lengths do not agree or the stamp does not fit into a ROS time.
    """
    has = (position is not None, velocity is not None, effort is not None)
    template, places = _joint_state(names, frame_id, has)
    message, size = bytearray(template), 8 * len(names)
    try:
        _STAMP.pack_into(message, 4, *divmod(stamp, _NANOSECONDS))
    except struct.error as exc:
        raise ValueError(f"stamp: {stamp} ns does not fit into a ROS time") from exc
    for place, value in zip(places, (position, velocity, effort), strict=True):
        if value is not None:
            data = value.tobytes()
            if len(data) != size:
                raise ValueError(f"{len(names)} values are needed, got shape {value.shape}")
            message[place : place + size] = data
    return bytes(message)


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
    key = tuple((str(label), int(size)) for label, size in dims)
    values = np.ascontiguousarray(data, "<f8")
    if values.shape[1:] != tuple(size for _, size in key):
        raise ValueError(
            f"data: shape (n, {', '.join(str(s) for _, s in key)}) is needed, got {values.shape}"
        )
    template = _multiarray(key)
    total = math.prod(values.shape[1:])
    rows = np.empty((len(values), len(template) + 8 * total), np.uint8)
    rows[:, : len(template)] = np.frombuffer(template, np.uint8)
    _put(rows, len(template), values.reshape(len(values), total))
    return rows


def encode_float64_multiarray_message(dims: tuple[tuple[str, int], ...], data: Floats) -> bytes:
    """One Float64MultiArray message, the same bytes as `encode_float64_multiarray` with n = 1.

    Parameters
    ----------
    dims : tuple of (str, int)
        Labels and lengths of the dimensions, the slowest first.
    data : ndarray of float64, shape lengths

    Raises
    ------
    ValueError
        Where the shape is not that of `dims`.
    """
    if data.shape != tuple([size for _, size in dims]):
        raise ValueError(f"data: shape ({', '.join(str(s) for _, s in dims)}) is needed, got {data.shape}")
    return _multiarray(dims) + data.tobytes()


def encode_diagnostic_array(
    stamp: int, statuses: Iterable[tuple[int, str, str, str, Mapping[str, str]]]
) -> bytes:
    """A DiagnosticArray message.

    Parameters
    ----------
    stamp : int
        Time of the header [ns].
    statuses : iterable of (int, str, str, str, mapping of str to str)
        Level, name, message, hardware_id and values.

    Raises
    ------
    ValueError
        Where a level is no byte, or the stamp does not fit into a ROS time.
    """
    every, body = list(statuses), bytearray()
    try:
        body += _STAMP.pack(*divmod(stamp, _NANOSECONDS))
        _add_string(body, "")
        _add_uint32(body, len(every))
        for level, *texts, values in every:
            body.append(level)
            for text in texts:
                _add_string(body, text)
            _add_uint32(body, len(values))
            for key, value in values.items():
                _add_string(body, key)
                _add_string(body, value)
    except struct.error as exc:
        raise ValueError(f"stamp: {stamp} ns does not fit into a ROS time") from exc
    return _HEADER + bytes(body)


@functools.lru_cache(maxsize=256)
def _joint_state(
    names: tuple[str, ...], frame_id: str, has: tuple[bool, ...]
) -> tuple[bytes, tuple[int, ...]]:
    """Message with zeros for stamp and values, and the places of the three arrays [byte]."""
    body = bytearray(8) + _string(frame_id)
    body += _padding(body, 4) + struct.pack("<I", len(names))
    for name in names:
        body += _padding(body, 4) + _string(name)
    places = []
    for present in has:
        count = len(names) if present else 0
        body += _padding(body, 4) + struct.pack("<I", count)
        body += _padding(body, 8) if count else b""
        places.append(4 + len(body))
        body += bytes(8 * count)
    return _HEADER + bytes(body), tuple(places)


@functools.lru_cache(maxsize=256)
def _multiarray(dims: tuple[tuple[str, int], ...]) -> bytes:
    """Message up to its values."""
    lengths = [size for _, size in dims]
    total = math.prod(lengths)
    body = bytearray(struct.pack("<I", len(dims)))
    for i, (label, size) in enumerate(dims):
        body += _padding(body, 4) + _string(label)
        body += _padding(body, 4) + struct.pack("<II", size, math.prod(lengths[i:]))
    body += _padding(body, 4) + struct.pack("<II", 0, total)
    body += _padding(body, 8) if total else b""
    return _HEADER + bytes(body)


def _add_string(body: bytearray, text: str) -> None:
    body += _FILL[len(body) % 4]
    body += _string(text)


def _add_uint32(body: bytearray, value: int) -> None:
    body += _FILL[len(body) % 4]
    body += _UINT32.pack(value)


@functools.lru_cache(maxsize=512)  # keys, and values that rarely change, come in every report
def _string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def _padding(body: bytearray, alignment: int) -> bytes:
    return bytes(-len(body) % alignment)


def _put(rows: Bytes, place: int, values: npt.NDArray[np.generic]) -> None:
    """Write the bytes of values, shape (n,) or (n, k), from `place` on."""
    data = np.ascontiguousarray(values.reshape(len(rows), -1) if len(rows) else values.reshape(0, 1))
    if data.size:
        rows[:, place : place + data.shape[1] * data.itemsize] = data.view(np.uint8)
