"""Least squares on whitened columns, by blocks: any block can be held out without another fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import special
from scipy.linalg import lapack

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.calibration import CERTAIN_SIZE, DISAGREEING, FORETOLD

_DRAWS = 2000  # of a bootstrap
_ALONE = 1e-10  # share of a column outside a block below which it is only rounding
_ALIKE = 1e-10  # least eigenvalue of a Gram matrix over its greatest; below, columns differ by rounding only
_APART = 1e-6  # least squared share of each column that those before it leave, if no columns are alike
_TOLD_APART = 1e-6  # largest deviation from one of the inverse times the matrix


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
    precision, pull : ndarray, shape (k,)
        Prior precision and centre of every coefficient. If the blocks say nothing, it stays at the centre.
    wandering : ndarray of int64, shape (m,)
        Indices of columns that other blocks cannot predict: a held-out block fits them itself.
    """

    gram: Floats
    moment: Floats
    square: Floats
    precision: Floats
    pull: Floats
    wandering: Integers

    def deviance(self) -> float:
        """Residual sum of squares of the fit to all blocks, including that of the prior."""
        return self.deviance_at(np.empty(0, np.int64), np.empty(0))

    def deviance_at(self, fixed: Integers, values: Floats) -> float:
        """Deviance with the coefficients at some indices fixed, (m,) indices and values."""
        (gram, moment), free = self.whole, np.delete(np.arange(self.pull.size), fixed)
        rest = moment[free] - gram[np.ix_(free, fixed)] @ values
        own = values @ (gram[np.ix_(fixed, fixed)] @ values - 2.0 * moment[fixed])
        known = self.square.sum() + self.precision @ self.pull**2 + own
        return float(known - rest @ solve(gram[np.ix_(free, free)], rest))

    def holding(self, numbers: Integers, values: Floats) -> Design:
        """The design with some coefficients fixed: their columns are subtracted from the target."""
        if not numbers.size:
            return self
        gram, moment = self.gram.copy(), self.moment - self.gram[:, :, numbers] @ values
        square = self.square - (self.moment + moment)[:, numbers] @ values
        gram[:, numbers], gram[:, :, numbers], moment[:, numbers] = 0.0, 0.0, 0.0
        precision = self.precision.copy()
        precision[numbers] = 0.0
        return replace(self, gram=gram, moment=moment, square=square, precision=precision)

    def without_wandering(self) -> Design:
        """The design with the wandering columns projected out of every block."""
        numbers = self.wandering
        if not numbers.size:
            return self
        gram, moment, square = self.gram.copy(), self.moment.copy(), self.square.copy()
        for block, (g, m) in enumerate(zip(self.gram, self.moment, strict=True)):
            inside = g[numbers]
            own = inverse(inside[:, numbers])
            gram[block] -= inside.T @ own @ inside
            moment[block] -= inside.T @ own @ m[numbers]
            square[block] -= m[numbers] @ own @ m[numbers]
        rest = replace(self, gram=gram, moment=moment, square=square)
        return rest.holding(numbers, np.zeros(numbers.size))

    @cached_property
    def of_data(self) -> tuple[Floats, Floats]:
        """Normal equations of all blocks."""
        return self.gram.sum(axis=0), self.moment.sum(axis=0)

    @cached_property
    def whole(self) -> tuple[Floats, Floats]:
        """Normal equations of all blocks and the prior."""
        gram, moment = self.of_data
        return gram + np.diag(self.precision), moment + self.precision * self.pull

    def held_out(self) -> Floats:
        """Residual sum of squares of each block, predicted by a fit to all others; shape (blocks,)."""
        result = self.without_wandering().square.copy()
        for block, (g, m, _, _, beta, _) in enumerate(self._by_others):
            result[block] += beta @ g @ beta - 2.0 * beta @ m
        return result

    @cached_property
    def _by_others(self) -> list[tuple[Floats, Floats, Floats, Floats, Floats, Floats]]:
        """As `blocks`, with the others' solution (k,) and the inverse of their Gram matrix (k, k)."""
        found = []
        for own, own_moment, others, towards in self.without_wandering().blocks():
            spread = inverse(others)
            found.append((own, own_moment, others, towards, spread @ towards, spread))
        return found

    def held_out_gain(self, dropped: slice) -> tuple[Floats, Floats, Floats]:
        """Gain by some columns in each block, predicted by fits to all others.

        Parameters
        ----------
        dropped : slice
            The columns in question.

        Returns
        -------
        gain : ndarray, shape (blocks,)
            Decrease of the block's residual sum of squares.
        predicted : ndarray, shape (blocks,)
            Decrease if the prediction were right.
        variance : ndarray, shape (blocks,)
            Of half the gain about half its prediction. Noise contributes `predicted`; the rest is from the
            uncertainty of all coefficients. A block in a state that no other block has says little.
        """
        count = self.moment.shape[1]
        rest = np.delete(np.arange(count), np.r_[dropped])
        gain, predicted, variance = np.empty((3, self.square.size))
        for block, (g, m, others, towards, beta, spread) in enumerate(self._by_others):
            fewer = np.zeros(count)
            told = np.einsum("ij,ji->i", spread[dropped], others[:, dropped])  # one if no column is alike
            if np.all(np.abs(told - 1.0) < _TOLD_APART):
                step = np.linalg.solve(spread[dropped, dropped], beta[dropped])
                fewer[rest] = (beta - spread[:, dropped] @ step)[rest]
            else:
                fewer[rest] = solve(others[np.ix_(rest, rest)], towards[rest])
            change = beta - fewer
            gain[block] = 2.0 * change @ m - beta @ g @ beta + fewer @ g @ fewer
            along = g @ change
            predicted[block] = change @ along
            variance[block] = predicted[block] + along @ spread @ along
        return gain, predicted, variance

    def held_out_loss(self, dropped: slice) -> Floats:
        """Increase of each block's residual sum of squares without some columns, shape (blocks,).

        All coefficients come from a fit to the other blocks, with these columns: nothing takes their place.
        """
        loss = np.empty(self.square.size)
        for block, (g, m, _, _, beta, _) in enumerate(self._by_others):
            part = np.zeros(beta.size)
            part[dropped] = beta[dropped]
            loss[block] = 2.0 * part @ (m - g @ beta) + part @ g @ part
        return loss

    def prior_gain(self, dropped: slice) -> tuple[float, float]:
        """Gain by some columns in the prior term of the others, in addition to that in the blocks.

        Returns
        -------
        gain : float
            Increase of the others' sum of squares from their prior if these columns are dropped.
        predicted : float
            Sum of squares of the others' shift. Summed over all blocks and this term, gain and predicted gain
            of a fit to all blocks are equal.
        """
        gram, moment = self.whole
        rest = np.delete(np.arange(moment.size), np.r_[dropped])
        whole, fewer = solve(gram, moment), np.zeros(moment.size)
        fewer[rest] = solve(gram[np.ix_(rest, rest)], moment[rest])
        away, there = ((one - self.pull)[rest] for one in (fewer, whole))
        own = self.precision[rest]
        return float(own @ (away**2 - there**2)), float(own @ (away - there) ** 2)

    def blocks(self) -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
        """Normal equations of every block and of all others.

        A column confined to one block is only rounding in the others: it is set to zero there.
        """
        gram, moment = self.whole
        for own, own_moment in zip(self.gram, self.moment, strict=True):
            others, towards = gram - own, moment - own_moment
            alone = np.diag(others) < _ALONE * np.diag(gram)
            others[alone], others[:, alone], towards[alone] = 0.0, 0.0, 0.0
            yield own, own_moment, others, towards


