"""What changes over time: steps of the mean, drifts, and when a limit would be reached.

Nothing is said of a series that has too few values for the question, and what is said has a p-value by
permutation (steps) or by Kendall's rank correlation (drifts), corrected for the number of series that were
asked (Benjamini and Hochberg, 1995): of a fleet in which nothing changes, a run reports anything with a
chance of at most `FALSE_ALARM`. Permutations take the values of a constant series as exchangeable: their
deviations may differ, but bags that follow each other must not resemble each other more than others do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from hd_diag.arrays import Floats, Integers

FALSE_ALARM = 0.05
"""Chance that a run reports a change or a drift of anything where nothing changes."""

LEAST = 3  # values in a segment
_ENOUGH = 20  # permutations beyond the series itself that settle a p-value
_TOGETHER = 999
_MOST = 200_000
_BOOTSTRAP = 400
_HORIZON = 10.0  # a limit is not foretold beyond this many times the time observed


@dataclass(frozen=True)
class Series:
    """A quantity of one joint over time, in time order.

    Attributes
    ----------
    robot, joint, quantity, unit : str
    time : ndarray, shape (n,)
        Since 1970 [s].
    value, std : ndarray, shape (n,)
        Values and their standard deviations, in `unit`; nan deviations are unknown.
    limit : float
        That the quantity should stay below; nan = none.
    """

    robot: str
    joint: str
    quantity: str
    unit: str
    time: Floats
    value: Floats
    std: Floats
    limit: float = math.nan


@dataclass(frozen=True)
class Change:
    """A step of the mean.

    Attributes
    ----------
    before, after : float
        Times of the last value before it and the first after it [s].
    low, high : float
        95 % interval of its time [s].
    size, size_low, size_high : float
        Mean after less mean before, with its 95 % interval.
    p_value : float
        Of the step against none between its neighbours.
    """

    before: float
    after: float
    low: float
    high: float
    size: float
    size_low: float
    size_high: float
    p_value: float


@dataclass(frozen=True)
class Slope:
    """Theil–Sen slope with its 95 % interval [unit/s], and the line's value at the first time."""

    value: float
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class Trend:
    """What a series says.

    Attributes
    ----------
    series : Series
    needed : int
        Values without which nothing can be told.
    weights : ndarray, shape (n,)
        Of the values: the inverse of their variance, that between bags included.
    step_p, drift_p : float
        p-values of the series alone; nan where there are too few values.
    step_q, drift_q : float
        The same, corrected for all series of the run.
    form : str
        ``unknown`` (too few values), ``constant``, ``steps`` or ``drift``.
    changes : tuple of Change
        Where the form is ``steps``.
    slope : Slope or None
        Of all values.
    crossing : tuple of float or None
        When the limit is reached [s since 1970] and its 95 % interval, inf where that has no end; None where
        no drift goes there.
    """

    series: Series
    needed: int
    weights: Floats
    step_p: float = math.nan
    drift_p: float = math.nan
    step_q: float = math.nan
    drift_q: float = math.nan
    form: str = "unknown"
    changes: tuple[Change, ...] = ()
    slope: Slope | None = None
    crossing: tuple[float, float, float] | None = None


def trends(series: Sequence[Series], tick: Callable[[], None] = lambda: None) -> list[Trend]:
    """What every series says, beside all others.

    Parameters
    ----------
    series : sequence of Series
    tick : callable
        Called before each; what it raises ends the work.

    Returns
    -------
    list of Trend
        In the same order. Equal series give equal results.
    """
    tests = 2 * len(series)
    found, penalties = [], []
    for one in series:
        tick()
        trend, penalty = _tested(one, tests)
        found.append(trend)
        penalties.append(penalty)
    return [_described(trend, penalty) for trend, penalty in zip(_corrected(found), penalties, strict=True)]


