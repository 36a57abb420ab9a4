"""Search for the set of causes with the most evidence."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hd_diag.diagnosis.evidence.calibration import SIZES
from hd_diag.diagnosis.evidence.sets import Remainders, Set, presence
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.diagnosis.fit.refit import FEW_STARTS, distinct, refit
from hd_diag.diagnosis.search.ranking import competes
from hd_diag.diagnosis.search.unmodelled_terms import OUTPUT_LINES, UNMODELLED_TERMS
from hd_diag.effects.effect import Effect, Stage

_MOST = 5  # causes
_TRIED = 4  # candidates that are settled in each turn
_NEAR = 0.5  # share of the best candidate's gain from which another is tried
_SHAPES = ("torsional_hardening",)  # torsion's own shape: a remainder
_TERMS = ("creep", "rests", "place", "sided_torque")
_BY_TORQUE = ("friction", "torsion")
RESTARTS = 2  # causes, up to which each lets the parameters be searched for again


class Candidate(NamedTuple):
    """A cause at a point of its grid, and what it would bring where the fit stands [log odds]."""

    name: str
    item: Item
    gain: float
    widths: dict[str, float]


def searched(fit: LinearisedFit) -> list[Effect]:
    """Causes that a record can be searched for.

    By a motor's current what acts as torque is the motor's own; torsion's shape is a remainder.
    """
    causes = [
        effect
        for effect in fit.data.searched
        if competes(fit, effect) and effect.name not in _SHAPES and not (fit.data.given and _of_motor(effect))
    ]
    terms = [term for term in (*UNMODELLED_TERMS, OUTPUT_LINES[0]) if term.name in _TERMS or term in OUTPUT_LINES]
    return [*causes, *(term for term in terms if fit.data.testable(term)[0])]


def _of_motor(effect: Effect) -> bool:
    return effect.kind in _BY_TORQUE or effect.stage == Stage.TORQUE


def candidates(at: Set, refused: Collection[str] = ()) -> list[Candidate]:
    """Every cause that is not in a set, at its best grid point beside it; the best first."""
    fit, chosen = at.fit, at.chosen
    rest = fit.remainder(chosen)
    points: dict[str, tuple[Effect, tuple[float, ...]]] = {}
    for effect in searched(fit):
        if effect.name in at.names or effect.name in refused:
            continue
        for number, nonlinear in enumerate(effect.starts(fit.signals, rest).points):
            if fit.white(effect, nonlinear).shape[1]:
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
    start = Set(fit, Remainders.of(fit.data.source, float(np.median(slope))), ())
    return start.valued().settled()


def search(starts: list[LinearisedFit], rng: np.random.Generator) -> Set:
    """The best set of causes, from the best of some starts on."""
    first = begun(starts[0]).relearned().settled()
    best = first
    for start in starts[1:]:
        other = begun(replace(start, whiten=first.fit.whiten))
        if other.value > best.value:
            best = other
    refused = set[str]()
    for _ in range(2 * _MOST):
        if len(best.causes) >= _MOST:
            break
        now = best.relearned()
        found = _next(now, refused, rng)
        if found is None:
            break
        best = _exchanged(_fewer(found), rng)
    return best


def _next(now: Set, refused: set[str], rng: np.random.Generator) -> Set | None:
    """The set with one cause more, settled; None where none brings more than it costs."""
    ranked = [one for one in candidates(now, refused) if one.gain > 0.0]
    if not ranked:
        return None
    near = [one for one in ranked[:_TRIED] if one.gain > _NEAR * ranked[0].gain or one.gain > ranked[0].gain - 10.0]
    trials = [now.beside(one.item, one.widths).settled() for one in near]
    trials = [one for one in trials if one.sensible]
    if len(now.causes) < RESTARTS:
        trials += [again for one in trials[:2] if (again := restarted(one, rng)) is not None]
    best = max(trials, key=lambda one: one.value, default=None)
    return best if best is not None and best.value > now.value else None


def restarted(at: Set, rng: np.random.Generator) -> Set | None:
    """The same causes where a global search of the parameters leads beside them; None where it leads back."""
    fit, own = at.fit, at.fit.data
    extra = fit.joined(at.causes)
    more = fit.effects.torque(fit.sized(at.chosen, fit.fit(at.chosen)[0]))[own.at]
    record = replace(own.record, torque=own.record.torque + more)
    again = refit(record, own.configured, rng, extra, fit.parameters, FEW_STARTS, held=fit.held)
    if not distinct([fit.parameters, again.parameters], own.configured)[1:]:
        return None
    return replace(at, fit=fit.moved(again.parameters).beside(fit.present)).settled()


def _fewer(at: Set) -> Set:
    """Without causes that cost more than they bring beside the others."""
    for effect, _ in at.causes[:-1]:
        fewer = at.without(effect.name).settled()
        if fewer.value > at.value:
            return _fewer(fewer)
    return at


def _exchanged(at: Set, rng: np.random.Generator) -> Set:
    return at
