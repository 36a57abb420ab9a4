"""The causes found, with their numbers from a fit to all rows."""

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
from hd_diag.diagnosis.evidence.unmodelled_terms import UnmodelledLine, UnmodelledTerm
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import interval
from hd_diag.diagnosis.fit.joint_refinement import covariance
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.effects.effect import Effect
from hd_diag.effects.motor_current import MotorCurrent
from hd_diag.effects.remainders import EVEN, LOOP, ORDERS, Line, Remainder

_NEARLY_ALL = 0.99  # quantile of a function's size: few rows determine its extremes
_CHANCE_SHARE = 3.0  # deducted per column of a wandering effect; noise alone gives 1


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
        Of the coefficients, then the nonlinear values.
    amplitude : float
        Of its part in the error [rad rms].
    reach : float
        Half the peak-to-peak range of its part [rad].
    standing : Standing
        How certain it is, and which causes this record cannot distinguish from it.
    gain, gain_low, gain_high : float
        Share of the held-out deviance that it explains, with its 95 % interval.
    shared : ndarray, shape (k,)
        Change of its coefficients with slow remainders at their usual width and without unmodelled lines.
        Either may contain a part of the cause, or the cause a part of it. The covariance includes this
        change.
    others : tuple of (Effect, coefficients)
        Causes that this record cannot distinguish from it, at the sizes that reproduce its part.
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
        """Names of the causes in its class, usually its own among them; the most probable first."""
        return self.standing.alike


@dataclass(frozen=True)
class Function:
    """A fitted remainder.

    Attributes
    ----------
    effect : Remainder
    nonlinear : tuple of float
    coefficients : ndarray, shape (k,)
    rms, largest : float
        Rms of its part in the error, and the size that 1 % of the rows exceed [rad]. If it is larger than
        usual, only the part that all others leave counts: two may exceed the error and cancel each other.
    at : float
        Where that size occurs: torque [N m], input speed [rad/s], output angle [rad] or time [s].
    is_larger : bool
        Whether it is larger than usual. A loop must also exceed the usual lost motion.
    is_described : bool
        Whether a running model should hold it: it lasts, is large enough, and without it held-out blocks
        are predicted worse.
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
    """A fit with the causes found, and all other fitted effects.

    Attributes
    ----------
    fit : LinearisedFit
        At the final parameters.
    causes : tuple of Cause
        Largest gain first.
    given : tuple of (Effect, nonlinear values)
        Terms without a known cause, effects of the motor, and remainders.
    table : tuple of OrderRow
        Waves in the residual, largest first.
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
        """All effects fitted in addition to the model's parameters."""
        return (*((cause.effect, cause.nonlinear) for cause in self.causes), *self.given)

    @property
    def larger(self) -> frozenset[str]:
        """Names of the remainders that are larger than usual."""
        return frozenset(one.effect.name for one in self.functions if one.is_larger)

    @property
    def torque_shift(self) -> Floats:
        """Torques possible with the causes, less the record's torque, shape (n, k) [N m]."""
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
    """Solution of the best set. The generator draws the bootstrap intervals of the gains."""
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
    """Other named causes, with the coefficients that best reproduce the part of one fitted cause."""
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
    """Change of coefficients by cause with slow remainders at usual width, without unmodelled lines."""
    best = best if best.widths else best.valued()
    evidence = best.evidence()
    slow = {effect.name for effect, _ in best.remainders.items if effect not in ORDERS}
    lines = {effect.name for effect, _ in best.causes if isinstance(effect, UnmodelledLine)}
    usual = {name: 1.0 if name in slow else width for name, width in best.widths.items() if name not in lines}
    there, here = (evidence.coefficients(widths)[1] for widths in (usual, best.widths))
    return {
        effect.name: (there[effect.name] - here[effect.name])[: effect.size] * effect.usual
        for effect, _ in best.causes
        if effect.name not in lines
    }


def part_of(fit: LinearisedFit, chosen: Chosen, item: Item, is_larger: bool) -> Floats:
    """A remainder's part in the error at fitted rows, about its mean (n,) [rad]; see :class:`Function`."""
    if is_larger:
        own = _of_one_order(chosen, item)
        part = left_by(fit, chosen, tuple(one for one in chosen if one not in own), own)
    else:
        part = fit.columns(*item) @ fit.fit(chosen)[0][fit.places(chosen)[chosen.index(item)]]
    return np.asarray(part - part.mean())


def _of_one_order(chosen: Chosen, item: Item) -> Chosen:
    """All lines of the same order among the chosen effects; of what is no line, itself."""
    effect = item[0]
    if not isinstance(effect, Line):
        return (item,)
    return tuple(one for one in chosen if isinstance(one[0], Line) and one[0].order == effect.order)


def _told(fit: LinearisedFit, chosen: Chosen, larger: Collection[str]) -> set[str]:
    """Names of the remainders larger than usual; of lines of one order, which add up, only one.

    That is the line that changes with the torque if its change is large enough to be told, else the even one.
    """
    names = set(larger)
    for item in (one for one in chosen if one[0] is EVEN):
        line = _of_one_order(chosen, item)[-1]
        if line is item or names.isdisjoint((EVEN.name, line[0].name)):
            continue
        others = tuple(one for one in chosen if one != line)
        changes = line[0].name in larger and np.std(left_by(fit, chosen, others, (line,))) >= LEAST_SIZE
        names -= {EVEN.name, line[0].name}
        names.add(line[0].name if changes else EVEN.name)
    return names


