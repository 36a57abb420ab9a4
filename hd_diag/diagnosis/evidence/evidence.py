"""Evidence of sets of columns from one Gram matrix: sizes are integrated out, prior widths maximised.

    log evidence(S) = -1/2 [ y'y - m' (G + 1/L)^-1 m + log det(1 + L G) ] + log prior(S)

for whitened columns with normal equations G, m and prior covariance L. The likelihood is tempered (MacKay,
Neural Computation 4, 1992; Miller and Dunson, J. Am. Stat. Assoc. 114, 2019).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, block_diag, cholesky, solve_triangular

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.calibration import TEMPER

Widths = Mapping[str, float]

# Usual sizes of a group's columns (k,), the prior widths to choose from, and log odds for each larger one.
Prior = tuple[Floats, tuple[float, ...], float]

_WIDE = 1e-2  # prior deviation of the encoders' zeros [rad]: practically free
_ROUNDS = 4  # sweeps of the search for the best widths
_BATCH = 64  # columns whose products are computed together
_ROUNDING = 1e-11  # relative rounding of products of columns: smaller pivots are only rounding


@dataclass(frozen=True)
class Group:
    """Columns that enter a set together.

    Attributes
    ----------
    places : ndarray of int64, shape (k,)
        Indices of the columns.
    widths : tuple of float
        Prior widths to choose from, in units of the usual size.
    larger : float
        Prior log odds of each step beyond the usual width.
    """

    places: Integers
    widths: tuple[float, ...]
    larger: float = 0.0

    def cost(self, width: float) -> float:
        """Prior log odds of a width."""
        steps = self.widths.index(width) - self.widths.index(1.0)
        return self.larger * max(steps, 0)


@dataclass(frozen=True)
class Evidence:
    """Tempered normal equations of all columns. A set holds the base and some of the groups.

    Attributes
    ----------
    gram : ndarray, shape (k, k)
        Of columns in units of their usual size.
    moment : ndarray, shape (k,)
    square : float
    unit : ndarray, shape (k,)
        Usual size of every column.
    base : int
        Number of leading columns that every set has. Their units make the prior standard normal.
    pull : ndarray, shape (base,)
        Centre of this prior, in these units.
    groups : dict
        Groups of the other columns, by name.
    """

    gram: Floats
    moment: Floats
    square: float
    unit: Floats
    base: int
    pull: Floats
    groups: dict[str, Group]

    @staticmethod
    def of(
        gram: Floats,
        moment: Floats,
        square: float,
        precision: Floats,
        pull: Floats,
        groups: Iterable[tuple[str, Prior]],
    ) -> Evidence:
        """Evidence from normal equations of whitened columns: the base, then group by group.

        Parameters
        ----------
        gram : ndarray, shape (k, k)
        moment : ndarray, shape (k,)
        square : float
        precision, pull : ndarray, shape (base,)
            Precision and centre of the base's prior.
        groups : iterable
            Name and prior of each group.
        """
        own = np.where(precision > 0.0, np.maximum(precision, 1e-300) ** -0.5, _WIDE)
        sizes, places = _placed(groups, own.size)
        unit = np.concatenate((own, sizes))
        whole = TEMPER * unit[:, None] * gram * unit
        return Evidence(whole, TEMPER * unit * moment, TEMPER * square, unit, own.size, pull / own, places)

    def beside(self, columns: Floats, target: Floats, apart: Iterable[tuple[str, Floats, Prior]]) -> Evidence:
        """The evidence with more groups. A set holds one of them at most, so their products are not needed.

        Parameters
        ----------
        columns : ndarray, shape (n, k)
            Whitened columns of the known normal equations.
        target : ndarray, shape (n,)
        apart : iterable
            Name, whitened columns and prior of each new group.
        """
        priors, moments = list[tuple[str, Prior]](), [self.moment]
        inner, across = list[Floats](), list[Floats]()
        for some in _together(apart):
            priors += [(name, prior) for name, _, prior in some]
            more = np.concatenate([part * usual for _, part, (usual, *_) in some], axis=1)
            inner.append(TEMPER * (more.T @ more))
            across.append(TEMPER * self.unit[:, None] * (columns.T @ more))
            moments.append(TEMPER * (more.T @ target))
        gram, moment, size = block_diag(self.gram, *inner), np.concatenate(moments), self.moment.size
        gram[:size, size:] = np.concatenate([np.empty((size, 0)), *across], axis=1)
        gram[size:, :size] = gram[:size, size:].T
        sizes, places = _placed(priors, size)
        unit = np.concatenate((self.unit, sizes))
        return replace(self, gram=gram, moment=moment, unit=unit, groups=self.groups | places)

    def log(self, widths: Widths) -> float:
        """Log evidence of a set with these prior widths, without a constant and the odds of presence."""
        _, _, _, solved, root = self._solved(widths)
        deviance = self.square + float(self.pull @ self.pull) - float(solved @ solved)
        larger = sum(self.groups[name].cost(width) for name, width in widths.items())
        return -0.5 * deviance - float(np.sum(np.log(np.diag(root)))) + larger

    def tuned(self, widths: Widths, names: Iterable[str] | None = None) -> tuple[float, dict[str, float]]:
        """Highest log evidence near some widths, and its widths; only groups in `names` change if given."""
        found, best = dict(widths), self.log(widths)
        free = [name for name in (found if names is None else names) if len(self.groups[name].widths) > 1]
        for _ in range(_ROUNDS):
            before = best
            for name in free:
                best, found = self._one_tuned(found, best, name)
            if best <= before:
                break
        return best, found

    def _one_tuned(self, widths: dict[str, float], best: float, name: str) -> tuple[float, dict[str, float]]:
        """Log evidence and widths after steps of one group's width, as long as each step raises it."""
        choices = self.groups[name].widths
        for step in (1, -1):
            at, moved = choices.index(widths[name]), False
            while 0 <= at + step < len(choices):
                trial = {**widths, name: choices[at + step]}
                value = self.log(trial)
                # A far too small width may need two steps to gain; the search stops at one.
                if value <= best:
                    break
                best, widths, at, moved = value, trial, at + step, True
            if moved:
                break
        return best, widths

    def gains(self, widths: Widths, names: Iterable[str]) -> dict[str, tuple[float, float]]:
        """Gain of each named group if added to a set: log odds, and the prior width that gives them."""
        places, scale, _, solved, root = self._solved(widths)
        found = {}
        whole = solve_triangular(root, scale[:, None] * self.gram[places], lower=True, check_finite=False)
        left = self.moment - whole.T @ solved
        for name in names:
            group = self.groups[name]
            own = group.places
            across, rest = whole[:, own], left[own]
            inner = self.gram[np.ix_(own, own)] - across.T @ across
            best = (-np.inf, group.widths[0])
            values, vectors = np.linalg.eigh(inner)
            along = vectors.T @ rest
            values = np.maximum(values, 0.0)
            for width in group.widths:
                wide = 1.0 + width**2 * values
                gain = 0.5 * float(np.sum(width**2 * along**2 / wide - np.log(wide)))
                best = max(best, (gain + group.cost(width), width))
            found[name] = best
        return found

    def coefficients(self, widths: Widths) -> tuple[Floats, dict[str, Floats]]:
        """Most probable coefficients of the base, in its units, and of each group, in usual sizes."""
        _, scale, _, solved, root = self._solved(widths)
        whole = scale * solve_triangular(root, solved, lower=True, trans=1)
        at, found = self.base, {}
        for name in widths:
            size = self.groups[name].places.size
            found[name] = whole[at : at + size]
            at += size
        return whole[: self.base], found

    def information(self, widths: Widths, name: str) -> tuple[Floats, Floats]:
        """Tempered information on a group in usual sizes, (k, k): given the set's columns, and alone."""
        places, scale, _, _, root = self._solved(widths)
        own = self.groups[name].places
        across = solve_triangular(root, scale[:, None] * self.gram[np.ix_(places, own)], lower=True)
        whole = self.gram[np.ix_(own, own)]
        return whole - across.T @ across, whole

    def _solved(self, widths: Widths) -> tuple[Integers, Floats, Floats, Floats, Floats]:
        """Column indices, scales, right side, half-solved right side and Cholesky root of a set."""
        places = [np.arange(self.base), *(self.groups[name].places for name in widths)]
        wide = [np.ones(self.base), *(np.full(self.groups[n].places.size, w) for n, w in widths.items())]
        at, scale = np.concatenate(places), np.concatenate(wide)
        matrix = scale[:, None] * self.gram[np.ix_(at, at)] * scale
        matrix[np.diag_indices_from(matrix)] += 1.0
        right = scale * self.moment[at]
        right[: self.base] += self.pull
        root = _root(matrix)
        solved = solve_triangular(root, right, lower=True, check_finite=False)
        return at, scale, right, solved, root


