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
from hd_diag.diagnosis.evidence.unmodelled_terms import OUTPUT_LINES, UNMODELLED_TERMS
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import COMPLIANCE, CUP, DATUM, alike
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.diagnosis.fit.refit import DISTINCT, FEW_STARTS, distinct, refit
from hd_diag.diagnosis.work import Work
from hd_diag.effects.effect import Effect, Stage
from hd_diag.effects.remainders import ORDERS, PLACE

_MOST, _TURNS = 5, 12  # causes; turns of a search
_RIVALS = 6  # of each cause, that are settled in its place
_TRIED = 4  # candidates that are settled in each turn
_POLISHED = 2  # of these, at most
_AGAIN = 2  # times that some are: the next best where none of the best is foretold
_HOPEFUL = 2.0  # log odds that a candidate may lack where the fit stands: steps of the parameters bring more
_OF_MODEL = ("torsional_hardening",)  # the torsion's own shape
_ZERO, _TURNED = "torque_offset", 0.01  # share of the torques that another zero must put on the other flank
_BY_TORQUE = ("friction", "torsion")
_HOPELESS = 100.0  # log odds, beyond which another minimum is not followed
_CLOSE = 10.0  # log odds, within which a set is settled before it is judged
_NEARLY = 5.0  # the same, within which its nonlinear values are settled as well
_DATUM_STEPS = (2.0, 4.0, 8.0, 16.0)  # to either side, in units of the parameters
_PLAINLY = 25.0  # log odds on some rows, from which a cause holds on all
_TO_MINIMUM = 5  # rounds of settling
_FIRST, _TURN = 0.15, 0.6  # of the time, that is gone before; of what is left of the search, after each turn
RESTARTS = 1  # times that the parameters are searched for again, beside the causes by then


SEARCHED = 0.6
"""Share of the time that a diagnosis may take, by which the search must end."""

FURTHER_CAUSES = "looking for further causes"
DATUM_REACH = "how far the datum may be off"
"""What is left out where it has no more time."""


class Candidate(NamedTuple):
    """A cause at a point of its grid, and what it would bring where the fit stands [log odds]."""

    name: str
    item: Item
    gain: float
    widths: dict[str, float]


def competes(fit: LinearisedFit, effect: Effect) -> bool:
    """Whether an effect can be judged: what acts under a torque that was not measured cannot.

    What the record cannot prove competes all the same: else the nearest of what it can would be named for it.
    """
    known = fit.data.source.has_torque
    if fit.data.testable(effect)[0]:
        return known or effect.stage != Stage.TORQUE
    return known and effect.stage != Stage.NOWHERE


def is_searched(fit: LinearisedFit, effect: Effect) -> bool:
    """Whether a record can be searched for a cause.

    By a motor's current what acts as torque is the motor's own. Parameters and the torsion's shape are none.
    """
    of_motor = effect.kind in _BY_TORQUE or effect.stage == Stage.TORQUE
    return competes(fit, effect) and effect.name not in _OF_MODEL and not (fit.data.given and of_motor)


def searched(fit: LinearisedFit) -> list[Effect]:
    """Causes and shapes of no known cause that a record can be searched for."""
    causes = [effect for effect in fit.data.searched if is_searched(fit, effect)]
    return [*causes, *(term for term in UNMODELLED_TERMS if fit.data.testable(term)[0])]


def candidates(at: Set) -> list[Candidate]:
    """Every cause that is not in a set, at its best grid point beside it; the best first."""
    fit, chosen = at.fit, at.chosen
    rest = fit.remainder(chosen)
    points: dict[str, tuple[Effect, tuple[float, ...]]] = {}
    lines = [line.name for line in OUTPUT_LINES if line.name not in at.names][1:]  # alike: the first will do
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
    """Widths of a set, and with remainders that have grown back at their usual size: one, or all of them.

    A remainder that has grown hides the cause that it grew for.
    """
    grown = [effect.name for effect, _ in at.remainders.items if at.widths[effect.name] > 1.0]
    every = [dict(at.widths), *({**at.widths, name: 1.0} for name in grown)]
    return every if len(grown) < 2 else [*every, {**at.widths, **dict.fromkeys(grown, 1.0)}]


