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
from hd_diag.diagnosis.search.unmodelled_terms import Foil
from hd_diag.effects.effect import Effect

CLASS_DEVIANCE = 10.0
"""Causes whose exchange moves the held-out deviance by less cannot be told apart."""


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
    gain : float
    gain_low, gain_high : float
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
    """Result of a search: the bench at the final parameters, the causes, most explaining first, and foils."""

    bench: LinearisedFit
    causes: tuple[Cause, ...]
    foils: Chosen = ()

    @property
    def chosen(self) -> Chosen:
        """Effects and their nonlinear values, then the shapes that have no name."""
        named = tuple((cause.effect, cause.nonlinear) for cause in self.causes)
        return (*named, *self.foils)

    @property
    def torque_shift(self) -> float:
        """Real less reported torque by the causes [N m]."""
        return sum(cause.effect.torque_shift(cause.coefficients) for cause in self.causes)


def causes(
    bench: LinearisedFit, chosen: Chosen, p_values: dict[str, float], rivals: Collection[str]
) -> tuple[Cause, ...]:
    """The chosen effects with their numbers, most explaining first; shapes without a name left out.

    Parameters
    ----------
    bench : LinearisedFit
        Settled beside the chosen effects.
    chosen : sequence of (Effect, nonlinear values)
    p_values : dict
        By the effect's name, after correction for the family.
    rivals : collection of str
        Names of the effects that may be alike.

    Returns
    -------
    tuple of Cause
    """
    beta, _, _ = bench.fit(chosen)
    spread, places = covariance(bench, chosen)
    every = bench.places(chosen)
    rng = np.random.default_rng(0)
    found = []
    for index, (effect, nonlinear) in enumerate(chosen):
        if isinstance(effect, Foil):
            continue
        rows = places[index][: effect.size]
        share = _share(bench, chosen, index)
        low, high = interval(share, rng)
        found.append(
            Cause(
                effect,
                nonlinear,
                beta[rows],
                _part(spread, places[index]),
                bench.amplitude(effect, nonlinear, beta[every[index]]),
                p_values.get(effect.name, float("nan")),
                (effect.name, *_alike(bench, chosen, index, rivals)),
                float(np.mean(share)),
                low,
                min(high, 1.0),
            )
        )
    return tuple(sorted(found, key=lambda cause: -cause.gain))


def fitted(bench: LinearisedFit, found: Search) -> Search:
    """The same causes with numbers from another bench; names, classes and gains stay.

    Parameters
    ----------
    bench : LinearisedFit
        Settled beside the causes.
    found : Search

    Returns
    -------
    Search
    """
    beta, _, _ = bench.fit(found.chosen)
    spread, places = covariance(bench, found.chosen)
    again = []
    for cause, place, every in zip(found.causes, places, bench.places(found.chosen), strict=False):
        coefficients = beta[place[: cause.effect.size]]
        amplitude = bench.amplitude(cause.effect, cause.nonlinear, beta[every])
        again.append(
            replace(cause, coefficients=coefficients, covariance=_part(spread, place), amplitude=amplitude)
        )
    return replace(found, bench=bench, causes=tuple(again))


def parameters_of(found: Search) -> tuple[Floats, Floats]:
    """The model's parameters beside the causes, and their covariance, in units of `fit_parameters.SCALES`."""
    beta, _, _ = found.bench.fit(found.chosen)
    spread, _ = covariance(found.bench, found.chosen)
    return found.bench.parameters + beta[: fit_parameters.COUNT], spread[
        : fit_parameters.COUNT, : fit_parameters.COUNT
    ]


def _share(bench: LinearisedFit, chosen: Chosen, index: int) -> Floats:
    """What one effect brings in every block not fitted, over the mean of what all others leave there."""
    others = chosen[:index] + chosen[index + 1 :]
    gains, _ = held_out_gain(bench, chosen, index)
    return np.asarray(gains / max(float(np.mean(bench.design(others).held_out())), 1e-300))


def _part(spread: Floats, place: npt.NDArray[np.int64]) -> Floats:
    """Covariance of some values; zero for those that are not fitted."""
    part = spread[np.ix_(place, place)]
    fixed = place < 0
    part[fixed], part[:, fixed] = 0.0, 0.0
    return part


def _foretold(bench: LinearisedFit, chosen: Chosen) -> float:
    """Deviance of blocks that were not fitted."""
    return float(bench.design(chosen).held_out().sum())


def _fitted(bench: LinearisedFit, chosen: Chosen) -> float:
    """Deviance with Akaike's price of every column: what wanders foretells no block."""
    return float(bench.design(chosen).deviance() + 2.0 * bench.joined(chosen).shape[1])


def _alike(bench: LinearisedFit, chosen: Chosen, index: int, rivals: Collection[str]) -> list[str]:
    """Effects that would do as well in place of one; those that the motion cannot test among them."""
    effect, others = chosen[index][0], chosen[:index] + chosen[index + 1 :]
    named = {e.name for e, _ in chosen}
    judged = _fitted if wanders(bench, chosen) else _foretold
    here = judged(bench, chosen)
    found = [name for name in effect.always_confused if name not in named]
    untested = {
        other.name for other in by_name(bench, effect.confused_with) if not bench.data.testable(other)[0]
    }
    without = bench.corrected(others)
    for candidate in ranked(without, others, by_name(bench, {*rivals, *untested}), untested):
        if candidate.effect.name in named or candidate.effect.name in found:
            continue
        trial = (*others, (candidate.effect, candidate.nonlinear))
        if judged(without.corrected(trial), trial) - here < CLASS_DEVIANCE:
            found.append(candidate.effect.name)
    return found
