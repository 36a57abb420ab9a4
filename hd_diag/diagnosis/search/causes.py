"""Causes found, with their numbers: coefficients, covariance, held-out share, the class of each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import interval
from hd_diag.diagnosis.fit.joint_refinement import covariance
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.search.acceptance import held_out_gain, wanders
from hd_diag.diagnosis.search.ranking import by_name, ranked
from hd_diag.diagnosis.search.unmodelled_terms import UnmodelledTerm
from hd_diag.effects.effect import Effect

CLASS_DEVIANCE = 10.0
"""Causes whose exchange changes the held-out deviance by less cannot be told apart."""


@dataclass(frozen=True)
class Cause:
    """A named effect with its fitted numbers.

    Attributes
    ----------
    effect : Effect
    nonlinear : tuple of float
        Values of its nonlinear quantities.
    coefficients : ndarray, shape (k,)
    covariance : ndarray, shape (k + m, k + m)
        Of the coefficients and the nonlinear values.
    amplitude : float
        Of its part in the error [rad rms].
    p_value : float
        After correction for the whole family of candidates.
    alike : tuple of str
        Names that this record cannot tell from it, itself first.
    gain, gain_low, gain_high : float
        Share of the held-out deviance that it explains, with its interval.
    """

    effect: Effect
    nonlinear: tuple[float, ...]
    coefficients: Floats
    covariance: Floats
    amplitude: float
    p_value: float
    alike: tuple[str, ...]
    gain: float = 0.0
    gain_low: float = 0.0
    gain_high: float = 0.0


@dataclass(frozen=True)
class Search:
    """Result of a search: the fit at the final parameters, causes, most explaining first, and other terms."""

    fit: LinearisedFit
    causes: tuple[Cause, ...]
    unmodelled: Chosen = ()

    @property
    def chosen(self) -> Chosen:
        """Effects and their nonlinear values, then the unmodelled terms."""
        named = tuple((cause.effect, cause.nonlinear) for cause in self.causes)
        return (*named, *self.unmodelled)

    @property
    def torque_shift(self) -> float:
        """Real less reported torque by the causes [N m]."""
        return sum(cause.effect.torque_shift(cause.coefficients) for cause in self.causes)


def causes(
    fit: LinearisedFit,
    chosen: Chosen,
    p_values: dict[str, float],
    rivals: Collection[str],
    rng: np.random.Generator,
) -> tuple[Cause, ...]:
    """The chosen effects with their numbers, most explaining first, without unmodelled terms.

    Parameters
    ----------
    fit : LinearisedFit
        Settled beside the chosen effects.
    chosen : sequence of (Effect, nonlinear values)
    p_values : dict
        By the effect's name, after correction for the family.
    rivals : collection of str
        Names of the effects that may be alike.
    rng : numpy.random.Generator
        For the intervals of the gains.
    """
    found = []
    for index, ((effect, nonlinear), numbers) in enumerate(zip(chosen, _numbers(fit, chosen), strict=True)):
        if isinstance(effect, UnmodelledTerm):
            continue
        share = _share(fit, chosen, index)
        low, high = interval(share, rng)
        alike = (effect.name, *_alike(fit, chosen, index, rivals))
        p_value = p_values.get(effect.name, float("nan"))
        gains = float(np.mean(share)), low, min(high, 1.0)
        found.append(Cause(effect, nonlinear, *numbers, p_value, alike, *gains))
    return tuple(sorted(found, key=lambda cause: -cause.gain))


def refitted(fit: LinearisedFit, found: Search) -> Search:
    """The same causes with numbers from a fit to other rows; names, classes and gains stay."""
    again = tuple(
        replace(cause, coefficients=coefficients, covariance=spread, amplitude=amplitude)
        for cause, (coefficients, spread, amplitude) in zip(
            found.causes, _numbers(fit, found.chosen), strict=False
        )
    )
    return replace(found, fit=fit, causes=again)


def _numbers(fit: LinearisedFit, chosen: Chosen) -> list[tuple[Floats, Floats, float]]:
    """Coefficients, covariance and amplitude of every chosen effect."""
    beta, _, _ = fit.fit(chosen)
    spread, places = covariance(fit, chosen)
    return [
        (beta[place[: effect.size]], _part(spread, place), fit.amplitude(effect, nonlinear, beta[every]))
        for (effect, nonlinear), place, every in zip(chosen, places, fit.places(chosen), strict=True)
    ]


def parameters_of(found: Search) -> tuple[Floats, Floats]:
    """The model's parameters beside the causes, and their covariance, in units of `fit_parameters.SCALES`."""
    own = slice(fit_parameters.COUNT)
    beta, _, _ = found.fit.fit(found.chosen)
    spread, _ = covariance(found.fit, found.chosen)
    return found.fit.parameters + beta[own], spread[own, own]


def _share(fit: LinearisedFit, chosen: Chosen, index: int) -> Floats:
    """Gain of one effect in every held-out block, over the mean residual deviance of all others."""
    others = chosen[:index] + chosen[index + 1 :]
    gains, _ = held_out_gain(fit, chosen, index)
    return np.asarray(gains / max(float(np.mean(fit.design(others).held_out())), 1e-300))


def _part(spread: Floats, place: npt.NDArray[np.int64]) -> Floats:
    """Covariance of some values; zero for those that are not fitted."""
    part = spread[np.ix_(place, place)]
    fixed = place < 0
    part[fixed], part[:, fixed] = 0.0, 0.0
    return part


def _held_out_deviance(fit: LinearisedFit, chosen: Chosen) -> float:
    return float(fit.design(chosen).held_out().sum())


def _akaike(fit: LinearisedFit, chosen: Chosen) -> float:
    """Deviance with Akaike's price of every column: what wanders predicts no block."""
    return float(fit.design(chosen).deviance() + 2.0 * fit.joined(chosen).shape[1])


def _alike(fit: LinearisedFit, chosen: Chosen, index: int, rivals: Collection[str]) -> list[str]:
    """Effects that would do as well in place of one; those that the motion cannot test among them."""
    effect, others = chosen[index][0], chosen[:index] + chosen[index + 1 :]
    named = {e.name for e, _ in chosen}
    criterion = _akaike if wanders(fit, chosen) else _held_out_deviance
    here = criterion(fit, chosen)
    found = [name for name in effect.always_confused if name not in named]
    confused = by_name(fit, effect.confused_with)
    untested = {other.name for other in confused if not fit.data.testable(other)[0]}
    without = fit.corrected(others)
    for candidate in ranked(without, others, by_name(fit, {*rivals, *untested}), untested):
        if candidate.effect.name in named or candidate.effect.name in found:
            continue
        trial = (*others, (candidate.effect, candidate.nonlinear))
        if criterion(without.corrected(trial), trial) - here < CLASS_DEVIANCE:
            found.append(candidate.effect.name)
    return found