def begun(fit: LinearisedFit) -> Set:
    """The set without causes where a fit stands, settled."""
    drive = fit.data.configured
    slope = np.abs(fit.data.model.at(fit_parameters.vector(drive, drive)).signals.predicted_torque_slope)
    finite = slope[np.isfinite(slope)]  # it is without end in the gap between the flanks
    compliance = float(np.median(finite)) if finite.size else 0.0
    start = Set(fit, Remainders.of(fit.data.source, drive, compliance), (), fit.data.given)
    first = start.valued().settled().polished(_TO_MINIMUM)
    return max([first, *_by_no_motor(first)], key=lambda one: one.value)


def _by_no_motor(at: Set) -> list[Set]:
    """The same from where a motor takes nothing of its current: what it takes has several minima."""
    points = [(effect, nonlinear) for effect, _ in at.motor for nonlinear in effect.grid]
    nothing = [(one, np.zeros(one[0].size)) for one in points]
    starts = [replace(at, fit=at.fit.beside((one,)), motor=(one[0],), widths={}) for one in nothing]
    return [one.valued().settled().polished(_TO_MINIMUM) for one in starts]


Instead = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Found:
    """The best set of causes, and what else was weighed against it.

    Attributes
    ----------
    best : Set
    rivals : tuple of Set
        The same causes at other minima of the parameters that are nearly as good.
    instead : dict
        Of each cause by name: log odds of sets with another in its place, by that one's name; with none in
        its place, by the empty name.
    datum_reach : float
        Half the 95 % interval of the datum, by the likelihood along it, in units of the parameters.
    """

    best: Set
    rivals: tuple[Set, ...] = ()
    instead: Instead = field(default_factory=dict)
    datum_reach: float = 0.0

    @property
    def ambiguous(self) -> bool:
        """Whether a rival is displaced otherwise; that its teeth or its datum are others makes a ± longer."""
        count = self.best.fit.parameters.size
        displaced = [number for number in range(count) if number not in (DATUM, COMPLIANCE, CUP)]
        return any(_is_beyond_valley(self.best, rival, displaced) for rival in self.rivals)


def search(
    starts: list[LinearisedFit], every: LinearisedFit, rng: np.random.Generator, torque_zero: float = 0.0
) -> Found:
    """The best set of causes, and what other minima of the parameters make of it.

    Parameters
    ----------
    starts : list of LinearisedFit
        At minima of the parameters, on some rows: there causes are looked for. One may hold displacements as
        configured: a free one costs what the record tells of it, even where it does nothing.
    every : LinearisedFit
        On all rows: there what was found is weighed, and what is small is looked for.
    rng : numpy.random.Generator
        Chooses the samples of other starts.
    torque_zero : float
        The torque's zero by a fit from many starts [N m]: one that puts many torques on the other flank is
        out of reach of steps from the reported torque.
    """
    work = every.work
    first = begun(starts[0].with_noise(starts[0].data.given))
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
                minima[0] = found.polished(_TO_MINIMUM)
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
    best, known = minima[0].moved_to(every).settled(_TO_MINIMUM).polished(), _plain(instead)
    if best.fit.held:  # all rows may show a displacement that some do not
        best = max(best, best.at(starts[0].parameters).settled(_TO_MINIMUM), key=lambda one: one.value)
    instead = known
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
    """How far one half of a search is: each turn takes most of what is left."""
    share = half + 0.5 * (1.0 - _TURN**turn)
    work.tell(_FIRST + (SEARCHED - _FIRST) * share, text)


def _better(now: Set, known: Instead) -> tuple[Set | None, Instead]:
    """A set with one cause more, or another in the place of one; None where none is better.

    Of some causes it may be `known` that nothing is.
    """
    found = _next(now) if len(now.causes) < _MOST else None
    return (_fewer(found), known) if found is not None else _exchanged(now, known)


def _gain(one: Set, now: Set) -> float:
    """What a set has more than another, no more than by the noise learned beside it [log odds].

    By one noise alone each of two may give way to the other. A set that is not sensible has nothing more.
    """
    gain = one.value - now.value
    if gain <= 0.0:
        return gain
    own = one.relearned
    return min(gain, own.value - now.on(own).value) if own.sensible else -math.inf


def _plain(instead: Instead) -> Instead:
    """Those of causes which hold so plainly on some rows that all rows need not be asked."""
    return {name: odds for name, odds in instead.items() if max(odds.values()) < -_PLAINLY}


