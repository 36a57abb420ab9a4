"""Candidates ranked: each effect at its best grid point, by what it explains beside those chosen already."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import f_test, orthonormal, solve, surprise
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.effects.effect import Effect

_LOOKED_AT = 5.0  # surprise from which a candidate is looked at, at its size
_SECANTS = 3  # steps to the size of an effect that is not proportional to it


@dataclass(frozen=True)
class Candidate:
    """An effect at its best grid point beside what is chosen already."""

    effect: Effect
    nonlinear: tuple[float, ...]
    gain: float
    p_value: float
    surprise: float


class Projector:
    """What the model, nuisance and chosen effects leave of whitened columns.

    Parameters
    ----------
    bench : LinearisedFit
    chosen : sequence of (Effect, nonlinear values)
    """

    def __init__(self, bench: LinearisedFit, chosen: Chosen) -> None:
        parts = [bench.always_white, *(bench.white(effect, nonlinear) for effect, nonlinear in chosen)]
        fixed = np.concatenate(parts, axis=1)
        self.basis = orthonormal(fixed)
        self.rest = bench.residual_white - self.basis @ (self.basis.T @ bench.residual_white)
        self.deviance = float(self.rest @ self.rest)
        self.rows = int(np.count_nonzero(bench.residual_white))
        self.fitted = fixed.shape[1]

    def gain(self, columns: Floats) -> float:
        """Fall of the residual sum of squares by these columns."""
        coefficients, moment = self.fit(columns)
        return float(moment @ coefficients)

    def fit_beyond(self, columns: Floats, beyond: Floats) -> tuple[Floats, float]:
        """Coefficients beside a whitened part that is there anyway, and the gain of both."""
        rest = self.rest - (beyond - self.basis @ (self.basis.T @ beyond))
        coefficients, moment = self.fit(columns, rest)
        return coefficients, self.deviance - float(rest @ rest) + float(moment @ coefficients)

    def fit(self, columns: Floats, rest: Floats | None = None) -> tuple[Floats, Floats]:
        """Coefficients of these columns, zero for those that nothing is left of, and their moments."""
        part = columns - self.basis @ (self.basis.T @ columns)
        moment = part.T @ (self.rest if rest is None else rest)
        own = np.einsum("ij,ij->j", part, part) > 1e-8 * np.maximum(
            np.einsum("ij,ij->j", columns, columns), 1e-300
        )
        coefficients = np.zeros(moment.size)
        if own.any():
            coefficients[own] = solve(part[:, own].T @ part[:, own], moment[own])
        return coefficients, moment


def candidates(bench: LinearisedFit, chosen: Chosen) -> list[Candidate]:
    """Every effect not chosen, at its best grid point, by the gain it brings; the best first."""
    return ranked(bench, chosen, bench.data.searched)


def ranked(
    bench: LinearisedFit, chosen: Chosen, effects: Sequence[Effect], untested: Collection[str] = ()
) -> list[Candidate]:
    """Some effects, each at its best grid point; the most surprising first.

    Parameters
    ----------
    bench : LinearisedFit
    chosen : sequence of (Effect, nonlinear values)
        Beside which they are looked at; its own effects are no candidates.
    effects : sequence of Effect
    untested : collection of str
        Names that take part although the motion does not allow to find them.

    Returns
    -------
    list of Candidate
    """
    named = {effect.name for effect, _ in chosen}
    projector = Projector(bench, chosen)
    rest = bench.remainder(chosen)
    found = []
    for effect in effects:
        if effect.name in named or not (bench.data.testable(effect)[0] or effect.name in untested):
            continue
        best: Candidate | None = None
        for nonlinear in effect.starts(bench.signals, rest).points:
            coefficients, moment = projector.fit(bench.white(effect, nonlinear))
            if not effect.sensible(coefficients[: effect.size], nonlinear):
                continue
            gain = float(moment @ coefficients)
            one = _candidate(bench, projector, effect, nonlinear, gain)
            if best is None or one.surprise > best.surprise:
                best = one
        if best is not None:
            gain = _gain_at_size(bench, projector, best) if best.surprise > _LOOKED_AT else 0.0
            if gain > best.gain:
                best = _candidate(bench, projector, effect, best.nonlinear, gain)
            found.append(best)
    return sorted(found, key=lambda candidate: -candidate.surprise)


def _candidate(
    bench: LinearisedFit, projector: Projector, effect: Effect, nonlinear: tuple[float, ...], gain: float
) -> Candidate:
    width = bench.columns(effect, nonlinear).shape[1]
    after = projector.deviance - gain
    p = f_test(projector.deviance, after, width, projector.rows, projector.fitted + width)
    noise = max(after, 1e-300) / max(projector.rows - projector.fitted, 1)
    return Candidate(effect, nonlinear, gain, p, surprise(gain / noise, width))


def _gain_at_size(bench: LinearisedFit, projector: Projector, candidate: Candidate) -> float:
    """Gain with the columns that hold at the size found, where an effect has such."""
    effect, nonlinear = candidate.effect, candidate.nonlinear
    if not effect.own_slopes:
        return 0.0
    coefficients, _ = projector.fit(bench.white(effect, nonlinear))
    best = 0.0
    for _ in range(_SECANTS):
        columns = np.nan_to_num(effect.slopes(bench.signals, coefficients, nonlinear))
        beyond = bench.full_size(effect, nonlinear, coefficients) - columns @ coefficients
        white = bench.whiten(np.column_stack((columns, beyond)), bench.data.run)
        coefficients, gain = projector.fit_beyond(white[:, :-1], white[:, -1])
        best = max(best, gain)
    return best


def family_size(bench: LinearisedFit) -> int:
    """Number of hypotheses: candidates times grid points."""
    testable = [effect for effect in bench.data.searched if bench.data.testable(effect)[0]]
    return sum(effect.starts(bench.signals).trials for effect in testable)


def by_name(bench: LinearisedFit, names: Collection[str]) -> list[Effect]:
    """The effects searched for that have these names."""
    return [effect for effect in bench.data.searched if effect.name in names]
