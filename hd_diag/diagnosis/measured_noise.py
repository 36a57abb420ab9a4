"""Noise as it is measured: what differs when the same state is passed again, whatever the model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import toeplitz
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.noise import ORDER, slices
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.stamps import usual_step
from hd_diag.effects.signals import Signals

_QUERIES, _KNOWN, _NEIGHBOURS = 6000, 24_000, 24  # moments looked from, and to, and how many nearest
_PAIRS = 4  # of each moment
_APART = 0.5  # [s], beyond which noise of an encoder has forgotten itself
_WAY = 1.0  # [rad] of the input, in between: a rest is not passed again
_NEAR = 8.0  # square of the distance [-] of states that count as the same
_LAG = 0.2  # [s], over which the torque's rise tells the branch of a loop
_LEAST_PAIRS, _LEAST_SLICES = 400, 8
_SLOW = 3.0  # [s]: what is constant for so long is no noise of an encoder
_SLICE = 0.5  # of the bootstrap [s]
_VAGUE = 1.5  # ratio of the interval's ends from which nothing is extrapolated
_DRAWS = 200
_OWN = 0.06  # of it: slow noise that leading back takes for a difference of states
_DIFFERENCE = 6  # order of the difference that no smooth motion makes
_QUICKEST = 0.25  # of their variance, that noise has at least in every wave
_WHOLE = 0.02  # of a step, by which counts may be off whole numbers
_MOST_STEPS = 1000.0  # between neighbours, for counts that can be recognised


class MeasuredNoise(NamedTuple):
    """Noise of a record [rad rms], and its 95 % interval; `repeated` if states were passed again.

    It is `vague` where passes disagree too much to be extrapolated: then it may be all that differs.
    """

    rms: float
    low: float
    high: float
    repeated: bool
    vague: bool = False


class Revisits(NamedTuple):
    """Pairs of moments at which the drive is in nearly the same state, in passes of their own.

    Their rows (n,), and the squares of the distances of the states, kind by kind, (n, k) [-].
    """

    first: Integers
    second: Integers
    apart: Floats


NEVER = Revisits(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty((0, 1)))
"""Of a motion that never comes back."""


def revisits(signals: Signals) -> Revisits:
    """Moments at which wave generator, output, torque and its rise, speed and direction come back."""
    state, kinds = _states(signals)
    rng, size = np.random.default_rng(0), signals.size
    known = np.sort(rng.choice(size, min(_KNOWN, size), replace=False))
    asked = np.sort(rng.choice(size, min(_QUERIES, size), replace=False))
    count = min(_NEIGHBOURS, known.size)
    found = known[cKDTree(state[known]).query(state[asked], count)[1].reshape(asked.size, count)]
    way = np.cumsum(np.abs(np.diff(signals.wave_generator_angle, prepend=signals.wave_generator_angle[0])))
    again = np.abs(signals.time[found] - signals.time[asked, None]) > _APART
    again &= np.abs(way[found] - way[asked, None]) > _WAY
    again |= signals.run[found] != signals.run[asked, None]
    again &= np.cumsum(again, axis=1) <= _PAIRS
    first, second = np.broadcast_to(asked[:, None], found.shape)[again], found[again]
    away = (state[first] - state[second]) ** 2
    near = away.sum(axis=1) < _NEAR
    apart = np.stack([away[:, kinds == kind].sum(axis=1) for kind in range(kinds[-1] + 1)], axis=1)
    return Revisits(first[near], second[near], apart[near])


def measured_noise(
    residual: Floats, time: Floats, run: Integers, passed: Revisits, counted: float
) -> MeasuredNoise:
    """Noise of a residual (n,) [rad]; an error of the model is the same in the same state and drops out.

    Times are in s, a run has no gap; what encoders that count leave is `counted` [rad].

    Notes
    -----
    Half the mean square difference of pairs (variogram), led back to states that are the same (its nugget:
    Matheron, Economic Geology 58, 1963) by a straight line in the squares of their distances. Without states
    that come back: sixth differences, which tell white noise alone: a lower bound. The upper one is then what
    changes within some seconds.
    """
    least = max(_of_short_differences(residual, run), counted)
    slice_ = slices(time, run, _SLICE)[passed.first]
    if passed.first.size < _LEAST_PAIRS or np.unique(slice_).size < _LEAST_SLICES:
        return MeasuredNoise(least, (1.0 - _OWN) * least, max(_quick(residual, time, run), least), False)
    half = 0.5 * (residual[passed.first] - residual[passed.second]) ** 2
    columns = np.column_stack((np.ones(half.size), passed.apart))
    columns /= np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    unit = max(float(half.mean()), 1e-300)
    grams, moments = _by_slice(columns, half / unit, slice_)
    draws = np.random.default_rng(0).multinomial(len(grams), np.full(len(grams), 1.0 / len(grams)), _DRAWS)
    drawn = _nuggets(np.tensordot(draws, grams, 1), draws @ moments)
    low, high = (np.sqrt(unit * np.quantile(drawn, (0.025, 0.975))) * (1.0 - _OWN, 1.0 + _OWN)).tolist()
    rms = math.sqrt(unit * _nuggets(grams.sum(axis=0)[None], moments.sum(axis=0)[None])[0])
    vague = bool(high > _VAGUE * low)
    if vague:  # too few to lead them back
        rms = high = math.sqrt(float(half.mean()))
    low = max(min(low, rms), (1.0 - _OWN) * least)
    return MeasuredNoise(max(rms, least), low, max(high, rms, least), True, vague)


def measured_covariance(residual: Floats, run: Integers, passed: Revisits, noise: MeasuredNoise) -> Floats:
    """Covariances of the noise at lags 0 to ORDER [rad^2], whatever misfit is in a residual.

    Those of the differences between passes; what the noise leaves of their variance is misfit as well, and
    changes little over so few samples. Where it changes, these are no covariances: they are shrunk towards
    white noise of the same variance, until no wave has less of it than a share of the quickest differences.
    """
    last = np.maximum(passed.first, passed.second) + ORDER < run.size
    first, second = passed.first[last], passed.second[last]
    whole = (run[first + ORDER] == run[first]) & (run[second + ORDER] == run[second])
    first, second = first[whole], second[whole]
    if not first.size:  # no pass is long enough: white
        return np.asarray(noise.rms**2 * np.eye(1, ORDER + 1)[0])
    away = np.stack([residual[first + lag] - residual[second + lag] for lag in range(ORDER + 1)])
    found = np.array([0.5 * float(np.mean(away[: ORDER + 1 - lag] * away[lag:])) for lag in range(ORDER + 1)])
    found -= max(float(found[0]) - noise.rms**2, 0.0)
    whole, weakest = float(found[0]), float(np.linalg.eigvalsh(toeplitz(found))[0])
    least = min(_QUICKEST * _of_short_differences(residual, run) ** 2, whole)
    if weakest < least:
        found[1:] *= (whole - least) / (whole - weakest)
    return found


def _states(signals: Signals) -> tuple[Floats, Integers]:
    """State of every moment, (n, k), in units within which nothing changes much; kinds of the coordinates."""
    load, speed = signals.torque, signals.forward_speed
    span = max(float(np.ptp(load)), 0.02 * signals.rated_torque)
    fast = max(float(np.percentile(np.abs(speed), 99)), 1e-9)
    lag = max(round(_LAG / usual_step(signals.time)), 1)
    before = np.concatenate((np.full(min(lag, load.size), load[0]), load[:-lag]))
    coordinates = (
        (0, np.cos(signals.wave_generator_angle) / 0.15),
        (0, np.sin(signals.wave_generator_angle) / 0.15),
        (1, np.cos(signals.output_angle) / 0.6),
        (1, np.sin(signals.output_angle) / 0.6),
        (2, load / (0.04 * span)),
        (3, (load - before) / (0.1 * span)),
        (4, speed / (0.1 * fast)),
        (5, np.tanh(speed / (0.02 * fast)) / 0.3),
        (6, signals.time / 40.0),
    )
    kinds, values = zip(*coordinates, strict=True)
    return np.stack(values, axis=1), np.array(kinds)


def _by_slice(columns: Floats, target: Floats, number: Integers) -> tuple[Floats, Floats]:
    """Normal equations of every slice, shape (slices, k, k) and (slices, k)."""
    order = np.argsort(number, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
    grams = np.stack([columns[rows].T @ columns[rows] for rows in parts])
    return grams, np.stack([columns[rows].T @ target[rows] for rows in parts])


def _nuggets(gram: Floats, moment: Floats) -> list[float]:
    """First coefficient of each of n non-negative least squares, by Gram matrices (n, k, k)."""
    ridge = 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None]
    root = np.linalg.cholesky(gram + ridge * np.eye(gram.shape[-1]))
    target = np.linalg.solve(root, moment[..., None])[..., 0]
    return [float(nnls(each.T, own)[0][0]) for each, own in zip(root, target, strict=True)]


def _of_short_differences(values: Floats, run: Integers) -> float:
    """Rms of noise that is white, from differences between neighbours [rad]."""
    order = _DIFFERENCE
    if values.size <= order:
        return 0.0
    weights = np.array([(-1.0) ** k * math.comb(order, k) for k in range(order + 1)])
    inside = run[order:] == run[:-order]
    found = np.convolve(values, weights / np.linalg.norm(weights), "valid")[inside]
    return float(np.sqrt(np.mean(found**2))) if found.size else 0.0


def _quick(values: Floats, time: Floats, run: Integers) -> float:
    """Rms of values less their mean over each `_SLOW` seconds [rad]."""
    number = slices(time, run, _SLOW)
    count = np.bincount(number)
    rest = values - (np.bincount(number, values) / count)[number]
    return float(np.sqrt(rest @ rest / max(values.size - count.size, 1)))


def count_steps(record: Record, ratio: float) -> tuple[float, float]:
    """Steps of the input's encoder, at the output, and of the output's [rad]; 0 where none is found."""
    return _step(record.input_angle, record.run) / abs(ratio), _step(record.output_angle, record.run)


def rounding(step: float) -> float:
    """Rms of what rounding to steps leaves [rad]."""
    return step / math.sqrt(12.0)


def _step(angle: Floats, run: Integers) -> float:
    """Step of an encoder that counts [rad]; zero where none is found."""
    change = np.abs(np.diff(angle))[np.diff(run) == 0]
    moved = change[change > 1e-12]
    if moved.size < 0.01 * change.size or not moved.size:
        return 0.0
    step = float(moved.min())
    number = moved / step
    whole = np.abs(number - np.rint(number)) < _WHOLE
    return step if float(np.mean(whole)) > 0.99 and float(np.median(number)) < _MOST_STEPS else 0.0
