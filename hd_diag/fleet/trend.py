"""What changes over time: steps of the mean, drifts, and when a limit would be reached.

A series with too few values for the question is ``unknown``. Steps have a p-value by permutation, drifts one
by Kendall's rank correlation, corrected for the number of series (Benjamini and Hochberg, 1995): if nothing
changes in a fleet, a run reports anything with a chance of at most `FALSE_ALARM`. Permutations assume
that the values of a constant series can be exchanged: their deviations may differ, but neighbouring bags must
not resemble each other more than others do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from hd_diag.arrays import Floats
from hd_diag.fleet.series import Series

FALSE_ALARM = 0.05
"""Chance that a run reports any step or drift although nothing changes."""

LEAST = 3
"""Least number of values in a segment between two steps."""

_ENOUGH = 20  # permutations at least as clear as the series that suffice for a p-value
_BOOTSTRAP = 400  # samples
_TOGETHER = 999  # permutations at a time
_MOST = 200_000  # most permutations
_HORIZON = 10.0  # a limit is not predicted beyond this many times the time observed


@dataclass(frozen=True)
class MeanShift:
    """A step of the mean.

    `before` and `after` are the times of the last value before it and the first after it, `low` and `high`
    the 95 % interval of its own time [s]. `size` is the mean after less the mean before, with a 95 %
    interval. `p_value` is against no step between the neighbouring steps.
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
class Trend:
    """What a series shows: ``unknown`` (too few values), ``constant``, ``steps`` or ``drift``.

    With `needed` values the clearest possible step would be reported; each value has a weight. The p-values
    are against a constant, alone (p) and corrected for all series (q); nan with too few values. `line` is
    scipy's Theil–Sen line [unit/s, unit], with times counted from the first. `crossing` is the time when the
    limit is reached [s since 1970], with its 95 % interval, inf if the interval has no end; None if no drift
    leads there.
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

    @property
    def changed(self) -> bool:
        """Whether the series steps or drifts."""
        return self.form in ("steps", "drift")


def trends(
    series: Sequence[Series], rng: np.random.Generator, tick: Callable[[], None] = lambda: None
) -> list[Trend]:
    """Trends of all series, in the same order, with p-values corrected for their number.

    `tick` is called before each series: an exception from it ends the work.
    """
    tests = 2 * len(series)
    needed = least_values(tests)
    most = min(math.ceil(_ENOUGH * tests / FALSE_ALARM), _MOST)  # resolves p-values for so many
    found = [Trend(one, needed, weights(one.value, one.std)) for one in series]
    tested: dict[int, tuple[float, float, float]] = {}
    for number, (one, trend) in enumerate(zip(series, found, strict=True)):
        tick()
        if one.value.size >= needed:
            step_p, penalty = permuted(one.value, trend.weights, most, rng)
            drift_p = np.nan_to_num(stats.kendalltau(one.time, one.value).pvalue, nan=1.0)
            tested[number] = step_p, float(drift_p), penalty
    p_values = [p for step_p, drift_p, _ in tested.values() for p in (step_p, drift_p)]
    corrected = stats.false_discovery_control(p_values).reshape(-1, 2).tolist() if tested else []
    for (number, (step_p, drift_p, penalty)), (step_q, drift_q) in zip(
        tested.items(), corrected, strict=True
    ):
        of_tests = {"step_p": step_p, "drift_p": drift_p, "step_q": step_q, "drift_q": drift_q}
        found[number] = _tested(replace(found[number], **of_tests), penalty, rng)
    return found


def _tested(trend: Trend, penalty: float, rng: np.random.Generator) -> Trend:
    """The trend with its form, changes and crossing, from corrected p-values and the penalty of a step."""
    series, weight, edges = trend.series, trend.weights, list[int]()
    if trend.step_q <= FALSE_ALARM:
        centered = series.value - np.average(series.value, weights=weight)
        best = LEAST + int(np.argmax(gains(series.value, weight)))
        edges = segments(centered, weight, penalty) or [best]
    form, changes, crossing = "steps" if edges else "constant", list[MeanShift](), None
    line = stats.theilslopes(series.value, series.time - series.time[0], 0.95)
    if trend.drift_q <= FALSE_ALARM and (not edges or _line_is_better(series, weight, edges)):
        form, crossing = "drift", _crossing(series, line, rng)
    elif edges:
        ends = [0, *edges, series.value.size]
        parts = zip(ends, edges, ends[2:], strict=False)  # begin, step and end of each
        changes = [_change(series, weight, *part, rng) for part in parts]
    return replace(trend, form=form, changes=tuple(changes), line=line, crossing=crossing)


def least_values(tests: int) -> int:
    """Least number of values needed to report the clearest step among so many tests.

    Of the n! orders of n values split in the middle, 2 (n/2)!² are as clear as the clearest: p is at least 2
    / (n over n/2).
    """
    number = 2 * LEAST
    while 2.0 / math.comb(number, number // 2) > FALSE_ALARM / max(tests, 1):
        number += 1
    return number


# Steps ---


def weights(value: Floats, std: Floats) -> Floats:
    """Inverse of each value's variance (n,), which is its squared deviation plus the variance between bags.

    Deviations that are nan or zero count as the median of the others; if none is known, all weights are
    equal.

    DerSimonian and Laird (1986), Meta-analysis in clinical trials: the variance between bags from the
    weighted sum of squares. It does not depend on the order, as permutations require.
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


