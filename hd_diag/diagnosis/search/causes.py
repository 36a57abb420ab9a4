"""Causes found, with their numbers: coefficients, covariance, held-out share, the class of each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import interval, lower_bound
from hd_diag.diagnosis.fit.joint_refinement import covariance, free, polished, settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.search.acceptance import (
    block_deviances,
    chance,
    held_out_gain,
    lasting,
    only_corrects_shape,
    passing,
    size,
    smooth,
    wanders,
)
from hd_diag.diagnosis.search.order_table import OrderRow, refitted_rows
from hd_diag.diagnosis.search.ranking import Candidate, by_name, family_size, ranked, same_columns
from hd_diag.diagnosis.search.remainder import Remainder
from hd_diag.diagnosis.search.unmodelled_terms import UNMODELLED_TERMS, UnmodelledTerm
from hd_diag.effects.effect import Effect, Stage
from hd_diag.effects.motor_current import MotorCurrent
from hd_diag.formatting import words

CLASS_DEVIANCE = 10.0
"""Causes whose exchange changes the held-out deviance by less cannot be told apart."""

_DISAGREEING = 0.2  # of what one cause gains on another, in blocks where it loses
_FAR = 0.1  # of a cause's gain, up to which another is distinguished from it without a fit of its own
_NEARLY_AS_MUCH = 0.5  # of a gain, that a torque which the motion cannot prove may lack, or a rival keep
_TO_ITS_SIZE = 8  # rounds in which it is brought there
_NEARLY = 3  # rounds in which one that does nearly as well is brought to its best
_PLAINLY = 0.1  # of a cause's gain, by which an unmodelled term beats it
_CERTAIN = 100.0  # gain of such a cause
_CLASSED, _DOUBTED = 0.63, 0.9  # of the time that a diagnosis may take, by which classes and doubts are known


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
        Chance that noise makes any of the candidates gain as much beside the others.
    alike : tuple of str
        Names that this record cannot tell from it, itself first.
    gain, gain_low, gain_high : float
        Share of the held-out deviance that it explains, with its interval.
    own : float
        Rms of its part that nothing else explains [rad].
    doubtful : bool
        Whether it may only mend the shape of something else, or a shape of no known cause explains plainly
        more in its place.
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
    own: float = 0.0
    doubtful: bool = False


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes
    ----------
    fit : LinearisedFit
        At the final parameters.
    causes : tuple of Cause
        Most explaining first.
    unmodelled : tuple of (UnmodelledTerm, nonlinear values)
    table : tuple of OrderRow
        Waves in the rest, largest first.
    rivals : frozenset of str
        Names of what was tried in place of others.
    family : int
        Number of hypotheses.
    """

    fit: LinearisedFit
    causes: tuple[Cause, ...]
    unmodelled: Chosen = ()
    table: tuple[OrderRow, ...] = ()
    rivals: frozenset[str] = frozenset()
    family: int = 1

    @property
    def chosen(self) -> Chosen:
        """Effects and their nonlinear values, then the unmodelled terms."""
        named = tuple((cause.effect, cause.nonlinear) for cause in self.causes)
        return (*named, *self.unmodelled)

    @property
    def torque_shift(self) -> Floats:
        """What the torque may be by the causes less that of the record that is fitted, (n, k) [N m]."""
        return self.fit.effects.possible_torques(self.fit.sized(self.chosen, self.fit.fit(self.chosen)[0]))

    def without(self, number: int) -> Search:
        """The same without one of the chosen, settled anew; what is said of the others stays."""
        rest = self.chosen[:number] + self.chosen[number + 1 :]
        fit = settle(self.fit.corrected(rest), rest, _TO_ITS_SIZE, learn=False)
        named = self.causes[:number] + self.causes[number + 1 :]
        return replace(self, fit=fit, causes=named, unmodelled=rest[len(named) :])


def causes(
    fit: LinearisedFit,
    chosen: Chosen,
    rivals: Collection[str],
    rng: np.random.Generator,
) -> tuple[Cause, ...]:
    """The chosen effects with their numbers, most explaining first, without unmodelled terms.

    Parameters
    ----------
    fit : LinearisedFit
        Settled beside the chosen effects.
    chosen : sequence of (Effect, nonlinear values)
    rivals : collection of str
        Names of the effects that may be alike.
    rng : numpy.random.Generator
        For the intervals of the gains.
    """
    found = []
    for index, ((effect, nonlinear), numbers) in enumerate(zip(chosen, _numbers(fit, chosen), strict=True)):
        if effect.given or isinstance(effect, UnmodelledTerm):
            continue
        share = _share(fit, chosen, index)
        low, high = interval(share, rng)
        alike = (effect.name, *effect.always_confused)
        with fit.work.until(_CLASSED, f"testing what would explain {words(effect.name)} as well"):
            alike = (effect.name, *_alike(fit, chosen, index, rivals))
        gains = float(np.mean(share)), low, min(high, 1.0)
        found.append(Cause(effect, nonlinear, *numbers, chance(fit, chosen, index), alike, *gains))
    return tuple(sorted(found, key=lambda cause: -cause.gain))


