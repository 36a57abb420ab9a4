"""The causes that were found, with their numbers from a fit to all rows."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.calibration import LEAST_SIZE, ODDS, TEMPER, USUAL_LOOP
from hd_diag.diagnosis.evidence.naming import Standing, left_by
from hd_diag.diagnosis.evidence.order_table import OrderRow
from hd_diag.diagnosis.evidence.sets import Set
from hd_diag.diagnosis.evidence.unmodelled_terms import UnmodelledTerm
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import interval
from hd_diag.diagnosis.fit.joint_refinement import covariance
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.effects.effect import Effect
from hd_diag.effects.motor_current import MotorCurrent
from hd_diag.effects.remainders import LOOP, ORDERS, Remainder

_NEARLY_ALL = 0.99  # of the rows: at its very ends few rows tell of a function
_CHANCE_SHARE = 3.0  # times what noise alone gives to the columns of what wanders


@dataclass(frozen=True)
class Cause:
    """An effect of the best set with its fitted numbers.

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
    reach : float
        Half of what its part covers, peak to peak [rad].
    standing : Standing
        How sure it is, and which causes this record cannot tell from it.
    gain, gain_low, gain_high : float
        Share of the held-out deviance that it explains, with its interval.
    shared : ndarray, shape (k,)
        By how much its coefficients change where slow remainders are as usual: what these have grown for may
        be its own, or it theirs. It is part of the covariance.
    others : tuple of (Effect, coefficients)
        Which causes this record cannot tell from it, at the sizes at which they do what it does.
    """

    effect: Effect
    nonlinear: tuple[float, ...]
    coefficients: Floats
    covariance: Floats
    amplitude: float
    standing: Standing
    gain: float = 0.0
    gain_low: float = 0.0
    gain_high: float = 0.0
    reach: float = math.inf
    shared: Floats = field(default_factory=lambda: np.zeros(0))
    others: tuple[tuple[Effect, Floats], ...] = ()

    @property
    def alike(self) -> tuple[str, ...]:
        """Names that this record cannot tell from it, itself among them; the most probable first."""
        return self.standing.alike


@dataclass(frozen=True)
class Function:
    """A remainder as it was fitted.

    Attributes
    ----------
    effect : Remainder
    nonlinear : tuple of float
    coefficients : ndarray, shape (k,)
    rms, largest : float
        Of its part in the error, and what hardly any row exceeds [rad]. Of one larger than usual it is
        what all others leave: two may be larger than the error, and undo each other.
    at : float
        Where that is: torque [N m], speed of the input [rad/s], place of the output [rad] or time [s].
    is_larger : bool
        Whether it is larger than usual.
    is_described : bool
        Whether it is worth a term in a model that runs: it lasts, and foretells blocks that were held out.
    """

    effect: Remainder
    nonlinear: tuple[float, ...]
    coefficients: Floats
    rms: float
    largest: float
    at: float
    is_larger: bool
    is_described: bool


@dataclass(frozen=True)
class Solution:
    """A fit with the causes that were found, and all else that is fitted with them.

    Attributes
    ----------
    fit : LinearisedFit
        At the final parameters.
    causes : tuple of Cause
        Most explaining first.
    given : tuple of (Effect, nonlinear values)
        Remainders, shapes of no known cause, and what a motor takes of its current.
    table : tuple of OrderRow
        Waves in the rest, largest first.
    functions : tuple of Function
        The remainders with their numbers.
    """

    fit: LinearisedFit
    causes: tuple[Cause, ...] = ()
    given: Chosen = ()
    table: tuple[OrderRow, ...] = ()
    functions: tuple[Function, ...] = ()

    @property
    def chosen(self) -> Chosen:
        """All that is fitted beside the model's parameters."""
        return (*((cause.effect, cause.nonlinear) for cause in self.causes), *self.given)

    @property
    def larger(self) -> frozenset[str]:
        """Names of the remainders that are larger than usual."""
        return frozenset(one.effect.name for one in self.functions if one.is_larger)

    @property
    def torque_shift(self) -> Floats:
        """What the torque may be by the causes less that of the record that is fitted, (n, k) [N m]."""
        return self.fit.effects.possible_torques(self.fit.sized(self.chosen, self.fit.fit(self.chosen)[0]))

    def at(self, fit: LinearisedFit) -> Solution:
        """The same causes with numbers from another fit."""
        numbers = _numbers(fit, self.chosen)
        again = tuple(
            replace(cause, **one.also(cause.shared)._asdict())
            for cause, one in zip(self.causes, numbers, strict=False)
        )
        functions = tuple(
            replace(one, coefficients=own.coefficients, rms=own.rms, largest=own.largest, at=own.at)
            for one, own in zip(self.functions, _functions(fit, self.chosen, self.larger), strict=True)
        )
        return replace(self, fit=fit, causes=again, functions=functions)


