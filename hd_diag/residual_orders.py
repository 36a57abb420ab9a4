"""Orders of the residual while a joint runs: a lock-in with forgetting, in bounded memory."""

from __future__ import annotations

import math

import numpy as np

from hd_diag.samples import Floats, Times

ORDERS = (("input", 1), ("input", 2), ("input", 4), ("output", 1))
"""Followed orders: periods per turn of the input or of the output."""

_MEMORY = 30.0  # time of motion after which a sample counts for 1/e [s]
_LONGEST_STEP = 0.1  # of motion between two samples [s]; longer ones are gaps
_SLOWEST = 0.05  # of the input [rad/s]; slower is rest
_LEAST_INFORMATION = 0.1  # of a cosine over many turns 0.5 is left beside the other orders
_LEAST_SAMPLES = 200.0
_RIDGE = 1e-6  # keeps orders that do not move from spoiling the others


class ResidualOrders:
    """Amplitudes of orders in the residual, by recursive least squares over the last half minute of motion.

    What comes of samples depends on their sequence alone, to the last bit, however many come at once.
    """

    def __init__(self) -> None:
        count = 1 + 2 * len(ORDERS)
        self._gram = np.zeros((count, count))
        self._moment = np.zeros(count)
        self._last: tuple[int, float] | None = None

    def add(self, stamp: Times, input_angle: Floats, output_angle: Floats, residual: Floats) -> None:
        """Take samples; those at rest and those without a residual are left out.

        Parameters
        ----------
        stamp : ndarray of int64, shape (n,)
            [ns]
        input_angle, output_angle : ndarray, shape (n,)
            As reported [rad].
        residual : ndarray, shape (n,)
            [rad]
        """
        columns = (stamp, input_angle, output_angle, residual)
        for now, angle, output, value in zip(*(column.tolist() for column in columns), strict=True):
            before, self._last = self._last, (now, angle)
            if before is None or not math.isfinite(value):
                continue
            step = min((now - before[0]) * 1e-9, _LONGEST_STEP)
            if step > 0.0 and abs(angle - before[1]) > _SLOWEST * step:
                self._take(step, angle, output, value)

    def amplitudes(self) -> dict[tuple[str, int], float]:
        """Amplitude of every order that the motion shows apart from the others [rad]."""
        weight = float(self._gram[0, 0])
        if weight < _LEAST_SAMPLES:
            return {}
        normal = self._gram / weight + _RIDGE * np.eye(self._moment.size)
        inverse = np.linalg.inv(normal)
        found = inverse @ (self._moment / weight)
        amplitudes = {}
        for number, order in enumerate(ORDERS):
            rows = slice(1 + 2 * number, 3 + 2 * number)
            information = 1.0 / float(np.linalg.eigvalsh(inverse[rows, rows])[-1])
            if information > _LEAST_INFORMATION:
                amplitudes[order] = float(np.hypot(*found[rows]))
        return amplitudes

    def _take(self, step: float, angle: float, output: float, value: float) -> None:
        phases = [order * (angle if frame == "input" else output) for frame, order in ORDERS]
        waves = [wave(phase) for phase in phases for wave in (math.cos, math.sin)]
        row = np.array([1.0, *waves])
        kept = math.exp(-step / _MEMORY)
        self._gram *= kept
        self._gram += row[:, None] * row
        self._moment *= kept
        self._moment += row * value
