"""Orders of the residual, compiled; imported late because it imports numba."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.model.kernel.compiler import entry_point, part

# Way of the input [rad] and time of motion [s] over which an order's past decays to 1/e.
FORGOTTEN_WAY, FORGOTTEN_TIME = 64 * 2.0 * math.pi, 30.0
_WINDOW = 2 * 2.0 * math.pi  # way of the input over which waves are separated from slow changes [rad]
_LEAST_SAMPLES = 32.0  # samples per window, for nine unknowns
_LEAST_INFORMATION = 0.2  # per sample: a fitted cosine has 0.5 over many turns, 0.2 over one and a half
_RIDGE = 1e-6  # regularisation, so that orders without motion do not spoil the others
_LOADED = 0.5  # mean torque over its mean magnitude, above which a window loads one side
_FEWEST_WINDOWS, _FEWEST_SAMPLES = 4.0, 200.0  # least windows and samples to report an order
# An order repeats if its windows agree: the mean wave has at least half of their power, and a larger share
# than noise has by chance. For k waves of noise the share exceeds r with probability (1 - r)^(k - 1).
_STEADY, _STEADY_WINDOWS = 0.5, 12.0
_CHANCE = 1e-6
_LONGEST_STEP = 0.1  # longest step between two samples [s]; longer ones are gaps
_SLOWEST = 0.05  # least speed of the input [rad/s]; slower is rest


@entry_point
def follow(
    samples: Any,
    joint: int,
    last: Floats,
    step: Times,
    gram: Floats,
    moment: Floats,
    window: Floats,
    waves: Floats,
    output: Floats,
    means: Floats,
) -> None:
    """Follow the orders in `residual_orders.ORDERS` over windows of motion.

    `samples` are records of `SAMPLE`; those of other joints, and those without an output angle, are skipped.
    All arguments except for `samples` and `joint` are updated. `last` is the input angle of the previous
    sample, `step` its stamp, nan and 0 before the first. `gram` (9, 9) and `moment` (9,) are the normal
    equations of the present window; `window` (7,) holds its first residual and angle, way, time, and sums of
    torque, torque's magnitude and output angle. `waves` (sides, orders, 5) has sums over earlier windows:
    weights, their squares, waves (x, y) and their power. `output` (3, 3) and `means` (3,) are the normal
    equations of the output's order.
    """
    terms = np.ones(9)
    for i in range(samples.size):
        sample = samples[i]
        if sample.joint != joint or not math.isfinite(sample.output_angle):
            continue
        angle, residual = sample.input_angle, sample.residual
        elapsed, turned = (sample.stamp - step[0]) * 1e-9, abs(angle - last[0])
        last[0], step[0] = angle, sample.stamp
        if not 0.0 < elapsed <= _LONGEST_STEP:
            _empty(gram, moment, window)  # samples may be lost in between
        if not (elapsed > 0.0 and turned > _SLOWEST * min(elapsed, _LONGEST_STEP)):
            continue
        if not math.isfinite(residual):
            continue
        if gram[0, 0] == 0.0:
            window[0], window[1] = residual, angle
        else:
            window[2] += turned
            window[3] += elapsed
        _add(terms, gram, moment, angle, angle - window[1], residual - window[0])
        window[4] += sample.torque
        window[5] += abs(sample.torque)
        window[6] += sample.output_angle
        if window[2] >= _WINDOW and gram[0, 0] >= _LEAST_SAMPLES:
            _close(gram, moment, window, waves, output, means)
            _empty(gram, moment, window)


@part
def _empty(gram: Floats, moment: Floats, window: Floats) -> None:
    for sums in (gram.ravel(), moment, window):
        sums[:] = 0.0


@part
def _add(
    terms: Floats, gram: Floats, moment: Floats, angle: float, from_first: float, residual: float
) -> None:
    """Add a sample to a window's normal equations: a parabola of the angle, then cosines and sines."""
    terms[1] = from_first / _WINDOW
    terms[2] = terms[1] * terms[1]
    terms[3], terms[6] = math.cos(angle), math.sin(angle)
    for k in (4, 5):  # twice the angle
        terms[k] = 1.0 - 2.0 * terms[k + 2] * terms[k + 2]
        terms[k + 3] = 2.0 * terms[k + 2] * terms[k - 1]
    for j in range(9):
        moment[j] += terms[j] * residual
        for k in range(j + 1):
            gram[j, k] += terms[j] * terms[k]