def solve(gram: Floats, moment: Floats) -> Floats:
    """Solution of normal equations, shape (k,). Columns may be of any scale, or alike."""
    return np.asarray(inverse(gram) @ moment)


def inverse(gram: Floats) -> Floats:
    """Inverse of a Gram matrix, shape (k, k). Columns may be of any scale, alike, or zero."""
    square = np.diag(gram)
    if not square.size or not np.all(square > 0.0):
        own, found = np.flatnonzero(square > 0.0), np.zeros_like(gram)
        if own.size:
            found[np.ix_(own, own)] = inverse(gram[np.ix_(own, own)])
        return found
    scale = np.sqrt(square)
    scaled = gram / np.outer(scale, scale)
    root, failed = lapack.dpotrf(scaled, lower=1)
    if not failed and np.all(np.diag(root) ** 2 > _APART):  # no two are alike: several times as fast
        half = lapack.dpotri(root, lower=1)[0]  # zero above the diagonal
        half[np.diag_indices_from(half)] *= 0.5
        return np.asarray((half + half.T) / np.outer(scale, scale))
    values, vectors = np.linalg.eigh(scaled)
    kept = values > _ALIKE * values.max()
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(scale, scale))


def design(
    columns: Floats,
    target: Floats,
    block: Integers,
    precision: Floats | None = None,
    pull: Floats | None = None,
    wandering: Integers | None = None,
) -> Design:
    """Normal equations of whitened columns.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
    target : ndarray, shape (n,)
    block : ndarray of int64, shape (n,)
        Contiguous stretches numbered from zero.
    precision, pull : ndarray, shape (k,), optional
        Of the prior; by default there is none.
    wandering : ndarray of int64, shape (m,), optional
        Indices of columns that one block cannot predict for another.

    Returns
    -------
    Design
    """
    none = np.zeros(columns.shape[1])
    precision, pull = (none if one is None else one for one in (precision, pull))
    edges = np.flatnonzero(np.diff(block)) + 1
    parts = [(columns[first:last], target[first:last]) for first, last in pairwise([0, *edges, block.size])]
    gram, moment = np.stack([x.T @ x for x, _ in parts]), np.stack([x.T @ y for x, y in parts])
    square = np.array([float(y @ y) for _, y in parts])
    alone = np.empty(0, np.int64) if wandering is None else wandering
    return Design(gram, moment, square, precision, pull, alone)


