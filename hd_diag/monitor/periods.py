"""Periods of a rate, by stamps alone: where one begins, something is due."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Times

_NO_ROWS = np.empty(0, np.int64)
_EVER = 2**62  # [ns]


class Periods:
    """The last period of a stream, and where the next one begins.

    Parameters
    ----------
    shift : float
        Share of their length by which periods begin earlier [-].
    """

    def __init__(self, shift: float) -> None:
        self._shift = shift
        self._number = -_EVER
        self._begin = self._end = 0

    def within(self, stamp: int) -> bool:
        """Whether a stamp [ns] lies in the period that has begun last: nothing is due."""
        return self._begin <= stamp < self._end

    def change(self) -> None:
        """Look again: the rate may be another."""
        self._begin = self._end = 0

    def begun(self, stamp: Times, rate: float) -> Times:
        """Rows at which a period begins.

        Parameters
        ----------
        stamp : ndarray of int64, shape (n,)
            [ns], rising.
        rate : float
            [Hz]; zero: no period ever begins.

        Returns
        -------
        ndarray of int64
        """
        if rate <= 0.0:
            self._begin, self._end = -_EVER, _EVER
            return _NO_ROWS
        if self.within(int(stamp[0])) and self.within(int(stamp[-1])):
            return _NO_ROWS
        length = round(1e9 / rate)
        offset = round(self._shift * length)
        period = (stamp + offset) // length
        rows = np.flatnonzero(period != np.concatenate(([self._number], period[:-1])))
        self._number = int(period[-1])
        self._begin = self._number * length - offset
        self._end = self._begin + length
        return rows
