"""Rows of a second publisher: one value recurs between samples that stay on the joint's own path."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import numpy as np

from hd_diag.arrays import Floats, Integers, Rows

_CANDIDATES = 4  # most frequent values of a column that are tried
_LEAST = 3  # least jumps to a value and back: fewer are outliers
_FAR = 5.0  # least jump over the joint's own 99th percentile step: no joint jumps that far and back
_SMALLEST = 1e-3  # least jump if the joint itself rests [rad, N m]
_SHORT = 5  # most rows of a torque at one value: under a brake it may be zero for longer
_DIGITS = 9  # decimal places in the comparison of wrapped angles
_UNITS = {"input": "rad", "output": "rad", "torque": "N m"}


def other_rows(
    time: Floats, bag: Integers, columns: Mapping[str, Floats], period: Mapping[str, float], where: str = ""
) -> tuple[Rows, str]:
    """Rows (n,) that a second publisher gave, and a sentence about them; empty if there are none.

    `time` [s] and the recordings' numbers `bag` are (n,). `columns` are angles [rad] and torque [N m] by
    role, each (n,). `period` is the wrap of an angle within a turn [rad]; `where` tells where they were
    published.

    Notes
    -----
    A joint passes a value, rests there, or steps and stays. It does not leave its path for the same value,
    to the last digit, and come back, three times or more. If other columns are constant in these rows too,
    all rows with these values are the publisher's, also those near the joint's own path.
    """
    longest = {"torque": _SHORT}
    between = [
        _between(column, bag, period.get(name, inf), longest.get(name, time.size))
        for name, column in columns.items()
    ]
    rows: Rows = np.any(between, axis=0) if between else np.zeros(time.size, dtype=bool)
    if not rows.any():
        return rows, ""
    keys = {name: _key(column, period.get(name, inf)) for name, column in columns.items()}
    alike = {name: float(key[rows][0]) for name, key in keys.items() if np.ptp(key[rows]) == 0.0}
    if len(alike) > 1:
        rows = rows | np.all([keys[name] == value for name, value in alike.items()], axis=0)
    count = int(np.count_nonzero(rows))
    span = sum(float(np.ptp(time[bag == number])) for number in np.unique(bag))
    told = " and ".join(f"{name} {value:g} {_UNITS[name]}" for name, value in alike.items())
    text = (
        f"{count} rows{' with ' if told else ''}{told}, {count / max(span, 1e-9):.3g} a second, stand "
        "between samples that go on elsewhere: no joint jumps there and back, a second publisher"
        f"{where} does"
    )
    return rows, text


def _key(column: Floats, period: float) -> Floats:
    """Values to compare; an angle within a turn is reduced to its place in the turn."""
    if period == inf:
        return column
    place = np.round(np.remainder(column, period), _DIGITS)
    return np.asarray(np.where(place >= np.round(period, _DIGITS), 0.0, place))


def _between(column: Floats, bag: Integers, period: float, longest: int) -> Rows:
    """Rows (n,) at which a column jumps to one value and back, within `longest` rows."""
    found = np.zeros(column.size, dtype=bool)
    finite = np.isfinite(column)
    steps = np.diff(column[finite])
    if period == inf and not (steps.max(initial=0.0) > _SMALLEST and steps.min(initial=0.0) < -_SMALLEST):
        return found  # no jumps in both directions
    key = _key(column, period)
    ordered = np.sort(key[finite])
    if not np.any(ordered[_LEAST - 1 :] == ordered[: 1 - _LEAST]):  # moving: no value repeats often
        return found
    values, counts = np.unique(ordered, return_counts=True)
    for number in np.argsort(-counts, kind="stable")[:_CANDIDATES]:
        if counts[number] < _LEAST:
            break
        rows = np.flatnonzero(key == values[number])
        own = np.flatnonzero(finite & (key != values[number]))
        after = own.searchsorted(rows)
        if not own.size:
            continue
        left, right = own[np.maximum(after - 1, 0)], own[np.minimum(after, own.size - 1)]
        # At either end of a recording a row has one neighbour.
        has_left, has_right = ((side < rows) == before for side, before in ((left, True), (right, False)))
        has_left, has_right = has_left & (bag[left] == bag[rows]), has_right & (bag[right] == bag[rows])
        left, right = np.where(has_left, left, right), np.where(has_right, right, left)
        away = np.minimum(*(_apart(column[side] - column[rows], period) for side in (left, right)))
        if np.count_nonzero(away > _SMALLEST) < _LEAST:
            continue
        step = _apart(column[own[1:]] - column[own[:-1]], period)[bag[own[1:]] == bag[own[:-1]]]
        least = max(_FAR * float(np.percentile(step, 99)), _SMALLEST) if step.size else np.inf
        back = (_apart(column[right] - column[left], period) <= least) & (has_left | has_right)
        jumps = (away > least) & back & (np.bincount(after)[after] <= longest)
        if np.unique(after[jumps]).size >= _LEAST:
            found[rows[jumps]] = True
    return found


def _apart(difference: Floats, period: float) -> Floats:
    """Magnitude of differences; the shorter way for angles within a turn."""
    if period < inf:
        difference = np.remainder(difference + 0.5 * period, period) - 0.5 * period
    return np.abs(difference)
