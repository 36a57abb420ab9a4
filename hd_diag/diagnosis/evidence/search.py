"""Search for the set of causes with the most evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.calibration import NAMED, TEMPER, TWO_SIDED
from hd_diag.diagnosis.evidence.sets import Remainders, Set, presence
from hd_diag.diagnosis.evidence.unmodelled_terms import OUTPUT_LINES, UNMODELLED_TERMS, UnmodelledTerm
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import COMPLIANCE, CUP, DATUM, alike
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.diagnosis.fit.refit import DISTINCT, FEW_STARTS, distinct, refit
from hd_diag.diagnosis.work import Work
from hd_diag.effects.effect import Effect, Stage
from hd_diag.effects.remainders import ORDERS, PLACE

_MOST, _TURNS = 5, 12  # most causes in a set; most turns of a search
_RIVALS = 6  # alternatives fitted in place of each cause
_TRIED = 4  # candidates settled in each batch
_POLISHED = 2  # settled candidates of a batch that are polished, at most
_AGAIN = 2  # batches in each turn: the second follows if no candidate of the first holds
_HOPEFUL = 2.0  # log odds that a candidate may lack before settling, which adds to them
_OF_MODEL = ("torsional_hardening",)  # the shape of the torsion is no cause
_ZERO, _TURNED = "torque_offset", 0.01  # least share of torques that another zero moves to the other flank
_BY_TORQUE = ("friction", "torsion")
_HOPELESS = 100.0  # log odds below the best from which another minimum is dropped
_CLOSE = 10.0  # log odds within which a set is settled before it is compared
_NEARLY = 5.0  # log odds within which its nonlinear values are polished as well
_DATUM_STEPS = (2.0, 4.0, 8.0, 16.0)  # to either side, in units of the parameters
_PLAINLY = 25.0  # log odds on some rows that make a test on all rows unnecessary
_FIRST, _TURN = 0.15, 0.6  # share of the time before the search; share of a half that a turn leaves
TO_MINIMUM = 5  # rounds of settling
RESTARTS = 1  # times that other minima are tried with the causes found so far


SEARCHED = 0.6
"""Share of a diagnosis's time limit by which the search must end."""

FURTHER_CAUSES = "looking for further causes"
DATUM_REACH = "how far the datum may be off"
"""Names of the two parts that a search skips when its time is up."""


class Candidate(NamedTuple):
    """A cause at one grid point, its gain before settling [log odds], and all prior widths with it."""

    name: str
    item: Item
    gain: float
    widths: dict[str, float]


def competes(fit: LinearisedFit, effect: Effect) -> bool:
    """Whether an effect can be judged. Effects that act through the torque need a measured torque.

    Effects that the motion cannot prove compete as well if the torque is measured. Otherwise we would name a
    lookalike.
    """
    if fit.data.source.has_torque:
        return True
    return effect.stage != Stage.TORQUE and fit.data.testable(effect)[0]


def of_motor(effect: Effect) -> bool:
    """Whether an effect acts as torque: the motor's own friction and constant imitate it."""
    return effect.kind in _BY_TORQUE or effect.stage == Stage.TORQUE


def is_searched(fit: LinearisedFit, effect: Effect) -> bool:
    """Whether a record can be searched for a cause.

    If the torque is computed from motor current, effects that act as torque belong to the motor and are not
    searched for. Model parameters and the shape of the torsion are not causes.
    """
    belongs = bool(fit.data.given) and of_motor(effect)
    return competes(fit, effect) and effect.name not in _OF_MODEL and not belongs


def searched(fit: LinearisedFit) -> list[Effect]:
    """Causes, and terms without a known cause, that a record can be searched for."""
    causes = [effect for effect in fit.data.searched if is_searched(fit, effect)]
    return [*causes, *(term for term in UNMODELLED_TERMS if fit.data.testable(term)[0])]


