"""Where a series of weighted values changes its mean: PELT (ruptures) with a cost that knows the weights."""

from __future__ import annotations

import numpy as np
import ruptures
from ruptures.base import BaseCost

from hd_diag.arrays import Floats

LEAST = 3
"""Values in a segment, at least."""


class WeightedMean(BaseCost):  # type: ignore[misc]
    """Weighted sum of squares about the weighted mean; a signal has the columns value and weight."""

    model = "weighted_mean"
    min_size = LEAST

    def fit(self, signal: Floats) -> WeightedMean:
        """Take a signal, shape (n, 2)."""
        value, weight = np.asarray(signal, dtype=np.float64).T
        value = value - np.average(value, weights=weight)  # or the squares would cancel
        columns = np.stack((weight, weight * value, weight * value**2), axis=1)
        self.signal = signal
        self._sums = np.concatenate((np.zeros((1, 3)), np.cumsum(columns, axis=0)))
        return self

    def error(self, start: int, end: int) -> float:
        """Cost of the values from `start` to before `end`."""
        weight, first, second = self._sums[end] - self._sums[start]
        return float(max(second - first**2 / weight, 0.0))


def changes(value: Floats, weight: Floats, penalty: float) -> list[int]:
    """Indices of the first values after each change of the mean.

    Parameters
    ----------
    value, weight : ndarray, shape (n,)
    penalty : float
        By which the cost must fall for each change.

    Returns
    -------
    list of int
        Empty where the mean does not change.

    Notes
    -----
    Killick, Fearnhead, Eckley (2012), Optimal detection of changepoints with a linear computational cost.
    """
    search = ruptures.Pelt(custom_cost=WeightedMean(), min_size=LEAST, jump=1)
    return [int(i) for i in search.fit(np.stack((value, weight), axis=1)).predict(pen=penalty)[:-1]]
