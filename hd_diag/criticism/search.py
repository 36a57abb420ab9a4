"""Search for causes: forward selection by groups of columns, held-out gain, swaps, drops and classes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from hd_diag.criticism import base
from hd_diag.criticism.design import f_test, holds, interval, solve, surprise
from hd_diag.criticism.foils import FOILS, Foil
from hd_diag.criticism.polish import covariance, free, polished
from hd_diag.criticism.refit import FEW_STARTS, distinct, refit
from hd_diag.criticism.workbench import SEARCHED, Chosen, Workbench, settle
from hd_diag.effects.effect import Effect
from hd_diag.model.torsion_map import ARCSEC

Floats = npt.NDArray[np.float64]

FAMILY_ERROR = 0.01
"""Chance of any false name by noise, over all candidates and grid points."""

LEAST_SIZE = 0.25 * ARCSEC
"""A cause smaller than this beside the refitted model is of no practical size [rad rms]."""

CLASS_DEVIANCE = 10.0
"""Causes whose exchange moves the held-out deviance by less cannot be told apart."""

_NAMES = {effect.name: effect for effect in SEARCHED}
_MOST_CAUSES = 4
_SLOW = 0.34  # share of the samples that count as slow
_MOST_FOILS = 3
_RIVALS = 6  # best candidates of a round that are looked at again in place of others
_CERTAIN_SIZE = 0.5 * ARCSEC  # of a shape that nothing held out can prove [rad rms]
_SECONDS = 2.5  # of a mean in which quick noise is gone
_LASTING_CHANCE = 1e-6
_UNEVEN = 1.3  # ratio of what is left fast and slow that asks for a look
_RESTART_GAIN = 12.0  # deviance by which another minimum must beat the present one


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
        After correction for the whole family of candidates.
    alike : tuple of str
        Names that this record cannot tell from it, itself first.
    gain : float
    gain_low, gain_high : float
        Share of the held-out deviance that it explains, with its interval.
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


@dataclass(frozen=True)
class Candidate:
    """An effect at its best grid point beside what is chosen already."""

    effect: Effect
    nonlinear: tuple[float, ...]
    gain: float
    p_value: float
    surprise: float


@dataclass(frozen=True)
class Search:
    """Result of a search: the bench at the final parameters, the causes, most explaining first, and foils."""

    bench: Workbench
    causes: tuple[Cause, ...]
    foils: Chosen = ()

    @property
    def chosen(self) -> Chosen:
        """Effects and their nonlinear values, then the shapes that have no name."""
        named = tuple((cause.effect, cause.nonlinear) for cause in self.causes)
        return (*named, *self.foils)


def search(bench: Workbench, progress: Callable[[str], None] = lambda text: None) -> Search:
    """Find the causes of what the refitted model leaves.

    Parameters
    ----------
    bench : Workbench
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
    family, rivals = _family(bench), set[str]()
    for _ in range(_MOST_CAUSES + _MOST_FOILS):
        progress(f"looking for cause {len(chosen) + 1}")
        if not chosen and speed_dependent(bench):
            bench = _begun_slowly(bench)
        ranked = candidates(bench, chosen) if _named(chosen) < _MOST_CAUSES else []
        rivals |= {candidate.effect.name for candidate in ranked[:_RIVALS]}
        found = _next(bench, chosen, family, ranked)
        if found is None:
            break
        p_values[found.effect.name] = found.p_value
        chosen = (*chosen, (found.effect, found.nonlinear))
        bench, chosen = _refined(bench, chosen)
        if isinstance(found.effect, Foil):  # a cause that was only the nearest to it is not needed any more
            chosen = _kept(bench, chosen)
            continue
        bench, chosen = _swapped(bench, chosen, rivals)
        if len(chosen) == 1:
            bench = _restarted(bench, chosen)
    chosen = _kept(bench, chosen)
    bench, chosen = _finished(settle(bench, chosen), chosen)
    foils = tuple(item for item in chosen if isinstance(item[0], Foil))
    return Search(bench, _causes(bench, chosen, p_values, rivals), foils)


def candidates(bench: Workbench, chosen: Chosen) -> list[Candidate]:
    """Every effect not chosen, at its best grid point, by the gain it brings; the best first."""
    return _ranked(bench, chosen, SEARCHED)


