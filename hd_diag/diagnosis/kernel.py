"""Filters over long columns, compiled on the first call."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model.kernel.compiler import entry_point

_BLOCK = 1024  # values that stay in the fastest cache while all taps are applied


@entry_point
def filtered(columns: Floats, taps: Floats, edges: Integers) -> Floats:
    """Columns (n, k) filtered by taps (m,) between edges; the first m - 1 rows after an edge are zero.

    m is a multiple of three, as three taps at a time are twice as fast as one.
    """
    width, reach, result = columns.shape[1], taps.size - 1, np.zeros(columns.shape)
    flat, filled = columns.reshape(columns.size), result.reshape(columns.size)
    for part in range(edges.size - 1):
        end = edges[part + 1] * width
        for first in range((edges[part] + reach) * width, end, _BLOCK):
            last = min(first + _BLOCK, end)
            total = filled[first:last]
            for lag in range(0, taps.size, 3):
                one = flat[first - lag * width : last - lag * width]
                two = flat[first - (lag + 1) * width : last - (lag + 1) * width]
                three = flat[first - (lag + 2) * width : last - (lag + 2) * width]
                for i in range(total.size):
                    total[i] += taps[lag] * one[i] + taps[lag + 1] * two[i] + taps[lag + 2] * three[i]
    return result


@entry_point
def innovations(columns: Floats, edges: Integers, slow: float, kept: float) -> tuple[Floats, float]:
    """Normalised innovations (n, k) of columns (n, k) with white noise of variance one plus slow noise.

    The slow noise has standard deviation `slow`, and each row keeps the share `kept` of the previous one
    (Kalman, J. Basic Engineering 82, 1960). The state restarts at each edge. The second result is half the
    sum of the log variances.
    """
    result, logarithm = np.empty(columns.shape), 0.0
    state = np.zeros(columns.shape[1])
    for part in range(edges.size - 1):
        state[:] = 0.0
        open_ = slow**2
        for row in range(edges[part], edges[part + 1]):
            variance = open_ + 1.0
            root, gain = np.sqrt(variance), open_ / variance
            for i in range(state.size):
                away = columns[row, i] - state[i]
                result[row, i] = away / root
                state[i] = kept * (state[i] + gain * away)
            open_ = kept**2 * gain + (1.0 - kept**2) * slow**2
            logarithm += np.log(root)
    return result, logarithm


def warm_up() -> None:
    """Compile now, or load the cached code from disk."""
    innovations(np.zeros((1, 1)), np.array([0, 1]), 1.0, 0.5)
    filtered(np.zeros((1, 1)), np.ones(3), np.array([0, 1]))
