"""Waves of a torque in the windows of its motion: amplitudes, deviations, and which of them stand out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.diagnosis.ripple.windows import TURNS, Windows

LEAST_WINDOWS = 5
"""Windows of motion that a line takes."""

BESIDE = (2.0, 4.0)
"""Least and greatest distance of the orders beside a line [periods in a window]."""

_MOST_BESIDE = 12  # of them on either side
_CONDITION = 30.0  # of columns that can be told apart
_LEAST_RUNS = 6  # from which on runs, not windows, are what is independent


class Column(NamedTuple):
    """What a wave's amplitudes in the windows go with: its order less the multiple; its sign's law."""

    shift: float
    reverses: bool


class Waves(NamedTuple):
    """Amplitudes of windows (s,) at an order, and at those beside it (s, m), with the windows' weights."""

    at: Windows
    values: Complexes
    beside: Complexes
    weight: Floats

    def parts(self, number: Integers) -> list[Waves]:
        """Those of the windows of each number (s,)."""
        return [
            Waves(self.at.select(rows), self.values[rows], self.beside[rows], self.weight[rows])
            for rows in (number == one for one in np.unique(number))
        ]

    def design(self, columns: Sequence[Column]) -> Complexes:
        """Shape (s, p), each row times the root of its weight."""
        turned = [np.exp(1j * column.shift * self.at.middle) for column in columns]
        signs = [self.at.direction if column.reverses else 1.0 for column in columns]
        root = np.sqrt(self.weight)
        return np.stack([root * sign * one for sign, one in zip(signs, turned, strict=True)], axis=1)


class Estimate(NamedTuple):
    """Amplitudes (p,), their deviations, chances by noise alone, freedom, and the deviance that is left."""

    values: Complexes
    stds: Floats
    p_values: Floats
    freedom: int
    deviance: float


def waves_at(order: float, at: Windows) -> Waves:
    """Waves at an order per turn of the input, of the windows whose samples tell it."""
    at = at.select(at.highest >= order + BESIDE[1] / TURNS)
    if not at.size:
        return Waves(at, np.empty(0, complex), np.empty((0, 0), complex), np.empty(0))
    number = min(int((BESIDE[1] - BESIDE[0]) * at.reach / TURNS), _MOST_BESIDE - 1) + 1
    away = np.linspace(*BESIDE, number) / TURNS
    found = at.amplitudes(order + np.concatenate(([0.0], away, -away)))
    noise = np.mean(np.abs(found[:, 1:]) ** 2, axis=1)
    return Waves(at, found[:, 0], found[:, 1:], 2.0 / np.maximum(noise + np.mean(noise), 1e-300))


def estimate(waves: Waves, columns: Sequence[Column]) -> Estimate:
    """Amplitudes of columns fitted together.

    The variance is the greatest of three: by the scatter of the windows; of the runs, where there are enough
    (what the runs' speeds or courses have in common is not independent in their windows); of the amplitudes
    that the orders beside have. Each gives its own F-test.
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
    chances = [stats.f.sf(power / np.maximum(variance, 1e-300), 2, free) for variance, free in tests]
    stds = np.sqrt(np.max([variance for variance, _ in tests], axis=0))
    return Estimate(values, stds, np.max(chances, axis=0), min(free for _, free in tests), deviance)


def possible(waves: Waves, columns: Sequence[Column]) -> bool:
    """Whether the windows are enough, and tell the columns apart."""
    ways = min(np.count_nonzero(waves.at.direction == sign) for sign in (1.0, -1.0))
    if waves.at.size < len(columns) + LEAST_WINDOWS - 1 or (ways < 2 and any(c.reverses for c in columns)):
        return False
    return bool(np.linalg.cond(waves.design(columns)) ** 2 < _CONDITION)


def standing_out(waves: Waves, columns: Sequence[Column], threshold: float) -> list[Column]:
    """Columns that stand out one after the other, the one that explains most first."""
    chosen: list[Column] = []
    while True:
        trials = [[*chosen, column] for column in columns if column not in chosen]
        found = [(estimate(waves, trial), trial) for trial in trials if possible(waves, trial)]
        best = min(found, key=lambda one: one[0].deviance, default=None)
        if best is None or best[0].p_values[-1] > threshold:
            return chosen
        chosen = best[1]
