"""What no known cause explains, described but not named: order, amplitude, torque and direction."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import f_test, holds, orthonormal
from hd_diag.diagnosis.fit.linearised_fit import Chosen, Item, LinearisedFit
from hd_diag.diagnosis.noise import Whitening, whitening
from hd_diag.diagnosis.search.acceptance import LEAST_SIZE
from hd_diag.diagnosis.search.causes import Search
from hd_diag.model.torsion_map import ARCSEC

Rows = npt.NDArray[np.bool_]

_MOST_CELLS = 4_000_000
_PER_TURN = 128  # cells per turn of the input, so orders up to 64 are seen
_MOST_ORDERS = 40.0
_LEAST_ORDER = 0.012  # once and twice per output turn are causes of their own
_MOST_WAVES = 4
_LEAST_PART = 0.08  # of the record, in which a wave is searched for alone
_CONFIRMED = 0.5  # of the gain of held-out blocks that a wave predicts
_UNLIKE = 0.8  # ratio of speeds below which they differ
_CHANCE = 1e-4  # of a wave by noise alone, over all orders searched


@dataclass(frozen=True)
class Unexplained:
    """A part of the residual that no known cause explains.

    Attributes
    ----------
    order : float
        Cycles per turn of the input, or per turn of the output, or hertz; 0 for what is not periodic.
    frame : str
        ``input``, ``output`` or ``time``.
    amplitude : float
        [rad]
    torque_law, direction_law : str
        How it depends on torque and direction, in words.
    description : str
        What is not periodic, in words.
    where : str
        In words, if it shows in one direction, at some speeds or under one sign of the torque only.
    """

    order: float
    frame: str
    amplitude: float
    torque_law: str
    direction_law: str
    description: str = ""
    where: str = ""


class Weight(NamedTuple):
    """A factor of a wave, shape (n,), and in words where that is not zero."""

    values: Floats
    where: str = ""


def unexplained(found: Search) -> list[Unexplained]:
    """Unmodelled terms, and periodic parts of the residual that stand out of the noise."""
    fit, residual = found.fit, found.fit.remainder(found.chosen)
    result = [_term(found, item, residual) for item in found.unmodelled]
    columns: list[Floats] = []
    for _ in range(_MOST_WAVES):
        wave = _strongest(fit, found.chosen, residual, columns)
        if wave is None:
            break
        pair, part, described = wave
        columns.append(pair)
        residual = residual - part
        result.append(described)
    return result


def _term(found: Search, item: Item, residual: Floats) -> Unexplained:
    """A part without a period; its amplitude is root two of its rms."""
    fit, (term, _) = found.fit, item
    place = fit.places(found.chosen)[found.chosen.index(item)]
    part = fit.columns(*item) @ fit.fit(found.chosen)[0][place]
    part = part - part.mean()
    amplitude = float(np.sqrt(2.0) * np.std(part))
    laws = _laws(fit, part + residual, part / max(amplitude, 1e-300))
    return Unexplained(0.0, "input" if term.frame == "torque" else term.frame, amplitude, *laws, term.cause)


def _strongest(
    fit: LinearisedFit, chosen: Chosen, residual: Floats, taken: list[Floats]
) -> tuple[Floats, Floats, Unexplained] | None:
    """The wave that stands out most: evenly, in proportion to the torque, or in a part of the record.

    Its columns, shape (n, 2), its part of the residual [rad], shape (n,), and its description.
    """
    weights = _weights(fit)
    peaks = [
        (*peak, frame, weight)
        for frame in ("input", "time")
        for weight in weights
        if (peak := _peak(_phase(fit, frame), residual * weight.values)) is not None
    ]
    if not peaks:
        return None
    _, order, frame, weight = max(peaks, key=lambda one: one[0])
    order = _refined(fit, residual * weight.values, order, frame)
    even = _pair(fit, order, frame)
    # Noise is learnt beside waves of this order in every part, or strong ones would count as noise.
    every = [even * one.values[:, None] for one in weights]
    whiten = whitening(residual - _explained(np.concatenate(every, axis=1), residual), fit.data.run)
    white = whiten(residual, fit.data.run)
    gains = [float(np.sum(_explained(whiten(pair, fit.data.run), white) ** 2)) for pair in every]
    weight, pair = weights[int(np.argmax(gains))], every[int(np.argmax(gains))]
    coefficients = np.linalg.lstsq(pair, residual, rcond=None)[0]
    part = pair @ coefficients
    amplitude = float(np.sqrt(2.0) * np.std(part))
    columns = np.concatenate([fit.always(), fit.joined(chosen), *taken, pair], axis=1)
    tests = 4.0 * len(weights) * _MOST_ORDERS * max(_turns(_phase(fit, "input")), 1.0)
    if tests * _chance(fit, columns, whiten) > _CHANCE or amplitude < np.sqrt(2.0) * LEAST_SIZE:
        return None
    gain, predicted = _block_gains(fit, residual, pair, whiten)
    if not holds(gain, predicted) and gain.sum() < _CONFIRMED * predicted.sum():
        return None
    wave = even @ coefficients / np.hypot(*coefficients)
    if float(weight.values.min()) < 0.0:
        wave *= np.sign(fit.signals.torque)
    laws = _laws(fit, residual, wave)
    return pair, part, Unexplained(order, frame, amplitude, *laws, where=weight.where)


def _chance(fit: LinearisedFit, columns: Floats, whiten: Whitening) -> float:
    """Chance of the gain of the last two columns by noise."""
    white, residual = whiten(columns, fit.data.run), whiten(fit.residual, fit.data.run)
    before, after = _deviance(residual, white[:, :-2]), _deviance(residual, white)
    return f_test(before, after, 2, int(np.count_nonzero(fit.residual_white)), columns.shape[1])


def _weights(fit: LinearisedFit) -> list[Weight]:
    """One; the torque over its greatest where it has both signs; one in a part of the record alone."""
    load = fit.signals.torque
    full = load / max(float(np.max(np.abs(load))), 1e-300)
    both = float(full.min()) < -0.2 and float(full.max()) > 0.2
    whole = [Weight(np.ones(load.size)), *([Weight(full)] if both else [])]
    parts = [*_signs(full, "under positive torque", "under negative torque"), *_speeds(fit)]
    return [*whole, *(Weight(rows.astype(np.float64), where) for rows, where in parts)]


def _signs(values: Floats, above: str, below: str) -> list[tuple[Rows, str]]:
    """Rows with values of either sign, if there are enough of both."""
    parts = [(values > 0.0, above), (values < 0.0, below)]
    return parts if min(float(np.mean(rows)) for rows, _ in parts) > _LEAST_PART else []


def _speeds(fit: LinearisedFit) -> list[tuple[Rows, str]]:
    """Rows of one direction, and in it of each third of the speeds, where the speed differs."""
    speed = fit.signals.forward_speed / (2.0 * np.pi)
    found = _signs(speed, "forward", "backward") or [(speed != 0.0, "")]
    edges = np.quantile(np.abs(speed), (0.0, 1 / 3, 2 / 3, 1.0))
    bands = []
    for rows, way in found:
        for low, high in pairwise(edges.tolist()):
            inside = rows & (np.abs(speed) >= low) & (np.abs(speed) <= high)
            if edges[1] < _UNLIKE * edges[2] and float(np.mean(inside)) > _LEAST_PART:
                bands.append((inside, f"{way} at {low:.2g} to {high:.2g} turns/s of the input".strip()))
    return [*(one for one in found if one[1]), *bands]


def _explained(columns: Floats, residual: Floats) -> Floats:
    """Part of a residual that columns explain."""
    return np.asarray(columns @ np.linalg.lstsq(columns, residual, rcond=None)[0])


def _deviance(residual: Floats, columns: Floats) -> float:
    """Residual sum of squares of a fit of columns."""
    basis = orthonormal(columns)
    return float(np.sum((residual - basis @ (basis.T @ residual)) ** 2))


def _block_gains(
    fit: LinearisedFit, residual: Floats, pair: Floats, whiten: Whitening
) -> tuple[Floats, Floats]:
    """Fall of the sum of squares in each block by a wave fitted to all others, and the fall predicted."""
    white = whiten(np.column_stack((pair, residual)), fit.data.run)
    gains, predicted = [], []
    for block in range(int(fit.data.block[-1]) + 1):
        inside = fit.data.block == block
        found = np.linalg.lstsq(white[~inside, :2], white[~inside, 2], rcond=None)[0]
        here, wave = white[inside, 2], white[inside, :2] @ found
        gains.append(float(here @ here - np.sum((here - wave) ** 2)))
        predicted.append(float(wave @ wave))
    return np.array(gains), np.array(predicted)


def _turns(phase: Floats) -> float:
    return float(np.ptp(phase)) / (2.0 * np.pi)


def _peak(phase: Floats, residual: Floats) -> tuple[float, float] | None:
    """Height of the highest peak of the spectrum over its neighbourhood, and its order."""
    turns = _turns(phase)
    cells = int(np.ceil(turns * _PER_TURN)) + 1
    if turns < 3.0 or cells > _MOST_CELLS:
        return None
    index = ((phase - phase.min()) / (2.0 * np.pi) * _PER_TURN).astype(np.int64)
    total = np.bincount(index, weights=residual, minlength=cells)
    count = np.bincount(index, minlength=cells)
    mean = np.where(count > 0, total / np.maximum(count, 1), 0.0)
    power = np.abs(np.fft.rfft(mean, 2 * cells)) ** 2
    orders = np.arange(power.size) * _PER_TURN / (2.0 * cells)
    use = (orders > max(_LEAST_ORDER, 2.0 / turns)) & (orders < _MOST_ORDERS)
    if use.sum() < 50:
        return None
    power, orders = power[use], orders[use]
    width = max(25, power.size // 60)
    floor = np.array([np.median(part) for part in np.array_split(power, max(power.size // width, 1))])
    local = np.interp(np.arange(power.size), np.linspace(0, power.size, floor.size), floor)
    ratio = power / np.maximum(local, 1e-300)
    best = int(np.argmax(ratio))
    return float(ratio[best]), float(orders[best])


def _phase(fit: LinearisedFit, frame: str) -> Floats:
    return fit.signals.wave_generator_angle if frame == "input" else 2.0 * np.pi * fit.signals.time


def _pair(fit: LinearisedFit, order: float, frame: str) -> Floats:
    phase = order * _phase(fit, frame)
    return np.stack((np.cos(phase), np.sin(phase)), axis=1)


def _refined(fit: LinearisedFit, residual: Floats, order: float, frame: str) -> float:
    """The order near a peak at which a wave explains most."""
    step = 0.5 / max(_turns(_phase(fit, frame)), 1.0)
    for _ in range(3):
        trial = order + step * np.linspace(-1.0, 1.0, 9)
        power = [float(np.sum((_pair(fit, value, frame).T @ residual) ** 2)) for value in trial]
        order, step = float(trial[int(np.argmax(power))]), step / 4.0
    return order


def _laws(fit: LinearisedFit, residual: Floats, wave: Floats) -> tuple[str, str]:
    """How a wave depends on torque and direction."""

    def size(rows: Rows) -> float:
        own = wave[rows]
        return float(residual[rows] @ own / max(float(own @ own), 1e-300)) / ARCSEC

    load, speed = np.abs(fit.signals.torque), fit.signals.speed
    torque_law = "not tested: the torque did not change"
    if np.ptp(load) >= 0.2 * max(float(load.max()), 1e-9):
        low, high = np.quantile(load, (0.33, 0.67))
        small, large = size(load < low), size(load > high)
        trend = "grows" if large > small else "falls"
        torque_law = f"{trend} with torque: {small:.2f} to {large:.2f} arcsec"
        if _alike(small, large):
            torque_law = "independent of torque"
    direction_law = "not tested: one direction only"
    if min(np.mean(speed > 0.0), np.mean(speed < 0.0)) >= 0.1:
        forward, backward = size(speed > 0.0), size(speed < 0.0)
        direction_law = f"{forward:.2f} arcsec forward, {backward:.2f} arcsec backward"
        if _alike(forward, backward):
            direction_law = "the same in both directions"
    return torque_law, direction_law


def _alike(one: float, other: float) -> bool:
    return abs(one - other) < 0.25 * max(abs(one), abs(other))