def candidates(at: Set) -> list[Candidate]:
    """All causes outside a set, each at its best grid point given the set; highest gain first."""
    fit, chosen = at.fit, at.chosen
    rest = fit.remainder(chosen)
    points: dict[str, tuple[Effect, tuple[float, ...]]] = {}
    lines = [line.name for line in OUTPUT_LINES if line.name not in at.names][1:]  # alike: one is enough
    for effect in searched(fit):
        if effect.name in at.names or effect.name in lines:
            continue
        rough = fit.roughly(effect)
        for number, nonlinear in enumerate(effect.starts(rough.signals, rest).points):
            if rough.white(effect, nonlinear).shape[1]:
                points[f"{effect.name}/{number}"] = (effect, nonlinear)
    evidence = at.evidence(points.items())
    now, best = evidence.log(at.widths), dict[str, Candidate]()
    for widths in _smaller(at):
        loss = now - evidence.log(widths)
        for key, (gain, width) in evidence.gains(widths, points).items():
            item = points[key]
            whole = gain + presence(fit, item[0]) - loss
            one = Candidate(item[0].name, item, whole, {**widths, item[0].name: width})
            if one.name not in best or best[one.name].gain < one.gain:
                best[one.name] = one
    return sorted(best.values(), key=lambda one: -one.gain)


def _smaller(at: Set) -> list[dict[str, float]]:
    """Widths of a set: as tuned, and with one or all of the grown remainders back at their usual size.

    A grown remainder hides the cause that it grew for.
    """
    grown = [effect.name for effect, _ in at.remainders.items if at.widths[effect.name] > 1.0]
    every = [dict(at.widths), *({**at.widths, name: 1.0} for name in grown)]
    return every if len(grown) < 2 else [*every, {**at.widths, **dict.fromkeys(grown, 1.0)}]


def begun(fit: LinearisedFit) -> Set:
    """The set without causes, settled from a fit; the best of its minima."""
    drive = fit.data.configured
    slope = np.abs(fit.data.model.at(fit_parameters.vector(drive, drive)).signals.predicted_torque_slope)
    finite = slope[np.isfinite(slope)]  # infinite in the gap between the flanks
    compliance = float(np.median(finite)) if finite.size else 0.0
    start = Set(fit, Remainders.of(fit.data.source, drive, compliance), (), fit.data.given)
    first = start.valued().settled().polished(TO_MINIMUM)
    return max([first, *_by_no_motor(first)], key=lambda one: one.value)


def without_causes(start: LinearisedFit) -> Set:
    """The set without causes from a fit, with the noise learned there."""
    return begun(start.with_noise(start.data.given))


def _by_no_motor(at: Set) -> list[Set]:
    """The same set settled from zero motor torque: the fit of the motor's own torque has several minima."""
    points = [(effect, nonlinear) for effect, _ in at.motor for nonlinear in effect.grid]
    nothing = [(one, np.zeros(one[0].size)) for one in points]
    starts = [replace(at, fit=at.fit.beside((one,)), motor=(one[0],), widths={}) for one in nothing]
    return [one.valued().settled().polished(TO_MINIMUM) for one in starts]


Instead = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Found:
    """The best set of causes, and the alternatives it was compared with.

    Attributes
    ----------
    best : Set
    rivals : tuple of Set
        The same causes at other minima of the parameters that are nearly as likely.
    instead : dict
        For each cause by name: log odds of the sets with another cause in its place, by the name of that
        cause. The empty name stands for the set with none in its place.
    datum_reach : float
        Half the 95 % interval of the datum by its profile likelihood, in units of the parameters.
    """

    best: Set
    rivals: tuple[Set, ...] = ()
    instead: Instead = field(default_factory=dict)
    datum_reach: float = 0.0

    @property
    def ambiguous(self) -> bool:
        """Whether a rival has other displacements. Another datum or compliance only lengthens a ±."""
        count = self.best.fit.parameters.size
        displaced = [number for number in range(count) if number not in (DATUM, COMPLIANCE, CUP)]
        return any(_is_beyond_valley(self.best, rival, displaced) for rival in self.rivals)


