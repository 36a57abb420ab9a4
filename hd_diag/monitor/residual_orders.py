"""Orders of the residual while a joint runs: a lock-in with forgetting, in bounded memory."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats, Integers, Times

ORDERS = (("input", 1), ("input", 2), ("input", 4), ("output", 1))
"""Followed orders: periods per turn of the input or of the output."""

_LEAST_INFORMATION = 0.1  # of a cosine over many turns 0.5 is left beside the other orders
_LEAST_SAMPLES = 200.0
_RIDGE = 1e-6  # keeps orders that do not move from spoiling the others


class ResidualOrders:
    """Amplitudes of orders in the residual, by recursive least squares over the last half minute of motion.

    What comes of samples depends on their sequence alone, to the last bit, however many come at once.

    Attributes
    ----------
    state : tuple of ndarray
        Last input angle [rad], sums of the normal equations (9, 9) and (9,), last stamp [ns].
    """

    def __init__(self) -> None:
        count = 1 + 2 * len(ORDERS)
        sums = np.zeros((count, count)), np.zeros(count)
        self.state = np.full(1, np.nan), *sums, np.zeros(1, np.int64)

    def add(
        self, stamp: Times, input_angle: Floats, output_angle: Floats, residual: Floats, ends: Integers
    ) -> Floats:
        """Take samples; those at rest and those without a residual are left out.

        Parameters
        ----------
        stamp : ndarray of int64, shape (n,)
            [ns]
        input_angle, output_angle : ndarray, shape (n,)
            As reported [rad].
        residual : ndarray, shape (n,)
            [rad]
        ends : ndarray of int64, shape (l,)
            Rising numbers of samples after which the amplitudes are asked for.

        Returns
        -------
        ndarray, shape (l, orders)
            Amplitudes of `ORDERS` [rad]; nan where the motion does not show one apart from the others.
        """
        from hd_diag.monitor.kernel import follow  # late: it imports numba

        size = self.state[2].size
        sums = np.empty((ends.size, size, size)), np.empty((ends.size, size))
        follow(stamp, input_angle, output_angle, residual, *self.state, ends, *sums)
        return _amplitudes(*sums)


def _amplitudes(gram: Floats, moment: Floats) -> Floats:
    weight = gram[:, 0, 0]
    divisor = np.maximum(weight, 1.0)[:, None]
    inverse = np.linalg.inv(gram / divisor[:, None] + _RIDGE * np.eye(moment.shape[1]))
    found = (inverse * (moment / divisor)[:, None, :]).sum(axis=2)
    cosine, sine = np.arange(1, 1 + len(ORDERS)), np.arange(1 + len(ORDERS), moment.shape[1])
    # Of the 2 x 2 blocks of each order the greater eigenvalue: the direction that is known least.
    a, b, c = inverse[:, cosine, cosine], inverse[:, cosine, sine], inverse[:, sine, sine]
    information = 1.0 / (0.5 * (a + c) + np.hypot(0.5 * (a - c), b))
    is_known = (information > _LEAST_INFORMATION) & (weight >= _LEAST_SAMPLES)[:, None]
    return np.where(is_known, np.hypot(found[:, cosine], found[:, sine]), np.nan)
