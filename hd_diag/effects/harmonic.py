"""Effects that are waves over an angle: one class for all encoders, flanges and bearings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.quantity import turning
from hd_diag.effects.signals import Signals


@dataclass(frozen=True, kw_only=True)
class Harmonic(Effect):
    """``a cos(k angle - d)`` for one order or several.

    Parameters
    ----------
    angle : str
        Name of the signal. A wave of "input_angle" is a reading error: at the output it has the opposite sign
        and is divided by the ratio.
    orders : tuple of float
        k, one for every amplitude and direction. The first nonlinear quantity, if any, multiplies them.
    """

    angle: str
    orders: tuple[float, ...] = (1.0,)

    def sensible(self, coefficients: Floats, nonlinear: Values) -> bool:
        """Whether the first order has the largest wave; the gear itself has waves at the others."""
        size = np.hypot(coefficients[::2], coefficients[1::2])
        return super().sensible(coefficients, nonlinear) and bool(size[0] >= size.max())

    @property
    def reach(self) -> Floats:
        """Further orders have usual sizes, because the gear has waves there too; see :meth:`Effect.reach`."""
        return np.concatenate((super().reach[:2], self.usual[2:]))

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Cosine and sine of every order; see :meth:`Effect.columns`."""
        angle = getattr(signals, self.angle)
        base = nonlinear[0] if nonlinear else 1.0
        waves = np.concatenate([turning(k * base * angle) for k in self.orders], axis=1)
        return -waves / signals.ratio if self.angle == "input_angle" else waves
