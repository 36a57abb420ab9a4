"""Torque over position: windows of some turns of the wave generator, each less a smooth part of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numpy.polynomial import legendre

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.diagnosis.noise import bounds, numbered
from hd_diag.diagnosis.record import GAP_STEPS, RecordError, segments
from hd_diag.diagnosis.smoothing import rate

TURNS = 8.0
"""Of the wave generator in a window."""

TURN = 2.0 * np.pi

_CELLS = 512  # of a window, over which samples are averaged
_LEAST_SAMPLES = 4.0  # of a period; and of a window, for each degree of its smooth part
_SLOW = 0.1  # of the greatest speed, below which friction is not smooth
_SPEED_WINDOW = 0.05  # [s]
_DEGREE = 3  # of the smooth part, over position and over time


@dataclass(frozen=True)
class Windows:
    """Stretches of one direction and equal travel, s of them, in cells (s, c).

    Attributes
    ----------
    phase, rest, weight : ndarray, shape (s, c)
        Input angle [rad]; torque less what is smooth over position and time [N m]; of a cell, by Hann's
        window over the travel; the sum is 2.
    direction, middle, speed : ndarray, shape (s,)
        1 or -1; mean input angle [rad]; mean speed of the input over the travel, signed [rad/s].
    rows : ndarray of int64, shape (s, 2)
        First row of the samples, and the one after the last.
    run, record : ndarray of int64, shape (s,)
        Number of the motion without a turn or a rest that a window is of; of the recording.
    highest : ndarray, shape (s,)
        Periods per turn of the input up to which the samples tell a wave.
    """

    phase: Floats
    rest: Floats
    weight: Floats
    direction: Floats
    middle: Floats
    speed: Floats
    rows: Integers
    run: Integers
    record: Integers
    highest: Floats

    @property
    def size(self) -> int:
        """Number of windows."""
        return int(self.middle.size)

    @property
    def reach(self) -> float:
        """Turns of the input from end to end [-]."""
        return float(np.ptp(self.middle)) / TURN + TURNS

    def select(self, rows: npt.NDArray[np.bool_] | Integers) -> Windows:
        """Some of the windows."""
        return replace(self, **{name: column[rows] for name, column in vars(self).items()})

    def amplitudes(self, orders: Floats) -> Complexes:
        """Complex amplitudes (s, k) [N m] of waves at orders (k,) per turn of the input, from angle zero."""
        weighted = self.weight * self.rest
        waves = [np.sum(weighted * np.exp(-1j * order * self.phase), axis=1) for order in orders]
        return np.stack(waves, axis=1)


def windows(time: Floats, input_angle: Floats, torque: Floats, record: Integers) -> Windows:
    """Windows of a motion.

    Parameters
    ----------
    time, input_angle, torque : ndarray, shape (n,)
        [s]; continuous over the turns [rad]; [N m], or of any quantity that goes with it.
    record : ndarray of int64, shape (n,)
        Number of the recording, ascending.

    Raises
    ------
    RecordError
        Where stamps do not rise or nothing moves.
    """
    step = np.diff(time)
    if not (step > 0.0).any():
        raise RecordError("too short: at least two stamps that rise are needed")
    usual = float(np.median(step[step > 0.0]))
    segment = segments(time, record, GAP_STEPS)
    speed = rate(input_angle, segment, usual, _SPEED_WINDOW)
    way = np.sign(speed) * (np.abs(speed) > _SLOW * np.percentile(np.abs(speed), 95))
    run = numbered((np.diff(segment) != 0) | (np.diff(way) != 0.0))
    found = [
        (
            *_cells(time[part], input_angle[part], torque[part], np.abs(speed[part])),
            *(way[a], run[a], record[a], (part.start, part.stop)),
        )
        for begin, end in bounds(run)
        if way[begin] != 0.0
        for a, part in _parts(input_angle, begin, end)
    ]
    if not found:
        raise RecordError(
            f"too little motion, or too few samples of it: {float(np.ptp(input_angle)) / TURN:.3g} turns; "
            f"{TURNS:g} turns of the wave generator in one go are needed, {_LEAST_SAMPLES:g} samples each"
        )
    phase, rest, weight, mean, highest, way, run, record, rows = map(np.array, zip(*found, strict=True))
    middle = np.sum(weight * phase, axis=1) / np.sum(weight, axis=1)
    return Windows(phase, rest, weight, way, middle, way * mean, rows, run, record, highest)


def _parts(angle: Floats, begin: int, end: int) -> list[tuple[int, slice]]:
    """First rows and rows of the windows of a motion in one direction."""
    travel = np.maximum.accumulate(np.abs(angle[begin:end] - angle[begin])) / TURN
    count = int(travel[-1] / TURNS)
    edges = begin + np.searchsorted(travel, np.linspace(0.0, travel[-1], count + 1))
    least = int(_LEAST_SAMPLES * 2 * _DEGREE)
    return [(a, slice(a, b)) for a, b in pairwise(edges.tolist()) if b - a >= least]


def _cells(
    time: Floats, angle: Floats, torque: Floats, speed: Floats
) -> tuple[Floats, Floats, Floats, float, float]:
    """Angle, rest, weight of each cell of a window (c,), its mean speed, and the highest order it tells."""
    way = np.abs(angle - angle[0])
    place, moment = _unit(np.maximum.accumulate(way)), _unit(time)
    basis = np.hstack((legendre.legvander(place, _DEGREE), legendre.legvander(moment, _DEGREE)[:, 1:]))
    root = np.sqrt(speed)
    smooth = basis @ np.linalg.lstsq(basis * root[:, None], torque * root, rcond=1e-6)[0]
    index = np.minimum((0.5 * (place + 1.0) * _CELLS).astype(np.int64), _CELLS - 1)
    weight = np.bincount(index, speed * np.cos(0.5 * np.pi * place) ** 2, _CELLS)
    mean = [
        np.bincount(index, speed * values, _CELLS) / np.maximum(np.bincount(index, speed, _CELLS), 1e-300)
        for values in (angle, torque - smooth, speed)
    ]
    resolved = np.count_nonzero(np.diff(angle)) / (_LEAST_SAMPLES * float(way.max()) / TURN)
    share = weight / weight.sum()
    return mean[0], mean[1], 2.0 * share, float(share @ mean[2]), resolved


def _unit(values: Floats) -> Floats:
    """Rising values between -1 and 1."""
    return np.asarray(2.0 * (values - values[0]) / (values[-1] - values[0]) - 1.0)
