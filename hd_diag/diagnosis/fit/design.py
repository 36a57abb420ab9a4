"""Least squares on whitened columns, by blocks: any of them can be held out without another fit."""

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
_ALONE = 1e-10  # share of a column outside a block that is nothing but rounding
_ALIKE = 1e-10  # least eigenvalue of a Gram matrix over its greatest: columns that rounding makes differ
_APART = 1e-6  # share of a column that those before it leave, from which none of a matrix are alike
_TOLD_APART = 1e-6  # of the inverse times the matrix from one


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
        Of the prior of every coefficient, and where it is centred: what blocks cannot tell stays there.
    wandering : ndarray of int64, shape (m,)
        Columns of which other blocks say nothing: a block that is held out fits them anew.
    """

    gram: Floats
    moment: Floats
    square: Floats
    precision: Floats
    pull: Floats
    wandering: Integers

    def deviance(self) -> float:
        """Residual sum of squares of the fit to all blocks, with that of the prior."""
        return self.deviance_at(np.empty(0, np.int64), np.empty(0))

    def deviance_at(self, fixed: Integers, values: Floats) -> float:
        """The same with the coefficients of some indices fixed at values, (m,) each."""
        (gram, moment), free = self.whole, np.delete(np.arange(self.pull.size), fixed)
        rest = moment[free] - gram[np.ix_(free, fixed)] @ values
        own = values @ (gram[np.ix_(fixed, fixed)] @ values - 2.0 * moment[fixed])
        known = self.square.sum() + self.precision @ self.pull**2 + own
        return float(known - rest @ solve(gram[np.ix_(free, free)], rest))

    def holding(self, numbers: Integers, values: Floats) -> Design:
        """The same with some coefficients at values: their columns are taken off the target."""
        if not numbers.size:
            return self
        gram, moment = self.gram.copy(), self.moment - self.gram[:, :, numbers] @ values
        square = self.square - (self.moment + moment)[:, numbers] @ values
        gram[:, numbers], gram[:, :, numbers], moment[:, numbers] = 0.0, 0.0, 0.0
        precision = self.precision.copy()
        precision[numbers] = 0.0
        return replace(self, gram=gram, moment=moment, square=square, precision=precision)

    def without_wandering(self) -> Design:
        """The same with every block less what its own fit of the wandering columns explains."""
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
        """Sum of squares of each block, predicted by a fit to all others; shape (blocks,)."""
        result = self.without_wandering().square.copy()
        for block, (g, m, _, _, beta, _) in enumerate(self._by_others):
            result[block] += beta @ g @ beta - 2.0 * beta @ m
        return result

    @cached_property
    def _by_others(self) -> list[tuple[Floats, Floats, Floats, Floats, Floats, Floats]]:
        """As `blocks`, with the solution of all others (k,) and the inverse of their Gram matrix (k, k)."""
        found = []
        for own, own_moment, others, towards in self.without_wandering().blocks():
            spread = inverse(others)
            found.append((own, own_moment, others, towards, spread @ towards, spread))
        return found

    def held_out_gain(self, dropped: slice) -> tuple[Floats, Floats, Floats]:
        """What some columns bring in each block, by fits to all others.

        Parameters
        ----------
        dropped : slice
            The columns in question.

        Returns
        -------
        gain : ndarray, shape (blocks,)
            Fall of the block's sum of squares.
        predicted : ndarray, shape (blocks,)
            The fall if the prediction were right.
        variance : ndarray, shape (blocks,)
            Of half the gain about it: by noise as much as is predicted, and by what the others leave open of
            all coefficients. A block in whose state no other is says little.
        """
        count = self.moment.shape[1]
        rest = np.delete(np.arange(count), np.r_[dropped])
        gain, predicted, variance = np.empty((3, self.square.size))
        for block, (g, m, others, towards, beta, spread) in enumerate(self._by_others):
            fewer = np.zeros(count)
            told = np.einsum("ij,ji->i", spread[dropped], others[:, dropped])  # one where no other is alike
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

    def prior_gain(self, dropped: slice) -> tuple[float, float]:
        """What some columns bring by the prior of all others, beside what they bring in the blocks.

        Returns
        -------
        gain : float
            How much farther the others are from their prior without these columns, as a sum of squares.
        predicted : float
            The square of how far they move. In a fit to all blocks both sums, these included, are equal.
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

        A column that lives in the block alone leaves only rounding behind: it is set to zero.
        """
        gram, moment = self.whole
        for own, own_moment in zip(self.gram, self.moment, strict=True):
            others, towards = gram - own, moment - own_moment
            alone = np.diag(others) < _ALONE * np.diag(gram)
            others[alone], others[:, alone], towards[alone] = 0.0, 0.0, 0.0
            yield own, own_moment, others, towards


def solve(gram: Floats, moment: Floats) -> Floats:
    """Solution of normal equations whose columns may be of any scale, or alike; shape (k,)."""
    return np.asarray(inverse(gram) @ moment)


def inverse(gram: Floats) -> Floats:
    """Inverse of a Gram matrix whose columns may be of any scale, alike, or zero; shape (k, k)."""
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
        Of the prior; none without.
    wandering : ndarray of int64, shape (m,), optional
        Columns of which one block says nothing about another.

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
    """Basis of columns (n, k) of any scale, shape (n, m); those that are alike, or zero, have fewer.

    By their Gram matrix, ten times as fast as by reflections; a second round takes out what rounding leaves.
    """
    for _ in range(2):
        norm = np.linalg.norm(columns, axis=0)
        columns = columns[:, norm > 0.0] / norm[norm > 0.0]
        values, vectors = np.linalg.eigh(columns.T @ columns)
        kept = values > _ALIKE * values.max(initial=0.0)
        columns = columns @ (vectors[:, kept] / np.sqrt(values[kept]))
    return columns


def projection(columns: Floats, target: Floats) -> Floats:
    """Part of a target (n,), or of several (n, k), that columns of any scale explain; in its shape."""
    return np.asarray(columns @ solve(columns.T @ columns, columns.T @ target))


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
    return float(special.fdtrc(added, freedom, ratio))


def lower_bound(gains: Floats) -> float:
    """Lower 99 % confidence bound of a mean over blocks."""
    if gains.size < 2:
        return -np.inf
    spread = float(np.std(gains, ddof=1)) / np.sqrt(gains.size)
    return float(np.mean(gains) - special.stdtrit(gains.size - 1, 0.99) * spread)


def holds(gain: Floats, predicted: Floats, variance: Floats) -> bool:
    """Whether a gain in blocks that were not fitted is beyond chance.

    Parameters
    ----------
    gain, predicted, variance : ndarray, shape (blocks,)
        See :meth:`Design.held_out_gain`.

    Returns
    -------
    bool
        If more than half of what others foretell is there, and at most twice as much, for certain: by noise,
        where the blocks agree or scatter no more than it lets them; else by their scatter, each counting by
        what it tells, as many as they come to (Kish, Survey Sampling, 1965, 8.2). All blocks together must
        gain, also those of which the others leave much open.
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
    """Gain in all blocks that were not fitted, each counting by what it tells."""
    return float(np.sum(predicted * gain / np.maximum(variance, 1e-300)))


def _is_between(share: float, margin: float) -> bool:
    """Whether a share is beyond the lower end by a margin, and beyond the upper one by no more."""
    return FORETOLD[0] + margin < share < FORETOLD[1] + margin


def interval(gains: Floats, rng: np.random.Generator, over: Floats | None = None) -> tuple[float, float]:
    """95 % interval of a mean over blocks, or of the ratio of two, by bootstrap: they are independent."""
    over = np.ones(gains.size) if over is None else over
    draws = rng.integers(0, gains.size, (_DRAWS, gains.size))
    low, high = np.quantile(gains[draws].sum(axis=1) / over[draws].sum(axis=1), (0.025, 0.975))
    return float(low), float(high)