@part
def _close(
    gram: Floats, moment: Floats, window: Floats, waves: Floats, output: Floats, means: Floats
) -> None:
    """Add a window's results: each order's wave, to the side that the torque loads, and its mean residual."""
    kept = math.exp(-min(window[2] / FORGOTTEN_WAY, window[3] / FORGOTTEN_TIME))
    loaded = window[4] / window[5] if window[5] > 0.0 else 0.0
    side = 1 if loaded > _LOADED else 2 if loaded < -_LOADED else 0
    for i in range(waves.shape[0]):
        for order in range(3):
            for k in range(5):
                waves[i, order, k] *= kept * kept if k == 1 else kept
    count, inverse = gram[0, 0], _inverse(gram)
    for order in range(3):
        if _is_known(inverse, count, 3 + order, 6 + order):
            x, y = np.sum(inverse[3 + order] * moment), np.sum(inverse[6 + order] * moment)
            wave = waves[side, order]
            for k, value in enumerate((1.0, 1.0, x, y, x * x + y * y)):
                wave[k] += value
    angle = window[6] / count
    place = (1.0, math.cos(angle), math.sin(angle))
    for j in range(3):
        means[j] = kept * means[j] + place[j] * (moment[0] + count * window[0])
        for k in range(3):
            output[j, k] = kept * output[j, k] + count * place[j] * place[k]


@part
def _inverse(gram: Floats) -> Floats:
    """Inverse of normal equations, given by their lower triangle; element (0, 0) is the number of samples.

    By Gauss-Jordan elimination: for numpy's inverse numba loads scipy.linalg, which takes 17 MB.
    """
    found = np.eye(gram.shape[0])
    left = np.tril(gram) + np.tril(gram, -1).T + _RIDGE * max(gram[0, 0], 1.0) * found
    for j in range(found.shape[0]):  # positive definite: no pivoting is needed
        pivot = left[j, j]
        left[j] /= pivot
        found[j] /= pivot
        for i in range(found.shape[0]):
            if i != j:
                factor = left[i, j]
                left[i] -= factor * left[j]
                found[i] -= factor * found[j]
    return found


@part
def _is_known(inverse: Floats, count: float, c: int, s: int) -> bool:
    """Whether the motion shows an order, by the largest variance of its cosine and sine coefficients."""
    half, mean = 0.5 * (inverse[c, c] - inverse[s, s]), 0.5 * (inverse[c, c] + inverse[s, s])
    return bool((mean + math.hypot(half, inverse[c, s])) * count * _LEAST_INFORMATION < 1.0)


@entry_point
def look(waves: Floats, output: Floats, means: Floats) -> Floats:
    """Amplitude, phase, standard deviation and whether it repeats, for each order (4, 4); nan: unknown.

    They are of the side on which the order repeats, or else is larger.
    """
    found = np.full((4, 4), math.nan)
    found[:, 3] = 0.0
    for order in range(3):
        for side in range(3):
            wave, known = waves[side, order], found[order]
            weight, squares, x, y, power = wave[0], wave[1], wave[2], wave[3], wave[4]
            windows = weight * weight / squares if squares > 0.0 else 0.0
            if windows < _FEWEST_WINDOWS:
                continue
            amplitude, mean_square = math.hypot(x, y) / weight, power / weight
            steady = amplitude * amplitude / mean_square if mean_square > 0.0 else 0.0
            chance = 1.0 - _CHANCE ** (1.0 / (windows - 1.0))
            repeats = 1.0 if windows >= _STEADY_WINDOWS and steady > max(_STEADY, chance) else 0.0
            if math.isnan(known[0]) or (repeats, amplitude) > (known[3], known[0]):
                variance = max(0.0, mean_square - amplitude * amplitude) / (windows - 1.0)
                known[0], known[1], known[3] = amplitude, math.atan2(y, x), repeats
                known[2] = math.sqrt(0.5 * variance)
    count, inverse = output[0, 0], _inverse(output)
    if count >= _FEWEST_SAMPLES and _is_known(inverse, count, 1, 2):
        x, y = np.sum(inverse[1] * means), np.sum(inverse[2] * means)
        found[3, 0], found[3, 1] = math.hypot(x, y), math.atan2(y, x)
    return found
