"""Steps of the mean of a series of weighted values: whether there are any, where, and how large."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from hd_diag.arrays import Floats
from hd_diag.fleet.series import Series

FALSE_ALARM = 0.05
"""Chance that a run reports a change or a drift of anything where nothing changes."""

LEAST = 3
"""Values in a segment between two steps, at least."""

ENOUGH = 20
"""Permutations as clear as the series itself that settle a p-value."""

BOOTSTRAP = 400
"""Samples of a bootstrap."""

_TOGETHER = 999  # permutations


@dataclass(frozen=True)
class MeanShift:
    """A step of the mean.

    Times of the last value before it and the first after it, and the 95 % interval of its own [s]; its size,
    mean after less mean before, with a 95 % interval; its p-value against none between its neighbours.
    """

    before: float
    after: float
    low: float
    high: float
    size: float
    size_low: float
    size_high: float
    p_value: float


def weights(value: Floats, std: Floats) -> Floats:
    """Inverse variances, with what the values scatter beyond their deviations.

    Of values and deviations (n,): deviations that are nan or zero count as the median of the others; where
    none is known, all weights are equal.

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


def gains(value: Floats, weight: Floats) -> Floats:
    """By how much each single split of values (..., n) lowers the weighted sum of squares.

    Gives (..., n - 2 LEAST + 1) of splits before index `LEAST`, ..., n - `LEAST`.
    """
    centered = value - np.sum(weight * value, axis=-1, keepdims=True) / np.sum(weight, axis=-1, keepdims=True)
    count = np.cumsum(weight, axis=-1)
    part = np.cumsum(weight * centered, axis=-1)
    before = slice(LEAST - 1, value.shape[-1] - LEAST)
    w, s, whole = count[..., before], part[..., before], count[..., -1:]
    return np.asarray(s**2 * whole / (w * (whole - w)))


def permuted(value: Floats, weight: Floats, most: int, rng: np.random.Generator) -> tuple[float, float]:
    """p-value of the best split, and the gain that the best split of a constant series rarely exceeds.

    Permutations go on until enough of them do as well or `most` are done (Besag and Clifford, 1991).
    """
    observed = float(gains(value, weight).max()) * (1.0 - 1e-9)
    exceeding, done, penalty = 0, 0, math.nan
    while done < most and exceeding < ENOUGH:
        order = rng.permuted(np.tile(np.arange(value.size), (_TOGETHER, 1)), axis=1)
        best = gains(value[order], weight[order]).max(axis=1)
        penalty = float(np.quantile(best, 1.0 - FALSE_ALARM)) if done == 0 else penalty
        exceeding += int(np.sum(best >= observed))
        done += _TOGETHER
    return (exceeding + 1) / (done + 1), penalty


def segments(value: Floats, weight: Floats, penalty: float) -> list[int]:
    """Indices of the first values after each change of the weighted mean; empty where it does not change.

    The penalty is by how much the weighted sum of squares must fall for each change.

    Killick, Fearnhead, Eckley (2012), Optimal detection of changepoints with a linear computational cost. A
    weighted mean is a regression of √w·value on √w.
    """
    import ruptures  # here, for it takes a while to import

    root = np.sqrt(weight)
    search = ruptures.Pelt(model="linear", min_size=LEAST, jump=1)
    return [int(i) for i in search.fit(np.stack((root * value, root), axis=1)).predict(pen=penalty)[:-1]]


def edges_of(value: Floats, weight: Floats, penalty: float) -> list[int]:
    """Where steps are; a constant series has one with a chance of `FALSE_ALARM`."""
    centered = value - np.average(value, weights=weight)
    return segments(centered, weight, penalty) or [LEAST + int(np.argmax(gains(value, weight)))]


def means(value: Floats, weight: Floats, edges: list[int]) -> Floats:
    """Every value replaced by the weighted mean of its segment, shape (n,)."""
    parts = zip(np.split(value, edges), np.split(weight, edges), strict=True)
    return np.concatenate([np.full(v.size, np.average(v, weights=w)) for v, w in parts])


def change_at(series: Series, weights: Floats, part: list[int], rng: np.random.Generator) -> MeanShift:
    """A step between two segments: its place by bootstrap of scaled residuals, its size by Student's t."""
    begin, edge, end = part
    time, value, weight = series.time[begin:end], series.value[begin:end], weights[begin:end]
    middle = edge - begin
    mean = means(value, weight, [middle])
    drawn = rng.choice((value - mean) * np.sqrt(weight), (BOOTSTRAP, value.size))
    places = LEAST + np.argmax(gains(mean + drawn / np.sqrt(weight), weight), axis=1)
    low, high = np.quantile(places, (0.025, 0.975), method="closest_observation").astype(int)
    size = float(mean[-1] - mean[0])
    freedom = value.size - 2
    variance = float(np.sum(weight * (value - mean) ** 2)) / freedom
    spread = math.sqrt(variance * (1.0 / weight[:middle].sum() + 1.0 / weight[middle:].sum()))
    reach = float(stats.t.ppf(0.975, freedom)) * spread
    p_value, _ = permuted(value, weight, _TOGETHER, rng)
    before, after, first, last = time[[middle - 1, middle, low - 1, high]].tolist()
    return MeanShift(before, after, first, last, size, size - reach, size + reach, p_value)