def search(
    starts: list[LinearisedFit],
    every: LinearisedFit,
    rng: np.random.Generator,
    torque_zero: float = 0.0,
    first: Set | None = None,
) -> Found:
    """The best set of causes, and its rivals at other minima of the parameters.

    Parameters
    ----------
    starts : list of LinearisedFit
        At minima of the parameters, on some rows. The search for causes begins here. One fit may hold
        displacements as configured: a free displacement costs evidence even if it changes nothing.
    every : LinearisedFit
        On all rows. The causes found are weighed here, and small causes are searched for.
    rng : numpy.random.Generator
        Draws the samples of a restart.
    torque_zero : float
        The torque's zero by a fit from many starts [N m]. If it puts many torques on the other flank, steps
        from the reported torque cannot reach it.
    first : Set, optional
        :func:`without_causes` of the first start, if it is known.
    """
    work = every.work
    first = first or without_causes(starts[0])
    whiten = first.relearned.fit.whiten
    minima = [begun(replace(start, whiten=whiten)) for start in starts]
    if turned := _with_torque_zero(minima[0].at(starts[0].parameters), torque_zero):
        minima = [one.on(turned) for one in minima]
        minima.append(turned)
    rows = every.data.at.size
    minima = _sorted(minima, rows)
    scanned = minima[0]
    better, reach = _along_datum_in_time(scanned, rows)
    if better is not scanned:
        minima.insert(0, better)
    instead, restarts = Instead(), 0
    with work.until(SEARCHED, FURTHER_CAUSES):
        for turn in range(_TURNS):
            _tell(work, 0.0, turn, f"looking for cause {len(minima[0].causes) + 1}")
            found, instead = _better(minima[0].clear().relearned, {})
            if found is not None:
                minima[0] = found.polished(TO_MINIMUM)
                continue
            best = minima[0]
            if not best.causes or restarts == RESTARTS:
                break
            restarts += 1
            least = _on_rows(best, rows) - _HOPELESS
            others = [one for one in minima if _on_rows(one, rows) > least]
            minima = _sorted(_at_minima(best, others, rng), rows)
            if minima[0] is best:
                break
    if minima[0] is not scanned:
        minima[0], reach = _along_datum_in_time(minima[0], rows)
    some = _of_causes(minima[0])
    best = some.moved_to(every).settled(TO_MINIMUM).polished()
    if best.fit.held:  # all rows may show a displacement that some rows do not
        best = max(best, best.at(starts[0].parameters).settled(TO_MINIMUM), key=lambda one: one.value)
    instead = known = {name: odds for name, odds in _plain(instead).items() if name in some.names}
    with work.until(SEARCHED, FURTHER_CAUSES):
        for turn in range(_TURNS):
            _tell(work, 0.5, turn, "weighing causes on all rows")
            now = best.clear().relearned
            found, instead = _better(now, known)
            best = now if found is None else found
            if found is None:
                break
    rivals = _rivals(minima, best, rows)
    return Found(best, rivals, _beside_rivals({**known, **instead}, best, rivals), reach)


def _tell(work: Work, half: float, turn: int, text: str) -> None:
    """Report the progress of one half of a search: each turn adds 40 % of the part that remains."""
    share = half + 0.5 * (1.0 - _TURN**turn)
    work.tell(_FIRST + (SEARCHED - _FIRST) * share, text)


def _better(now: Set, known: Instead) -> tuple[Set | None, Instead]:
    """A better set, with one cause added, replaced or removed, or None; and the odds of the alternatives.

    Causes in `known` are not weighed again: their alternatives are known to be worse.
    """
    found = with_next(now) if len(now.causes) < _MOST else None
    return (_fewer(found), known) if found is not None else _exchanged(now, known)


def _gain(one: Set, now: Set) -> float:
    """Gain of a set over another [log odds], at most the gain with the noise learned given this set.

    With one noise alone, two sets could replace each other in turn. The gain of a set that is not sensible
    is minus infinity.
    """
    gain = one.value - now.value
    if gain <= 0.0:
        return gain
    own = one.relearned
    return min(gain, own.value - now.on(own).value) if own.sensible else -math.inf


