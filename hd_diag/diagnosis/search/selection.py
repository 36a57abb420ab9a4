"""Search for causes: forward selection, each choice refined, exchanged for a better one, dropped if idle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.joint_refinement import free, polished
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit, settle
from hd_diag.diagnosis.fit.refit import FEW_STARTS, distinct, refit
from hd_diag.diagnosis.search.acceptance import kept, passing
from hd_diag.diagnosis.search.causes import CLASS_DEVIANCE, Search, causes
from hd_diag.diagnosis.search.ranking import Candidate, Projector, by_name, candidates, family_size, ranked
from hd_diag.diagnosis.search.unmodelled_terms import FOILS, Foil
from hd_diag.effects.effect import Effect, Stage

_MOST_CAUSES = 4
_SLOW = 0.34  # share of the samples that count as slow
_MOST_FOILS = 3
_RIVALS = 6  # best candidates of a round that are looked at again in place of others
_UNEVEN = 1.3  # ratio of what is left fast and slow that asks for a look
_RESTARTS = 3  # causes found, up to which each lets the model's parameters be searched for again
_PLAINLY = 10.0  # surprise by which a shape without a name must beat all causes to come before them
_FIRST_MOVE = 0.5  # of a grid step, by which a refinement begins
_RESTART_GAIN = 12.0  # deviance by which another minimum must beat the present one


def search(bench: LinearisedFit, progress: Callable[[str], None] = lambda text: None) -> Search:
    """Find the causes of what the refitted model leaves.

    Parameters
    ----------
    bench : LinearisedFit
        At the refitted parameters.
    progress : callable
        Told what is being done.

    Returns
    -------
    Search
    """
    chosen: Chosen = ()
    p_values: dict[str, float] = {}
    bench = settle(bench, chosen)
    family, rivals = family_size(bench), set[str]()
    for _ in range(_MOST_CAUSES + _MOST_FOILS):
        progress(f"looking for cause {len(chosen) + 1}")
        if not chosen and speed_dependent(bench):
            bench = _begun_slowly(bench)
        best = candidates(bench, chosen) if _named(chosen) < _MOST_CAUSES else []
        rivals |= {candidate.effect.name for candidate in best[:_RIVALS]}
        found = _next(bench, chosen, family, best)
        if found is None:
            break
        p_values[found.effect.name] = found.p_value
        chosen = (*chosen, (found.effect, found.nonlinear))
        bench, chosen = _refined(bench, chosen)
        bench, chosen = _clear(bench, chosen)
        if isinstance(found.effect, Foil):  # a cause that was only the nearest to it is not needed any more
            chosen = kept(bench, chosen)
            continue
        bench, chosen = _swapped(bench, chosen, rivals)
        if len(chosen) <= _RESTARTS:
            bench = _restarted(bench, chosen)
    chosen = kept(bench, chosen)
    bench, chosen = _finished(settle(bench, chosen), chosen)
    needed = kept(bench, chosen)
    if needed != chosen:
        bench, chosen = _finished(settle(bench, needed), needed)
    foils = tuple(item for item in chosen if isinstance(item[0], Foil))
    return Search(bench, causes(bench, chosen, p_values, rivals), foils)


def speed_dependent(bench: LinearisedFit) -> bool:
    """Whether what is left is larger, or smaller, where the joint runs fast."""
    speed, rest = np.abs(bench.signals.speed), bench.remainder(())
    slow, fast = np.quantile(speed, (_SLOW, 1.0 - _SLOW))
    ratio = np.std(rest[speed >= fast]) / max(float(np.std(rest[speed <= slow])), 1e-300)
    return bool(slow < 0.5 * fast and not 1.0 / _UNEVEN < ratio < _UNEVEN)


def _next(bench: LinearisedFit, chosen: Chosen, family: int, best: list[Candidate]) -> Candidate | None:
    """The best candidate that passes every test; where none does, the best nameless shape; else None.

    Between grid points a cause may explain too little of blocks that were not fitted. A shape that foretells
    nothing comes last: a constant for every run imitates friction and drift together.
    """
    shapes = ranked(bench, chosen, FOILS)[:2] if len(chosen) - _named(chosen) < _MOST_FOILS else []
    leading = [one for one in shapes[:1] if isinstance(one.effect, Foil) and one.effect.sees_ahead]
    if best and leading and leading[0].surprise > best[0].surprise + _PLAINLY:
        shape = passing(bench, chosen, leading, family)
        if shape is not None:
            return shape
    found = passing(bench, chosen, best[:3], family) or passing(
        bench, chosen, [_between(bench, chosen, one) for one in best[:1] if free(one.effect)], family
    )
    if found is not None:
        return found
    return passing(bench, chosen, shapes, family)


def _between(bench: LinearisedFit, chosen: Chosen, candidate: Candidate) -> Candidate:
    """A candidate off its grid point; the chance is that of the grid's best."""
    effect = candidate.effect
    return replace(candidate, nonlinear=_best_nonlinear(bench, chosen, effect, candidate.nonlinear))


def _named(chosen: Chosen) -> int:
    return sum(not isinstance(effect, Foil) for effect, _ in chosen)


def _begun_slowly(bench: LinearisedFit) -> LinearisedFit:
    """The parameters that the slow part shows, if a cause beside them then explains more.

    A resonance, a delay or an unbalance changes the ripple at speed: fitted to all of it, the model's own
    parameters go astray, and no cause stands out beside them.
    """
    speed = np.abs(bench.data.record.speed)
    slow = refit(bench.data.record.select(speed <= np.quantile(speed, _SLOW)), bench.data.configured)
    other = bench.moved(slow.parameters)
    trials = [(each, next(iter(candidates(each, ())), None)) for each in (bench, other)]
    left = [each.design(((best.effect, best.nonlinear),) if best else ()).deviance() for each, best in trials]
    return other if left[1] < left[0] - _RESTART_GAIN else bench


