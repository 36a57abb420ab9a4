"""Lines of a torque at multiples of the wave generator's turn: amplitude, phase, and whether they repeat."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.diagnosis.ripple.windows import TURN, TURNS, Windows

FALSE_ALARM = 1e-3
"""Chance that a record without ripple shows any line of one kind: at the gear's orders, or at others."""

LEAST_WINDOWS = 5
"""Least number of windows for a line."""

BESIDE = (2.0, 4.0)
"""Least and greatest distance of the orders beside a line [periods in a window]."""

_MOST_BESIDE = 12  # orders on either side
_CONDITION = 30.0  # largest squared condition number of distinguishable columns
_LEAST_RUNS = 6  # with as many runs, the runs count as independent samples too
_SAME = 9.0  # deviance up to which another order counts as equal to the best
_LEAST_RECORDS = 3  # for a deviation from their scatter
_NO_NOISE = 1e-12  # least deviation of a part [N m]
_POWER = 2.33  # standard deviations for detection with 99 % chance
_OTHER = 0.01  # p value below which parts differ
_STEADY = 0.8  # agreement above which phases count as equal, as sizes vary with speed and load


class RecordedLine(NamedTuple):
    """A line in one recording: amplitude [N m], its standard deviation, phase [rad]."""

    amplitude: float
    std: float
    phase: float


@dataclass(frozen=True)
class Line:
    """A line of the torque, ``amplitude cos(order output_angle - phase)``, or the search for one.

    Attributes
    ----------
    order : float
        Periods per turn of the output.
    reverses : bool
        Whether it changes its sign with the direction, as friction or a late torque does.
    alike : tuple of (float, bool)
        Orders that explain the record about as well, and whether they reverse.
    amplitude, std, phase, least : float
        [N m], [N m], [rad], whether found or not; `std` is that of the cosine or sine part; `least` is the
        amplitude that would have been found with 99 % chance [N m].
    p_value : float
        Chance of this amplitude by noise alone, for this one test.
    agreement : float
        Length of the mean of the runs' phases, weighted by amplitude: 1 if all are the same.
    repeats : bool or None
        Whether it is the same in every recording, or in every run of a single one; None for a single run.
    filtered : bool
        Whether a filter damps waves at this frequency: the true amplitude is larger by an unknown factor.
    """

    order: float
    reverses: bool
    alike: tuple[tuple[float, bool], ...]
    amplitude: float
    std: float
    phase: float
    least: float
    p_value: float
    found: bool
    agreement: float
    repeats: bool | None
    records: tuple[RecordedLine, ...]
    filtered: bool = False


def lines_at(
    whole: Windows, multiple: float, ratio: float, shifts: Sequence[float], tests: int
) -> list[Line]:
    """A line for each testable column at a multiple of the wave generator's turn, found or not.

    Each of the `shifts` of the multiple gives two columns: one equal in both directions, one reversing. The
    false alarm is divided by the number of `tests`.
    """
    waves = _waves_at(multiple, whole)
    columns = [_Column(shift, reverses) for reverses in (False, True) for shift in shifts]
    records = waves.parts(waves.at.record)
    tests *= len(columns) * (1 if len(records) == 1 else 1 + len(records))
    threshold = FALSE_ALARM / tests
    chosen = _standing_out(waves, columns, threshold)
    single: set[_Column] = set()
    if not chosen and len(records) > 1:
        single = {column for part in records for column in _standing_out(part, columns, threshold)}

    def told(column: _Column) -> tuple[float, bool]:
        return ratio * (multiple + column.shift), column.reverses

    lines = []
    for column in columns:
        together = chosen if column in chosen else [*chosen, column]
        if _possible(waves, together):
            alike = tuple(told(other) for other in _alike(waves, together, column, columns))
            line = Line(*told(column), alike, *_found(waves, together, column, threshold))
            lines.append(_apart(line) if column in single else line)
    return lines


