"""Compiled code for JointState messages of one layout, to bytes and back; imported late, like numba."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Bytes, Floats, Integers, Times
from hd_diag.model.kernel.compiler import entry_point, part

_NANOSECONDS = 1_000_000_000
_LARGEST = 2**31  # seconds that do not fit into 32 bits
_TOGETHER = 128  # messages written together, so that they stay in the processor's cache
READ, OTHER, BAD_STAMP = 0, 1, 2


@entry_point
def write(
    rows: Integers,
    template: Integers,
    stamp: Times,
    position: Floats,
    velocity: Floats,
    effort: Floats,
    places: Integers,
) -> bool:
    """Fill messages of 4-byte words (n, size) from template, stamps [ns] (n,) and values (n, k).

    `places` are those of the three arrays, 0 if absent. Returns False if a stamp's seconds exceed 32 bits.
    """
    for first in range(0, rows.shape[0], _TOGETHER):
        last = min(first + _TOGETHER, rows.shape[0])
        for i in range(first, last):
            second = stamp[i] // _NANOSECONDS
            if not -_LARGEST <= second < _LARGEST:
                return False
            for word in range(template.size):
                rows[i, word] = template[word]
            rows[i, 1], rows[i, 2] = second, stamp[i] - second * _NANOSECONDS
        _put(position.view(np.int32), rows, places[0], first, last)
        _put(velocity.view(np.int32), rows, places[1], first, last)
        _put(effort.view(np.int32), rows, places[2], first, last)
    return True


@part
def _put(values: Integers, rows: Integers, place: int, first: int, last: int) -> None:
    if place:
        for i in range(first, last):
            for word in range(values.shape[1]):
                rows[i, place + word] = values[i, word]


@entry_point
def read(
    rows: Bytes,
    template: Bytes,
    fixed: Integers,
    places: Integers,
    widths: Integers,
    is_big_endian: bool,
    stamp: Times,
    values: Floats,
    fate: Bytes,
) -> int:
    """Read stamps [ns] (n,) and values, m arrays side by side, of messages (n, size); count those not `READ`.

    Messages that differ from the template in a fixed range (begin and end, (r, 2)) have an `OTHER` layout.
    For a `BAD_STAMP`, `stamp` holds the message's nanoseconds.
    """
    failed = 0
    for i in range(rows.shape[0]):
        row, differs = rows[i], 0
        for j in range(fixed.shape[0]):
            for byte in range(fixed[j, 0], fixed[j, 1]):
                differs |= row[byte] ^ template[byte]
        if differs:
            fate[i] = OTHER
            failed += 1
            continue
        second, nano = _uint32(row[4:8], is_big_endian), _uint32(row[8:12], is_big_endian)
        if nano >= _NANOSECONDS:
            stamp[i], fate[i] = nano, BAD_STAMP
            failed += 1
            continue
        stamp[i] = (second if second < _LARGEST else second - 2 * _LARGEST) * _NANOSECONDS + nano
        found, begin = values[i].view(np.uint8), 0
        for j in range(places.size):
            for byte in range(8 * widths[j]):
                found[begin + byte] = row[places[j] + byte]
            begin += 8 * widths[j]
        if is_big_endian:
            for place in range(0, found.size, 8):
                found[place : place + 8] = found[place : place + 8][::-1].copy()
    return failed


@part
def _uint32(data: Bytes, is_big_endian: bool) -> int:
    value = np.int64(0)
    for byte in range(4):
        value |= np.int64(data[byte]) << (8 * (3 - byte if is_big_endian else byte))
    return int(value)