def least_values(tests: int) -> int:
    """Values from which on the clearest step possible is told among so many tests.

    Notes
    -----
    Of the n! orders of n values split in the middle, 2 (n/2)!² are as clear as the clearest: p is at least
    2 / (n over n/2).
    """
    number = 2 * LEAST
    while 2.0 / math.comb(number, number // 2) > FALSE_ALARM / tests:
        number += 1
    return number


def weights(value: Floats, std: Floats) -> Floats:
    """Inverse variances, with what the values scatter beyond their deviations.

    Parameters
    ----------
    value, std : ndarray, shape (n,)
        Deviations that are nan or zero count as the median of the others.

    Returns
    -------
    ndarray, shape (n,)
        All equal where no deviation is known.

    Notes
    -----
    DerSimonian and Laird (1986), Meta-analysis in clinical trials: the variance between bags from the
    weighted sum of squares. It does not depend on the order, as permutations ask.
    """
    known = np.isfinite(std) & (std > 0.0)
    if not known.any():
        return np.ones(value.size)
    own = np.where(known, std, np.median(std[known])) ** -2.0
    mean = np.average(value, weights=own)
    excess = float(np.sum(own * (value - mean) ** 2)) - (value.size - 1)
    scale = float(own.sum() - np.sum(own**2) / own.sum())
    between = max(excess / scale, 0.0) if scale > 0.0 else 0.0
    return np.asarray(1.0 / (1.0 / own + between))


def _tested(series: Series, tests: int) -> tuple[Trend, float]:
    """p-values of one series, and the penalty of a step."""
    needed = least_values(tests)
    weight = weights(series.value, series.std)
    trend = Trend(series, needed, weight)
    if series.value.size < needed:
        return trend, math.nan
    most = min(max(_TOGETHER, math.ceil(_ENOUGH * tests / FALSE_ALARM)), _MOST)
    step_p, penalty = _permuted(series.value, weight, most)
    rank = stats.kendalltau(series.time, series.value)
    drift_p = float(rank.pvalue) if np.isfinite(rank.pvalue) else 1.0
    line = stats.theilslopes(series.value, series.time - series.time[0], 0.95)
    slope = Slope(float(line[0]), float(line[2]), float(line[3]), float(line[1]))
    return replace(trend, step_p=step_p, drift_p=drift_p, slope=slope), penalty


def gains(value: Floats, weight: Floats) -> Floats:
    """By how much each single split lowers the weighted sum of squares.

    Parameters
    ----------
    value, weight : ndarray, shape (..., n)

    Returns
    -------
    ndarray, shape (..., n - 2 LEAST + 1)
        Of splits before index `LEAST`, ..., n - `LEAST`.
    """
    centered = value - np.sum(weight * value, axis=-1, keepdims=True) / np.sum(weight, axis=-1, keepdims=True)
    count = np.cumsum(weight, axis=-1)
    part = np.cumsum(weight * centered, axis=-1)
    before = slice(LEAST - 1, value.shape[-1] - LEAST)
    w, s, whole = count[..., before], part[..., before], count[..., -1:]
    return np.asarray(s**2 * whole / (w * (whole - w)))


def _permuted(value: Floats, weight: Floats, most: int) -> tuple[float, float]:
    """p-value of the best split, and the gain that the best split of a constant series rarely exceeds.

    Permutations go on until enough of them do as well or `most` are done (Besag and Clifford, 1991).
    """
    rng = np.random.default_rng(0)
    observed = float(gains(value, weight).max()) * (1.0 - 1e-9)
    exceeding, done, penalty = 0, 0, math.nan
    while done < most and exceeding < _ENOUGH:
        order = rng.permuted(np.tile(np.arange(value.size), (_TOGETHER, 1)), axis=1)
        best = gains(value[order], weight[order]).max(axis=1)
        penalty = float(np.quantile(best, 1.0 - FALSE_ALARM)) if done == 0 else penalty
        exceeding += int(np.sum(best >= observed))
        done += _TOGETHER
    return (exceeding + 1) / (done + 1), penalty


def _corrected(found: list[Trend]) -> list[Trend]:
    """With the p-values of all series corrected together."""
    asked = [trend for trend in found if trend.slope is not None]
    p = np.array([[trend.step_p, trend.drift_p] for trend in asked]).ravel()
    q = iter(stats.false_discovery_control(p).reshape(-1, 2).tolist()) if asked else iter(())
    return [
        replace(trend, **dict(zip(("step_q", "drift_q"), next(q), strict=True))) if trend.slope else trend
        for trend in found
    ]


def _described(trend: Trend, penalty: float) -> Trend:
    """With its form, and what belongs to that."""
    if trend.slope is None:
        return trend
    stepped, drifting = trend.step_q <= FALSE_ALARM, trend.drift_q <= FALSE_ALARM
    edges = _edges(trend, penalty) if stepped else []
    if drifting and (not stepped or _line_is_better(trend, edges)):
        return replace(trend, form="drift", crossing=_crossing(trend))
    if not stepped:
        return replace(trend, form="constant")
    parts = [0, *edges, trend.series.value.size]
    changes = [_change(trend, parts[i : i + 3]) for i in range(len(edges))]
    return replace(trend, form="steps", changes=tuple(changes))


def _edges(trend: Trend, penalty: float) -> list[int]:
    """Where steps are: by PELT, whose penalty a constant series exceeds with a chance of `FALSE_ALARM`."""
    from hd_diag.fleet.segments import changes  # here, for ruptures takes a while to import

    value, weight = trend.series.value, trend.weights
    best = LEAST + int(np.argmax(gains(value, weight)))
    return changes(value, weight, penalty) or [best]


def _line_is_better(trend: Trend, edges: list[int]) -> bool:
    """Whether one line describes a series better than its steps do, by Schwarz's criterion (1978)."""
    series, weight = trend.series, trend.weights
    time = series.time - series.time.mean()
    line = np.asarray(np.polyval(np.polyfit(time, series.value, 1, w=np.sqrt(weight)), time), np.float64)
    steps = _means(series.value, weight, edges)
    count = series.value.size

    def criterion(predicted: Floats, numbers: int) -> float:
        squares = float(np.sum(weight * (series.value - predicted) ** 2))
        return count * math.log(max(squares, 1e-300)) + numbers * math.log(count)

    return criterion(line, 2) < criterion(steps, 2 * len(edges) + 1)


def _means(value: Floats, weight: Floats, edges: list[int]) -> Floats:
    parts = zip(np.split(value, edges), np.split(weight, edges), strict=True)
    return np.concatenate([np.full(v.size, np.average(v, weights=w)) for v, w in parts])


def _change(trend: Trend, part: list[int]) -> Change:
    """A step between two segments: its place by bootstrap of scaled residuals, its size by Student's t."""
    begin, edge, end = part
    time, rows = trend.series.time[begin:end], slice(begin, end)
    value, weight = trend.series.value[rows], trend.weights[rows]
    middle = edge - begin
    mean = _means(value, weight, [middle])
    rng = np.random.default_rng(0)
    drawn = rng.choice((value - mean) * np.sqrt(weight), (_BOOTSTRAP, value.size))
    again = mean + drawn / np.sqrt(weight)
    places = LEAST + np.argmax(gains(again, weight), axis=1)
    low, high = np.quantile(places, (0.025, 0.975), method="closest_observation").astype(int)
    size = float(mean[-1] - mean[0])
    freedom = value.size - 2
    variance = float(np.sum(weight * (value - mean) ** 2)) / freedom
    spread = math.sqrt(variance * (1.0 / weight[:middle].sum() + 1.0 / weight[middle:].sum()))
    reach = float(stats.t.ppf(0.975, freedom)) * spread
    p_value, _ = _permuted(value, weight, _TOGETHER)
    return Change(
        float(time[middle - 1]),
        float(time[middle]),
        float(time[low - 1]),
        float(time[high]),
        size,
        size - reach,
        size + reach,
        p_value,
    )


def _crossing(trend: Trend) -> tuple[float, float, float] | None:
    """When the line reaches the limit, with its interval by bootstrap of the residuals.

    Those of so few values are too small, and their quantiles too near: both are widened as Student's t asks.
    """
    series, slope = trend.series, trend.slope
    assert slope is not None
    if not (np.isfinite(series.limit) and slope.value > 0.0):
        return None
    time = series.time - series.time[0]
    fitted = slope.start + slope.value * time
    rng = np.random.default_rng(0)
    freedom = time.size - 2
    wider = math.sqrt(time.size / freedom) * float(stats.t.ppf(0.975, freedom) / stats.norm.ppf(0.975))
    left = wider * (series.value - fitted)
    pairs = np.triu_indices(time.size, 1)
    times = [
        _reached(time, fitted + rng.choice(left, left.size), pairs, series.limit) for _ in range(_BOOTSTRAP)
    ]
    low, high = np.quantile(times, (0.025, 0.975), method="closest_observation")
    when = (series.limit - slope.start) / slope.value
    if when > (1.0 + _HORIZON) * time[-1]:
        return None
    return tuple(float(t + series.time[0]) for t in (when, low, high))  # type: ignore[return-value]


def _reached(time: Floats, value: Floats, pairs: tuple[Integers, Integers], limit: float) -> float:
    """Time at which the Theil–Sen line of values reaches a limit; inf where it never does."""
    first, second = pairs
    apart = time[second] - time[first]
    rises = value[second] - value[first]
    slope = float(np.median(rises[apart > 0.0] / apart[apart > 0.0]))
    start = float(np.median(value) - slope * np.median(time))
    return (limit - start) / slope if slope > 0.0 else math.inf