def solution(best: Set, standings: dict[str, Standing], rng: np.random.Generator) -> Solution:
    """Of the best set; the generator is for the intervals of the gains."""
    fit = best.fit
    known = [one for one in best.causes if not isinstance(one[0], UnmodelledTerm)]
    terms = [one for one in best.causes if isinstance(one[0], UnmodelledTerm)]
    chosen = (*known, *terms, *best.given)
    found, shared = [], _shared(best)
    for index, ((effect, nonlinear), numbers) in enumerate(zip(chosen, _numbers(fit, chosen), strict=True)):
        if index < len(known):
            share = _share(fit, chosen, index)
            low, high = interval(share, rng)
            gains = float(np.mean(share)), low, min(high, 1.0)
            standing, own = standings[effect.name], shared[effect.name][: effect.size]
            found.append(
                Cause(
                    effect,
                    nonlinear,
                    **numbers.also(own)._asdict(),
                    standing=standing,
                    gain=gains[0],
                    gain_low=gains[1],
                    gain_high=gains[2],
                    shared=own,
                    others=_others(fit, (effect, nonlinear), numbers.coefficients, standing.alike),
                )
            )
    causes, given = tuple(sorted(found, key=lambda cause: -cause.gain)), (*terms, *best.given)
    larger = [effect.name for effect, _ in best.remainders.items if best.widths[effect.name] > 1.0]
    return Solution(fit, causes, given, functions=_functions(fit, chosen, larger))


def _others(
    fit: LinearisedFit, item: Item, coefficients: Floats, names: Collection[str]
) -> tuple[tuple[Effect, Floats], ...]:
    """Other causes by their names, with the coefficients at which they do most of what one of a fit does."""
    found = []
    part = fit.columns(*item)[:, : coefficients.size] @ coefficients
    for effect in (one for one in fit.data.searched if one.name in names and one.name != item[0].name):
        trials = []
        for nonlinear in effect.starts(fit.signals, part).points:
            columns = fit.columns(effect, nonlinear)[:, : effect.size]
            own, *_ = np.linalg.lstsq(columns - columns.mean(axis=0), part - part.mean(), rcond=None)
            trials.append((float(np.std(part - columns @ own)), own))
        found.append((effect, min(trials, key=lambda one: one[0])[1]))
    return tuple(found)


def _shared(best: Set) -> dict[str, Floats]:
    """By how much coefficients of causes change where slow remainders are as usual, by name."""
    best = best if best.widths else best.valued()
    evidence = best.evidence()
    slow = {effect.name for effect, _ in best.remainders.items if effect not in ORDERS}
    usual = {name: 1.0 if name in slow else width for name, width in best.widths.items()}
    there, here = (evidence.coefficients(widths)[1] for widths in (usual, best.widths))
    return {
        effect.name: (there[effect.name] - here[effect.name])[: effect.size] * effect.usual
        for effect, _ in best.causes
    }


def part_of(fit: LinearisedFit, chosen: Chosen, item: Item, is_larger: bool) -> Floats:
    """What a remainder adds along the rows of a fit, about its mean (n,) [rad]; see :class:`Function`."""
    if is_larger:
        part = left_by(fit, chosen, tuple(one for one in chosen if one != item), item)
    else:
        part = fit.columns(*item) @ fit.fit(chosen)[0][fit.places(chosen)[chosen.index(item)]]
    return np.asarray(part - part.mean())


def _functions(fit: LinearisedFit, chosen: Chosen, larger: Collection[str]) -> tuple[Function, ...]:
    """The remainders among the chosen effects."""
    beta, built = fit.fit(chosen)[0], fit.design(chosen)
    found = []
    for (effect, nonlinear), place in zip(chosen, fit.places(chosen), strict=True):
        if not isinstance(effect, Remainder):
            continue
        part = part_of(fit, chosen, (effect, nonlinear), effect.name in larger)
        rms, most = float(np.std(part)), int(np.argsort(np.abs(part))[int(_NEARLY_ALL * (part.size - 1))])
        where = getattr(fit.signals, effect.follows)
        foretold = 0.5 * TEMPER * float(built.held_out_gain(place)[0].sum())  # log odds
        described = effect.lasting and rms >= LEAST_SIZE and foretold > ODDS
        found.append(
            Function(
                effect,
                nonlinear,
                beta[place],
                rms,
                float(abs(part[most])),
                float(where[most]),
                effect.name in larger and (effect is not LOOP or 2.0 * abs(part[most]) > USUAL_LOOP),
                described,
            )
        )
    return tuple(found)


