"""Search for causes: forward selection by groups of columns, held-out gain, swaps, drops and classes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from hd_diag.criticism import base
from hd_diag.criticism.design import f_test, interval, lower_bound, solve
from hd_diag.criticism.refit import refit
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

_MOST_CAUSES = 4
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
    covariance : ndarray, shape (k, k)
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


@dataclass(frozen=True)
class Search:
    """Result of a search: the bench at the final parameters and the causes, most explaining first."""

    bench: Workbench
    causes: tuple[Cause, ...]

    @property
    def chosen(self) -> Chosen:
        """Effects and their nonlinear values."""
        return tuple((cause.effect, cause.nonlinear) for cause in self.causes)


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
    family = _family(bench)
    for _ in range(_MOST_CAUSES):
        progress(f"looking for cause {len(chosen) + 1}")
        found = _next(bench, chosen, family)
        if found is None:
            break
        p_values[found.effect.name] = found.p_value
        chosen = (*chosen, (found.effect, found.nonlinear))
        bench, chosen = _refined(bench, chosen)
        bench, chosen = _swapped(bench, chosen)
        if len(chosen) == 1:
            bench = _restarted(bench, chosen)
    chosen = _kept(bench, chosen)
    bench = settle(bench, chosen)
    return Search(bench, _causes(bench, chosen, p_values))


def candidates(bench: Workbench, chosen: Chosen) -> list[Candidate]:
    """Every effect not chosen, at its best grid point, by the gain it brings; the best first."""
    named = {effect.name for effect, _ in chosen}
    projector = _Projector(bench, chosen)
    rest = bench.remainder(chosen)
    found = []
    for effect in SEARCHED:
        if effect.name in named or not bench.testable(effect)[0]:
            continue
        best: tuple[float, tuple[float, ...]] | None = None
        for nonlinear in effect.scan(bench.signals, rest):
            gain = projector.gain(bench.white(effect, nonlinear))
            if best is None or gain > best[0]:
                best = gain, nonlinear
        if best is not None:
            width = bench.columns(effect, best[1]).shape[1]
            p = f_test(
                projector.deviance,
                projector.deviance - best[0],
                width,
                projector.rows,
                projector.fitted + width,
            )
            found.append(Candidate(effect, best[1], best[0], p))
    return sorted(found, key=lambda candidate: (candidate.p_value, -candidate.gain))


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
        part = columns - self.basis @ (self.basis.T @ columns)
        moment = part.T @ self.rest
        own = np.einsum("ij,ij->j", part, part) > 1e-8 * np.maximum(
            np.einsum("ij,ij->j", columns, columns), 1e-300
        )
        if not own.any():
            return 0.0
        gram = part[:, own].T @ part[:, own]
        return float(moment[own] @ solve(gram, moment[own]))


def _family(bench: Workbench) -> int:
    """Number of hypotheses: candidates times grid points."""
    return sum(effect.trials(bench.signals) for effect in SEARCHED if bench.testable(effect)[0])


def _next(bench: Workbench, chosen: Chosen, family: int) -> Candidate | None:
    """The best candidate that passes every test; None if none does."""
    for candidate in candidates(bench, chosen)[:3]:
        p = min(1.0, candidate.p_value * family)
        if p > FAMILY_ERROR:
            return None
        more = (*chosen, (candidate.effect, candidate.nonlinear))
        if (
            _size(bench, chosen, candidate) > LEAST_SIZE
            and lower_bound(_held_out_gain(bench, chosen, more)) > 0.0
        ):
            return replace(candidate, p_value=p)
    return None


def _held_out_gain(bench: Workbench, fewer: Chosen, more: Chosen) -> Floats:
    """Fall of the held-out sum of squares of each block."""
    return bench.design(fewer).held_out() - bench.design(more).held_out()


def _size(bench: Workbench, chosen: Chosen, candidate: Candidate) -> float:
    """Rms of a candidate's part that neither the model nor the chosen effects could imitate [rad]."""
    columns = bench.columns(candidate.effect, candidate.nonlinear)
    beta, _, _ = bench.fit((*chosen, (candidate.effect, candidate.nonlinear)))
    part = columns @ beta[-columns.shape[1] :]
    fixed = np.concatenate((bench.always(), bench.joined(chosen)), axis=1)
    basis = np.linalg.qr(fixed / np.maximum(np.linalg.norm(fixed, axis=0), 1e-300))[0]
    own = part - basis @ (basis.T @ part)
    return float(np.sqrt(np.mean(own**2)))


def _refined(bench: Workbench, chosen: Chosen) -> tuple[Workbench, Chosen]:
    """The newest effect's nonlinear values and all parameters, brought to their best."""
    bench = settle(bench, chosen, rounds=2)
    effect, nonlinear = chosen[-1]
    if any(not quantity.discrete for quantity in effect.nonlinear):
        chosen = (*chosen[:-1], (effect, _best_nonlinear(bench, chosen[:-1], effect, nonlinear)))
        bench = settle(bench, chosen, rounds=1)
    return bench, chosen