def doubted(found: Search) -> Search:
    """The same, with own sizes; doubtful is what only mends a shape, a term beats, or slow noise may be.

    So is what is needed only beside a doubtful one: two large effects that undo each other.
    """
    fit, chosen, judged = found.fit, found.chosen, []
    for index, cause in enumerate(found.causes):
        others = chosen[:index] + chosen[index + 1 :]
        own, doubtful = size(fit, others, *chosen[index]), only_corrects_shape(fit, chosen, index)
        doubtful = doubtful or (smooth(cause.effect) and _beaten(fit, chosen, index))
        if "temperature" in cause.effect.needs:  # slow noise follows it as well
            doubtful = doubtful or not lasting(fit, others, cause.effect, cause.nonlinear)
        judged.append(replace(cause, own=own, doubtful=doubtful))
    doubts = {cause.effect.name for cause in judged if cause.doubtful}
    certain = tuple(item for item in chosen if item[0].name not in doubts)
    with fit.work.until(_DOUBTED, "testing whether causes hold without hints"):
        if doubts:
            judged = [
                replace(one, doubtful=one.doubtful or _undone(fit, certain, one.effect)) for one in judged
            ]
    return replace(found, causes=tuple(judged))


def _undone(fit: LinearisedFit, certain: Chosen, effect: Effect) -> bool:
    """Whether one of the certain effects passes no test beside the others of them, once these are settled."""
    others = tuple(item for item in certain if item[0] is not effect)
    there = settle(replace(fit, held=()).corrected(others), others, _TO_ITS_SIZE)
    return passing(there, others, ranked(there, others, [effect]), family_size(fit)) is None


def _beaten(fit: LinearisedFit, chosen: Chosen, index: int) -> bool:
    """Whether an unmodelled term explains plainly more in place of one of the chosen effects."""
    without, itself, others = left_out(fit, chosen, index)
    terms = ranked(without, others, [term for term in UNMODELLED_TERMS if term.predictive])
    if not terms:
        return False
    trial, now = (*others, (terms[0].effect, terms[0].nonlinear)), itself.deviance((*others, chosen[index]))
    return without.corrected(trial).deviance(trial) < now - plain_gain(without.deviance(others) - now)


def plain_gain(gain: float) -> float:
    """By how much an unmodelled term must beat a cause of some gain to take its place."""
    return max(2.0 * CLASS_DEVIANCE, _PLAINLY * gain)


def left_out(fit: LinearisedFit, chosen: Chosen, index: int) -> tuple[LinearisedFit, LinearisedFit, Chosen]:
    """The fit without one of the chosen effects, from there beside it again, at the end, and the others.

    Whatever is tried in its place starts there, as it does itself: what settling everything beside it brought
    is no merit of its own. Where others grow so much there that it does not lead back, all start beside the
    others at their size. Where it does not from there either, as a torque that puts teeth on the other flank,
    it stays as it was: only what is settled in its place can be compared with it.
    """
    others = chosen[:index] + chosen[index + 1 :]
    again, without = (*others, chosen[index]), fit.corrected(others)
    itself = without.corrected(again)
    if itself.deviance(again) > fit.deviance(chosen) + CLASS_DEVIANCE:
        sized = fit.sized(chosen, fit.fit(chosen)[0])
        without = fit.beside(sized[:index] + sized[index + 1 :])
        itself = without.corrected(again)
        itself = fit if itself.deviance(again) > fit.deviance(chosen) + CLASS_DEVIANCE else itself
    return without, itself, others


def refitted(fit: LinearisedFit, found: Search) -> Search:
    """The same causes with numbers from a fit to other rows; names, classes and gains stay."""
    again = tuple(
        replace(cause, coefficients=numbers[0], covariance=numbers[1], amplitude=numbers[2])
        for cause, numbers in zip(found.causes, _numbers(fit, found.chosen), strict=False)
    )
    whole = replace(found, fit=fit, causes=again)
    rest = Remainder.of(fit, whole.chosen)
    return replace(whole, table=refitted_rows(rest, found.table, fit.signals.rated_torque))