class _Numbers(NamedTuple):
    """Of a cause, see :class:`Cause`."""

    coefficients: Floats
    covariance: Floats
    amplitude: float
    reach: float

    def also(self, shared: Floats) -> _Numbers:
        """With what the coefficients (k,) share with remainders as part of the covariance."""
        spread = self.covariance.copy()
        spread[: shared.size, : shared.size] += np.outer(shared, shared)
        return self._replace(covariance=spread)


def _numbers(fit: LinearisedFit, chosen: Chosen) -> list[_Numbers]:
    """Of every chosen effect; remainders have no part of their own."""
    beta, _, _ = fit.fit(chosen)
    spread, places = covariance(fit, chosen)
    found = []
    for (effect, nonlinear), place, every in zip(chosen, places, fit.places(chosen), strict=True):
        part = np.zeros(1) if effect.standard else fit.part(effect, nonlinear, beta[every])
        size = float(np.std(part)), 0.5 * float(np.ptp(part))
        found.append(_Numbers(beta[place[: effect.size]], _part(spread, place), *size))
    return found


def parameters_of(found: Solution) -> tuple[Floats, Floats]:
    """The model's parameters beside the causes, and their covariance, in units of `fit_parameters.units`.

    What is held makes the others no more certain than they are beside it. The covariance is by slopes over
    what the record leaves open. By a motor's current all compliances may be off by one factor, and the
    torque by its inverse, as far as the prior lets them.
    """
    own, fit = slice(found.fit.parameters.size), found.fit
    beta, _, _ = fit.fit(found.chosen)
    wide = fit.widened(found.chosen)  # not over what is held: that has a bound of its own
    spread = covariance(replace(wide, held=()), found.chosen)[0][own, own]
    parameters = fit_parameters.admissible(fit.parameters + beta[own], fit.data.configured)
    return parameters, spread + fit_parameters.scaling(parameters, fit.data.held, fit.data.configured)


def motor_deviations(found: Solution) -> dict[str, float]:
    """Standard deviations of what a motor needs of its current, that of the common factor included."""
    fit = replace(found.fit, held=())
    for index, (effect, nonlinear) in enumerate(found.chosen):
        if not isinstance(effect, MotorCurrent):
            continue
        spread, places = covariance(fit, found.chosen)
        own = _part(spread, places[index])
        coefficients = found.fit.fit(found.chosen)[0][places[index][: effect.size]]
        configured = fit.data.configured
        along = effect.by_factor(coefficients) * fit_parameters.common_factor(configured)
        own[: effect.size, : effect.size] += np.outer(along, along)
        return effect.standard_deviations(coefficients, nonlinear, own)
    return {}


def _share(fit: LinearisedFit, chosen: Chosen, index: int) -> Floats:
    """Gain of one effect in every held-out block, over the mean residual deviance of all others.

    An effect that wanders cannot be predicted from block to block: its gain in each block beyond that of as
    many columns by chance.
    """
    others, place = chosen[:index] + chosen[index + 1 :], fit.places(chosen)[index]
    if chosen[index][0].wanders(chosen[index][1]):
        without, beside = (_block_deviances(fit, some) for some in (others, chosen))
        gains = without - beside - _CHANCE_SHARE * (place.stop - place.start) / without.size
    else:
        gains = fit.design(chosen).held_out_gain(place)[0]
    return np.asarray(gains / max(float(np.mean(fit.design(others).held_out())), 1e-300))


def _block_deviances(fit: LinearisedFit, chosen: Chosen) -> Floats:
    """Residual sum of squares of a fit to all blocks, in every block, less that of the data."""
    beta, _, built = fit.fit(chosen)
    return np.asarray(np.einsum("k,bkl,l->b", beta, built.gram, beta) - 2.0 * built.moment @ beta)


def _part(spread: Floats, place: npt.NDArray[np.int64]) -> Floats:
    """Covariance of some values; zero for those that are not fitted."""
    part = spread[np.ix_(place, place)]
    fixed = place < 0
    part[fixed], part[:, fixed] = 0.0, 0.0
    return part
