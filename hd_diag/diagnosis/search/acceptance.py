"""What a candidate must pass: chance, practical size, proof on blocks not fitted or in lasting means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import f_test, holds, orthonormal
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.search.ranking import Candidate
from hd_diag.diagnosis.search.unmodelled_terms import Foil
from hd_diag.effects.effect import Effect
from hd_diag.model.torsion_map import ARCSEC

FAMILY_ERROR = 0.01
"""Chance of any false name by noise, over all candidates and grid points."""

LEAST_SIZE = 0.25 * ARCSEC
"""A cause smaller than this beside the refitted model is of no practical size [rad rms]."""

_CERTAIN_SIZE = 0.5 * ARCSEC  # of a shape that nothing held out can prove [rad rms]
_SECONDS = 2.5  # of a mean in which quick noise is gone
_CHANCE_SHARE = 3.0  # times what noise alone gives to so many columns
_LASTING_CHANCE = 1e-6


def passing(bench: LinearisedFit, chosen: Chosen, ranked: list[Candidate], family: int) -> Candidate | None:
    """The first candidate that passes every test, its p value that of the whole family.

    Parameters
    ----------
    bench : LinearisedFit
    chosen : sequence of (Effect, nonlinear values)
        What the candidates are to be added to.
    ranked : list of Candidate
        The best first.
    family : int
        Number of hypotheses.

    Returns
    -------
    Candidate or None
    """
    for candidate in ranked:
        p = min(1.0, candidate.p_value * family)
        if p > FAMILY_ERROR:
            return None
        effect, nonlinear = candidate.effect, candidate.nonlinear
        if size(bench, chosen, effect, nonlinear) > LEAST_SIZE and _proved(bench, chosen, effect, nonlinear):
            return replace(candidate, p_value=p)
    return None


def kept(bench: LinearisedFit, chosen: Chosen) -> Chosen:
    """Without the effects that are no longer needed beside the others."""
    for index, (effect, nonlinear) in enumerate(chosen):
        rest = chosen[:index] + chosen[index + 1 :]
        blind = isinstance(effect, Foil) and not effect.sees_ahead
        small = size(bench, rest, effect, nonlinear) < (_CERTAIN_SIZE if blind else LEAST_SIZE)
        if blind and not small:
            continue
        if small or not holds(*held_out_gain(bench, chosen, index)):
            return kept(bench, rest)
    return chosen


def held_out_gain(bench: LinearisedFit, chosen: Chosen, index: int) -> tuple[Floats, Floats]:
    """What one of the chosen effects brings in blocks not fitted; see :meth:`Design.held_out_gain`.

    Of one that wanders, no block tells what it does in the next: what it brings in each block beyond what as
    many columns bring by chance.
    """
    place = bench.places(chosen)[index]
    if wanders(bench, chosen[index : index + 1]):
        others = (*chosen[:index], *chosen[index + 1 :])
        left = [_block_deviances(bench, some) for some in (others, chosen)]
        by_chance = _CHANCE_SHARE * (place.stop - place.start) / left[0].size
        gain = left[0] - left[1] - by_chance
        return gain, np.maximum(gain, 0.0)
    return bench.design(chosen).held_out_gain(place)


def wanders(bench: LinearisedFit, chosen: Chosen) -> bool:
    """Whether one of some effects is let to wander over the record."""
    return any(
        bench.columns(effect, nonlinear).shape[1] > effect.size
        for effect, nonlinear in chosen
        if not isinstance(effect, Foil)
    )


def _block_deviances(bench: LinearisedFit, chosen: Chosen) -> Floats:
    """Sums of squares that a fit to all leaves in every block, less those of the data."""
    beta, _, built = bench.fit(chosen)
    return np.asarray(np.einsum("k,bkl,l->b", beta, built.gram, beta) - 2.0 * built.moment @ beta)


def size(bench: LinearisedFit, chosen: Chosen, effect: Effect, nonlinear: tuple[float, ...]) -> float:
    """Rms of an effect's part that neither the model nor the chosen effects could imitate [rad]."""
    columns = bench.columns(effect, nonlinear)
    beta, _, _ = bench.fit((*chosen, (effect, nonlinear)))
    part = columns @ beta[-columns.shape[1] :]
    fixed = np.concatenate((bench.always(), bench.joined(chosen)), axis=1)
    basis = orthonormal(fixed)
    own = part - basis @ (basis.T @ part)
    return float(np.sqrt(np.mean(own**2)))


def _proved(bench: LinearisedFit, chosen: Chosen, effect: Effect, nonlinear: tuple[float, ...]) -> bool:
    """Whether blocks that were not fitted bear it out; of what they cannot, a great gain is asked."""
    if isinstance(effect, Foil) and not effect.sees_ahead:
        return size(bench, chosen, effect, nonlinear) > _CERTAIN_SIZE and _lasting(bench, chosen, effect)
    return holds(*held_out_gain(bench, (*chosen, (effect, nonlinear)), len(chosen)))


def _lasting(bench: LinearisedFit, chosen: Chosen, foil: Foil) -> bool:
    """Whether means over seconds are explained far better than slow noise of their own scatter would be."""
    rest = bench.remainder(chosen)
    mean, columns = _means(bench, rest), _means(bench, bench.columns(foil, ()))
    columns = np.concatenate((columns, np.ones((mean.size, 1))), axis=1)
    left = mean - columns @ np.linalg.lstsq(columns, mean, rcond=None)[0]
    before, after = float(np.sum((mean - mean.mean()) ** 2)), float(left @ left)
    return f_test(before, after, columns.shape[1] - 1, mean.size, columns.shape[1]) < _LASTING_CHANCE


def _means(bench: LinearisedFit, columns: Floats) -> Floats:
    """Over stretches of `_SECONDS` within runs."""
    stretch = np.floor(bench.data.record.time / _SECONDS).astype(np.int64)
    change = np.concatenate(([0], (np.diff(stretch) != 0) | (np.diff(bench.data.run) != 0)))
    number = np.cumsum(change)
    count = np.bincount(number)
    wide = columns.reshape(columns.shape[0], -1)
    means = np.stack([np.bincount(number, c) / count for c in wide.T], axis=1)
    full = count > 0.5 * np.median(count)
    return means[full].reshape(-1, *columns.shape[1:])