def _ranked(
    bench: Workbench, chosen: Chosen, effects: Sequence[Effect], untested: Collection[str] = ()
) -> list[Candidate]:
    named = {effect.name for effect, _ in chosen}
    projector = _Projector(bench, chosen)
    rest = bench.remainder(chosen)
    found = []
    for effect in effects:
        if effect.name in named or not (bench.testable(effect)[0] or effect.name in untested):
            continue
        best: tuple[float, tuple[float, ...]] | None = None
        for nonlinear in effect.scan(bench.signals, rest):
            gain = projector.gain(bench.white(effect, nonlinear))
            if best is None or gain > best[0]:
                best = gain, nonlinear
        if best is not None:
            best = max(best, (_gain_at_size(bench, projector, effect, best[1]), best[1]))
            width = bench.columns(effect, best[1]).shape[1]
            p = f_test(
                projector.deviance,
                projector.deviance - best[0],
                width,
                projector.rows,
                projector.fitted + width,
            )
            noise = max(projector.deviance - best[0], 1e-300) / max(projector.rows - projector.fitted, 1)
            found.append(Candidate(effect, best[1], best[0], p, surprise(best[0] / noise, width)))
    return sorted(found, key=lambda candidate: -candidate.surprise)


def _gain_at_size(
    bench: Workbench, projector: _Projector, effect: Effect, nonlinear: tuple[float, ...]
) -> float:
    """Gain with the columns that hold at the size found, where an effect has such."""
    if type(effect).secant is Effect.secant:
        return 0.0
    coefficients, _ = projector.fit(bench.white(effect, nonlinear))
    columns = np.nan_to_num(effect.secant(bench.signals, coefficients, nonlinear))
    return projector.gain(bench.whiten(columns, bench.run))


class _Projector:
    """What the model, nuisance and chosen effects leave of whitened columns."""

    def __init__(self, bench: Workbench, chosen: Chosen) -> None:
        parts = [bench.always_white, *(bench.white(effect, nonlinear) for effect, nonlinear in chosen)]
        fixed = np.concatenate(parts, axis=1)
        scale = np.maximum(np.linalg.norm(fixed, axis=0), 1e-300)
        self.basis = np.linalg.qr(fixed / scale)[0]
        self.rest = bench.left_white - self.basis @ (self.basis.T @ bench.left_white)
        self.deviance = float(self.rest @ self.rest)
        self.rows = int(np.count_nonzero(bench.left_white))
        self.fitted = fixed.shape[1]

    def gain(self, columns: Floats) -> float:
        """Fall of the residual sum of squares by these columns."""
        coefficients, moment = self.fit(columns)
        return float(moment @ coefficients)

    def fit(self, columns: Floats) -> tuple[Floats, Floats]:
        """Coefficients of these columns, zero for those that nothing is left of, and their moments."""
        part = columns - self.basis @ (self.basis.T @ columns)
        moment = part.T @ self.rest
        own = np.einsum("ij,ij->j", part, part) > 1e-8 * np.maximum(
            np.einsum("ij,ij->j", columns, columns), 1e-300
        )
        coefficients = np.zeros(moment.size)
        if own.any():
            coefficients[own] = solve(part[:, own].T @ part[:, own], moment[own])
        return coefficients, moment


def _family(bench: Workbench) -> int:
    """Number of hypotheses: candidates times grid points."""
    return sum(effect.trials(bench.signals) for effect in SEARCHED if bench.testable(effect)[0])


def _next(bench: Workbench, chosen: Chosen, family: int, ranked: list[Candidate]) -> Candidate | None:
    """The best candidate that passes every test; where none does, the best nameless shape; else None."""
    found = _passing(bench, chosen, ranked[:3], family)
    if found is not None:
        return found
    if len(chosen) - _named(chosen) < _MOST_FOILS:
        return _passing(bench, chosen, _ranked(bench, chosen, FOILS)[:2], family)
    return None


def _passing(bench: Workbench, chosen: Chosen, ranked: list[Candidate], family: int) -> Candidate | None:
    for candidate in ranked:
        p = min(1.0, candidate.p_value * family)
        if p > FAMILY_ERROR:
            return None
        if _size(bench, chosen, candidate) > LEAST_SIZE and _proved(bench, chosen, candidate):
            return replace(candidate, p_value=p)
    return None