def _numbers(fit: LinearisedFit, chosen: Chosen) -> list[tuple[Floats, Floats, float]]:
    """Coefficients, covariance and amplitude of every chosen effect."""
    beta, _, _ = fit.fit(chosen)
    spread, places = covariance(fit, chosen)
    return [
        (beta[place[: effect.size]], _part(spread, place), fit.amplitude(effect, nonlinear, beta[every]))
        for (effect, nonlinear), place, every in zip(chosen, places, fit.places(chosen), strict=True)
    ]


def parameters_of(found: Search) -> tuple[Floats, Floats]:
    """The model's parameters beside the causes, and their covariance, in units of `fit_parameters.units`.

    What is held makes the others no more certain than they are beside it. By a motor's current all
    compliances may be off by one factor, and the torque by its inverse, as far as the prior lets them.
    """
    own, fit = slice(found.fit.parameters.size), found.fit
    beta, _, _ = fit.fit(found.chosen)
    spread = covariance(replace(fit, held=()), found.chosen)[0][own, own]
    parameters = fit_parameters.admissible(fit.parameters + beta[own], fit.data.configured)
    return parameters, spread + fit_parameters.scaling(parameters, fit.data.held, fit.data.configured)


def motor_deviations(found: Search) -> dict[str, float]:
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


def _deviances(fit: LinearisedFit, chosen: Chosen, blind: bool) -> Floats:
    """Sum of squares of every block: held out, or, where something wanders, fitted with Akaike's price."""
    if not blind:
        return fit.design(chosen).held_out()
    fitted = block_deviances(fit, chosen)
    return np.asarray(fitted + 2.0 * fit.joined(chosen).shape[1] / fitted.size)


def _alike(fit: LinearisedFit, chosen: Chosen, index: int, rivals: Collection[str]) -> list[str]:
    """Effects that would do as well in place of one, whether or not the motion can prove them.

    One that is worse in some blocks and better in others cannot be distinguished from it either: where the
    model leaves more than noise, sums alone say nothing. Torques that the motion cannot prove compete with
    whatever else: of one that hardly changes another value may be real, where ripple is not quite the same.
    """
    effect, named = chosen[index][0], {e.name for e, _ in chosen}
    found = [name for name in effect.always_confused if name not in named]
    without, itself, others = left_out(fit, chosen, index)
    again = (*others, chosen[index])
    gain = without.deviance(others) - fit.deviance(chosen)
    far = _FAR * gain if gain > _CERTAIN else 0.0
    unproven = {e.name for e in fit.data.searched if e.stage == Stage.TORQUE and not fit.data.testable(e)[0]}
    more = unproven if effect.stage != Stage.TORQUE else ()
    for candidate in ranked(without, others, by_name(fit, {*rivals, *effect.confused_with, *more})):
        name, trial = candidate.effect.name, (*others, (candidate.effect, candidate.nonlinear))
        if name in named or name in found or (candidate.gain < far and name not in unproven):
            continue
        if name in unproven:
            there = settle(without.corrected(trial), trial, _TO_ITS_SIZE, learn=False)
            as_much = there.deviance(trial) - itself.deviance(again) < _NEARLY_AS_MUCH * gain
            if as_much or same_columns(without, chosen[index], trial[-1]):
                found.append(name)
            continue
        there, blind = without.corrected(trial), wanders(chosen) or wanders(trial)
        if itself is fit:
            there = settle(there, trial, _TO_ITS_SIZE, learn=False)
        worse = _deviances(there, trial, blind) - _deviances(itself, again, blind)
        if _separable(worse) and worse.sum() < far and free(candidate.effect):
            there, trial = polished(there, trial, _NEARLY)  # it may do as well at its best
            worse = _deviances(there, trial, blind) - _deviances(fit, chosen, blind)
        if not (_separable(worse) or _another(fit, chosen, candidate)):
            found.append(name)
    return found


def _another(fit: LinearisedFit, chosen: Chosen, candidate: Candidate) -> bool:
    """Whether a rival explains about as much beside what is chosen as in place of a part: then it is none."""
    beside = (*chosen, (candidate.effect, candidate.nonlinear))
    gain = fit.deviance(chosen) - fit.corrected(beside).deviance(beside)
    return gain > _NEARLY_AS_MUCH * candidate.gain


def _separable(worse: Floats) -> bool:
    lost, won = -float(worse[worse < 0.0].sum()), float(worse[worse > 0.0].sum())
    return won - lost > CLASS_DEVIANCE and (lower_bound(worse) > 0.0 or lost < _DISAGREEING * won)