def _found(waves: _Waves, columns: list[_Column], column: _Column, threshold: float) -> tuple[Any, ...]:
    """Values of a `Line` from `amplitude` on, for one of the jointly fitted columns."""
    at, found = columns.index(column), _estimate(waves, columns)
    value, others = complex(found.values[at]), found.values.copy()
    others[at] = 0.0
    left = waves.values - waves.design(columns) @ others / np.sqrt(waves.weight)
    rest = waves._replace(values=left)
    parts, runs = (
        [_mean(one, column) for one in rest.parts(number)] for number in (waves.at.record, waves.at.run)
    )
    std = max(float(found.stds[at]), _scatter(parts))
    # Quantile of F with two degrees of freedom in the numerator, in closed form.
    limit = math.sqrt(found.freedom * (threshold ** (-2.0 / found.freedom) - 1.0))
    return (
        abs(value),
        std,
        _phase(value),
        (limit + _POWER) * std,
        float(found.p_values[at]),
        bool(found.p_values[at] <= threshold),
        _agreement([one for one, _ in runs]),
        _same(parts if len(parts) > 1 else runs),
        tuple(RecordedLine(abs(one), spread, _phase(one)) for one, spread in parts),
    )


def _alike(
    waves: _Waves, columns: list[_Column], column: _Column, possibly: Sequence[_Column]
) -> Iterator[_Column]:
    """Columns that explain the windows about as well in place of the given one."""
    found = _estimate(waves, columns)
    for other in possibly:
        trial = [other if one == column else one for one in columns]
        if other not in columns and _possible(waves, trial):
            more = _estimate(waves, trial).deviance - found.deviance
            if more < _SAME * found.deviance / found.freedom:
                yield other


def _mean(waves: _Waves, column: _Column) -> tuple[complex, float]:
    """Amplitude of one column in some windows, and its standard deviation from the orders beside [N m]."""
    inverse = np.linalg.pinv(waves.design([column]))[0] * np.sqrt(waves.weight)
    spread = np.sqrt(0.5 * np.mean(np.abs(inverse @ waves.beside) ** 2))
    return complex(inverse @ waves.values), float(spread)


def _scatter(parts: Sequence[tuple[complex, float]]) -> float:
    """Standard deviation of a mean from the scatter of recordings; zero if there are too few."""
    if len(parts) < _LEAST_RECORDS:
        return 0.0
    return float(np.std([one for one, _ in parts]) / np.sqrt(2.0 * (len(parts) - 1)))


def _same(parts: Sequence[tuple[complex, float]]) -> bool | None:
    """Whether parts differ from their mean by no more than noise, or agree well; None for a single part.

    The test is about their scatter, so the deviation must not contain it.
    """
    if len(parts) < 2:
        return None
    values, spread = np.array([one for one, _ in parts]), np.array([max(std, _NO_NOISE) for _, std in parts])
    mean = np.average(values, weights=spread**-2.0)
    squares = float(np.sum(np.abs((values - mean) / spread) ** 2))
    alike = special.chdtrc(2 * (len(parts) - 1), squares) > _OTHER
    return bool(alike or _agreement(list(values)) > _STEADY)


def _agreement(values: Sequence[complex]) -> float:
    """Length of the mean of the phases, weighted by amplitude: 1 if all are the same."""
    sizes = np.array(values)
    return float(np.abs(np.sum(sizes)) / max(float(np.sum(np.abs(sizes))), 1e-300))


def _apart(line: Line) -> Line:
    """A found line whose phase differs between recordings; its amplitude is their rms."""
    sizes, stds = (np.array([getattr(part, name) for part in line.records]) for name in ("amplitude", "std"))
    size, std = float(np.sqrt(np.mean(sizes**2))), float(np.sqrt(np.mean(stds**2) / sizes.size))
    return replace(line, amplitude=size, std=std, phase=np.nan, found=True, repeats=False)


def _phase(value: complex) -> float:
    """Phase in ``cos(order angle - phase)`` [rad]."""
    return float(-np.angle(value) % TURN)


# Waves, and selection of the significant ones ---


class _Column(NamedTuple):
    """A regressor of amplitudes over windows: its order less the multiple, and whether the sign reverses."""

    shift: float
    reverses: bool


class _Waves(NamedTuple):
    """Amplitudes of windows (s,) at an order, and at those beside it (s, m), with the windows' weights."""

    at: Windows
    values: Complexes
    beside: Complexes
    weight: Floats

    def parts(self, number: Integers) -> list[_Waves]:
        """Waves of the windows with each value of `number` (s,)."""
        return [
            _Waves(self.at.select(rows), self.values[rows], self.beside[rows], self.weight[rows])
            for rows in (number == one for one in np.unique(number))
        ]

    def design(self, columns: Sequence[_Column]) -> Complexes:
        """Design matrix (s, p), with each row times the root of its weight."""
        turned = [np.exp(1j * column.shift * self.at.middle) for column in columns]
        signs = [self.at.direction if column.reverses else 1.0 for column in columns]
        root = np.sqrt(self.weight)
        return np.stack([root * sign * one for sign, one in zip(signs, turned, strict=True)], axis=1)