def _on_rows(one: Set, rows: int) -> float:
    """Log evidence that a set may have on so many rows, if they tell as much as those that it is on.

    A minimum that costs parameters may be worth them on all rows, and not on some.
    """
    more = rows / one.fit.data.at.size - 1.0
    return one.value - 0.5 * TEMPER * more * one.fit.deviance(one.chosen)


def _sorted(minima: list[Set], rows: int) -> list[Set]:
    """By what they may be on so many rows, the best first."""
    return sorted(minima, key=lambda one: -_on_rows(one, rows))


def _rivals(minima: list[Set], best: Set, rows: int) -> tuple[Set, ...]:
    """The best set at other minima of the parameters, where it is nearly as likely.

    Of the minima on some rows those are tried that are near there, on all rows.
    """
    first, *others = minima
    least = math.log(1.0 - NAMED)
    close = _on_rows(first, rows) - _CLOSE
    near = [one for one in others if _on_rows(one, rows) > close and one.names == first.names]
    apart = [one.fit for one in near if _is_beyond_valley(first, one)]
    there = [best.at(fit.parameters, fit.held).settled() for fit in apart]
    return tuple(one for one in there if one.value > best.value + least and _is_beyond_valley(best, one))


def _beside_rivals(instead: Instead, best: Set, rivals: Sequence[Set]) -> Instead:
    """The same, where none in a cause's place may be as likely with the parameters of a rival."""
    found = dict(instead)
    for name in instead.keys() & best.names:
        odds = [one.without(name).settled().value - best.value for one in rivals]
        found[name] = {**instead[name], "": max([instead[name].get("", -math.inf), *odds])}
    return found


def _is_beyond_valley(best: Set, other: Set, own: Sequence[int] | None = None) -> bool:
    """Whether another minimum is no place in the valley that the best one's covariance tells of.

    By some parameters alone, all where their numbers are not given.
    """
    fit = best.fit
    numbers = list(range(fit.parameters.size) if own is None else own)
    spread = fit.fit(best.chosen)[1][np.ix_(numbers, numbers)]
    steps = ((one - fit.parameters)[numbers] for one in alike(other.fit.parameters, fit.data.configured))
    return min(float(step @ np.linalg.solve(spread, step)) for step in steps) > DISTINCT


def _with_torque_zero(at: Set, zero: float) -> Set | None:
    """With an offset of the torque as large as a zero, clear of both; None where few change flanks."""
    torque = at.fit.data.record.torque
    effect = next((one for one in searched(at.fit) if one.name == _ZERO), None)
    if effect is None or np.mean((torque > 0.0) != (torque + zero > 0.0)) < _TURNED:
        return None
    item, widths = (effect, ()), {**at.widths, _ZERO: 1.0}
    more = replace(at, causes=(item,), widths=widths)
    there = replace(more, fit=more.fit.beside((*at.fit.present, (item, np.array([zero])))))
    return there.clear().settled(8)


def _exchanged(now: Set, known: Instead) -> tuple[Set | None, Instead]:
    """A better set with another cause in the place of one, if there is any; and what was weighed for each."""
    instead, senseless = Instead(), now.senseless  # by the noise learned beside it
    for effect, nonlinear in now.causes:
        if effect.name in known:
            instead[effect.name] = known[effect.name]
            continue
        without = now.without(effect.name).settled(_TO_MINIMUM)
        trials, itself = [without], _kind((effect, nonlinear))
        if now.before is not None and now.before.names == without.names:
            trials.append(now.before.on(now))  # the others may have moved to make room for it
        # Else what polishing brings any set would count for the cause.
        trials = [one.polished() if one.value > now.value - _CLOSE else one for one in trials]
        # What is alike on any record is weighed by its name alone.
        ranked = [one for one in candidates(without) if one.name not in effect.always_confused]
        own = max((one.gain for one in ranked if one.name == effect.name), default=math.inf)
        # What settling brings more, it brings the cause itself as well; none is better than what has no hope.
        least = max(min(now.value - without.value, own) - _CLOSE, -_HOPEFUL)
        for one in ranked[:_RIVALS]:
            if _kind(one.item) != itself and one.gain > least:
                there = without.beside(one.item, one.widths).settled()
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
    """A cause's name and the discrete ones of its nonlinear values: which tooth, which form."""
    effect, nonlinear = item
    pairs = zip(effect.nonlinear, nonlinear, strict=True)
    return effect.name, tuple(value for quantity, value in pairs if quantity.discrete)