def _plain(instead: Instead) -> Instead:
    """Alternatives of the causes that hold so clearly on some rows that all rows need no test."""
    return {name: odds for name, odds in instead.items() if max(odds.values()) < -_PLAINLY}


def _of_causes(at: Set) -> Set:
    """The set without terms of no known cause: on more rows a cause may explain the same better."""
    for effect, _ in at.causes:
        if isinstance(effect, UnmodelledTerm):
            at = at.without(effect.name)
    return at


def _on_rows(one: Set, rows: int) -> float:
    """Log evidence expected of a set on so many rows, if they are as informative as its own rows.

    A minimum with more free parameters may pay on all rows, though it does not pay on some.
    """
    more = rows / one.fit.data.at.size - 1.0
    return one.value - 0.5 * TEMPER * more * one.fit.deviance(one.chosen)


def _sorted(minima: list[Set], rows: int) -> list[Set]:
    """Sets by their log evidence expected on so many rows, the highest first."""
    return sorted(minima, key=lambda one: -_on_rows(one, rows))


def _rivals(minima: list[Set], best: Set, rows: int) -> tuple[Set, ...]:
    """The best set at other minima of the parameters, where it is nearly as likely.

    Minima that are nearly as likely on some rows are tried on all rows.
    """
    first, *others = minima
    least = math.log(1.0 - NAMED)
    close = _on_rows(first, rows) - _CLOSE
    near = [one for one in others if _on_rows(one, rows) > close and one.names == first.names]
    apart = [one.fit for one in near if _is_beyond_valley(first, one)]
    there = [best.at(fit.parameters, fit.held).settled() for fit in apart]
    return tuple(one for one in there if one.value > best.value + least and _is_beyond_valley(best, one))


def _beside_rivals(instead: Instead, best: Set, rivals: Sequence[Set]) -> Instead:
    """The same odds, but the odds of no cause are the highest over the best set and its rivals."""
    found = dict(instead)
    for name in instead.keys() & best.names:
        odds = [one.without(name).settled().value - best.value for one in rivals]
        found[name] = {**instead[name], "": max([instead[name].get("", -math.inf), *odds])}
    return found


def _is_beyond_valley(best: Set, other: Set, own: Sequence[int] | None = None) -> bool:
    """Whether another minimum lies outside the valley that the best set's covariance describes.

    Compares the parameters with indices `own`, by default all of them.
    """
    fit = best.fit
    numbers = list(range(fit.parameters.size) if own is None else own)
    spread = fit.fit(best.chosen)[1][np.ix_(numbers, numbers)]
    steps = ((one - fit.parameters)[numbers] for one in alike(other.fit.parameters, fit.data.configured))
    return min(float(step @ np.linalg.solve(spread, step)) for step in steps) > DISTINCT


def _with_torque_zero(at: Set, zero: float) -> Set | None:
    """The set with a torque offset of `zero`, on rows clear of both zeros; None if few change flanks."""
    torque = at.fit.data.record.torque
    effect = next((one for one in searched(at.fit) if one.name == _ZERO), None)
    if effect is None or np.mean((torque > 0.0) != (torque + zero > 0.0)) < _TURNED:
        return None
    item, widths = (effect, ()), {**at.widths, _ZERO: 1.0}
    more = replace(at, causes=(item,), widths=widths)
    there = replace(more, fit=more.fit.beside((*at.fit.present, (item, np.array([zero])))))
    return there.clear().settled(8)


