"""Subsets of long records: contiguous stretches, and the few rows between them that friction remembers.

A fit needs about two kilobytes a row. Of more than `LIMIT` rows it gets stretches of neighbouring rows at
their true times: they keep the colour of the noise and the orders of the teeth, which random or evenly spaced
rows would lose.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.blocks import blocks
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record

LIMIT = 20_000
"""Rows that a fit gets, at most. Chosen for speed: more rows average noise, but not what no model describes.
The whole process then needs less than 1 GiB."""

_STRETCHES = 48  # two for each block of the fit
_SHORTEST = 125  # rows of a stretch: shorter ones cover more of the motion, longer ones more noise
_PLACES = 24  # at which a stretch may begin within its cell
_LEVELS = 16  # of the torque, of the speed, of the output's turn
_PAIRED = 6  # of torque and speed together
_GROUPS = (slice(0, 16), slice(16, 32), slice(32, 48), slice(48, 84))
_RARE = 0.002  # share of the rows below which nothing needs to be shown

_APART = 30  # rows between single ones, so that none counts as a neighbour of another
_SWING = 0.005  # of the range of the torque; smaller reversals are noise
_REVERSALS = 16  # of the torque that are remembered through a gap
_PARTS = 8  # of a gap, in each of which the input's way is kept


def subsample(record: Record, limit: int = LIMIT) -> Record:
    """A record of at most `limit` rows, see :func:`some_rows`: the same where it is short enough.

    It has the extent of the whole.
    """
    return record if record.size <= limit else record.select(some_rows(record, limit))


def some_rows(record: Record, limit: int) -> Integers:
    """Numbers of at most `limit` rows, all of them where there are no more.

    Otherwise stretches, one in each of up to 48 cells that divide the runs evenly, or the whole record where
    it has many runs. The place of a stretch in its cell is chosen so that all torques, speeds, directions and
    places of the output's turn are covered. Between stretches there are single rows at which torque or input
    reverse: friction remembers those.
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
    """First row and end of the cells, in order."""
    runs = bounds(record.run)
    if len(runs) > most:
        runs = [(0, record.size)]
    cells: list[tuple[int, int]] = []
    for begin, end in runs:
        count = max(round((end - begin) * most / record.size), 1)
        cells += pairwise(np.linspace(begin, end, count + 1).astype(np.int64).tolist())
    return cells


def _places(record: Record, cells: list[tuple[int, int]], length: int) -> list[int]:
    """First row of the stretch in each cell: together they shall cover what the whole record covers."""
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
    """Shares half-way between those of the record and equal ones: rare conditions tell parameters apart."""
    parts = [(share[group], share[group] > _RARE) for group in _GROUPS]
    return np.concatenate([0.5 * part + 0.5 * some / max(int(some.sum()), 1) for part, some in parts])


def _counts(record: Record, edges: Integers) -> Floats:
    """Rows before each of some edges, in order, by torque, speed, place, and torque and speed together.

    Shape (e, 84). The place is that in the output's turn.
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
    """Number of the level, of so many between zero and one."""
    return np.minimum(share * count, count - 1).astype(np.int64)


def _between(record: Record, begin: int, end: int) -> Integers:
    """Single rows of a gap: the last reversals of the torque, and extremes of the input angle."""
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
    """Rows of reversals of the torque that no later one exceeded: friction remembers these (Preisach)."""
    first, found = 0, list[int]()
    while first < torque.size and len(found) < _REVERSALS:
        rest = torque[first:][::-1]
        pair = sorted(torque.size - 1 - int(find(rest)) for find in (np.argmin, np.argmax))
        if abs(float(torque[pair[1]] - torque[pair[0]])) < swing:
            break
        found += pair
        first = pair[1]
    return found