def _best_nonlinear(
    bench: Workbench, others: Chosen, effect: Effect, start: tuple[float, ...]
) -> tuple[float, ...]:
    """Nonlinear values of least residual, from a grid point, within the effect's bounds."""
    projector = _Projector(bench, others)
    quantities = effect.nonlinear
    low, high = np.array([q.low for q in quantities]), np.array([q.high for q in quantities])
    width = bench.grid_step(effect, start) * [not q.discrete for q in quantities]

    def moved(move: Floats) -> tuple[float, ...]:
        return tuple(float(v) for v in np.clip(np.array(start) + move * width, low, high))

    def loss(move: Floats) -> float:
        return -projector.gain(bench.white(effect, moved(move), keep=False))

    best = minimize(
        loss, np.zeros(len(start)), method="Nelder-Mead", options={"maxfev": 40, "xatol": 1e-3, "fatol": 0.1}
    )
    return moved(best.x)


def _swapped(bench: Workbench, chosen: Chosen) -> tuple[Workbench, Chosen]:
    """Exchange a chosen effect for a better one where there is one."""
    for index, (effect, _) in enumerate(chosen):
        others = chosen[:index] + chosen[index + 1 :]
        best = next(iter(candidates(bench, others)), None)
        if best is None or best.effect.name == effect.name:
            continue
        trial = (*others, (best.effect, best.nonlinear))
        now, then = bench.design(chosen).deviance(), bench.design(trial).deviance()
        if then < now - CLASS_DEVIANCE and best.effect.name not in {e.name for e, _ in others}:
            bench, chosen = _refined(bench, trial)
    return bench, chosen


def _restarted(bench: Workbench, chosen: Chosen) -> Workbench:
    """Search the model's parameters globally again, now that the largest cause takes part freely."""
    again = refit(
        bench.record,
        bench.configured,
        extra=bench.joined(chosen),
        start=bench.parameters,
    )
    other = settle(Workbench(bench.source, bench.configured, again.parameters), chosen, rounds=2)
    other_left = other.design_with(bench.whiten, chosen).deviance()
    return other if other_left < bench.design(chosen).deviance() - _RESTART_GAIN else bench


def _kept(bench: Workbench, chosen: Chosen) -> Chosen:
    """Without the effects that are no longer needed beside the others."""
    for item in chosen:
        rest = tuple(other for other in chosen if other is not item)
        if len(rest) < len(chosen) and lower_bound(_held_out_gain(bench, rest, chosen)) <= 0.0:
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
    beta, covariance, _ = bench.fit(found.chosen)
    at = bench.always_white.shape[1]
    causes = []
    for cause in found.causes:
        columns = bench.columns(cause.effect, cause.nonlinear)
        rows = slice(at, at + columns.shape[1])
        at = rows.stop
        amplitude = float(np.std(columns @ beta[rows]))
        causes.append(
            replace(cause, coefficients=beta[rows], covariance=covariance[rows, rows], amplitude=amplitude)
        )
    return Search(bench, tuple(causes))


def _causes(bench: Workbench, chosen: Chosen, p_values: dict[str, float]) -> tuple[Cause, ...]:
    beta, covariance, _ = bench.fit(chosen)
    at = bench.always_white.shape[1]
    rng = np.random.default_rng(0)
    found = []
    for index, (effect, nonlinear) in enumerate(chosen):
        columns = bench.columns(effect, nonlinear)
        rows = slice(at, at + columns.shape[1])
        at = rows.stop
        others = chosen[:index] + chosen[index + 1 :]
        gains = _held_out_gain(bench, others, chosen)
        share = gains / max(float(np.mean(bench.design(others).held_out())), 1e-300)
        low, high = interval(share, rng)
        found.append(
            Cause(
                effect,
                nonlinear,
                beta[rows],
                covariance[rows, rows],
                float(np.std(columns @ beta[rows])),
                p_values.get(effect.name, float("nan")),
                (effect.name, *_alike(bench, chosen, index)),
                float(np.mean(share)),
                low,
                high,
            )
        )
    return tuple(sorted(found, key=lambda cause: -cause.gain))


def _alike(bench: Workbench, chosen: Chosen, index: int) -> list[str]:
    """Effects that would do as well in place of one."""
    effect = chosen[index][0]
    others = chosen[:index] + chosen[index + 1 :]
    named = {e.name for e, _ in chosen}
    here = float(bench.design(chosen).held_out().sum())
    found = [name for name in effect.always_confused if name not in named]
    for candidate in candidates(bench, others)[:6]:
        if candidate.effect.name in named or candidate.effect.name in found:
            continue
        trial = (*others, (candidate.effect, candidate.nonlinear))
        if float(bench.design(trial).held_out().sum()) - here < CLASS_DEVIANCE:
            found.append(candidate.effect.name)
    return found


def parameters_of(search_result: Search) -> tuple[Floats, Floats]:
    """The model's parameters beside the causes, and their covariance, in units of `base.SCALES`."""
    bench = search_result.bench
    beta, covariance, _ = bench.fit(search_result.chosen)
    return bench.parameters + beta[: base.COUNT], covariance[: base.COUNT, : base.COUNT]