def _functions(fit: LinearisedFit, chosen: Chosen, larger: Collection[str]) -> tuple[Function, ...]:
    """Numbers of the remainders among the chosen effects."""
    beta, built = fit.fit(chosen)[0], fit.design(chosen)
    places, told = dict(zip(chosen, fit.places(chosen), strict=True)), _told(fit, chosen, larger)
    found = []
    for item in chosen:
        effect, own = item[0], _of_one_order(chosen, item)
        if not isinstance(effect, Remainder):
            continue
        is_larger = effect.name in told
        # Together with a larger line of its order, and told of that.
        within = any(one.name in told for one, _ in own) and not is_larger
        part = np.zeros(fit.residual.size) if within else part_of(fit, chosen, item, is_larger)
        rms, most = float(np.std(part)), int(np.argsort(np.abs(part))[int(_NEARLY_ALL * (part.size - 1))])
        where = getattr(fit.signals, effect.follows)
        together = slice(places[own[0]].start, places[own[-1]].stop)
        # A model without it misses all of it, also what others imitate: they were fitted beside it.
        described = effect.lasting and float(np.std(fit.joined(own) @ beta[together])) >= LEAST_SIZE
        described = described and 0.5 * TEMPER * float(built.held_out_loss(together).sum()) > ODDS
        found.append(
            Function(
                effect,
                item[1],
                beta[places[item]],
                rms,
                float(abs(part[most])),
                float(where[most]),
                is_larger and (effect is not LOOP or 2.0 * abs(part[most]) > USUAL_LOOP),
                described,
            )
        )
    return tuple(found)


class _Numbers(NamedTuple):
    """Fitted numbers of a cause, see :class:`Cause`."""

    coefficients: Floats
    covariance: Floats
    amplitude: float
    reach: float

    def also(self, shared: Floats) -> _Numbers:
        """The numbers with the change of coefficients (k,) by remainders added to the covariance."""
        spread = self.covariance.copy()
        spread[: shared.size, : shared.size] += np.outer(shared, shared)
        return self._replace(covariance=spread)


def _numbers(fit: LinearisedFit, chosen: Chosen) -> list[_Numbers]:
    """Numbers of every chosen effect; amplitude and reach are zero for remainders."""
    beta, _, _ = fit.fit(chosen)
    spread, places = covariance(fit, chosen)
    found = []
    for (effect, nonlinear), place, every in zip(chosen, places, fit.places(chosen), strict=True):
        part = np.zeros(1) if effect.standard else fit.part(effect, nonlinear, beta[every])
        size = float(np.std(part)), 0.5 * float(np.ptp(part))
        found.append(_Numbers(beta[place[: effect.size]], _part(spread, place), *size))
    return found


def parameters_of(found: Solution) -> tuple[Floats, Floats]:
    """The model's parameters given the causes, and their covariance, in units of `fit_parameters.units`.

    The covariance treats held parameters as free, so holding them makes the others no more certain. Slopes
    are averaged over the range that the record leaves open. If the torque comes from motor current, all
    compliances may be off by one factor and the torque by its inverse, within the prior.
    """
    own, fit = slice(found.fit.parameters.size), found.fit
    beta, _, _ = fit.fit(found.chosen)
    wide = fit.widened(found.chosen)  # not over held parameters: they have bounds of their own
    spread = covariance(replace(wide, held=()), found.chosen)[0][own, own]
    parameters = fit_parameters.admissible(fit.parameters + beta[own], fit.data.configured)
    return parameters, spread + fit_parameters.scaling(parameters, fit.data.held, fit.data.configured)


def motor_deviations(found: Solution) -> dict[str, float]:
    """Standard deviations of the motor's quantities by name, including that of the common factor."""
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
    """Gain of one effect in every held-out block, relative to the mean held-out deviance without it.

    An effect that wanders cannot be predicted from block to block. Its gain is then that of the fit to all
    blocks, less three times the gain of as many columns by chance.
    """
    others, place = chosen[:index] + chosen[index + 1 :], fit.places(chosen)[index]
    if chosen[index][0].wanders(chosen[index][1]):
        without, beside = (_block_deviances(fit, some) for some in (others, chosen))
        gains = without - beside - _CHANCE_SHARE * (place.stop - place.start) / without.size
    else:
        gains = fit.design(chosen).held_out_gain(place)[0]
    return np.asarray(gains / max(float(np.mean(fit.design(others).held_out())), 1e-300))


def _block_deviances(fit: LinearisedFit, chosen: Chosen) -> Floats:
    """Residual sum of squares of a fit to all blocks, in every block, less the data's sum of squares."""
    beta, _, built = fit.fit(chosen)
    return np.asarray(np.einsum("k,bkl,l->b", beta, built.gram, beta) - 2.0 * built.moment @ beta)


def _part(spread: Floats, place: npt.NDArray[np.int64]) -> Floats:
    """Covariance of some values; zero for values that are not fitted."""
    part = spread[np.ix_(place, place)]
    fixed = place < 0
    part[fixed], part[:, fixed] = 0.0, 0.0
    return part
