"""Long records made short enough to draw: means with their spread, least and greatest values."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats

LOW, HIGH = 0.1, 0.9
"""Quantiles between which a band's spread lies [-]."""

_LEAST = 5  # samples in a bin below which it gets no mean


class Band(NamedTuple):
    """Bins of samples: mean and quantiles of each, nan where there are too few.

    Attributes
    ----------
    center, mean, low, high : ndarray, shape (bins,)
    samples : ndarray of int64, shape (bins,)
    """

    center: Floats
    mean: Floats
    low: Floats
    high: Floats
    samples: npt.NDArray[np.int64]


class Envelope(NamedTuple):
    """Least and greatest value of consecutive stretches, shape (stretches,) each; nan where there is none."""

    place: Floats
    low: Floats
    high: Floats


def band(place: Floats, value: Floats, edges: Floats) -> Band:
    """Means and spread of samples in bins.

    Parameters
    ----------
    place, value : ndarray, shape (n,)
    edges : ndarray, shape (bins + 1,)
        Rising.
    """
    order = np.argsort(place, kind="stable")
    ends = np.searchsorted(place[order], edges)
    ends[-1] = np.searchsorted(place[order], edges[-1], side="right")
    parts = [value[order[a:b]] for a, b in pairwise(ends.tolist())]
    table = np.array([_three(part) for part in parts]).reshape(-1, 3)
    center = 0.5 * (edges[:-1] + edges[1:])
    return Band(center, table[:, 0], table[:, 1], table[:, 2], np.diff(ends).astype(np.int64))


def _three(values: Floats) -> tuple[float, float, float]:
    """Mean and the two quantiles."""
    if values.size < _LEAST:
        return float("nan"), float("nan"), float("nan")
    low, high = np.quantile(values, (LOW, HIGH))
    return float(values.mean()), float(low), float(high)


def envelope(place: Floats, value: Floats, stretches: int) -> Envelope:
    """Least and greatest value over stretches of equal length, so that no peak is lost.

    Parameters
    ----------
    place : ndarray, shape (n,)
        Rising.
    value : ndarray, shape (n,)
    stretches : int
    """
    edges = np.linspace(place[0], np.nextafter(place[-1], np.inf), stretches + 1)
    index = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, stretches - 1)
    low, high = np.full(stretches, np.inf), np.full(stretches, -np.inf)
    known = np.isfinite(value)
    np.minimum.at(low, index[known], value[known])
    np.maximum.at(high, index[known], value[known])
    empty = low > high
    low[empty] = high[empty] = np.nan
    return Envelope(0.5 * (edges[:-1] + edges[1:]), low, high)


def strongest(place: Floats, value: Floats, highest: float, count: int) -> tuple[Floats, Floats]:
    """The greatest value in each of equal intervals from 0 on: a spectrum with all its peaks.

    Parameters
    ----------
    place, value : ndarray, shape (n,)
    highest : float
        End of the last interval.
    count : int
        Intervals; at most this many points are kept.

    Returns
    -------
    place, value : ndarray, shape (k,)
        Those of the greatest values.
    """
    index = np.minimum((place / highest * count).astype(np.int64), count - 1)
    order = np.lexsort((-value, index))
    first = order[np.unique(index[order], return_index=True)[1]]
    return place[first], value[first]
