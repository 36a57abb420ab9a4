"""Filter over long columns, compiled when first called."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model.kernel.compiler import entry_point

_BLOCK = 1024  # values that stay in the fastest memory while all taps pass over them


@entry_point
def filtered(columns: Floats, taps: Floats, edges: Integers) -> Floats:
    """Columns (n, k) filtered by taps (m,) from edge to edge, zero where fewer than m rows are known.

    m is a multiple of three: so many taps at a time are twice as fast as one.
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
    """What white noise of variance one and slow noise beside it leave to be foretold, in its deviations.

    Columns (n, k), from edge to edge; slow noise of deviation `slow`, of which a row keeps the share `kept`
    of the one before (Kalman, J. Basic Engineering 82, 1960). With it half the logarithm of the variances.
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
    """Compile now, or read from the disk."""
    innovations(np.zeros((1, 1)), np.array([0, 1]), 1.0, 0.5)
    filtered(np.zeros((1, 1)), np.ones(3), np.array([0, 1]))
