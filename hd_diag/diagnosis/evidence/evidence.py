"""Evidence of sets of columns from one Gram matrix: sizes integrated out, prior widths by the evidence.

    log evidence(S) = -1/2 [ y'y - m' (G + 1/L)^-1 m + log det(1 + L G) ] + log prior(S)

for whitened columns with normal equations G, m and prior covariance L, the likelihood tempered (MacKay,
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

# Usual sizes of a group's columns (k,), widths that their prior may have, and what each larger one costs.
Prior = tuple[Floats, tuple[float, ...], float]

_WIDE = 1e-2  # prior deviation of the encoders' zeros [rad]: as good as free
_ROUNDS = 4  # of a search for the best widths
_BATCH = 64  # columns whose products are made at once
_ROUNDING = 1e-11  # of products of columns, relative; what is less of a column is rounding


@dataclass(frozen=True)
class Group:
    """Columns that belong together: their places, and how they are weighed.

    Attributes
    ----------
    places : ndarray of int64, shape (k,)
    widths : tuple of float
        That their prior may have, in units of the usual size.
    larger : float
        What each step beyond the usual width costs [log odds].
    """

    places: Integers
    widths: tuple[float, ...]
    larger: float = 0.0

    def cost(self, width: float) -> float:
        """Prior log odds of a width."""
        return self.larger * self.widths.index(width) if self.larger else 0.0


@dataclass(frozen=True)
class Evidence:
    """Normal equations of all columns, in groups that may or may not be in a set.

    Attributes
    ----------
    gram : ndarray, shape (k, k)
        Tempered, of columns in units of their usual size.
    moment : ndarray, shape (k,)
    square : float
    unit : ndarray, shape (k,)
        Those sizes.
    base : int
        Number of the first columns, which every set has; their units make the prior a standard normal one.
    pull : ndarray, shape (base,)
        Where that is centred.
    groups : dict
        The others, by any name.
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
        """From normal equations of whitened columns: the base, then group by group.

        Parameters
        ----------
        gram : ndarray, shape (k, k)
        moment : ndarray, shape (k,)
        square : float
        precision, pull : ndarray, shape (base,)
            Prior of what every set has.
        groups : iterable
            What may be in a set, by name.
        """
        own = np.where(precision > 0.0, np.maximum(precision, 1e-300) ** -0.5, _WIDE)
        sizes, places = _placed(groups, own.size)
        unit = np.concatenate((own, sizes))
        whole = TEMPER * unit[:, None] * gram * unit
        return Evidence(whole, TEMPER * unit * moment, TEMPER * square, unit, own.size, pull / own, places)

    def beside(self, columns: Floats, target: Floats, apart: Iterable[tuple[str, Floats, Prior]]) -> Evidence:
        """With groups of which no set has two: their products are not made.

        Parameters
        ----------
        columns : ndarray, shape (n, k)
            Whitened, of which the normal equations are.
        target : ndarray, shape (n,)
        apart : iterable
            Names, whitened columns and priors.
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
        """Log evidence of a set with these prior widths, but for a constant and the priors of presence."""
        _, _, _, solved, root = self._solved(widths)
        deviance = self.square + float(self.pull @ self.pull) - float(solved @ solved)
        larger = sum(self.groups[name].cost(width) for name, width in widths.items())
        return -0.5 * deviance - float(np.sum(np.log(np.diag(root)))) + larger

    def tuned(self, widths: Widths, names: Iterable[str] | None = None) -> tuple[float, dict[str, float]]:
        """The best widths near some, and their log evidence; only those of some groups, of all without."""
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
        """After steps of one width, as long as each makes it better."""
        choices = self.groups[name].widths
        for step in (1, -1):
            at, moved = choices.index(widths[name]), False
            while 0 <= at + step < len(choices):
                trial = {**widths, name: choices[at + step]}
                value = self.log(trial)
                # Far too small a width may need two steps to show.
                if value <= best:
                    break
                best, widths, at, moved = value, trial, at + step, True
            if moved:
                break
        return best, widths

    def gains(self, widths: Widths, names: Iterable[str]) -> dict[str, tuple[float, float]]:
        """What each of some groups would bring beside a set: log odds, and the best width for it."""
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
        """Most probable coefficients: of the base, in its units, and of each group, in usual sizes."""
        _, scale, _, solved, root = self._solved(widths)
        whole = scale * solve_triangular(root, solved, lower=True, trans=1)
        at, found = self.base, {}
        for name in widths:
            size = self.groups[name].places.size
            found[name] = whole[at : at + size]
            at += size
        return whole[: self.base], found

    def information(self, widths: Widths, name: str) -> tuple[Floats, Floats]:
        """Of a group in usual sizes, tempered, (k, k): what a set beside it cannot imitate, and all of it."""
        places, scale, _, _, root = self._solved(widths)
        own = self.groups[name].places
        across = solve_triangular(root, scale[:, None] * self.gram[np.ix_(places, own)], lower=True)
        whole = self.gram[np.ix_(own, own)]
        return whole - across.T @ across, whole

    def _solved(self, widths: Widths) -> tuple[Integers, Floats, Floats, Floats, Floats]:
        """Places, scales, right side, half-solved right side and Cholesky root of a set."""
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
    """Usual sizes of groups of columns one after the other (k,), and the groups by name, from a place on."""
    sizes, places = [np.empty(0)], dict[str, Group]()
    for name, (usual, widths, larger) in priors:
        sizes.append(usual)
        places[name] = Group(np.arange(at, at := at + usual.size), widths, larger)
    return np.concatenate(sizes), places


def _together(
    groups: Iterable[tuple[str, Floats, Prior]],
) -> Iterator[list[tuple[str, Floats, Prior]]]:
    """Some groups at a time."""
    some: list[tuple[str, Floats, Prior]] = []
    for group in groups:
        some.append(group)
        if sum(columns.shape[1] for _, columns, _ in some) >= _BATCH:
            yield some
            some = []
    if some:
        yield some


def _root(matrix: Floats) -> Floats:
    """Cholesky root; of columns that are alike but for rounding, that with a diagonal as much larger.

    Else the products' rounding, far larger than a prior beside little noise, makes a pivot what it likes, or
    negative (Higham, Accuracy and Stability of Numerical Algorithms, 2002, 10.3).
    """
    diagonal = np.diag(matrix)
    with suppress(LinAlgError):
        root: Floats = cholesky(matrix, lower=True, check_finite=False)
        if np.all(np.diag(root) ** 2 > _ROUNDING * diagonal):
            return root
    larger: Floats = cholesky(matrix + np.diag(_ROUNDING * diagonal), lower=True, check_finite=False)
    return larger