def _named(chosen: Chosen) -> int:
    return sum(not isinstance(effect, Foil) for effect, _ in chosen)


def _proved(bench: Workbench, chosen: Chosen, candidate: Candidate) -> bool:
    """Whether blocks that were not fitted bear it out; of what they cannot, a great gain is asked."""
    effect = candidate.effect
    if isinstance(effect, Foil) and not effect.sees_ahead:
        return _size(bench, chosen, candidate) > _CERTAIN_SIZE and _lasting(bench, chosen, effect)
    return holds(*_held_out_gain(bench, (*chosen, (effect, candidate.nonlinear)), len(chosen)))


def _lasting(bench: Workbench, chosen: Chosen, foil: Foil) -> bool:
    """Whether means over seconds are explained far better than slow noise of their own scatter would be."""
    rest = bench.remainder(chosen)
    mean, columns = _means(bench, rest), _means(bench, bench.columns(foil, ()))
    columns = np.concatenate((columns, np.ones((mean.size, 1))), axis=1)
    left = mean - columns @ np.linalg.lstsq(columns, mean, rcond=None)[0]
    before, after = float(np.sum((mean - mean.mean()) ** 2)), float(left @ left)
    return f_test(before, after, columns.shape[1] - 1, mean.size, columns.shape[1]) < _LASTING_CHANCE


def _means(bench: Workbench, columns: Floats) -> Floats:
    """Over stretches of `_SECONDS` within runs."""
    stretch = np.floor(bench.record.time / _SECONDS).astype(np.int64)
    change = np.concatenate(([0], (np.diff(stretch) != 0) | (np.diff(bench.run) != 0)))
    number = np.cumsum(change)
    count = np.bincount(number)
    wide = columns.reshape(columns.shape[0], -1)
    means = np.stack([np.bincount(number, c) / count for c in wide.T], axis=1)
    kept = count > 0.5 * np.median(count)
    return means[kept].reshape(-1, *columns.shape[1:])


def _held_out_gain(bench: Workbench, chosen: Chosen, index: int) -> tuple[Floats, Floats]:
    """What one of the chosen effects brings in blocks not fitted; see :meth:`Design.held_out_gain`."""
    widths = [bench.columns(*item).shape[1] for item in chosen]
    first = bench.always_white.shape[1] + sum(widths[:index])
    return bench.design(chosen).held_out_gain(slice(first, first + widths[index]))


def _size(bench: Workbench, chosen: Chosen, candidate: Candidate) -> float:
    """Rms of a candidate's part that neither the model nor the chosen effects could imitate [rad]."""
    columns = bench.columns(candidate.effect, candidate.nonlinear)
    beta, _, _ = bench.fit((*chosen, (candidate.effect, candidate.nonlinear)))
    part = columns @ beta[-columns.shape[1] :]
    fixed = np.concatenate((bench.always(), bench.joined(chosen)), axis=1)
    basis = np.linalg.qr(fixed / np.maximum(np.linalg.norm(fixed, axis=0), 1e-300))[0]
    own = part - basis @ (basis.T @ part)
    return float(np.sqrt(np.mean(own**2)))


def speed_dependent(bench: Workbench) -> bool:
    """Whether what is left is larger, or smaller, where the joint runs fast."""
    speed, rest = np.abs(bench.signals.speed), bench.remainder(())
    slow, fast = np.quantile(speed, (_SLOW, 1.0 - _SLOW))
    ratio = np.std(rest[speed >= fast]) / max(float(np.std(rest[speed <= slow])), 1e-300)
    return bool(slow < 0.5 * fast and not 1.0 / _UNEVEN < ratio < _UNEVEN)


def _begun_slowly(bench: Workbench) -> Workbench:
    """The parameters that the slow part shows, if a cause beside them then explains more.

    A resonance, a delay or an unbalance changes the ripple at speed: fitted to all of it, the model's own
    parameters go astray, and no cause stands out beside them.
    """
    speed = np.abs(bench.record.speed)
    slow = refit(bench.record.select(speed <= np.quantile(speed, _SLOW)), bench.configured)
    other = Workbench(bench.source, bench.configured, slow.parameters, bench.whiten)
    other.noise_residual = bench.noise_residual
    trials = [(each, next(iter(candidates(each, ())), None)) for each in (bench, other)]
    left = [each.design(((best.effect, best.nonlinear),) if best else ()).deviance() for each, best in trials]
    return other if left[1] < left[0] - _RESTART_GAIN else bench


