"""What no known cause explains, described and not named: order, amplitude, torque and direction."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import f_test, holds, orthonormal
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.noise import Whitening, whitening
from hd_diag.diagnosis.search.acceptance import LEAST_SIZE
from hd_diag.diagnosis.search.causes import Search
from hd_diag.diagnosis.search.unmodelled_terms import Foil
from hd_diag.model.torsion_map import ARCSEC

Rows = npt.NDArray[np.bool_]

_PER_TURN = 128  # cells per turn of the input, so orders up to 64 are seen
_MOST_ORDERS = 40.0
_LEAST_ORDER = 0.012  # once and twice per output turn are causes of their own
_MOST_LINES = 4
_LEAST_PART = 0.08  # of the record, in which a wave is looked for alone
_BORNE_OUT = 0.5  # of what blocks that were not fitted should gain by a wave
_UNLIKE = 0.8  # ratio of speeds below which they differ
_CHANCE = 1e-4  # of a line by noise alone, over all orders looked at


@dataclass(frozen=True)
class Line:
    """An unexplained periodic part.

    Attributes
    ----------
    order : float
        Cycles per turn of the input, or per turn of the output, or hertz.
    frame : str
        ``input``, ``output`` or ``time``.
    amplitude : float
        [rad]
    torque_law, direction_law : str
        How it goes with torque and direction, in words.
    description : str
        What is not periodic (order 0), in words.
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


@dataclass(frozen=True)
class Weight:
    """What a wave is scaled by, shape (n,), and in words where that leaves something of it."""

    values: Floats
    where: str = ""


@dataclass(frozen=True)
class Wave:
    """A line with the columns that hold it, shape (n, 2), and its part of the remainder, shape (n,) [rad]."""

    columns: Floats
    part: Floats
    line: Line


def lines(found: Search) -> list[Line]:
    """Periodic parts of the remainder that stand out of the noise.

    Parameters
    ----------
    found : Search

    Returns
    -------
    list of Line
    """
    bench = found.bench
    rest = bench.remainder(found.chosen)
    result = [_shape(found, effect) for effect, _ in found.foils if isinstance(effect, Foil)]
    columns: list[Floats] = []
    for _ in range(_MOST_LINES):
        wave = _strongest(bench, found.chosen, rest, columns)
        if wave is None:
            break
        columns.append(wave.columns)
        rest = rest - wave.part
        result.append(wave.line)
    return result


def _shape(found: Search, foil: Foil) -> Line:
    """A part without a period; its amplitude is root two of its rms."""
    bench, index = found.bench, [effect for effect, _ in found.chosen].index(foil)
    beta, _, _ = bench.fit(found.chosen)
    part = bench.columns(*found.chosen[index]) @ beta[bench.places(found.chosen)[index]]
    part = part - part.mean()
    amplitude = float(np.sqrt(2.0) * np.std(part))
    rest, wave = part + bench.remainder(found.chosen), part / max(amplitude, 1e-300)
    return Line(
        0.0,
        "input" if foil.frame == "torque" else str(foil.frame),
        amplitude,
        _torque_law(bench, rest, wave),
        _direction_law(bench, rest, wave),
        foil.description,
    )


