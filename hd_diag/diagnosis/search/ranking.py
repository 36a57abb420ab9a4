"""Candidates ranked: each effect at its best grid point, by what it explains beside those chosen already."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import f_test, orthonormal, solve, surprise
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.effects.effect import Effect, Stage

_LOOKED_AT = 5.0  # surprise from which a candidate is looked at, at its size
_NEAR = 0.1  # of the best candidate's gain, from which another may be the better one at its size
_SECANTS = 3  # steps to the size of an effect that is not proportional to it
_PARALLEL = 1.0 - 1e-6  # cosine between columns that are the same but for a factor
_SAME = 0.02  # share of a size, within which a step leads to the same


@dataclass(frozen=True)
class Candidate:
    """An effect at its best grid point beside what is chosen already."""

    effect: Effect
    nonlinear: tuple[float, ...]
    gain: float
    p_value: float
    surprise: float


class Projector:
    """Projects whitened columns off the model, the encoders' offset and the chosen effects.

    Their prior stands below the samples, a row for each, and what a fit puts on a bound stays there: what
    only unheard-of values could imitate remains. Which do is seen in a fit with effects `beside` the chosen.
    """

    def __init__(self, fit: LinearisedFit, chosen: Chosen, beside: Chosen = ()) -> None:
        parts = [fit.always_white, *(fit.white(effect, nonlinear) for effect, nonlinear in chosen)]
        fixed = np.concatenate(parts, axis=1)
        held, steps = fit.on_bounds((*chosen, *beside))
        target = fit.residual_white - fixed[:, held] @ steps
        precision, pull = fit.prior(chosen)
        fixed[:, held], precision[held] = 0.0, 0.0
        self.basis = orthonormal(np.concatenate((fixed, np.diag(np.sqrt(precision)))))
        self.rest = self.off(target, np.sqrt(precision) * pull)
        self.deviance = float(self.rest @ self.rest)
        self.rows = int(np.count_nonzero(fit.residual_white))
        self.fitted = fixed.shape[1]

    def off(self, columns: Floats, below: Floats | None = None) -> Floats:
        """Columns less their projection, with a row below for each prior."""
        count = self.basis.shape[0] - columns.shape[0]
        below = np.zeros((count, *columns.shape[1:])) if below is None else below
        inner = self.basis[: columns.shape[0]].T @ columns + self.basis[columns.shape[0] :].T @ below
        found = np.concatenate((columns, below))
        found -= self.basis @ inner
        return found

    def gain(self, columns: Floats) -> float:
        """Fall of the residual sum of squares by these columns."""
        coefficients, moment = self.fit(columns)
        return float(moment @ coefficients)

    def fit_beyond(self, columns: Floats, beyond: Floats) -> tuple[Floats, float]:
        """Coefficients beside a whitened part that is present anyway, and the gain of both."""
        rest = self.rest - self.off(beyond)
        coefficients, moment = self.fit(columns, rest)
        return coefficients, self.deviance - float(rest @ rest) + float(moment @ coefficients)

    def fit(self, columns: Floats, rest: Floats | None = None) -> tuple[Floats, Floats]:
        """Coefficients of these columns, zero for those that vanish by projection, and their moments."""
        rest = self.rest if rest is None else rest  # projected already
        rows = slice(columns.shape[0])
        moment, square, inside = columns.T @ rest[rows], columns.T @ columns, self.basis[rows].T @ columns
        gram = square - inside.T @ inside
        own = np.diag(gram) > 1e-8 * np.maximum(np.diag(square), 1e-300)
        coefficients = np.zeros(moment.size)
        if own.any():
            coefficients[own] = solve(gram[np.ix_(own, own)], moment[own])
        return coefficients, np.where(own, moment, 0.0)


def candidates(fit: LinearisedFit, chosen: Chosen) -> list[Candidate]:
    """Every effect not chosen, at its best grid point, by the gain it brings; the best first."""
    return ranked(fit, chosen, fit.data.searched)


def ranked(fit: LinearisedFit, chosen: Chosen, effects: Sequence[Effect]) -> list[Candidate]:
    """Some effects beside those chosen already, each at its best grid point; the most surprising first.

    What the record cannot prove competes all the same: else the nearest of what it can would be named for it.
    """
    named = {effect.name for effect, _ in chosen}
    projector = Projector(fit, chosen)
    rest = fit.remainder(chosen)
    found = []
    for effect in effects:
        if effect.name in named or not competes(fit, effect):
            continue
        points = []
        for nonlinear in effect.starts(fit.signals, rest).points:
            white = fit.white(effect, nonlinear)
            if not white.shape[1]:  # of all rows, what the fitted ones have may be too much
                continue
            coefficients, moment = projector.fit(white)
            if effect.sensible(coefficients[: effect.size], nonlinear):
                gain = float(moment @ coefficients)
                points.append(_candidate(fit, projector, effect, nonlinear, gain))
        if points:
            found.append(sorted(points, key=_by_surprise))
    near = _NEAR * max((points[0].gain for points in found), default=0.0)
    best = []
    for points in found:
        one = points[0]
        if one.surprise > _LOOKED_AT and one.gain > near:
            if one.effect.proportional and not one.effect.own_slopes:
                one = _best_within_bounds(fit, chosen, projector, points)
            elif (gain := _gain_at_size(fit, projector, one)) > one.gain:
                one = _candidate(fit, projector, one.effect, one.nonlinear, gain)
        best.append(one)
    return sorted(best, key=_by_surprise)


def same_columns(fit: LinearisedFit, one: Item, other: Item) -> bool:
    """Whether two effects differ by a factor, as gain and zero of a torque that never changes."""
    first, second = (fit.columns(*item) for item in (one, other))
    if not first.shape[1] == second.shape[1] == 1:
        return False
    norms = float(np.linalg.norm(first) * np.linalg.norm(second))
    return abs(float(first[:, 0] @ second[:, 0])) > _PARALLEL * norms


def _by_surprise(candidate: Candidate) -> float:
    """The most surprising comes first."""
    return -candidate.surprise


def competes(fit: LinearisedFit, effect: Effect) -> bool:
    """Whether an effect can be judged: what acts under a torque that was not measured cannot."""
    known = fit.data.source.has_torque
    if fit.data.testable(effect)[0]:
        return known or effect.stage != Stage.TORQUE
    return known and effect.stage != Stage.NOWHERE


def _candidate(
    fit: LinearisedFit, projector: Projector, effect: Effect, nonlinear: tuple[float, ...], gain: float
) -> Candidate:
    width = fit.columns(effect, nonlinear).shape[1]
    after = projector.deviance - gain
    p = f_test(projector.deviance, after, width, projector.rows, projector.fitted + width)
    noise = max(after, 1e-300) / max(projector.rows - projector.fitted, 1)
    return Candidate(effect, nonlinear, gain, p, surprise(gain / noise, width))


def _best_within_bounds(
    fit: LinearisedFit, chosen: Chosen, projector: Projector, points: list[Candidate]
) -> Candidate:
    """The best point, the most surprising first, beside parameters within their bounds.

    Beyond them they imitate what no drive does; no gain is larger within.
    """

    def within(one: Candidate) -> Candidate:
        trial = (*chosen, (one.effect, one.nonlinear))
        gain = max(fit.deviance(chosen) - fit.deviance(trial), 0.0)
        return _candidate(fit, projector, *trial[-1], gain) if gain < one.gain else one

    best = within(points[0])
    for one in points[1:]:
        if best.surprise >= one.surprise:
            break
        best = min(best, within(one), key=_by_surprise)
    return best


def _gain_at_size(fit: LinearisedFit, projector: Projector, candidate: Candidate) -> float:
    """Gain at the size found, of an effect that is not its columns times its size."""
    effect, nonlinear = candidate.effect, candidate.nonlinear
    coefficients, _ = projector.fit(fit.white(effect, nonlinear))
    best = 0.0
    for _ in range(_SECANTS):
        at = fit.beside((*fit.present, ((effect, nonlinear), coefficients)))
        beyond = fit.residual - at.residual
        white = fit.whiten(np.column_stack((at.columns(effect, nonlinear), beyond)), fit.data.run)
        before = coefficients
        coefficients, gain = projector.fit_beyond(white[:, :-1], white[:, -1])
        best = max(best, gain)
        if np.linalg.norm(coefficients - before) < _SAME * np.linalg.norm(before):
            break
    return best


def family_size(fit: LinearisedFit) -> int:
    """Number of hypotheses: candidates times grid points."""
    return sum(effect.starts(fit.signals).trials for effect in fit.data.searched if competes(fit, effect))


def by_name(fit: LinearisedFit, names: Collection[str]) -> list[Effect]:
    """The effects searched for that have these names."""
    return [effect for effect in fit.data.searched if effect.name in names]
