"""Lines of a torque at a multiple of the wave generator's turn: size, phase, and whether they repeat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from hd_diag.diagnosis.ripple.waves import Column, Waves, estimate, possible, standing_out, waves_at
from hd_diag.diagnosis.ripple.windows import TURN, Windows

FALSE_ALARM = 1e-3
"""Chance that a record without ripple shows any of one kind: the gear's, another."""

_SAME = 9.0  # deviance that another order may cost and still count as equal to the best
_LEAST_RECORDS = 3  # that tell a deviation
_POWER = 2.33  # standard deviations: found with 99 % chance
_OTHER = 0.01  # chance below which parts differ
_STEADY = 0.8  # agreement from which phases count as the same all the same: sizes go with speed and load


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
        Whether it changes its sign with the direction: friction, or a torque that is late, do.
    alike : tuple of (float, bool)
        Orders, and whether they reverse, that explain the record about as well.
    amplitude, std, phase, least : float
        [N m], [N m], [rad], as found or not; the deviation is that of cosine or sine; amplitude that would
        have been found with 99 % chance [N m].
    p_value : float
        Of noise alone, of this one test.
    agreement : float
        Length of the mean of the runs' phases, weighted by amplitude: 1 if all are the same.
    repeats : bool or None
        Whether it is the same in every recording, of one in every run; None where there is only one.
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


def lines_at(
    whole: Windows, multiple: float, ratio: float, shifts: Sequence[float], tests: int
) -> list[Line]:
    """A line for each column that can be tested at a multiple of the wave generator's turn, found or not.

    Columns are shifts of the multiple, each the same in both directions and reversing; all of it is one of
    so many `tests`.
    """
    waves = waves_at(multiple, whole)
    columns = [Column(shift, reverses) for reverses in (False, True) for shift in shifts]
    records = waves.parts(waves.at.record)
    tests *= len(columns) * (1 if len(records) == 1 else 1 + len(records))
    threshold = FALSE_ALARM / tests
    chosen = standing_out(waves, columns, threshold)
    single: set[Column] = set()
    if not chosen and len(records) > 1:
        single = {column for part in records for column in standing_out(part, columns, threshold)}

    def told(column: Column) -> tuple[float, bool]:
        return ratio * (multiple + column.shift), column.reverses

    lines = []
    for column in columns:
        together = chosen if column in chosen else [*chosen, column]
        if possible(waves, together):
            alike = tuple(told(other) for other in _alike(waves, together, column, columns))
            line = Line(*told(column), alike, *_found(waves, together, column, threshold))
            lines.append(_apart(line) if column in single else line)
    return lines


def _found(waves: Waves, columns: list[Column], column: Column, threshold: float) -> tuple[Any, ...]:
    """What a line tells, from its amplitude on, of one of the columns that are fitted together."""
    at, found = columns.index(column), estimate(waves, columns)
    value, others = complex(found.values[at]), found.values.copy()
    others[at] = 0.0
    left = waves.values - waves.design(columns) @ others / np.sqrt(waves.weight)
    rest = waves._replace(values=left)
    parts, runs = (
        [_mean(one, column) for one in rest.parts(number)] for number in (waves.at.record, waves.at.run)
    )
    std = max(float(found.stds[at]), _scatter(parts))
    limit = float(np.sqrt(2.0 * stats.f.isf(threshold, 2, found.freedom)))
    return (
        abs(value),
        std,
        _phase(value),
        (limit + _POWER) * std,
        float(found.p_values[at]),
        bool(found.p_values[at] <= threshold),
        _agreement([one for one, _ in runs]),
        _same(parts if len(parts) > 1 else runs, value, std),
        tuple(RecordedLine(abs(one), spread, _phase(one)) for one, spread in parts),
    )


def _alike(
    waves: Waves, columns: list[Column], column: Column, possibly: Sequence[Column]
) -> Iterator[Column]:
    """Columns that explain the windows about as well in the place of one."""
    found = estimate(waves, columns)
    for other in possibly:
        trial = [other if one == column else one for one in columns]
        if other not in columns and possible(waves, trial):
            more = estimate(waves, trial).deviance - found.deviance
            if more < _SAME * found.deviance / found.freedom:
                yield other


def _mean(waves: Waves, column: Column) -> tuple[complex, float]:
    """Amplitude of one column in some windows, with its deviation by the orders beside."""
    inverse = np.linalg.pinv(waves.design([column]))[0] * np.sqrt(waves.weight)
    spread = np.sqrt(0.5 * np.mean(np.abs(inverse @ waves.beside) ** 2))
    return complex(inverse @ waves.values), float(spread)


def _scatter(parts: Sequence[tuple[complex, float]]) -> float:
    """Deviation of a mean by the scatter of recordings; zero where they are too few."""
    if len(parts) < _LEAST_RECORDS:
        return 0.0
    return float(np.std([one for one, _ in parts]) / np.sqrt(2.0 * (len(parts) - 1)))


def _same(parts: Sequence[tuple[complex, float]], value: complex, std: float) -> bool | None:
    """Whether parts differ from the whole by no more than their deviations and its; None of a single part."""
    if len(parts) < 2:
        return None
    squares = sum(abs(one - value) ** 2 / (spread**2 + std**2) for one, spread in parts)
    alike = stats.chi2.sf(squares, 2 * (len(parts) - 1)) > _OTHER
    return bool(alike or _agreement([one for one, _ in parts]) > _STEADY)


def _agreement(values: Sequence[complex]) -> float:
    """Length of the mean of phases, weighted by size: 1 if all are the same."""
    sizes = np.array(values)
    return float(np.abs(np.sum(sizes)) / max(float(np.sum(np.abs(sizes))), 1e-300))


def _apart(line: Line) -> Line:
    """A line that recordings have in phases of their own: its amplitude is that of each."""
    sizes, stds = (np.array([getattr(part, name) for part in line.records]) for name in ("amplitude", "std"))
    size, std = float(np.sqrt(np.mean(sizes**2))), float(np.sqrt(np.mean(stds**2) / sizes.size))
    return replace(line, amplitude=size, std=std, phase=np.nan, found=True, repeats=False)


def _phase(value: complex) -> float:
    """Of ``cos(order angle - phase)`` [rad]."""
    return float(-np.angle(value) % TURN)