def _strongest(bench: LinearisedFit, chosen: Chosen, rest: Floats, taken: list[Floats]) -> Wave | None:
    """The wave that stands out most: evenly, in proportion to the torque, or in a part of the record."""
    found, weights = [], _weights(bench)
    for frame in ("input", "time"):
        for weight in weights:
            peak = _peak(_phase(bench, frame), rest * weight.values)
            if peak is not None:
                found.append((peak[1], peak[0], frame, weight))
    if not found:
        return None
    _, order, frame, weight = max(found, key=lambda one: one[0])
    order = _refined(bench, rest * weight.values, order, frame)
    even = _pair(bench, order, frame)
    # Noise is learnt beside waves of this order in every part, or strong ones would count as noise.
    every = [even * one.values[:, None] for one in weights]
    learnt = whitening(rest - _explained(np.concatenate(every, axis=1), rest), bench.data.run)
    white = learnt(rest, bench.data.run)
    gains = [float(np.sum(_explained(learnt(pair, bench.data.run), white) ** 2)) for pair in every]
    weight, pair = weights[int(np.argmax(gains))], every[int(np.argmax(gains))]
    columns = np.concatenate([bench.always(), bench.joined(chosen), *taken, pair], axis=1)
    coefficients = np.linalg.lstsq(pair, rest, rcond=None)[0]
    part = pair @ coefficients
    white, left = learnt(columns, bench.data.run), learnt(bench.residual, bench.data.run)
    before, after = _deviance(left, white[:, :-2]), _deviance(left, white)
    counted = int(np.count_nonzero(bench.residual_white))
    turns = float(np.ptp(bench.signals.wave_generator_angle)) / (2.0 * np.pi)
    tests = 4.0 * len(weights) * _MOST_ORDERS * max(turns, 1.0)
    p = tests * f_test(before, after, 2, counted, columns.shape[1])
    amplitude = float(np.sqrt(2.0) * np.std(part))
    if p > _CHANCE or amplitude < np.sqrt(2.0) * LEAST_SIZE:
        return None
    gain, foretold = _block_gains(bench, rest, pair, learnt)
    if not holds(gain, foretold) and gain.sum() < _BORNE_OUT * foretold.sum():
        return None
    wave = even @ coefficients
    wave /= np.hypot(*coefficients)
    if float(weight.values.min()) < 0.0:
        wave *= np.sign(bench.signals.torque)
    laws = _torque_law(bench, rest, wave), _direction_law(bench, rest, wave)
    return Wave(pair, part, Line(order, frame, amplitude, *laws, where=weight.where))


def _weights(bench: LinearisedFit) -> list[Weight]:
    """One; the torque over its greatest where it has both signs; one in a part of the record alone."""
    load = bench.signals.torque
    full = load / max(float(np.max(np.abs(load))), 1e-300)
    both = float(full.min()) < -0.2 and float(full.max()) > 0.2
    whole = [Weight(np.ones(load.size)), *([Weight(full)] if both else [])]
    parts = [*_signs(full, "under positive torque", "under negative torque"), *_speeds(bench)]
    return [*whole, *(Weight(rows.astype(np.float64), where) for rows, where in parts)]


def _signs(values: Floats, above: str, below: str) -> list[tuple[Rows, str]]:
    """Rows with values of either sign, if there are enough of both."""
    parts = [(values > 0.0, above), (values < 0.0, below)]
    return parts if min(float(np.mean(rows)) for rows, _ in parts) > _LEAST_PART else []


def _speeds(bench: LinearisedFit) -> list[tuple[Rows, str]]:
    """Rows of one direction, and in it of each third of the speeds, where the speed differs."""
    speed = bench.signals.forward_speed / (2.0 * np.pi)
    found = _signs(speed, "forward", "backward") or [(speed != 0.0, "")]
    edges = np.quantile(np.abs(speed), (0.0, 1 / 3, 2 / 3, 1.0))
    bands = []
    for rows, way in found:
        for low, high in pairwise(edges.tolist()):
            inside = rows & (np.abs(speed) >= low) & (np.abs(speed) <= high)
            if edges[1] < _UNLIKE * edges[2] and float(np.mean(inside)) > _LEAST_PART:
                bands.append((inside, f"{way} at {low:.2g} to {high:.2g} turns/s of the input".strip()))
    return [*(one for one in found if one[1]), *bands]


def _explained(columns: Floats, rest: Floats) -> Floats:
    """Part of a remainder that columns explain."""
    return np.asarray(columns @ np.linalg.lstsq(columns, rest, rcond=None)[0])


def _deviance(left: Floats, columns: Floats) -> float:
    basis = orthonormal(columns)
    rest = left - basis @ (basis.T @ left)
    return float(rest @ rest)


