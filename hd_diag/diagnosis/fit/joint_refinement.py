"""Joint steps of a fit: the model's parameters, and the coefficients and nonlinear values of the causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy import special
from scipy.optimize import lsq_linear

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import Design
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.effects.effect import Effect, Stage

_ROUNDS = 8
_SHORTER = 3  # halvings of a step that makes the fit worse
_SHARES = (1.0, 0.3, 0.1)  # of a step, tried in turn until one makes the fit no worse
_WORSE = 1.05  # times the deviance before, allowed after a full step
_LONGEST, _CLEARLY = 8.0, 1.3  # largest factor that lengthens a step; factor above which it is tried
_LINEAR = 1.0  # standard deviations; the model is linear over such steps
_SINGULAR = 1e-12  # least variance of any direction, relative to the greatest
_SIDE = 0.975  # quantile at the upper end of a 95 % interval
_SETTLED = 0.05  # gain in deviance below which rounds end


def settle(fit: LinearisedFit, chosen: Chosen, rounds: int = 3, learn: bool = True) -> LinearisedFit:
    """Move the model to the best parameters given the chosen effects: Gauss-Newton on all rows.

    Parameters
    ----------
    fit : LinearisedFit
    chosen : sequence of (Effect, nonlinear values)
    rounds : int
    learn : bool
        Whether to learn the noise again first; it hardly changes with small steps.

    Returns
    -------
    LinearisedFit
        At the parameters found, with the chosen effects present.
    """
    if learn:
        fit = fit.with_noise(chosen)
    own = slice(fit.parameters.size)
    last, taken = np.zeros(fit.parameters.size), 0.0
    for _ in range(rounds):
        beta, covariance, _ = fit.fit(chosen)
        step = beta[own]
        away = step / np.sqrt(np.diag(covariance)[own] + 1e-12)
        longer = _longer(away, last, taken) if taken and not fit.data.given else fit.longer
        last = away
        # The linear fit itself covers a step this small.
        if longer * np.max(np.abs(away)) < _LINEAR:
            break
        trial, share = _stepped_by(fit, chosen, beta, longer)
        if trial is fit:
            break
        fit, taken = trial, share
    return fit if taken else fit.corrected(chosen)


def _stepped_by(
    fit: LinearisedFit, chosen: Chosen, beta: Floats, longer: float
) -> tuple[LinearisedFit, float]:
    """The fit after the longest share of a step that makes it no worse, and the share; else as it was, 0.

    A full step may make it worse by the factor `_WORSE`.
    """
    before, start = fit.cost(chosen), fit.at_present(chosen, beta)
    for share in (longer, *_SHARES) if longer > _CLEARLY else _SHARES:
        part = start + share * (beta - start)
        moved = fit_parameters.admissible(fit.parameters + part[: fit.parameters.size], fit.data.configured)
        trial = replace(fit.moved(moved), longer=longer).beside(fit.sized(chosen, part))
        if trial.cost(chosen) <= (_WORSE if share == 1.0 else 1.0) * before:
            return trial, share
    return fit, 0.0


def _longer(step: Floats, before: Floats, taken: float) -> float:
    """Factor by which a step falls short, from its ratio to the step before, which was `taken` times as long.

    The full-size response of causes changes with the parameters, and no column shows this. If both imitate
    each other, a step covers a share of the way (Aitken's acceleration of a linearly converging series).
    """
    left = float(step @ before) / float(before @ before)
    return float(np.clip(taken / max(1.0 - left, 1e-9), 1.0, _LONGEST))


def polished(fit: LinearisedFit, chosen: Chosen, rounds: int = _ROUNDS) -> tuple[LinearisedFit, Chosen]:
    """Gauss-Newton over the nonlinear values of all effects, the model's parameters settled in between.

    Parameters
    ----------
    fit : LinearisedFit
    chosen : sequence of (Effect, nonlinear values)
    rounds : int
        At most.

    Returns
    -------
    fit, chosen
        At the best values near those given.
    """
    for _ in range(rounds):
        before = fit.deviance(chosen)
        fit, chosen = _stepped(fit, chosen, before)
        fit = settle(fit, chosen, learn=False)
        if fit.deviance(chosen) > before - _SETTLED:
            break
    return fit, chosen


def slopes(fit: LinearisedFit, chosen: Chosen) -> Floats:
    """Derivatives of the effects' parts by their free nonlinear values.

    Parameters
    ----------
    fit : LinearisedFit
    chosen : sequence of (Effect, nonlinear values)

    Returns
    -------
    ndarray, shape (n, k)
        [rad] per unit, effect by effect; k = 0 where all effects are linear.
    """
    beta, _, _ = fit.fit(chosen)
    found = []
    for (effect, nonlinear), place in zip(chosen, fit.places(chosen), strict=True):
        coefficients = beta[place]
        step = 0.01 * fit.data.grid_step(effect, nonlinear) if free(effect) else np.empty(0)
        for index in free(effect):
            ends = [_moved(effect, nonlinear, index, sign * step[index]) for sign in (-1.0, 1.0)]
            low, high = (fit.effects.full_size(effect, end, coefficients) for end in ends)
            found.append((high - low) / max(ends[1][index] - ends[0][index], 1e-300))
    return np.stack(found, axis=1) if found else np.empty((fit.residual.size, 0))


def covariance(fit: LinearisedFit, chosen: Chosen) -> tuple[Floats, list[npt.NDArray[np.int64]]]:
    """Covariance of all fitted values, including the free nonlinear ones.

    It is that of the noise model, or larger where blocks of the record or recordings scatter more.

    Returns
    -------
    covariance : ndarray, shape (k, k)
        Model, offset, coefficients effect by effect, then nonlinear values effect by effect.
    places : list of ndarray
        For every effect the indices of its own coefficients, then of its nonlinear values; -1: not free.
    """
    linear = fit.places(chosen)
    last, places = linear[-1].stop if linear else 0, []
    for (effect, nonlinear), place in zip(chosen, linear, strict=True):
        inner = np.full(len(nonlinear), -1)
        for index in free(effect):
            inner[index], last = last, last + 1
        own = place.stop if effect.stage == Stage.REPORTED else place.start + effect.size
        places.append(np.concatenate((np.arange(place.start, own), inner)))
    beta, spread, built = fit.fit(chosen, slopes(fit, chosen))
    return spread * np.multiply.outer(*[_wider(fit, beta, spread, built)] * 2), places


def _wider(fit: LinearisedFit, beta: Floats, spread: Floats, built: Design) -> Floats:
    """Deviations by scatter (sandwich estimate) over those of the noise model, at least the misfit.

    The greater of two scatters counts: that of blocks, raised because they are few (Student's t), and that
    of recordings, whose blocks are correlated.
    """
    scatter = (built.moment - built.gram @ beta) @ spread
    bags, number = np.unique(fit.data.bag_of_block, return_inverse=True)
    together = np.zeros((bags.size, scatter.shape[1]))
    np.add.at(together, number, scatter)
    variances = [
        np.sum(parts**2, axis=0) * len(parts) / max(len(parts) - 1, 1) for parts in (scatter, together)
    ]
    if len(scatter) > 1:
        variances[0] *= (special.stdtrit(len(scatter) - 1, _SIDE) / special.ndtri(_SIDE)) ** 2
    variance = np.maximum(*variances) if bags.size > 1 else variances[0]
    least = fit.misfit**2
    return np.asarray(np.sqrt(np.maximum(variance / np.maximum(np.diag(spread), 1e-300), least)))


def sensible(fit: LinearisedFit, chosen: Chosen) -> list[bool]:
    """For each effect, whether it is plausible at its fitted size, and not the shape of another cause."""
    sized = fit.sized(chosen, fit.fit(chosen)[0])
    return [effect.sensible(own[: effect.size], nonlinear) for (effect, nonlinear), own in sized]


def free(effect: Effect) -> list[int]:
    """Indices of the continuous nonlinear values."""
    return [index for index, quantity in enumerate(effect.nonlinear) if not quantity.discrete]


def _stepped(fit: LinearisedFit, chosen: Chosen, before: float) -> tuple[LinearisedFit, Chosen]:
    """The fit and its effects after one step of the nonlinear values; as they were if no step helps."""
    columns = slopes(fit, chosen)
    if not columns.shape[1]:
        return fit, chosen
    beta, spread, _ = fit.fit(chosen, columns)
    own = slice(-columns.shape[1], None)
    step = _within(chosen, beta[own], spread[own, own])
    for _ in range(_SHORTER):
        trial = _moved_all(fit, chosen, step)
        tried = fit.corrected(trial)
        if tried.deviance(trial) < before and all(sensible(tried, trial)):
            return tried, trial
        step = 0.5 * step
    return fit, chosen


def _within(chosen: Chosen, step: Floats, spread: Floats) -> Floats:
    """The best step of the free values (k,), with covariance (k, k), that keeps each in its range."""
    room = [
        (q.fitted[0] - at, q.fitted[1] - at)
        for effect, values in chosen
        for q, at in ((effect.nonlinear[index], values[index]) for index in free(effect))
    ]
    low, high = np.array(room).T
    if np.all((low <= step) & (step <= high)):
        return step
    values, vectors = np.linalg.eigh(spread)
    root = (vectors / np.sqrt(np.maximum(values, _SINGULAR * values.max()))).T
    return np.asarray(np.clip(lsq_linear(root, root @ step, (low, high)).x, low, high))


def _moved_all(fit: LinearisedFit, chosen: Chosen, step: Floats) -> Chosen:
    moved, at = [], 0
    for effect, nonlinear in chosen:
        most = fit.data.grid_step(effect, nonlinear) if free(effect) else np.empty(0)
        for index in free(effect):
            nonlinear = _moved(effect, nonlinear, index, float(np.clip(step[at], -most[index], most[index])))
            at += 1
        moved.append((effect, nonlinear))
    return tuple(moved)


def _moved(effect: Effect, nonlinear: tuple[float, ...], index: int, step: float) -> tuple[float, ...]:
    quantity = effect.nonlinear[index]
    value = float(np.clip(nonlinear[index] + step, *quantity.fitted))
    return (*nonlinear[:index], value, *nonlinear[index + 1 :])