def _refined(bench: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """The newest effect's nonlinear values and all parameters, brought to their best."""
    bench = settle(bench, chosen, rounds=2)
    effect, nonlinear = chosen[-1]
    if free(effect):
        chosen = (*chosen[:-1], (effect, _best_nonlinear(bench, chosen[:-1], effect, nonlinear)))
        bench = settle(bench, chosen, rounds=1)
    return _of_kind(bench, chosen, len(chosen) - 1)


def _clear(bench: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """On the rows that are fit to use where the newest effect tells of another torque."""
    effect, _ = chosen[-1]
    (*_, (_, coefficients)) = bench.sized(chosen, bench.fit(chosen)[0])
    clear = bench.clear_of(effect.torque_shift(coefficients))
    return (bench, chosen) if clear is bench else _refined(clear, chosen)


def _of_kind(bench: LinearisedFit, chosen: Chosen, index: int) -> tuple[LinearisedFit, Chosen]:
    """An effect that carries others, at the discrete values that are best when all is settled beside them."""
    effect, nonlinear = chosen[index]
    if effect.stage <= Stage.GEAR:
        return bench, chosen
    best, found, least = bench, chosen, _deviance(bench, chosen)
    for other in effect.neighbours(bench.signals, nonlinear):
        trial = (*chosen[:index], (effect, other), *chosen[index + 1 :])
        moved = settle(bench.moved(bench.parameters), trial, rounds=2, learn=False)
        moved, trial = polished(moved, trial, rounds=2)
        if (deviance := _deviance(moved, trial)) < least:
            best, found, least = moved, trial, deviance
    return best, found


def _best_nonlinear(
    bench: LinearisedFit, others: Chosen, effect: Effect, start: tuple[float, ...]
) -> tuple[float, ...]:
    """Nonlinear values of least residual, from a grid point, within the effect's bounds."""
    projector = Projector(bench, others)
    quantities, moving = effect.nonlinear, free(effect)
    low, high = np.array([q.low for q in quantities]), np.array([q.high for q in quantities])
    width = bench.data.grid_step(effect, start)

    def moved(move: Floats) -> tuple[float, ...]:
        values = np.array(start)
        values[moving] += move * width[moving]
        return tuple(np.clip(values, low, high).tolist())

    def loss(move: Floats) -> float:
        return -projector.gain(bench.white(effect, moved(move), keep=False))

    corners = np.vstack((np.zeros(len(moving)), _FIRST_MOVE * np.eye(len(moving))))
    options = {"maxfev": 40, "xatol": 1e-3, "fatol": 0.1, "initial_simplex": corners}
    best = minimize(loss, corners[0], method="Nelder-Mead", options=options)
    return moved(best.x)


def _swapped(bench: LinearisedFit, chosen: Chosen, rivals: set[str]) -> tuple[LinearisedFit, Chosen]:
    """Exchange a chosen effect for a better one, or for itself at another grid point, where there is one."""
    for index, (effect, _) in enumerate(chosen[:-1]):
        if effect.stage > Stage.GEAR:
            bench, chosen = _of_kind(bench, chosen, index)
    for index, (effect, nonlinear) in enumerate(chosen):
        others = chosen[:index] + chosen[index + 1 :]
        now = bench.design(chosen).deviance()
        without = bench.corrected(others)
        best = next(iter(ranked(without, others, by_name(bench, rivals))), None)
        if best is not None and (best.effect, best.nonlinear) != (effect, nonlinear):
            trial = (*others, (best.effect, best.nonlinear))
            if _deviance(without, trial) < now - CLASS_DEVIANCE:
                bench, chosen = _refined(without.corrected(trial), trial)
    return bench, chosen


def _restarted(bench: LinearisedFit, chosen: Chosen) -> LinearisedFit:
    """Search the model's parameters globally again, now that the causes found take part freely."""
    again = refit(
        bench.data.record,
        bench.data.configured,
        extra=bench.joined(chosen),
        start=bench.parameters,
        starts=FEW_STARTS,
    )
    if not distinct([bench.parameters, again.parameters])[1:]:
        return bench
    other = settle(bench.moved(again.parameters), chosen, rounds=2)
    deviance = replace(other, whiten=bench.whiten).design(chosen).deviance()  # with one noise model
    return other if deviance < bench.design(chosen).deviance() - _RESTART_GAIN else bench


def _finished(bench: LinearisedFit, chosen: Chosen) -> tuple[LinearisedFit, Chosen]:
    """Everything at its best, the discrete values looked at once more where all others are."""
    bench, chosen = polished(bench, chosen)
    again = chosen
    for index, (effect, nonlinear) in enumerate(chosen):
        for other in effect.neighbours(bench.signals, nonlinear):
            trial = (*again[:index], (effect, other), *again[index + 1 :])
            if _deviance(bench, trial) < _deviance(bench, again):
                again = trial
    if again == chosen:
        return bench, chosen
    return polished(settle(bench.corrected(again), again, learn=False), again)


def _deviance(bench: LinearisedFit, chosen: Chosen) -> float:
    """With the effects at the size that fits."""
    return bench.corrected(chosen).design(chosen).deviance()
