"""Search for causes: forward selection; what is chosen is refined, exchanged for a better one, or dropped."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import f_test, surprise
from hd_diag.diagnosis.fit.fit_parameters import at_bound
from hd_diag.diagnosis.fit.joint_refinement import free, polished, settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.refit import Refit, distinct
from hd_diag.diagnosis.search.acceptance import FAMILY_ERROR, beside_another, by_chance, needed, passing
from hd_diag.diagnosis.search.causes import Search, causes, plain_gain
from hd_diag.diagnosis.search.exchange import (
    at_best_choices,
    best_nonlinear,
    deviance_of,
    finished_in_time,
    on_certain_rows,
    one_for_two,
    refined,
    swapped,
)
from hd_diag.diagnosis.search.minima import (
    globally_refitted,
    refitted_at_low_speed,
    restarted,
    speed_dependent,
)
from hd_diag.diagnosis.search.ranking import Candidate, Projector, by_name, candidates, family_size, ranked
from hd_diag.diagnosis.search.unmodelled_terms import (
    OUTPUT_LINES,
    UNMODELLED_TERMS,
    OutputLine,
    UnmodelledTerm,
)

FURTHER_CAUSES = "looking for further causes"
"""What is left out where the search has no more time."""

_MOST_CAUSES = 4
_MOST_TERMS = 3  # unmodelled, beside lines of the output's turn
_RIVALS = 6  # best candidates of a round that are tried later in place of others
_AS_MUCH = 0.9  # share of the best candidate's gain from which another is tried with all settled
_MISLED = 0.3  # the same where the parameters are those of another drive for certain
_HALF = 0.5  # the same for candidates beside which the parameters are those of another drive
_HIDDEN = 0.05  # share of a cause's columns below which the parameters imitate it
_ALONG_A_VALLEY = 8  # rounds of settling in which the parameters can reach another drive
_FAR = 2.0  # deviance over that of noise above which the parameters are still taken for wrong
_LARGE = 0.1  # gain over the deviance of noise above which a cause may have misled the parameters
_RESTARTS = 3  # causes found, up to which each lets the model's parameters be searched for again
_ZERO = "torque_offset"
_TURNED = 0.01  # share of the torques that another zero must put on the other flank
_PLAINLY = 10.0  # surprise by which an unmodelled term must beat all causes to come before them
_RESOLVED = 5.0  # surprise by which a wave of any order must beat a whole number per output turn
_SEARCHED = 0.45  # of the time that a diagnosis may take, by which it must end
_FIRST, _LAST = 0.15, 0.63  # of the time it takes, that are gone when the search begins and ends
_ROUND = 0.45  # of what is left of the search, after each round


def search(
    fit: LinearisedFit,
    rng: np.random.Generator,
    begun: Refit | None = None,
) -> Search:
    """Find the causes of the refitted model's residual, as far as there is time.

    Parameters
    ----------
    fit : LinearisedFit
        At the refitted parameters.
    rng : numpy.random.Generator
        For intervals.
    begun : Refit, optional
        What was fitted beside terms for whatever a cause may be.
    """
    work, chosen, rivals = fit.work, fit.data.given, set[str]()
    fit = settle(fit, chosen)
    with work.until(_SEARCHED, FURTHER_CAUSES):
        for now in _rounds(fit, chosen, rivals, rng, begun):
            fit, chosen = now
    work.tell(_LAST, "refining what was found")
    fit = fit.recentred()
    chosen = needed(fit, at_best_choices(fit, chosen))
    fit, chosen = finished_in_time(settle(fit, chosen), chosen)
    if (fewer := needed(fit, chosen)) != chosen:
        fit, chosen = finished_in_time(settle(fit, fewer), fewer)
    found = causes(fit, chosen, rivals, rng)
    fit, fewer = one_for_two(fit, chosen, found, rivals)
    if fewer != chosen:
        chosen, found = fewer, causes(fit, fewer, rivals, rng)
    unmodelled = tuple(item for item in chosen if item[0].given or isinstance(item[0], UnmodelledTerm))
    return Search(fit, found, unmodelled, (), frozenset(rivals), family_size(fit))


def _rounds(
    fit: LinearisedFit,
    chosen: Chosen,
    rivals: set[str],
    rng: np.random.Generator,
    begun: Refit | None,
) -> Iterator[tuple[LinearisedFit, Chosen]]:
    """The fit beside one effect more in every round; what is given at any time can be the last.

    Names of the rivals of what is chosen are added to `rivals`.
    """
    if chosen:
        fit, chosen = polished(fit, chosen)
        yield fit, chosen
    family, refused = family_size(fit), set[str]()
    for number in range(_MOST_CAUSES + _MOST_TERMS + len(OUTPUT_LINES)):
        fit.work.tell(_LAST - (_LAST - _FIRST) * _ROUND**number, f"looking for cause {len(chosen) + 1}")
        fit = fit.recentred()
        best = candidates(fit, chosen) if _count_named(chosen) < _MOST_CAUSES else []
        if not chosen and begun and (turned := _with_torque_zero(fit, begun)):
            fit, best = turned
        else:
            if not chosen and speed_dependent(fit):
                fit, best = refitted_at_low_speed(fit, best, rng)
            fit, best = _ranked_when_settled(fit, chosen, best, rng, begun.parameters if begun else None)
        rivals |= {candidate.effect.name for candidate in best[:_RIVALS]}
        found = _next(fit, chosen, family, best, refused)
        if found is None:
            break
        before = fit, chosen
        chosen = (*chosen, (found.effect, found.nonlinear))
        fit, chosen = refined(fit, chosen)
        fit, chosen = on_certain_rows(fit, chosen)
        if isinstance(found.effect, UnmodelledTerm):  # a cause that was only the nearest to it may go
            fewer = needed(fit, chosen)
            if fewer != chosen and not _plainly_better(before, fit, fewer):
                fit, chosen = before
                refused.add(found.effect.name)
                continue
            chosen = fewer
            yield fit, chosen
            continue
        yield fit, chosen
        fit, chosen = swapped(fit, chosen, rivals)
        if len(chosen) <= _RESTARTS:
            again = restarted(fit, chosen, rng)
            if again is not fit:  # beside other parameters another cause may be the better one
                fit, chosen = swapped(again, chosen, rivals)
        yield fit, chosen


def _next(
    fit: LinearisedFit, chosen: Chosen, family: int, best: list[Candidate], refused: Collection[str]
) -> Candidate | None:
    """The best candidate that passes every test; where none does, the best unmodelled term; else None.

    A cause that fails at its grid point is tried between grid points. A term that is not predictive comes
    after all causes: a constant for every run imitates friction and drift together. Last of all two are tried
    that explain something only together.
    """
    terms = ranked(fit, chosen, [term for term in _unmodelled(chosen) if term.name not in refused])[:2]
    first = [*best[:3], *sorted(best[3:], key=lambda one: -one.surprise)[:1]]
    likely = [one for one in best[:1] if by_chance(one, family) <= FAMILY_ERROR and free(one.effect)]
    leading = [one for one in terms[:1] if isinstance(one.effect, UnmodelledTerm) and one.effect.predictive]
    if ahead := bool(best and leading):  # of a cause that is not settled the gain says little
        most = leading[0].surprise - _margin(leading[0], best[0])
        ahead = best[0].surprise < most and _when_settled(fit, chosen, best[0], fit)[0] < most
    return (
        (passing(fit, chosen, leading, family) if ahead else None)
        or passing(fit, chosen, first, family)
        or passing(fit, chosen, [_between_grid_points(fit, chosen, one) for one in likely], family)
        or passing(fit, chosen, terms, family)
        or beside_another(fit, chosen, best, family)
    )


def _when_settled(
    fit: LinearisedFit, chosen: Chosen, one: Candidate, start: LinearisedFit, rounds: int = _ALONG_A_VALLEY
) -> tuple[float, LinearisedFit]:
    """Surprise of a candidate once all is settled beside it, from another fit on, and where that ends.

    Both on rows where the torque that it leaves is clear of zero: elsewhere no step may lead to its size.
    """
    trial = (*chosen, (one.effect, one.nonlinear))
    sized = start.sized(trial, start.fit(trial)[0])
    shift = start.effects.possible_torques(sized)
    there = settle(start.clear_of(shift).beside(sized), trial, rounds, learn=False)
    before, after = fit.clear_of(shift).beside(fit.present).deviance(chosen), deviance_of(there, trial)
    rows, width = int(np.count_nonzero(fit.residual_white)), there.columns(*trial[-1]).shape[1]
    return surprise((before - after) * rows / after, width), there


def _plainly_better(before: tuple[LinearisedFit, Chosen], fit: LinearisedFit, fewer: Chosen) -> bool:
    """Whether an unmodelled term, the last one, explains plainly more than causes that go with it."""
    there, causes = replace(before[0], whiten=fit.whiten), before[1]
    now = deviance_of(there, causes)
    without = deviance_of(there, tuple(item for item in causes if item in fewer))
    return deviance_of(fit, fewer) < now - plain_gain(without - now)


def _unmodelled(chosen: Chosen) -> list[UnmodelledTerm]:
    """Terms that may come next: of lines, which are alike, the first that is left."""
    lines = sum(isinstance(effect, OutputLine) for effect, _ in chosen)
    others = sum(isinstance(effect, UnmodelledTerm) for effect, _ in chosen) - lines
    return [*(UNMODELLED_TERMS if others < _MOST_TERMS else ()), *OUTPUT_LINES[lines : lines + 1]]


def _margin(term: Candidate, cause: Candidate) -> float:
    """Surprise by which a term must beat a cause; a wave of any order itself must beat a line.

    A line's order is whole; that of a cage or a belt would be close to a whole one by chance alone.
    """
    of_any_order = any(q.name == "order" and not q.discrete for q in cause.effect.nonlinear)
    return -_RESOLVED if isinstance(term.effect, OutputLine) and of_any_order else _PLAINLY


def _ranked_when_settled(
    fit: LinearisedFit, chosen: Chosen, best: list[Candidate], rng: np.random.Generator, begun: Floats | None
) -> tuple[LinearisedFit, list[Candidate]]:
    """Fit and candidates, the best few ranked by the deviance left once all is settled beside each.

    Parameters fitted without a large cause imitate it, and end away from where they began or at a bound. They
    are then searched for again beside each rival. Candidates that the parameters imitate nearly whole are
    always tried settled: their linear gain says nothing.
    """
    rows, before = int(np.count_nonzero(fit.residual_white)), fit.deviance(chosen)
    far = before - max((one.gain for one in best), default=0.0) > _FAR * rows
    moved = begun is not None and bool(distinct([fit.parameters, begun])[1:])
    large = bool(best) and best[0].gain > _LARGE * rows
    misled = large and (far or moved or bool(at_bound(fit.parameters, fit.data.configured)))
    share = _MISLED if misled else _AS_MUCH if far else _HALF
    plain = [one for one in best if one.surprise > _PLAINLY]
    hidden = _imitated_by_parameters(fit, chosen, plain)

    def competing(one: Candidate) -> bool:
        as_much = one.gain > share * best[0].gain
        return as_much and (far or misled or one is best[0] or _moves_parameters(fit, chosen, one))

    close = [one for one in plain if one in hidden or competing(one)]
    close, rounds = close if misled or close[1:] else [], 2 if far or misled else _ALONG_A_VALLEY

    def settled(candidate: Candidate) -> tuple[float, LinearisedFit]:
        trial = (*chosen, (candidate.effect, candidate.nonlinear))
        again = globally_refitted(fit, trial, rng).parameters if misled else fit.parameters
        other = fit.moved(again) if distinct([fit.parameters, again])[1:] else fit
        surprising, there = _when_settled(fit, chosen, candidate, other, rounds)
        return surprising, there if misled or candidate in hidden else fit

    trials = [(*settled(one), one) if one in close else (one.surprise, fit, one) for one in best]
    trials.sort(key=lambda trial: -trial[0])
    return trials[0][1] if trials else fit, [one for _, _, one in trials]


def _with_torque_zero(fit: LinearisedFit, begun: Refit) -> tuple[LinearisedFit, list[Candidate]] | None:
    """Fit and candidates led by an offset of the torque, if it explains more than any; None otherwise.

    An offset that puts many torques on the other flank is out of reach of steps from the reported torque; the
    fit from many starts finds it. All are compared on rows where the torque is clear of zero with it, too.
    """
    torque, effects = fit.data.record.torque, by_name(fit, (_ZERO,))
    if not effects or np.mean((torque > 0.0) != (torque + begun.torque_zero > 0.0)) < _TURNED:
        return None
    item = effects[0], ()
    present = ((item, np.array([begun.torque_zero])),)
    clear = settle(fit.clear_of(fit.effects.possible_torques(present)), ())
    there = settle(clear.moved(begun.parameters).beside(present), (item,), learn=False)
    before, after = clear.deviance(()), there.deviance((item,))
    rivals = candidates(clear, ())
    if before - after < max((one.gain for one in rivals), default=0.0):
        return None
    gain, rows = before - after, int(np.count_nonzero(there.residual_white))
    chance, size = f_test(before, after, 1, rows, fit.parameters.size + 1), surprise(gain * rows / after, 1)
    return there, [Candidate(*item, gain, chance, size), *rivals]


def _imitated_by_parameters(fit: LinearisedFit, chosen: Chosen, plain: list[Candidate]) -> list[Candidate]:
    """Candidates of whose columns parameters and chosen effects leave hardly anything."""
    if not plain:
        return []
    projector, found = Projector(fit, chosen), []
    for one in plain:
        columns = fit.white(one.effect, one.nonlinear)
        beside = projector.off(columns)[: len(columns)]
        if float(np.sum(beside**2)) < _HIDDEN * float(np.sum(columns**2)):
            found.append(one)
    return found


def _moves_parameters(fit: LinearisedFit, chosen: Chosen, candidate: Candidate) -> bool:
    """Whether beside a candidate the parameters are those of another drive."""
    step = fit.fit((*chosen, (candidate.effect, candidate.nonlinear)))[0][: fit.parameters.size]
    return bool(distinct([fit.parameters, fit.parameters + step])[1:])


def _between_grid_points(fit: LinearisedFit, chosen: Chosen, candidate: Candidate) -> Candidate:
    """A candidate between grid points, with the chance of the grid's best."""
    effect = candidate.effect
    return replace(candidate, nonlinear=best_nonlinear(fit, chosen, effect, candidate.nonlinear))


def _count_named(chosen: Chosen) -> int:
    return sum(not (effect.given or isinstance(effect, UnmodelledTerm)) for effect, _ in chosen)
