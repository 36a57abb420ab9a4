"""Torque over position, in windows of some turns of the wave generator, each with its smooth part removed."""

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
"""Turns of the wave generator in a window."""

TURN = 2.0 * np.pi

_CELLS = 512  # averaging cells of a window
_LEAST_SAMPLES = 4.0  # per period, and per degree of a window's smooth part
_SLOW = 0.1  # of the top speed; friction is not smooth below
_SPEED_WINDOW = 0.05  # [s]
_DEGREE = 3  # degree of the smooth part, over position and over time


@dataclass(frozen=True)
class Windows:
    """Stretches of one direction and about equal travel; s windows with c cells each.

    Attributes
    ----------
    phase, rest, weight : ndarray, shape (s, c)
        Input angle [rad]; torque without its smooth part over position and time [N m]; weight of each cell
        by Hann's window over the travel, with a sum of 2.
    direction, middle, speed : ndarray, shape (s,)
        1 or -1; mean input angle [rad]; mean speed of the input over the travel, signed [rad/s].
    rows : ndarray of int64, shape (s, 2)
        First row of the samples, and the row after the last.
    run, record : ndarray of int64, shape (s,)
        Number of the motion without a reversal or rest; number of the recording.
    highest : ndarray, shape (s,)
        Highest order that the samples resolve, in periods per turn of the input.
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
        """Complex amplitudes (s, k) [N m] at orders (k,) per turn of the input; phase zero at angle zero."""
        weighted = self.weight * self.rest
        waves = [np.sum(weighted * np.exp(-1j * order * self.phase), axis=1) for order in orders]
        return np.stack(waves, axis=1)


def windows(time: Floats, input_angle: Floats, torque: Floats, record: Integers) -> Windows:
    """Windows of a motion.

    Parameters
    ----------
    time, input_angle, torque : ndarray, shape (n,)
        [s]; continuous over the turns [rad]; [N m], or any quantity proportional to torque.
    record : ndarray of int64, shape (n,)
        Number of the recording, ascending.

    Raises
    ------
    RecordError
        If stamps do not rise or the motion is too short.
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
    """First row and slice of rows of each window in a motion in one direction."""
    travel = np.maximum.accumulate(np.abs(angle[begin:end] - angle[begin])) / TURN
    count = int(travel[-1] / TURNS)
    edges = begin + np.searchsorted(travel, np.linspace(0.0, travel[-1], count + 1))
    least = int(_LEAST_SAMPLES * 2 * _DEGREE)
    return [(a, slice(a, b)) for a, b in pairwise(edges.tolist()) if b - a >= least]


def _cells(
    time: Floats, angle: Floats, torque: Floats, speed: Floats
) -> tuple[Floats, Floats, Floats, float, float]:
    """Angle, rest and weight of a window's cells (c,), its mean speed, and its highest resolved order."""
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
    """Rising values (n,), scaled to the range from -1 to 1."""
    return np.asarray(2.0 * (values - values[0]) / (values[-1] - values[0]) - 1.0)
