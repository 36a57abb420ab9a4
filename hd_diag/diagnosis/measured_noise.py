"""Model-free noise of a record, from differences between two passes of the same state."""

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

_QUERIES, _KNOWN, _NEIGHBOURS = 6000, 24_000, 24  # moments queried, moments searched, nearest neighbours
_PAIRS = 4  # most pairs of one moment
_APART = 0.5  # least time between the two moments, so that encoder noise is uncorrelated [s]
_WAY = 1.0  # least input travel between them, so that a rest does not count as a revisit [rad]
_NEAR = 8.0  # largest squared distance of states that count as the same [-]
_LAG = 0.2  # time over which the torque's rise shows the branch of a loop [s]
_LEAST_PAIRS, _LEAST_SLICES = 400, 8
_SLOW = 3.0  # parts that stay constant for so long are not encoder noise [s]
_SLICE = 0.5  # length of a bootstrap slice [s]
_VAGUE = 1.5  # ratio of the interval's ends above which the extrapolation is dropped
_DRAWS = 200
_OWN = 0.06  # relative error: extrapolation takes some slow noise for a difference of states
_DIFFERENCE = 6  # order of a difference that removes any smooth motion
_QUICKEST = 0.25  # least noise at any frequency, over the variance of the sixth differences
_WHOLE = 0.02  # tolerance of a whole number of counts [counts]
_MOST_STEPS = 1000.0  # largest median change between neighbours that still shows counts [counts]


class MeasuredNoise(NamedTuple):
    """Noise of a record [rad rms], and its 95 % interval; `repeated` if states were passed again.

    It is `vague` if the passes disagree too much to extrapolate. It is then the rms of all differences.
    """

    rms: float
    low: float
    high: float
    repeated: bool
    vague: bool = False


class Revisits(NamedTuple):
    """Pairs of moments at which the drive is in nearly the same state, in separate passes.

    `first` and `second` are row indices (n,); `apart` holds squared distances per kind of state (n, k) [-].
    """

    first: Integers
    second: Integers
    apart: Floats


NEVER = Revisits(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty((0, 1)))
"""Empty result for a motion that never passes a state again."""


def revisits(signals: Signals) -> Revisits:
    """Pairs of moments with nearly the same angles, torque, torque rise, speed, direction and time."""
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
    """Noise of a residual (n,) [rad]; a model error is the same in the same state and cancels.

    Times are in s, and a run has no gap. `counted` is the quantisation noise of the encoders [rad], a lower
    limit.

    Notes
    -----
    The variogram is half the mean square difference of pairs. A straight line in the squared distances
    extrapolates it to distance zero (its nugget: Matheron, Economic Geology 58, 1963). Without revisited
    states, sixth differences measure only the white noise: a lower bound. The upper bound is then the rms of
    all changes within `_SLOW` seconds.
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
    if vague:  # too few pairs to extrapolate
        rms = high = math.sqrt(float(half.mean()))
    low = max(min(low, rms), (1.0 - _OWN) * least)
    return MeasuredNoise(max(rms, least), low, max(high, rms, least), True, vague)


def measured_covariance(residual: Floats, run: Integers, passed: Revisits, noise: MeasuredNoise) -> Floats:
    """Covariances of the noise at lags 0 to ORDER [rad^2], shape (ORDER + 1,), without the residual's misfit.

    They are those of the differences between passes. Variance beyond the noise is misfit, which hardly
    changes over so few samples, so it is subtracted at all lags. If it does change, the result may be no
    valid covariance. It is then shrunk towards white noise of the same variance until every frequency has at
    least a fixed share of the variance of the sixth differences.
    """
    last = np.maximum(passed.first, passed.second) + ORDER < run.size
    first, second = passed.first[last], passed.second[last]
    whole = (run[first + ORDER] == run[first]) & (run[second + ORDER] == run[second])
    first, second = first[whole], second[whole]
    if not first.size:  # white, as no pass is long enough
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
    """State of every moment (n, k), scaled so that one unit changes little; kind of each coordinate (k,)."""
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
    """First coefficient of n non-negative least squares, from normal equations (n, k, k) and (n, k)."""
    ridge = 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None]
    root = np.linalg.cholesky(gram + ridge * np.eye(gram.shape[-1]))
    target = np.linalg.solve(root, moment[..., None])[..., 0]
    return [float(nnls(each.T, own)[0][0]) for each, own in zip(root, target, strict=True)]


def _of_short_differences(values: Floats, run: Integers) -> float:
    """Rms of the white noise in values (n,), from their sixth differences within runs [rad]."""
    order = _DIFFERENCE
    if values.size <= order:
        return 0.0
    weights = np.array([(-1.0) ** k * math.comb(order, k) for k in range(order + 1)])
    inside = run[order:] == run[:-order]
    found = np.convolve(values, weights / np.linalg.norm(weights), "valid")[inside]
    return float(np.sqrt(np.mean(found**2))) if found.size else 0.0


def _quick(values: Floats, time: Floats, run: Integers) -> float:
    """Rms of values (n,) about their mean over each `_SLOW` seconds [rad]."""
    number = slices(time, run, _SLOW)
    count = np.bincount(number)
    rest = values - (np.bincount(number, values) / count)[number]
    return float(np.sqrt(rest @ rest / max(values.size - count.size, 1)))


def count_steps(record: Record, ratio: float) -> tuple[float, float]:
    """Count steps of the input encoder (over the ratio) and of the output encoder [rad]; 0 if none."""
    return _step(record.input_angle, record.run) / abs(ratio), _step(record.output_angle, record.run)


def rounding(step: float) -> float:
    """Rms quantisation error of a count step [rad]."""
    return step / math.sqrt(12.0)


def _step(angle: Floats, run: Integers) -> float:
    """Count step of an encoder [rad], from its angle (n,); zero if the angle shows no counts."""
    change = np.abs(np.diff(angle))[np.diff(run) == 0]
    moved = change[change > 1e-12]
    if moved.size < 0.01 * change.size or not moved.size:
        return 0.0
    step = float(moved.min())
    number = moved / step
    whole = np.abs(number - np.rint(number)) < _WHOLE
    return step if float(np.mean(whole)) > 0.99 and float(np.median(number)) < _MOST_STEPS else 0.0