def _along_datum_in_time(best: Set, rows: int) -> tuple[Set, float]:
    """As `_along_datum`; where there is no time for it the same set, and the farthest that is looked at."""
    found = best, _DATUM_STEPS[-1]
    with best.fit.work.until(SEARCHED, DATUM_REACH):
        found = _along_datum(best, rows)
    return found


def _along_datum(best: Set, rows: int) -> tuple[Set, float]:
    """The best set with any datum, and how far the datum reaches at 95 % by so many rows as there are in all.

    A torsion of another shape imitates its step at the zero of the torque, of which no slope tells: so it is
    held at values to either side, all else settled there (a profile likelihood).
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
                known = worse > TWO_SIDED**2  # it grows with the square
                share = math.sqrt(max(TWO_SIDED**2 - before[1], 0.0) / (worse - before[1])) if known else 1.0
                reach = max(reach, before[0] + share * (away - before[0]))
            if worse > times * _HOPELESS:
                break
            # Where it gets better again there is another minimum: at the least of the fall.
            if worse < before[1]:
                falling = fit
            elif falling is not None:
                better, falling = _freed(better, best, falling), None
            before = away, worse
        if falling is not None:
            better = _freed(better, best, falling)
    return better, reach


def _freed(better: Set, best: Set, held: LinearisedFit) -> Set:
    """The better of a set and of another, settled from where its datum was held."""
    free = replace(best, fit=replace(held, held=best.fit.held)).settled()
    return free if free.value > better.value and free.sensible else better


def _at_minima(found: Set, others: list[Set], rng: np.random.Generator) -> list[Set]:
    """The same causes from other minima of the parameters, and from a global search."""
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


def _next(now: Set) -> Set | None:
    """The set with one cause more, settled; None where none is worth its cost and foretold."""
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
    """The best set with one of some candidates more; None where none is better than without."""
    before = replace(now, before=None)
    there = [(one.name, replace(now.beside(one.item, one.widths), before=before)) for one in near]
    # What blocks do not foretell where the fit stands, they do a step away only with other nonlinear values.
    settled = [(name, one.settled()) for name, one in there if one.may_foretell(name)]
    trials = [(name, one) for name, one in settled if one.sensible and one.may_foretell(name)]
    trials.sort(key=lambda pair: -pair[1].value)
    best = max([now.value, *(one.value for _, one in trials)])
    polished = [(name, one.polished()) for name, one in trials[:_POLISHED] if one.value > best - _NEARLY]
    # Polished, a cause may fit what blocks do not foretell: then it stays as it was.
    better = [(name, one) for name, one in (*polished, *trials) if one.sensible and one.value > now.value]
    better.sort(key=lambda pair: -pair[1].value)
    foretold = (one for name, one in better if one.foretells(name))
    return next((one for one in foretold if _gain(one, now) > 0.0), None)


def _may_be_elsewhere(at: Set) -> bool:
    """Whether another minimum may do better: one of a displacement that a line stands for, or in a misfit.

    Where columns that any cause may look like explain no more than noise gives them, no other minimum can.
    """
    if any(at.widths[effect.name] > 1.0 for effect in (*ORDERS, PLACE)):
        return True
    more, here = at.fit.flexible(), at.fit.deviance(at.chosen)
    return bool(here - at.fit.deviance(at.chosen, more) > more.shape[1] + DISTINCT)


def restarted(at: Set, rng: np.random.Generator) -> Floats:
    """Parameters (p,) that a global search leads to, the causes of a set taking part freely."""
    fit, own = at.fit, at.fit.data
    extra = fit.joined(at.causes)
    more = fit.effects.torque(fit.sized(at.chosen, fit.fit(at.chosen)[0]))[own.at]
    record = replace(own.record, torque=own.record.torque + more)
    return refit(record, own.configured, rng, extra, fit.parameters, FEW_STARTS).parameters


def _fewer(at: Set) -> Set:
    """Without causes that cost more than they bring beside the others."""
    evidence = at.evidence()
    for effect, _ in at.causes[:-1]:
        rest = {name: width for name, width in at.widths.items() if name != effect.name}
        loss = at.value - at.presence - evidence.tuned(rest)[0] + presence(at.fit, effect)
        if loss < _CLOSE and (fewer := at.without(effect.name).settled()).value > at.value:
            return _fewer(fewer)
    return at