def _exchanged(now: Set, known: Instead) -> tuple[Set | None, Instead]:
    """A better set with one cause replaced or removed, or None; and the odds of each cause's alternatives."""
    instead, senseless = Instead(), now.senseless  # with the noise learned given the set
    for effect, nonlinear in now.causes:
        if effect.name in known:
            instead[effect.name] = known[effect.name]
            continue
        bare = now.without(
            effect.name
        )  # at the parameters of the set with the cause: alternatives start here
        without = bare.settled(TO_MINIMUM)
        trials, itself = [without], _kind((effect, nonlinear))
        if now.before is not None and now.before.names == without.names:
            trials.append(now.before.on(now))  # the others may have moved to make room for it
        # Otherwise the gain of polishing, which any set has, would count for the cause.
        trials = [one.polished() if one.value > now.value - _CLOSE else one for one in trials]
        # Effects that no record can distinguish share the cause's odds by name, see `naming`.
        ranked = [one for one in candidates(without) if one.name not in effect.always_confused]
        own = max((one.gain for one in ranked if one.name == effect.name), default=math.inf)
        # Settling adds to an alternative and to the cause alike, so both gains are before settling.
        least = max(min(now.value - without.value, own) - _CLOSE, -_HOPEFUL)
        for one in ranked[:_RIVALS]:
            if _kind(one.item) != itself and one.gain > least:
                there = bare.beside(one.item, one.widths).settled(TO_MINIMUM)
                if there.sensible:
                    tried = [there, there.polished()] if there.value > now.value - _NEARLY else [there]
                    trials += [each for each in tried if each.foretells(one.name)]
        if effect.name in senseless:
            return max(trials, key=lambda one: one.value), {}
        gains = [_gain(one, now) for one in trials]
        if max(gains) > 0.0:
            return trials[int(np.argmax(gains))], {}
        odds = dict[str, float]()
        for trial, gain in zip(trials, gains, strict=True):
            name = "".join(trial.names - without.names)
            odds[name] = max(gain, odds.get(name, -math.inf))
        instead[effect.name] = odds
    return None, instead


def _kind(item: Item) -> tuple[str, tuple[float, ...]]:
    """A cause's name and its discrete nonlinear values: which tooth, which form."""
    effect, nonlinear = item
    pairs = zip(effect.nonlinear, nonlinear, strict=True)
    return effect.name, tuple(value for quantity, value in pairs if quantity.discrete)


def _along_datum_in_time(best: Set, rows: int) -> tuple[Set, float]:
    """As `_along_datum`; if its time is up, the same set and the largest step."""
    found = best, _DATUM_STEPS[-1]
    with best.fit.work.until(SEARCHED, DATUM_REACH):
        found = _along_datum(best, rows)
    return found


def _along_datum(best: Set, rows: int) -> tuple[Set, float]:
    """The best set over a scan of the datum, and half the datum's 95 % interval for `rows` rows.

    The datum makes a step at zero torque. Torsion of another shape can imitate it, which no slope shows. So
    the datum is held at values to either side and all else is settled there (a profile likelihood).
    """
    better, reach, times = best, 0.0, rows / best.fit.data.at.size
    for side in (1.0, -1.0):
        fit, before, known, falling = best.fit, (0.0, 0.0), False, None
        for away in _DATUM_STEPS:
            start = fit.parameters.copy()
            start[DATUM] = best.fit.parameters[DATUM] + side * away
            if not np.allclose(fit_parameters.admissible(start, best.fit.data.configured), start):
                break
            held = replace(fit.moved(start), held=(*best.fit.held, DATUM)).beside(fit.present)
            fit = settle(held, best.chosen, 1, learn=False)
            worse = times * (fit.deviance(best.chosen) - best.fit.deviance(best.chosen))
            if not known:
                known = worse > TWO_SIDED**2  # the deviance grows with the square of the step
                share = math.sqrt(max(TWO_SIDED**2 - before[1], 0.0) / (worse - before[1])) if known else 1.0
                reach = max(reach, before[0] + share * (away - before[0]))
            if worse > times * _HOPELESS:
                break
            # If the deviance falls again there is another minimum: start from its lowest value.
            if worse < before[1]:
                falling = fit
            elif falling is not None:
                better, falling = _freed(better, best, falling), None
            before = away, worse
        if falling is not None:
            better = _freed(better, best, falling)
    return better, reach