class _Estimate(NamedTuple):
    """Amplitudes (p,), their deviations and p values, degrees of freedom, and the residual deviance."""

    values: Complexes
    stds: Floats
    p_values: Floats
    freedom: int
    deviance: float


def _waves_at(order: float, at: Windows) -> _Waves:
    """Waves at an order per turn of the input, in the windows that resolve it."""
    at = at.select(at.highest >= order + BESIDE[1] / TURNS)
    if not at.size:
        return _Waves(at, np.empty(0, complex), np.empty((0, 0), complex), np.empty(0))
    number = min(int((BESIDE[1] - BESIDE[0]) * at.reach / TURNS), _MOST_BESIDE - 1) + 1
    away = np.linspace(*BESIDE, number) / TURNS
    found = at.amplitudes(order + np.concatenate(([0.0], away, -away)))
    noise = np.mean(np.abs(found[:, 1:]) ** 2, axis=1)
    return _Waves(at, found[:, 0], found[:, 1:], 2.0 / np.maximum(noise + np.mean(noise), 1e-300))


def _estimate(waves: _Waves, columns: Sequence[_Column]) -> _Estimate:
    """Amplitudes of jointly fitted columns.

    The variance is the largest of three: from the scatter of the windows; from that of the runs, if there are
    enough (windows of a run share its speed and path, so they are not independent); from the amplitudes at
    the orders beside. Each has its own F-test, and the largest p value counts.
    """
    design, root = waves.design(columns), np.sqrt(waves.weight)[:, None]
    inverse = np.linalg.pinv(design)
    values = inverse @ (root[:, 0] * waves.values)
    rest = root[:, 0] * waves.values - design @ values
    count, freedom = len(columns), 2 * (waves.at.size - len(columns))
    deviance = float(np.sum(np.abs(rest) ** 2))
    beside = 0.5 * np.mean(np.abs(inverse @ (root * waves.beside)) ** 2, axis=1)
    tests = [(beside, 2 * waves.beside.shape[1])]
    tests.append((np.sum(np.abs(inverse) ** 2, axis=1) * deviance / freedom, freedom))
    names, run = np.unique(waves.at.run, return_inverse=True)
    if names.size >= max(_LEAST_RUNS, count + 2):
        pulls = np.zeros((count, names.size), complex)
        np.add.at(pulls.T, run, (inverse * rest).T)
        scale = names.size / (names.size - count)
        tests.append((0.5 * scale * np.sum(np.abs(pulls) ** 2, axis=1), 2 * (names.size - count)))
    power = 0.5 * np.abs(values) ** 2
    chances = [special.fdtrc(2, free, power / np.maximum(variance, 1e-300)) for variance, free in tests]
    stds = np.sqrt(np.max([variance for variance, _ in tests], axis=0))
    return _Estimate(values, stds, np.max(chances, axis=0), min(free for _, free in tests), deviance)


def _possible(waves: _Waves, columns: Sequence[_Column]) -> bool:
    """Whether there are enough windows, and the columns are distinguishable in them."""
    ways = min(np.count_nonzero(waves.at.direction == sign) for sign in (1.0, -1.0))
    if waves.at.size < len(columns) + LEAST_WINDOWS - 1 or (ways < 2 and any(c.reverses for c in columns)):
        return False
    return bool(np.linalg.cond(waves.design(columns)) ** 2 < _CONDITION)


def _standing_out(waves: _Waves, columns: Sequence[_Column], threshold: float) -> list[_Column]:
    """Significant columns, selected one by one: each time the one with the smallest residual."""
    chosen: list[_Column] = []
    while True:
        trials = [[*chosen, column] for column in columns if column not in chosen]
        found = [(_estimate(waves, trial), trial) for trial in trials if _possible(waves, trial)]
        best = min(found, key=lambda one: one[0].deviance, default=None)
        if best is None or best[0].p_values[-1] > threshold:
            return chosen
        chosen = best[1]
