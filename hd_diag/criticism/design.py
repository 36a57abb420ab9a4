"""Least squares on whitened columns, by blocks: any of them can be held out without another fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Design:
    """Normal equations of whitened columns, kept for every block.

    Attributes
    ----------
    gram : ndarray, shape (blocks, k, k)
        ``X_b^T X_b``.
    moment : ndarray, shape (blocks, k)
        ``X_b^T y_b``.
    square : ndarray, shape (blocks,)
        ``y_b^T y_b``.
    rows : int
        Number of rows that count.
    """

    gram: Floats
    moment: Floats
    square: Floats
    rows: int

    def deviance(self) -> float:
        """Residual sum of squares of the fit to all blocks."""
        gram, moment = self.gram.sum(axis=0), self.moment.sum(axis=0)
        return float(self.square.sum() - moment @ solve(gram, moment))

    def held_out(self) -> Floats:
        """Sum of squares of each block, predicted by a fit to all others; shape (blocks,)."""
        gram, moment = self.gram.sum(axis=0), self.moment.sum(axis=0)
        result = np.empty(self.square.size)
        for block in range(self.square.size):
            beta = solve(gram - self.gram[block], moment - self.moment[block])
            result[block] = (
                self.square[block] - 2.0 * beta @ self.moment[block] + beta @ self.gram[block] @ beta
            )
        return result


def solve(gram: Floats, moment: Floats) -> Floats:
    """Solution of normal equations whose columns may be of any scale, or alike; shape (k,)."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > 1e-10 * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return np.asarray(inverse @ (moment / scale) / scale)


def design(columns: Floats, target: Floats, block: Integers, counted: npt.NDArray[np.bool_]) -> Design:
    """Normal equations of whitened columns.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
    target : ndarray, shape (n,)
    block : ndarray of int64, shape (n,)
        Contiguous stretches numbered from zero.
    counted : ndarray of bool, shape (n,)
        Rows that whitening did not blank.

    Returns
    -------
    Design
    """
    edges = np.flatnonzero(np.diff(block)) + 1
    parts = np.split(np.arange(block.size), edges)
    gram = np.stack([columns[p].T @ columns[p] for p in parts])
    moment = np.stack([columns[p].T @ target[p] for p in parts])
    square = np.array([float(target[p] @ target[p]) for p in parts])
    return Design(gram, moment, square, int(np.count_nonzero(counted)))


def f_test(before: float, after: float, added: int, rows: int, fitted: int) -> float:
    """Chance of such a gain by noise alone.

    Parameters
    ----------
    before, after : float
        Residual sums of squares without and with the columns.
    added, fitted : int
        Columns added, and all columns with them.
    rows : int

    Returns
    -------
    float
        p value of the F test.
    """
    freedom = max(rows - fitted, 1)
    ratio = max(before - after, 0.0) / added / max(after / freedom, 1e-300)
    return float(stats.f.sf(ratio, added, freedom))


def lower_bound(gains: Floats, level: float = 0.99) -> float:
    """Lower confidence bound of a mean over blocks."""
    if gains.size < 2:
        return -np.inf
    spread = float(np.std(gains, ddof=1)) / np.sqrt(gains.size)
    return float(np.mean(gains) - stats.t.ppf(level, gains.size - 1) * spread)


def interval(gains: Floats, rng: np.random.Generator, level: float = 0.95) -> tuple[float, float]:
    """Bootstrap interval of a mean over blocks, which are as good as independent."""
    draws = gains[rng.integers(0, gains.size, (2000, gains.size))].mean(axis=1)
    low, high = np.quantile(draws, [(1.0 - level) / 2.0, (1.0 + level) / 2.0])
    return float(low), float(high)