def _freed(better: Set, best: Set, held: LinearisedFit) -> Set:
    """The better of two sets: `better`, or `best` settled from a fit whose datum was held."""
    free = replace(best, fit=replace(held, held=best.fit.held)).settled()
    return free if free.value > better.value and free.sensible else better


def _at_minima(found: Set, others: list[Set], rng: np.random.Generator) -> list[Set]:
    """A set, and the same causes settled from other minima of the parameters and from a global search."""
    own = found.fit.data.configured
    points = [found.fit.parameters]
    sets = [found]
    if _may_be_elsewhere(found):
        others = [*others, found.at(restarted(found, rng))]
    for other in others:
        if len(distinct([*points, other.fit.parameters], own)) > len(points):
            points.append(other.fit.parameters)
            there = found.at(other.fit.parameters, other.fit.held).settled()
            if there.sensible:
                sets.append(there)
    return sets


def with_next(now: Set) -> Set | None:
    """The set with one more cause, settled; None if none is worth its cost and predicts held-out blocks."""
    ranked = [one for one in candidates(now) if one.gain > -_HOPEFUL]
    for _ in range(_AGAIN):
        if not ranked:
            break
        near = [one for one in ranked[:_TRIED] if one.gain > ranked[0].gain - _CLOSE]
        if (found := _best_of(near, now)) is not None:
            return found
        ranked = [one for one in ranked if one not in near]
    return None


def _best_of(near: Sequence[Candidate], now: Set) -> Set | None:
    """The best set with one of some candidates added; None if no candidate improves the set."""
    before = replace(now, before=None)
    there = [(one.name, replace(now.beside(one.item, one.widths), before=before)) for one in near]
    # If held-out blocks are not predicted before settling, only other nonlinear values can change this.
    settled = [(name, one.settled()) for name, one in there if one.may_foretell(name)]
    trials = [(name, one) for name, one in settled if one.sensible and one.may_foretell(name)]
    trials.sort(key=lambda pair: -pair[1].value)
    best = max([now.value, *(one.value for _, one in trials)])
    polished = [(name, one.polished()) for name, one in trials[:_POLISHED] if one.value > best - _NEARLY]
    # A polished cause may no longer predict held-out blocks: then the settled one is used.
    better = [(name, one) for name, one in (*polished, *trials) if one.sensible and one.value > now.value]
    better.sort(key=lambda pair: -pair[1].value)
    foretold = (one for name, one in better if one.foretells(name))
    return next((one for one in foretold if _gain(one, now) > 0.0), None)


def _may_be_elsewhere(at: Set) -> bool:
    """Whether another minimum may be better: a line stands in for a displacement, or there is a misfit.

    There is no misfit if columns that imitate any cause explain no more than noise lets them.
    """
    if any(at.widths[effect.name] > 1.0 for effect in (*ORDERS, PLACE)):
        return True
    more, here = at.fit.flexible(), at.fit.deviance(at.chosen)
    return bool(here - at.fit.deviance(at.chosen, more) > more.shape[1] + DISTINCT)


def restarted(at: Set, rng: np.random.Generator) -> Floats:
    """Parameters (p,) from a global search in which the causes of a set are free columns."""
    fit, own = at.fit, at.fit.data
    extra = fit.joined(at.causes)
    more = fit.effects.torque(fit.sized(at.chosen, fit.fit(at.chosen)[0]))[own.at]
    record = replace(own.record, torque=own.record.torque + more)
    return refit(record, own.configured, rng, extra, fit.parameters, FEW_STARTS).parameters


def _fewer(at: Set) -> Set:
    """The set without causes that cost more than they gain given the others; the last cause stays."""
    evidence = at.evidence()
    for effect, _ in at.causes[:-1]:
        rest = {name: width for name, width in at.widths.items() if name != effect.name}
        loss = at.value - at.presence - evidence.tuned(rest)[0] + presence(at.fit, effect)
        if loss < _CLOSE and (fewer := at.without(effect.name).settled()).value > at.value:
            return _fewer(fewer)
    return at
