"""Chosen causes brought to their best: refined with all parameters free, exchanged for better ones."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np
from scipy.optimize import minimize

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.joint_refinement import free, polished, sensible, settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.search.acceptance import OVERSTATED
from hd_diag.diagnosis.search.causes import CLASS_DEVIANCE, Cause, left_out
from hd_diag.diagnosis.search.ranking import Projector, by_name, ranked
from hd_diag.diagnosis.search.unmodelled_terms import OUTPUT_LINES, OutputLine, UnmodelledTerm
from hd_diag.effects.effect import Effect, Stage

_FLEXIBLE = 8  # coefficients from which a shape may imitate two causes
_TRIED = 3  # best causes of few coefficients, that are tried settled in its place
_NEAR = 0.1  # of a cause's gain, up to which another may be the better one once all is settled beside it
_FIRST_MOVE = 0.5  # of a grid step, by which a refinement begins
_BEGIN, _TO_THE_END = 2, 8  # rounds
_AS_WELL, _HALVINGS = 3.84, 8  # deviance within which 95 % of true values lie; of the way to a usual one
_REFINED, _UNITED = 0.55, 0.65  # of the time that a diagnosis may take, by which they must end


def refined(fit: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """The newest effect's nonlinear values and all parameters, brought to their best."""
    fit = settle(fit, chosen, rounds=2)
    effect, nonlinear = chosen[-1]
    if free(effect):
        moved = (*chosen[:-1], (effect, best_nonlinear(fit, chosen[:-1], effect, nonlinear)))
        there = settle(fit, moved, rounds=1)
        if sensible(there, moved)[-1] or not sensible(fit, chosen)[-1]:
            fit, chosen = there, moved
    again = _best_neighbours(fit, chosen, len(chosen) - 1)
    if again != chosen:
        fit, chosen = settle(fit.corrected(again), again, rounds=2), again
    return _best_discrete_values(fit, chosen, len(chosen) - 1)