def _block_gains(
    bench: LinearisedFit, rest: Floats, pair: Floats, learnt: Whitening
) -> tuple[Floats, Floats]:
    """Fall of the sum of squares in each block by a wave fitted to all others, and what that foretells."""
    white = learnt(np.column_stack((pair, rest)), bench.data.run)
    gains, foretold = [], []
    for block in range(int(bench.data.block[-1]) + 1):
        inside = bench.data.block == block
        fit = np.linalg.lstsq(white[~inside, :2], white[~inside, 2], rcond=None)[0]
        here, wave = white[inside, 2], white[inside, :2] @ fit
        gains.append(float(here @ here - np.sum((here - wave) ** 2)))
        foretold.append(float(wave @ wave))
    return np.array(gains), np.array(foretold)


def _peak(phase: Floats, rest: Floats) -> tuple[float, float] | None:
    """Order of the highest peak over its own neighbourhood, and the ratio; cells of one turn averaged."""
    turns = float(np.ptp(phase)) / (2.0 * np.pi)
    if turns < 3.0:
        return None
    cells = int(np.ceil(turns * _PER_TURN)) + 1
    if cells > 4_000_000:
        return None
    index = ((phase - phase.min()) / (2.0 * np.pi) * _PER_TURN).astype(np.int64)
    total = np.bincount(index, weights=rest, minlength=cells)
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
    return float(orders[best]), float(ratio[best])


def _phase(bench: LinearisedFit, frame: str) -> Floats:
    return bench.signals.wave_generator_angle if frame == "input" else 2.0 * np.pi * bench.signals.time


def _pair(bench: LinearisedFit, order: float, frame: str) -> Floats:
    phase = order * _phase(bench, frame)
    return np.stack((np.cos(phase), np.sin(phase)), axis=1)


def _refined(bench: LinearisedFit, rest: Floats, order: float, frame: str) -> float:
    """The order near a peak at which a wave explains most."""
    step = 0.5 / max(float(np.ptp(_phase(bench, frame))) / (2.0 * np.pi), 1.0)
    for _ in range(3):
        trial = order + step * np.linspace(-1.0, 1.0, 9)
        power = []
        for value in trial:
            pair = _pair(bench, value, frame)
            power.append(float(np.sum((pair.T @ rest) ** 2)))
        order, step = float(trial[int(np.argmax(power))]), step / 4.0
    return order


def _share(rest: Floats, wave: Floats, rows: npt.NDArray[np.bool_]) -> float:
    return float(rest[rows] @ wave[rows] / max(float(wave[rows] @ wave[rows]), 1e-300))


def _torque_law(bench: LinearisedFit, rest: Floats, wave: Floats) -> str:
    load = np.abs(bench.signals.torque)
    if np.ptp(load) < 0.2 * max(float(load.max()), 1e-9):
        return "not tested: the torque did not change"
    low, high = np.quantile(load, (0.33, 0.67))
    small, large = _share(rest, wave, load < low), _share(rest, wave, load > high)
    if abs(large - small) < 0.25 * max(abs(large), abs(small)):
        return "independent of torque"
    trend = "grows" if large > small else "falls"
    return f"{trend} with torque: {small / ARCSEC:.2f} to {large / ARCSEC:.2f} arcsec"


def _direction_law(bench: LinearisedFit, rest: Floats, wave: Floats) -> str:
    forward, backward = bench.signals.speed > 0.0, bench.signals.speed < 0.0
    if min(forward.mean(), backward.mean()) < 0.1:
        return "not tested: one direction only"
    a, b = _share(rest, wave, forward), _share(rest, wave, backward)
    if abs(a - b) < 0.25 * max(abs(a), abs(b)):
        return "the same in both directions"
    return f"{a / ARCSEC:.2f} arcsec forward, {b / ARCSEC:.2f} arcsec backward"