def gains(value: Floats, weight: Floats) -> Floats:
    """Decrease of the weighted sum of squares by each single split of values (..., n).

    Shape (..., n - 2 LEAST + 1), for splits before index `LEAST`, ..., n - `LEAST`.
    """
    centered = value - np.sum(weight * value, axis=-1, keepdims=True) / np.sum(weight, axis=-1, keepdims=True)
    count = np.cumsum(weight, axis=-1)
    part = np.cumsum(weight * centered, axis=-1)
    before = slice(LEAST - 1, value.shape[-1] - LEAST)
    w, s, whole = count[..., before], part[..., before], count[..., -1:]
    return np.asarray(s**2 * whole / (w * (whole - w)))


def permuted(value: Floats, weight: Floats, most: int, rng: np.random.Generator) -> tuple[float, float]:
    """p-value of the best split, and the 1 - `FALSE_ALARM` quantile of its gain in a constant series.

    Permutations go on until enough of them gain as much or `most` are done (Besag and Clifford, 1991).
    """
    observed = float(gains(value, weight).max()) * (1.0 - 1e-9)
    exceeding, done, penalty = 0, 0, math.nan
    while done < most and exceeding < _ENOUGH:
        order = rng.permuted(np.tile(np.arange(value.size), (_TOGETHER, 1)), axis=1)
        best = gains(value[order], weight[order]).max(axis=1)
        penalty = float(np.quantile(best, 1.0 - FALSE_ALARM)) if done == 0 else penalty
        exceeding += int(np.sum(best >= observed))
        done += _TOGETHER
    return (exceeding + 1) / (done + 1), penalty


def segments(value: Floats, weight: Floats, penalty: float) -> list[int]:
    """Indices of the first values after each change of the weighted mean; empty if it does not change.

    Each change must lower the weighted sum of squares by at least `penalty`.

    Killick, Fearnhead, Eckley (2012), Optimal detection of changepoints with a linear computational cost. A
    weighted mean is a regression of √w·value on √w.
    """
    import ruptures  # imported late: it takes a while

    root = np.sqrt(weight)
    search = ruptures.Pelt(model="linear", min_size=LEAST, jump=1)
    return [int(i) for i in search.fit(np.stack((root * value, root), axis=1)).predict(pen=penalty)[:-1]]


def _means(value: Floats, weight: Floats, edges: list[int]) -> Floats:
    """Every value replaced by the weighted mean of its segment, shape (n,)."""
    parts = zip(np.split(value, edges), np.split(weight, edges), strict=True)
    return np.concatenate([np.full(v.size, np.average(v, weights=w)) for v, w in parts])


def _change(
    series: Series, weights: Floats, begin: int, edge: int, end: int, rng: np.random.Generator
) -> MeanShift:
    """A step between two segments: its place by bootstrap of scaled residuals, its size by Student's t."""
    time, value, weight = series.time[begin:end], series.value[begin:end], weights[begin:end]
    middle, freedom = edge - begin, value.size - 2
    mean = _means(value, weight, [middle])
    drawn = rng.choice((value - mean) * np.sqrt(weight), (_BOOTSTRAP, value.size))
    places = LEAST + np.argmax(gains(mean + drawn / np.sqrt(weight), weight), axis=1)
    low, high = np.quantile(places, (0.025, 0.975), method="closest_observation").astype(int)
    size = float(mean[-1] - mean[0])
    variance = float(np.sum(weight * (value - mean) ** 2)) / freedom
    spread = math.sqrt(variance * (1.0 / weight[:middle].sum() + 1.0 / weight[middle:].sum()))
    reach = float(stats.t.ppf(0.975, freedom)) * spread
    p_value, _ = permuted(value, weight, _TOGETHER, rng)
    before, after, first, last = time[[middle - 1, middle, low - 1, high]].tolist()
    return MeanShift(before, after, first, last, size, size - reach, size + reach, p_value)


# Drifts ---


def _line_is_better(series: Series, weight: Floats, edges: list[int]) -> bool:
    """Whether one line describes a series better than its steps do, by Schwarz's criterion (1978)."""
    time, count = series.time - series.time.mean(), series.value.size
    line = np.polyval(np.polyfit(time, series.value, 1, w=np.sqrt(weight)), time)

    def criterion(predicted: Floats, numbers: int) -> float:
        squares = float(np.sum(weight * (series.value - predicted) ** 2))
        return count * math.log(max(squares, 1e-300)) + numbers * math.log(count)

    steps = criterion(_means(series.value, weight, edges), 2 * len(edges) + 1)
    return criterion(np.asarray(line, np.float64), 2) < steps


def _crossing(series: Series, line: Any, rng: np.random.Generator) -> tuple[float, float, float] | None:
    """Time when the line reaches the limit, with its interval by bootstrap of the residuals [s since 1970].

    With few values the residuals are too small, and their quantiles too near: both are widened, the quantiles
    as by Student's t.
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
    drawn = rng.choice(wider * (series.value - fitted), (_BOOTSTRAP, time.size))
    first, second = np.triu_indices(time.size, 1)
    later = time[second] > time[first]
    first, second = first[later], second[later]

    def reached(value: Floats) -> float:
        """Time when the Theil–Sen line of values reaches the limit; inf if it never does."""
        slope = float(np.median((value[second] - value[first]) / (time[second] - time[first])))
        start = float(np.median(value) - slope * np.median(time))
        return (series.limit - start) / slope if slope > 0.0 else math.inf

    times = [reached(fitted + one) for one in drawn]
    low, high = np.quantile(times, (0.025, 0.975), method="closest_observation")
    return float(when + series.time[0]), float(low + series.time[0]), float(high + series.time[0])
