"""Subsets of long records: contiguous stretches, and the few rows between them that matter to friction.

A fit needs about two kilobytes per row. From a record with more than `LIMIT` rows it gets stretches of
neighbouring rows at their true times. These preserve the colour of the noise and the orders of the teeth,
which random or evenly spaced rows would lose.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.blocks import blocks
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record

LIMIT = 20_000
"""Largest number of rows of a fit. Chosen for speed: more rows reduce noise, but not misfit. With this limit
the whole process needs less than 1 GiB."""

_STRETCHES = 48  # two for each block of the fit
_SHORTEST = 125  # rows of a stretch: shorter ones cover more of the motion, longer ones more noise
_PLACES = 24  # candidate starts of a stretch within its cell
_LEVELS = 16  # classes of torque, of speed, of the place in the output's turn
_PAIRED = 6  # classes of torque and of speed in their joint histogram
_GROUPS = (slice(0, 16), slice(16, 32), slice(32, 48), slice(48, 84))
_RARE = 0.002  # conditions with a smaller share of the rows need not be covered

_APART = 30  # least distance of single rows, so that they are no neighbours
_SWING = 0.005  # of the range of the torque; smaller reversals are noise
_REVERSALS = 16  # most torque reversals kept from a gap
_PARTS = 8  # parts of a gap, each of which keeps the extremes of the input


def subsample(record: Record, limit: int = LIMIT) -> Record:
    """A record of at most `limit` rows, see :func:`some_rows`; a shorter record is returned unchanged.

    Its `extent` is that of the whole record.
    """
    return record if record.size <= limit else record.select(some_rows(record, limit))


def some_rows(record: Record, limit: int) -> Integers:
    """Indices of at most `limit` rows; all rows if there are no more.

    Otherwise the runs, or the whole record if it has many runs, are divided evenly into up to 48 cells. Each
    cell gives one stretch. The place of the stretches is chosen to cover all torques, speeds, directions and
    places of the output's turn. Between stretches, single rows at reversals of torque or input are kept,
    because friction remembers these.
    """
    if record.size <= limit:
        return np.arange(record.size)
    cells = _cells(record, min(_STRETCHES, max(limit // _SHORTEST, 1)))
    length = max(limit // len(cells) - _REVERSALS - 2 * _PARTS, 1)
    rows, last = [], 0
    for begin, (_, edge) in zip(_places(record, cells, length), cells, strict=True):
        end = min(begin + length, edge)
        rows += [_between(record, last, begin), np.arange(begin, end)]
        last = end
    return np.concatenate(rows)


def _cells(record: Record, most: int) -> list[tuple[int, int]]:
    """First row and end (exclusive) of about `most` cells, in order."""
    runs = bounds(record.run)
    if len(runs) > most:
        runs = [(0, record.size)]
    cells: list[tuple[int, int]] = []
    for begin, end in runs:
        count = max(round((end - begin) * most / record.size), 1)
        cells += pairwise(np.linspace(begin, end, count + 1).astype(np.int64).tolist())
    return cells


def _places(record: Record, cells: list[tuple[int, int]], length: int) -> list[int]:
    """First row of the stretch in each cell; together the stretches cover the record's conditions."""
    begins = np.array([np.linspace(begin, max(end - length, begin), _PLACES) for begin, end in cells])
    starts = begins.astype(np.int64)
    ends = np.minimum(starts + length, np.array(cells)[:, 1:])
    edges = np.unique(np.concatenate((starts.ravel(), ends.ravel(), [0, record.size])))
    before = _counts(record, edges)
    wanted = _wanted(before[-1] / record.size)
    shown = before[np.searchsorted(edges, ends)] - before[np.searchsorted(edges, starts)]
    total, chosen = np.zeros(wanted.size), dict[int, int]()
    while len(chosen) < len(cells):
        together = total + shown
        share = together / together[..., _GROUPS[0]].sum(axis=2, keepdims=True)
        off = np.sum((share - wanted) ** 2 / np.maximum(wanted, _RARE), axis=2)
        off[list(chosen)] = np.inf
        cell, place = divmod(int(np.argmin(off)), _PLACES)
        chosen[cell] = int(starts[cell, place])
        total = together[cell, place]
    return [chosen[cell] for cell in range(len(cells))]


def _wanted(share: Floats) -> Floats:
    """Shares halfway between the record's and equal ones, as rare conditions distinguish parameters."""
    parts = [(share[group], share[group] > _RARE) for group in _GROUPS]
    return np.concatenate([0.5 * part + 0.5 * some / max(int(some.sum()), 1) for part, some in parts])


def _counts(record: Record, edges: Integers) -> Floats:
    """Number of rows before each of the ascending edges (e,), by class; shape (e, 84).

    Classes are those of torque, speed, place in the output's turn, and torque and speed together.
    """
    low, span = float(record.torque.min()), max(float(np.ptp(record.torque)), 1e-9)
    fast = max(float(record.speed.max()), -float(record.speed.min()), 1e-9)
    count = _GROUPS[-1].stop
    found = np.zeros((edges.size + 1) * count)
    for rows, _, _ in blocks(0, record.size):
        load, speed = (record.torque[rows] - low) / span, 0.5 + 0.5 * record.speed[rows] / fast
        place = np.mod(record.output_angle[rows] / (2.0 * np.pi), 1.0)
        both = _PAIRED * _level(load, _PAIRED) + _level(speed, _PAIRED)
        part = count * np.searchsorted(edges, np.arange(rows.start, rows.stop), side="right")
        for group, level in zip(
            _GROUPS, (*(_level(x, _LEVELS) for x in (load, speed, place)), both), strict=True
        ):
            found += np.bincount(part + group.start + level, minlength=found.size)
    return np.cumsum(found.reshape(-1, count), axis=0)[:-1]


def _level(share: Floats, count: int) -> Integers:
    """Class index of each share between zero and one, for `count` classes."""
    return np.minimum(share * count, count - 1).astype(np.int64)


def _between(record: Record, begin: int, end: int) -> Integers:
    """Single rows of a gap: remembered reversals of the torque, and extremes of the input angle."""
    rows = slice(begin + _APART, max(end - _APART, 0))
    torque, angle = record.torque[rows], record.input_angle[rows]
    if not torque.size:
        return np.empty(0, dtype=np.int64)
    parts = bounds(np.arange(angle.size) * _PARTS // angle.size)
    ways = [a + int(find(angle[a:b])) for a, b in parts for find in (np.argmin, np.argmax)]
    found = np.unique(np.array(ways + _reversals(torque, _SWING * float(np.ptp(record.torque)))))
    kept: list[int] = []
    for row in found.tolist():
        if not kept or row >= kept[-1] + _APART:
            kept.append(row)
    return rows.start + np.array(kept, dtype=np.int64)


def _reversals(torque: Floats, swing: float) -> list[int]:
    """Rows of torque reversals that no later one exceeds; friction remembers these (Preisach)."""
    first, found = 0, list[int]()
    while first < torque.size and len(found) < _REVERSALS:
        rest = torque[first:][::-1]
        pair = sorted(torque.size - 1 - int(find(rest)) for find in (np.argmin, np.argmax))
        if abs(float(torque[pair[1]] - torque[pair[0]])) < swing:
            break
        found += pair
        first = pair[1]
    return found