def _refined(bench: Workbench, chosen: Chosen) -> tuple[Workbench, Chosen]:
    """The newest effect's nonlinear values and all parameters, brought to their best."""
    bench = settle(bench, chosen, rounds=2)
    effect, nonlinear = chosen[-1]
    if free(effect):
        chosen = (*chosen[:-1], (effect, _best_nonlinear(bench, chosen[:-1], effect, nonlinear)))
        bench = settle(bench, chosen, rounds=1)
    return bench, chosen


def _best_nonlinear(
    bench: Workbench, others: Chosen, effect: Effect, start: tuple[float, ...]
) -> tuple[float, ...]:
    """Nonlinear values of least residual, from a grid point, within the effect's bounds."""
    projector = _Projector(bench, others)
    quantities, moving = effect.nonlinear, free(effect)
    low, high = np.array([q.low for q in quantities]), np.array([q.high for q in quantities])
    width = bench.grid_step(effect, start)

    def moved(move: Floats) -> tuple[float, ...]:
        values = np.array(start)
        values[moving] += move * width[moving]
        return tuple(np.clip(values, low, high).tolist())

    def loss(move: Floats) -> float:
        return -projector.gain(bench.white(effect, moved(move), keep=False))

    best = minimize(
        loss, np.zeros(len(moving)), method="Nelder-Mead", options={"maxfev": 40, "xatol": 1e-3, "fatol": 0.1}
    )
    return moved(best.x)


def _swapped(bench: Workbench, chosen: Chosen, rivals: set[str]) -> tuple[Workbench, Chosen]:
    """Exchange a chosen effect for a better one, or for itself at another grid point, where there is one."""
    for index, (effect, nonlinear) in enumerate(chosen):
        others = chosen[:index] + chosen[index + 1 :]
        now = bench.design(chosen).deviance()
        bench.correct(others)
        best = next(iter(_ranked(bench, others, _of(rivals))), None)
        if best is not None and (best.effect, best.nonlinear) != (effect, nonlinear):
            trial = (*others, (best.effect, best.nonlinear))
            bench.correct(trial)
            if bench.design(trial).deviance() < now - CLASS_DEVIANCE:
                bench, chosen = _refined(bench, trial)
                continue
        bench.correct(chosen)
    return bench, chosen


def _finished(bench: Workbench, chosen: Chosen) -> tuple[Workbench, Chosen]:
    """Everything at its best, the discrete values looked at once more where all others are."""
    bench, chosen = polished(bench, chosen)
    again = chosen
    for index, (effect, nonlinear) in enumerate(chosen):
        for other in effect.beside(bench.signals, nonlinear):
            trial = (*again[:index], (effect, other), *again[index + 1 :])
            if _left(bench, trial) < _left(bench, again):
                again = trial
    bench.correct(again)
    return (bench, chosen) if again == chosen else polished(settle(bench, again, learn=False), again)


def _left(bench: Workbench, chosen: Chosen) -> float:
    """Deviance with the effects at the size that fits."""
    bench.correct(chosen)
    return bench.design(chosen).deviance()


def _restarted(bench: Workbench, chosen: Chosen) -> Workbench:
    """Search the model's parameters globally again, now that the largest cause takes part freely."""
    again = refit(
        bench.record,
        bench.configured,
        extra=bench.joined(chosen),
        start=bench.parameters,
        starts=FEW_STARTS,
    )
    if not distinct([bench.parameters, again.parameters])[1:]:
        return bench
    other = settle(Workbench(bench.source, bench.configured, again.parameters), chosen, rounds=2)
    other_left = other.design_with(bench.whiten, chosen).deviance()
    return other if other_left < bench.design(chosen).deviance() - _RESTART_GAIN else bench