def orthonormal(columns: Floats) -> Floats:
    """Orthonormal basis (n, m) of columns (n, k) of any scale; m < k if columns are alike or zero.

    The Gram matrix is ten times as fast as reflections. A second round removes its rounding.
    """
    for _ in range(2):
        norm = np.linalg.norm(columns, axis=0)
        columns = columns[:, norm > 0.0] / norm[norm > 0.0]
        values, vectors = np.linalg.eigh(columns.T @ columns)
        kept = values > _ALIKE * values.max(initial=0.0)
        columns = columns @ (vectors[:, kept] / np.sqrt(values[kept]))
    return columns


def projection(columns: Floats, target: Floats) -> Floats:
    """Projection of a target (n,), or of several (n, k), on columns of any scale; same shape."""
    return np.asarray(columns @ solve(columns.T @ columns, columns.T @ target))


def f_test(before: float, after: float, added: int, rows: int, fitted: int) -> float:
    """Probability of such a gain by noise alone.

    Parameters
    ----------
    before, after : float
        Residual sums of squares without and with the columns.
    added, fitted : int
        Number of columns added, and of all columns including these.
    rows : int

    Returns
    -------
    float
        p value of the F test.
    """
    freedom = max(rows - fitted, 1)
    ratio = max(before - after, 0.0) / added / max(after / freedom, 1e-300)
    return float(special.fdtrc(added, freedom, ratio))


def lower_bound(gains: Floats) -> float:
    """Lower 99 % confidence bound of a mean over blocks."""
    if gains.size < 2:
        return -np.inf
    spread = float(np.std(gains, ddof=1)) / np.sqrt(gains.size)
    return float(np.mean(gains) - special.stdtrit(gains.size - 1, 0.99) * spread)


def holds(gain: Floats, predicted: Floats, variance: Floats) -> bool:
    """Whether a gain in held-out blocks is beyond chance.

    Parameters
    ----------
    gain, predicted, variance : ndarray, shape (blocks,)
        See :meth:`Design.held_out_gain`.

    Returns
    -------
    bool
        True if the size in held-out blocks is certainly more than half the predicted size, where the gain is
        zero, and not certainly more than twice. The margin is that of noise if the blocks agree or scatter no
        more than noise. Next, the margin of their own scatter is tried: weighted by information, for the
        effective number of blocks (Kish, Survey Sampling, 1965, 8.2). The gains must have a positive sum.
    """
    told = predicted**2 / np.maximum(variance, 1e-300)
    whole, few = float(told.sum()), gain.size - 1
    if few < 1 or whole <= 0.0 or float(gain.sum()) <= 0.0:
        return False
    share = 0.5 * (1.0 + foretold(gain, predicted, variance) / whole)
    away = (0.5 * (gain + predicted) - share * predicted) / np.sqrt(np.maximum(variance, 1e-300))
    agreeing = float(told[gain < 0.0].sum()) <= DISAGREEING * whole
    as_noise = agreeing or float(away @ away) <= float(special.chdtri(few, 0.01))
    if as_noise and _is_between(share, CERTAIN_SIZE * whole**-0.5):
        return True
    freedom = whole**2 / float(told @ told) - 1.0
    scatter = max(float(told @ away**2) ** 0.5 / whole, whole**-0.5)
    return freedom >= 1.0 and _is_between(share, float(special.stdtrit(freedom, 0.99)) * scatter)


def foretold(gain: Floats, predicted: Floats, variance: Floats) -> float:
    """Sum of the gains in held-out blocks, each weighted by predicted gain over variance."""
    return float(np.sum(predicted * gain / np.maximum(variance, 1e-300)))


def _is_between(share: float, margin: float) -> bool:
    """Whether a share exceeds the lower end by more than a margin, and the upper end by less than it."""
    return FORETOLD[0] + margin < share < FORETOLD[1] + margin


def interval(gains: Floats, rng: np.random.Generator, over: Floats | None = None) -> tuple[float, float]:
    """95 % bootstrap interval of a mean over independent blocks, or of the ratio of two means."""
    over = np.ones(gains.size) if over is None else over
    draws = rng.integers(0, gains.size, (_DRAWS, gains.size))
    low, high = np.quantile(gains[draws].sum(axis=1) / over[draws].sum(axis=1), (0.025, 0.975))
    return float(low), float(high)
