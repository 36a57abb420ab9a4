"""Long records made short enough to draw: means with their spread, least and greatest values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import binned_statistic

from hd_diag.arrays import Floats, Integers

LOW, HIGH = 0.1, 0.9
"""Quantiles between which a band's spread lies [-]."""

_LEAST = 5  # samples in a bin below which it gets no mean


class Band(NamedTuple):
    """Bins of samples, shape (bins,): center, mean and quantiles, nan where too few; number of samples."""

    center: Floats
    mean: Floats
    low: Floats
    high: Floats
    samples: Integers


class Envelope(NamedTuple):
    """Least and greatest value of consecutive stretches, shape (stretches,) each; nan where there is none."""

    place: Floats
    low: Floats
    high: Floats


def band(place: Floats, value: Floats, edges: Floats) -> Band:
    """Means and spread of samples, shape (n,), in bins with rising edges, shape (bins + 1,)."""
    order = np.argsort(place, kind="stable")
    ends = np.searchsorted(place[order], edges)
    ends[-1] = np.searchsorted(place[order], edges[-1], side="right")
    table = np.full((3, edges.size - 1), np.nan)
    for k, part in enumerate(np.split(value[order], ends)[1:-1]):
        if part.size >= _LEAST:
            table[:, k] = part.mean(), *np.quantile(part, (LOW, HIGH))
    return Band(0.5 * (edges[:-1] + edges[1:]), table[0], table[1], table[2], np.diff(ends))


def envelope(place: Floats, value: Floats, stretches: int) -> Envelope:
    """Least and greatest value over stretches of equal length; the place, shape (n,), rises."""
    edges, known = np.linspace(place[0], place[-1], stretches + 1), np.isfinite(value)
    low, high = (binned_statistic(place[known], value[known], end, edges).statistic for end in ("min", "max"))
    return Envelope(0.5 * (edges[:-1] + edges[1:]), low, high)


def strongest(place: Floats, value: Floats, highest: float, count: int) -> tuple[Floats, Floats]:
    """Places and values of the greatest in each of `count` equal intervals from 0 to `highest`."""
    index = np.minimum((place / highest * count).astype(np.int64), count - 1)
    order = np.lexsort((-value, index))
    first = order[np.unique(index[order], return_index=True)[1]]
    return place[first], value[first]