def _placed(priors: Iterable[tuple[str, Prior]], at: int) -> tuple[Floats, dict[str, Group]]:
    """Usual sizes of consecutive groups of columns (k,), and the groups by name; indices start at `at`."""
    sizes, places = [np.empty(0)], dict[str, Group]()
    for name, (usual, widths, larger) in priors:
        sizes.append(usual)
        places[name] = Group(np.arange(at, at := at + usual.size), widths, larger)
    return np.concatenate(sizes), places


def _together(
    groups: Iterable[tuple[str, Floats, Prior]],
) -> Iterator[list[tuple[str, Floats, Prior]]]:
    """Groups in batches of about `_BATCH` columns."""
    some: list[tuple[str, Floats, Prior]] = []
    for group in groups:
        some.append(group)
        if sum(columns.shape[1] for _, columns, _ in some) >= _BATCH:
            yield some
            some = []
    if some:
        yield some


def _root(matrix: Floats) -> Floats:
    """Cholesky root. If columns differ by rounding only, the diagonal is first raised by this rounding.

    With little noise the rounding of products exceeds the prior's share. Pivots are then arbitrary or
    negative (Higham, Accuracy and Stability of Numerical Algorithms, 2002, 10.3).
    """
    diagonal = np.diag(matrix)
    with suppress(LinAlgError):
        root: Floats = cholesky(matrix, lower=True, check_finite=False)
        if np.all(np.diag(root) ** 2 > _ROUNDING * diagonal):
            return root
    larger: Floats = cholesky(matrix + np.diag(_ROUNDING * diagonal), lower=True, check_finite=False)
    return larger