def on_certain_rows(fit: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """Exclude rows where the torque that the effects leave may be near zero, and fit again."""
    sized = fit.sized(chosen, fit.fit(chosen)[0])
    certain = fit.clear_of(fit.effects.possible_torques(sized))
    return (fit, chosen) if certain is fit else refined(certain.beside(sized), chosen)


def swapped(fit: LinearisedFit, chosen: Chosen, rivals: set[str]) -> tuple[LinearisedFit, Chosen]:
    """Exchange chosen effects for better ones, or for themselves at a better grid point.

    A shape of many coefficients is exchanged for one or two causes of few as well, a wave that wanders for
    lines of the output's turn, too: greedily chosen, it takes their place.
    """
    for index, (effect, _) in enumerate(chosen[:-1]):
        if effect.stage > Stage.GEAR:
            fit, chosen = _best_discrete_values(fit, chosen, index)
    for index in range(len(chosen)):
        effect, nonlinear = chosen[index]
        if effect.given:
            continue
        without, itself, others = left_out(fit, chosen, index)
        again = (*others, (effect, nonlinear))
        now = min(_priced(fit, chosen), _priced(itself, again))
        found = ranked(without, others, by_name(fit, rivals))
        if not found:
            continue
        least = now - CLASS_DEVIANCE
        if _coefficients(fit, (chosen[index],)) >= _FLEXIBLE and found[0].effect.name == effect.name:
            lines = OUTPUT_LINES if effect.wanders(nonlinear) else ()
            there, trial = _few_in_place_of_one(without, others, rivals - {effect.name}, lines, least)
        else:
            near = now + _NEAR * (without.deviance(others) - now)
            trials = [(*others, (one.effect, one.nonlinear)) for one in found[:_TRIED]]
            begun = [(without.corrected(trial), trial) for trial in trials if trial != again]
            close = [one for one in begun if _priced(*one) < near]
            if not close:
                continue
            there, trial = _best_begun(close)
        fit, there = _settled(fit, chosen), _settled(there, trial)
        if _priced(there, trial) < _priced(fit, chosen) - CLASS_DEVIANCE:
            fit, chosen = refined(there, trial)
    return fit, chosen


def one_for_two(
    fit: LinearisedFit, chosen: Chosen, found: Sequence[Cause], rivals: Collection[str]
) -> tuple[LinearisedFit, Chosen]:
    """One cause in place of two, where it explains as much: what each might be; any, of a flexible shape."""
    known, most = {effect.name for effect, _ in chosen}, fit.deviance(chosen) + CLASS_DEVIANCE
    with fit.work.until(_UNITED, "testing one cause in place of two"):
        for two in combinations(found, 2):
            flexible = any(_coefficients(fit, ((one.effect, one.nonlinear),)) >= _FLEXIBLE for one in two)
            names = {*two[0].alike}.intersection(two[1].alike).union(rivals if flexible else ())
            others = tuple(item for item in chosen if all(item[0] is not one.effect for one in two))
            without = fit.corrected(others)
            for one in ranked(without, others, by_name(fit, names - known))[:_TRIED]:
                trial = (*others, (one.effect, one.nonlinear))
                there = _settled(without.corrected(trial), trial)
                if there.deviance(trial) < most and all(sensible(there, trial)):
                    return finished_in_time(there, trial)
    return fit, chosen


def _settled(fit: LinearisedFit, chosen: Chosen) -> LinearisedFit:
    """Settled in many rounds: only then may two sets of effects be compared."""
    return settle(fit, chosen, _TO_THE_END, learn=False)


def _priced(fit: LinearisedFit, chosen: Chosen) -> float:
    """Deviance with Akaike's price of the coefficients, where deviances are overstated (QAIC)."""
    return fit.deviance(chosen) + 2.0 * OVERSTATED * _coefficients(fit, chosen)


def _coefficients(fit: LinearisedFit, chosen: Chosen) -> int:
    """Number of those of some effects, of their wandering as well; of some values columns are zero."""
    return sum(int(np.count_nonzero(fit.columns(*item).any(axis=0))) for item in chosen)


def _few_in_place_of_one(
    fit: LinearisedFit, others: Chosen, rivals: set[str], lines: Sequence[OutputLine], least: float
) -> tuple[LinearisedFit, Chosen]:
    """The fit beside the best cause, or the best two, in place of a shape that may imitate both."""
    for _ in range(2):
        used = {effect.name for effect, _ in others}
        more = [line for line in lines if line.name not in used][:1]
        found = ranked(fit, others, [*by_name(fit, rivals), *more])
        trials = [(*others, (one.effect, one.nonlinear)) for one in found]
        few = [trial for trial in trials if _coefficients(fit, trial[-1:]) < _FLEXIBLE][:_TRIED]
        if not few:
            break
        fit, others = _best_begun([(fit.corrected(trial), trial) for trial in few])
        fit = _settled(fit, others)
        if _priced(fit, others) < least:
            break
    return fit, others


def _best_begun(trials: Sequence[tuple[LinearisedFit, Chosen]]) -> tuple[LinearisedFit, Chosen]:
    """The best of some fits beside sets of effects after a few rounds of settling, and its set."""
    begun = [(settle(fit, chosen, _BEGIN, learn=False), chosen) for fit, chosen in trials]
    return min(begun, key=lambda one: _priced(*one))


def finished_in_time(fit: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """Everything at its best; as it is where there is no time."""
    with fit.work.until(_REFINED, "refining the causes' numbers"):
        fit, chosen = _finished(fit, chosen)
    return fit, chosen


def _finished(fit: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """Everything at its best; discrete values are tried once more beside all others."""
    fit, chosen = polished(fit, chosen)
    again = at_best_choices(fit, chosen)
    if again != chosen:
        fit, chosen = polished(settle(fit.corrected(again), again, learn=False), again)
    drawn = _drawn_back(fit, chosen)
    if drawn != chosen:
        fit, chosen = settle(fit.corrected(drawn), drawn, learn=False), drawn
    return _without_idle(fit, chosen)


def _drawn_back(fit: LinearisedFit, chosen: Chosen) -> Chosen:
    """Values above the usual ones halfway to these, and again, while they do as well: nothing tells them.

    Of a lag the fit may know that it is long; what an endless one foretells is a guess.
    """
    most = deviance_of(fit, chosen) + _AS_WELL
    for index, (effect, _) in enumerate(chosen):
        for number in free(effect):
            usual, values = effect.nonlinear[number].prior_scale, list(chosen[index][1])
            for _ in range(_HALVINGS if values[number] > usual else 0):
                values[number] = 0.5 * (values[number] + usual)
                trial = (*chosen[:index], (effect, tuple(values)), *chosen[index + 1 :])
                there = fit.corrected(trial)
                if there.deviance(trial) > most or not all(sensible(there, trial)):
                    break
                chosen = trial
    return chosen


def at_best_choices(fit: LinearisedFit, chosen: Chosen) -> Chosen:
    """The chosen effects, each at the best of the discrete values beside its own, if it is itself there."""
    for index in range(len(chosen)):
        chosen = _best_neighbours(fit, chosen, index)
    return chosen


def _best_neighbours(fit: LinearisedFit, chosen: Chosen, index: int) -> Chosen:
    """The same with one of them."""
    effect, nonlinear = chosen[index]
    trials = [
        (*chosen[:index], (effect, value), *chosen[index + 1 :])
        for value in effect.neighbours(fit.signals, nonlinear)
    ]

    def worse(trial: Chosen) -> tuple[bool, float]:
        there = fit.corrected(trial)
        return not sensible(there, trial)[index], _priced(there, trial)

    return min((chosen, *trials), key=worse)


def _without_idle(fit: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """Drop each cause without which the parameters, settled anew, fit as well."""
    for index, (effect, _) in enumerate(chosen):
        if effect.given or isinstance(effect, UnmodelledTerm):
            continue
        rest = chosen[:index] + chosen[index + 1 :]
        there = _settled(fit.corrected(rest), rest)
        if there.deviance(rest) < fit.deviance(chosen) + CLASS_DEVIANCE + 2.0 * effect.size:
            return _without_idle(there, rest)
    return fit, chosen


def _best_discrete_values(fit: LinearisedFit, chosen: Chosen, index: int) -> tuple[LinearisedFit, Chosen]:
    """The fit with the best discrete values of an effect that carries others, all else settled."""
    effect, nonlinear = chosen[index]
    if effect.stage <= Stage.GEAR:
        return fit, chosen
    best, found, least = fit, chosen, deviance_of(fit, chosen)
    for other in effect.neighbours(fit.signals, nonlinear):
        trial = (*chosen[:index], (effect, other), *chosen[index + 1 :])
        moved = settle(fit.moved(fit.parameters), trial, rounds=2, learn=False)
        moved, trial = polished(moved, trial, rounds=2)
        if (deviance := deviance_of(moved, trial)) < least:
            best, found, least = moved, trial, deviance
    return best, found


def best_nonlinear(
    fit: LinearisedFit, others: Chosen, effect: Effect, start: tuple[float, ...]
) -> tuple[float, ...]:
    """Nonlinear values of least residual within the effect's bounds, starting at a grid point."""
    projector = Projector(fit, others, ((effect, start),))
    quantities, moving = effect.nonlinear, free(effect)
    low, high = np.array([q.low for q in quantities]), np.array([q.high for q in quantities])
    width = fit.data.grid_step(effect, start)

    def moved(move: Floats) -> tuple[float, ...]:
        values = np.array(start)
        values[moving] += move * width[moving]
        return tuple(np.clip(values, low, high).tolist())

    def loss(move: Floats) -> float:
        return -projector.gain(fit.white(effect, moved(move), keep=False))

    corners = np.vstack((np.zeros(len(moving)), _FIRST_MOVE * np.eye(len(moving))))
    options = {"maxfev": 40, "xatol": 1e-3, "fatol": 0.1, "initial_simplex": corners}
    best = minimize(loss, corners[0], method="Nelder-Mead", options=options)
    return moved(best.x)


def deviance_of(fit: LinearisedFit, chosen: Chosen) -> float:
    """With the effects at the size that fits."""
    return fit.corrected(chosen).deviance(chosen)