def _kept(bench: Workbench, chosen: Chosen) -> Chosen:
    """Without the effects that are no longer needed beside the others."""
    for index, (effect, nonlinear) in enumerate(chosen):
        if isinstance(effect, Foil) and not effect.sees_ahead:
            continue
        rest = chosen[:index] + chosen[index + 1 :]
        small = _size(bench, rest, Candidate(effect, nonlinear, 0.0, 0.0, 0.0)) < LEAST_SIZE
        if small or not holds(*_held_out_gain(bench, chosen, index)):
            return _kept(bench, rest)
    return chosen


def fitted(bench: Workbench, found: Search) -> Search:
    """The same causes with numbers from another bench; names, classes and gains stay.

    Parameters
    ----------
    bench : Workbench
        Settled beside the causes.
    found : Search

    Returns
    -------
    Search
    """
    beta, _, _ = bench.fit(found.chosen)
    spread, places = covariance(bench, found.chosen)
    causes = []
    for cause, place in zip(found.causes, places, strict=False):
        coefficients = beta[place[: cause.effect.size]]
        amplitude = float(np.std(bench.full_size(cause.effect, cause.nonlinear, coefficients)))
        causes.append(
            replace(cause, coefficients=coefficients, covariance=_part(spread, place), amplitude=amplitude)
        )
    return replace(found, bench=bench, causes=tuple(causes))


def _part(spread: Floats, place: npt.NDArray[np.int64]) -> Floats:
    """Covariance of some values; zero for those that are not fitted."""
    part = spread[np.ix_(place, place)]
    fixed = place < 0
    part[fixed], part[:, fixed] = 0.0, 0.0
    return part


def _causes(
    bench: Workbench, chosen: Chosen, p_values: dict[str, float], rivals: set[str]
) -> tuple[Cause, ...]:
    beta, _, _ = bench.fit(chosen)
    spread, places = covariance(bench, chosen)
    rng = np.random.default_rng(0)
    found = []
    for index, (effect, nonlinear) in enumerate(chosen):
        if isinstance(effect, Foil):
            continue
        rows = places[index][: effect.size]
        others = chosen[:index] + chosen[index + 1 :]
        gains, _ = _held_out_gain(bench, chosen, index)
        share = gains / max(float(np.mean(bench.design(others).held_out())), 1e-300)
        low, high = interval(share, rng)
        found.append(
            Cause(
                effect,
                nonlinear,
                beta[rows],
                _part(spread, places[index]),
                float(np.std(bench.full_size(effect, nonlinear, beta[rows]))),
                p_values.get(effect.name, float("nan")),
                (effect.name, *_alike(bench, chosen, index, rivals)),
                float(np.mean(share)),
                low,
                high,
            )
        )
    return tuple(sorted(found, key=lambda cause: -cause.gain))


def _of(names: set[str]) -> list[Effect]:
    return [effect for name, effect in _NAMES.items() if name in names]


def _alike(bench: Workbench, chosen: Chosen, index: int, rivals: set[str]) -> list[str]:
    """Effects that would do as well in place of one; those that the motion cannot test among them."""
    effect, others = chosen[index][0], chosen[:index] + chosen[index + 1 :]
    named = {e.name for e, _ in chosen}
    here = float(bench.design(chosen).held_out().sum())
    found = [name for name in effect.always_confused if name not in named]
    untested = {
        name for name in effect.confused_with if name in _NAMES and not bench.testable(_NAMES[name])[0]
    }
    bench.correct(others)
    for candidate in _ranked(bench, others, _of(rivals | untested), untested):
        if candidate.effect.name in named or candidate.effect.name in found:
            continue
        trial = (*others, (candidate.effect, candidate.nonlinear))
        bench.correct(trial)
        if float(bench.design(trial).held_out().sum()) - here < CLASS_DEVIANCE:
            found.append(candidate.effect.name)
    bench.correct(chosen)
    return found


def parameters_of(search_result: Search) -> tuple[Floats, Floats]:
    """The model's parameters beside the causes, and their covariance, in units of `base.SCALES`."""
    bench = search_result.bench
    beta, _, _ = bench.fit(search_result.chosen)
    spread, _ = covariance(bench, search_result.chosen)
    return bench.parameters + beta[: base.COUNT], spread[: base.COUNT, : base.COUNT]
