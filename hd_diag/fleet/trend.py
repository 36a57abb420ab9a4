"""What changes over time: steps of the mean, drifts, and when a limit would be reached.

A series with too few values for the question is ``unknown``. Steps have a p-value by permutation, drifts one
by Kendall's rank correlation, corrected for the number of series (Benjamini and Hochberg, 1995): of a fleet
in which nothing changes, a run reports anything with a chance of at most `FALSE_ALARM`. Permutations take the
values of a constant series as exchangeable: their deviations may differ, but bags that follow each other must
not resemble each other more than others do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from hd_diag.arrays import Floats
from hd_diag.fleet.series import Series
from hd_diag.fleet.steps import (
    BOOTSTRAP,
    ENOUGH,
    FALSE_ALARM,
    LEAST,
    MeanShift,
    change_at,
    edges_of,
    means,
    permuted,
    weights,
)

_MOST = 200_000  # permutations
_HORIZON = 10.0  # a limit is not predicted beyond this many times the time observed


CHANGED = ("steps", "drift")
"""Forms of a series that changes."""


@dataclass(frozen=True)
class Trend:
    """What a series shows: ``unknown`` (too few values), ``constant``, ``steps`` (changes) or ``drift``.

    From so many values `needed` on the clearest step possible would be reported; of each the series has a
    weight. The p-values are against a constant, alone (p) and corrected for all series (q); nan with too few
    values. `line` is Theil and Sen's as scipy has it [unit/s, unit], of times from the first on. `crossing`
    is when the limit is reached [s since 1970] with its 95 % interval, inf where that has no end; None where
    no drift leads there.
    """

    series: Series
    needed: int
    weights: Floats
    step_p: float = math.nan
    drift_p: float = math.nan
    step_q: float = math.nan
    drift_q: float = math.nan
    form: str = "unknown"
    changes: tuple[MeanShift, ...] = ()
    line: Any = None
    crossing: tuple[float, float, float] | None = None


def trends(
    series: Sequence[Series], rng: np.random.Generator, tick: Callable[[], None] = lambda: None
) -> list[Trend]:
    """What every series shows, beside all others, in the same order.

    `tick` is called before each: what it raises ends the work.
    """
    tests = 2 * len(series)
    needed = least_values(tests)
    most = min(math.ceil(ENOUGH * tests / FALSE_ALARM), _MOST)  # resolves p-values as far as so many ask
    weighted = [weights(one.value, one.std) for one in series]
    tested: dict[int, tuple[float, float, float]] = {}
    for number, one in enumerate(series):
        tick()
        if one.value.size >= needed:
            step_p, penalty = permuted(one.value, weighted[number], most, rng)
            drift_p = np.nan_to_num(stats.kendalltau(one.time, one.value).pvalue, nan=1.0)
            tested[number] = step_p, float(drift_p), penalty
    p_values = np.array([[step_p, drift_p] for step_p, drift_p, _ in tested.values()])
    corrected = stats.false_discovery_control(p_values.ravel()).reshape(-1, 2) if tested else p_values
    q_values = dict(zip(tested, corrected.tolist(), strict=True))
    return [
        _trend(one, needed, weight, tested[number], q_values[number], rng)
        if number in tested
        else Trend(one, needed, weight)
        for number, (one, weight) in enumerate(zip(series, weighted, strict=True))
    ]


def _trend(
    series: Series,
    needed: int,
    weight: Floats,
    tested: tuple[float, float, float],
    corrected: tuple[float, float],
    rng: np.random.Generator,
) -> Trend:
    (step_p, drift_p, penalty), (step_q, drift_q) = tested, corrected
    edges = edges_of(series.value, weight, penalty) if step_q <= FALSE_ALARM else []
    form = "steps" if edges else "constant"
    line = stats.theilslopes(series.value, series.time - series.time[0], 0.95)
    changes: tuple[MeanShift, ...] = ()
    crossing = None
    if drift_q <= FALSE_ALARM and (not edges or _line_is_better(series, weight, edges)):
        form, crossing = "drift", _crossing(series, line, rng)
    elif edges:
        parts = [0, *edges, series.value.size]
        changes = tuple(change_at(series, weight, parts[i : i + 3], rng) for i in range(len(edges)))
    return Trend(series, needed, weight, step_p, drift_p, step_q, drift_q, form, changes, line, crossing)


def least_values(tests: int) -> int:
    """Values from which on the clearest step possible is reported among so many tests.

    Of the n! orders of n values split in the middle, 2 (n/2)!² are as clear as the clearest: p is at least 2
    / (n over n/2).
    """
    number = 2 * LEAST
    while 2.0 / math.comb(number, number // 2) > FALSE_ALARM / max(tests, 1):
        number += 1
    return number


# Drifts ---


def _line_is_better(series: Series, weight: Floats, edges: list[int]) -> bool:
    """Whether one line describes a series better than its steps do, by Schwarz's criterion (1978)."""
    time, count = series.time - series.time.mean(), series.value.size
    line = np.polyval(np.polyfit(time, series.value, 1, w=np.sqrt(weight)), time)

    def criterion(predicted: Floats, numbers: int) -> float:
        squares = float(np.sum(weight * (series.value - predicted) ** 2))
        return count * math.log(max(squares, 1e-300)) + numbers * math.log(count)

    steps = criterion(means(series.value, weight, edges), 2 * len(edges) + 1)
    return criterion(np.asarray(line, np.float64), 2) < steps


def _crossing(series: Series, line: Any, rng: np.random.Generator) -> tuple[float, float, float] | None:
    """When the line reaches the limit, with its interval by bootstrap of the residuals.

    Those of so few values are too small, and their quantiles too near: both are widened as Student's t asks.
    """
    if not (np.isfinite(series.limit) and line.slope > 0.0):
        return None
    time = series.time - series.time[0]
    when = (series.limit - line.intercept) / line.slope
    if when > (1.0 + _HORIZON) * time[-1]:
        return None
    fitted = line.intercept + line.slope * time
    freedom = time.size - 2
    wider = math.sqrt(time.size / freedom) * float(stats.t.ppf(0.975, freedom) / stats.norm.ppf(0.975))
    residual = wider * (series.value - fitted)
    drawn = rng.choice(residual, (BOOTSTRAP, time.size))
    times = [_reached(time, fitted + one, series.limit) for one in drawn]
    low, high = np.quantile(times, (0.025, 0.975), method="closest_observation")
    return float(when + series.time[0]), float(low + series.time[0]), float(high + series.time[0])


def _reached(time: Floats, value: Floats, limit: float) -> float:
    """Time at which the Theil–Sen line of values reaches a limit; inf where it never does."""
    first, second = np.triu_indices(time.size, 1)
    apart, rises = time[second] - time[first], value[second] - value[first]
    slope = float(np.median(rises[apart > 0.0] / apart[apart > 0.0]))
    start = float(np.median(value) - slope * np.median(time))
    return (limit - start) / slope if slope > 0.0 else math.inf
