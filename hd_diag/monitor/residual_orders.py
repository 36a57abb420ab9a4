"""Orders of the residual while a joint runs: waves of short windows, and whether they agree; bounded memory.

A window is two turns of the input. In each window the waves of the input's orders are fitted together with
slow changes. They are sorted by the side of the teeth that the torque loads, because an eccentricity's wave
turns by half a period with it. An order repeats if the waves of many windows agree in size and phase; those
of noise, of a transient or of another order do not. The weight decays to 1/e in 64 turns or half a minute of
motion.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

ORDERS = (("input", 1), ("input", 2), ("input", 4), ("output", 1))
"""Followed orders: periods per turn of the input or of the output."""


class Order(NamedTuple):
    """An order: frame and periods per turn; ``amplitude cos(order angle - phase)`` [rad].

    `std` is the amplitude's standard deviation from the spread of the windows [rad]. `repeats` tells whether
    the windows agree. Orders of the output are not compared by windows: nan and False.
    """

    frame: str = ""
    number: int = 0
    amplitude: float = math.nan
    phase: float = math.nan
    std: float = math.nan
    repeats: bool = False

    @property
    def name(self) -> str:
        """Such as ``input 2``; empty if no order is known."""
        return f"{self.frame} {self.number}" if self.frame else ""


class ResidualOrders:
    """Orders of a joint's residual; `state` holds the arrays of `kernel_orders.follow`.

    The result depends on the sequence of samples alone, to the last bit, and not on the number per call.
    """

    def __init__(self) -> None:
        window = np.zeros((9, 9)), np.zeros(9), np.zeros(7)
        before = np.zeros((3, 3, 5)), np.zeros((3, 3)), np.zeros(3)
        self.state = np.full(1, np.nan), np.zeros(1, np.int64), *window, *before

    def add(self, samples: Any, joint: int) -> None:
        """Take the samples of a joint, by its number, from records of `SAMPLE` (n,).

        Samples at rest and samples without an output angle are left out.
        """
        from hd_diag.monitor.kernel_orders import follow  # late: it imports numba

        follow(samples, joint, *self.state)

    def known(self) -> list[Order]:
        """The orders that the motion so far separates from the others."""
        from hd_diag.monitor.kernel_orders import look

        return [
            Order(frame, number, amplitude, phase, std, bool(repeats))
            for (frame, number), (amplitude, phase, std, repeats) in zip(
                ORDERS, look(*self.state[-3:]).tolist(), strict=True
            )
            if amplitude >= 0.0
        ]
