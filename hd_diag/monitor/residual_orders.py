"""Orders of the residual while a joint runs: a lock-in with forgetting, in bounded memory."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats, Times

ORDERS = (("input", 1), ("input", 2), ("input", 4), ("output", 1))
"""Followed orders: periods per turn of the input or of the output."""

_MEMORY = 30.0  # time of motion after which a sample counts for 1/e [s]
_LONGEST_STEP = 0.1  # of motion between two samples [s]; longer ones are gaps
_SLOWEST = 0.05  # of the input [rad/s]; slower is rest
_LEAST_INFORMATION = 0.1  # of a cosine over many turns 0.5 is left beside the other orders
_LEAST_SAMPLES = 200.0
_BLOCK = 256  # samples
_RIDGE = 1e-6  # keeps orders that do not move from spoiling the others


class ResidualOrders:
    """Amplitudes of orders in the residual, by recursive least squares over the last half minute of motion.

    What comes of samples depends on their sequence alone, to the last bit, however many come at once: those
    in motion are taken in blocks of one size.

    Attributes
    ----------
    sums : (ndarray, ndarray)
        Normal equations of all whole blocks.
    last : (int, float) or None
        Stamp [ns] and input angle [rad] of the last sample.
    moving : ndarray, shape (n, 4)
        Samples in motion that make no whole block yet.
    """

    def __init__(self) -> None:
        count = 1 + 2 * len(ORDERS)
        self.sums = np.zeros((count, count)), np.zeros(count)
        self.last: tuple[int, float] | None = None
        self.moving = np.empty((0, 4))

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
        if not stamp.size:
            return
        before, angle = self.last or (int(stamp[0]), float(input_angle[0]))
        self.last = int(stamp[-1]), float(input_angle[-1])
        step = np.minimum(np.diff(stamp, prepend=before) * 1e-9, _LONGEST_STEP)
        turned = np.abs(np.diff(input_angle, prepend=angle))
        used = (step > 0.0) & (turned > _SLOWEST * step) & np.isfinite(residual)
        rows = np.stack((step, input_angle, output_angle, residual), axis=1)[used]
        rows = np.concatenate((self.moving, rows))
        end = len(rows) - len(rows) % _BLOCK
        for begin in range(0, end, _BLOCK):
            self.sums = _with(*self.sums, rows[begin : begin + _BLOCK])
        self.moving = rows[end:]

    def amplitudes(self) -> dict[tuple[str, int], float]:
        """Amplitude of every order that the motion shows apart from the others [rad]."""
        gram, moment = _with(*self.sums, self.moving)
        weight = float(gram[0, 0])
        if weight < _LEAST_SAMPLES:
            return {}
        normal = gram / weight + _RIDGE * np.eye(moment.size)
        inverse = np.linalg.inv(normal)
        found = inverse @ (moment / weight)
        cosine, sine = np.arange(1, 1 + len(ORDERS)), np.arange(1 + len(ORDERS), moment.size)
        # Of the 2 x 2 blocks of each order the greater eigenvalue: the direction that is known least.
        a, b, c = inverse[cosine, cosine], inverse[cosine, sine], inverse[sine, sine]
        information = 1.0 / (0.5 * (a + c) + np.hypot(0.5 * (a - c), b))
        known = zip(
            ORDERS, information > _LEAST_INFORMATION, np.hypot(found[cosine], found[sine]), strict=True
        )
        return {order: float(amplitude) for order, apart, amplitude in known if apart}


def _with(gram: Floats, moment: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Sums after more samples, rows of (step [s], input angle, output angle, residual [rad])."""
    step, angle, output, value = np.ascontiguousarray(rows.T)
    terms = _terms(angle, output)
    elapsed = np.cumsum(step)
    end = elapsed[-1] if len(rows) else 0.0
    weight = np.exp((elapsed - end) / _MEMORY)
    usable = np.isfinite(terms[1:]).all(axis=0)
    if not usable.all():
        terms, weight = np.where(usable, terms, 0.0), np.where(usable, weight, 0.0)
    kept, weighted = np.exp(-end / _MEMORY), weight * terms
    # Not by BLAS: its results may depend on its number of threads.
    return (
        gram * kept + np.einsum("ik,jk->ij", weighted, terms),
        moment * kept + np.einsum("ik,k->i", weighted, value),
    )


def _terms(angle: Floats, output: Floats) -> Floats:
    """1, cosines and sines of all orders, shape (1 + 2 orders, n); nan where an angle has none."""
    terms = np.ones((1 + 2 * len(ORDERS), angle.size))
    cosine, sine = terms[1 : 1 + len(ORDERS)], terms[1 + len(ORDERS) :]
    for number, (frame, order) in enumerate(ORDERS):
        half = ORDERS.index((frame, order // 2)) if (frame, order // 2) in ORDERS else None
        if half is None:
            phase = order * (angle if frame == "input" else output)
            np.cos(phase, out=cosine[number])
            np.sin(phase, out=sine[number])
        else:  # twice the angle, for less than a cosine and a sine
            cosine[number] = 1.0 - 2.0 * sine[half] * sine[half]
            sine[number] = 2.0 * sine[half] * cosine[half]
    return terms
