"""A wave at one order of the input's turn without a known cause, for use in an extended model."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.quantity import Quantity, amplitude, direction, switch, turning
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC


class OrderLine(Effect):
    """``a cos(k theta_in - d)``, or this wave times ``T / T_rated``."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Cosine and sine of the order; see :meth:`Effect.columns`."""
        order, loaded = nonlinear
        wave = turning(order * signals.input_angle)
        return np.asarray(wave * (signals.torque[:, None] / signals.rated_torque) if loaded else wave)


ORDER_LINE = OrderLine(
    name="order_line",
    cause="A wave of this order without a known cause.",
    kind="kinematic",
    frame="input",
    needs=("output_angle", "torque"),
    searched=False,
    quantities=(
        amplitude("amplitude", "rad", 1e-1, 3.0 * ARCSEC, "of the transmission error"),
        direction("phase", "of the wave at input angle zero"),
        Quantity("order", "-", 0.0, 1e5, 2.0, "periods per turn of the input", linear=False),
        switch("loaded", "1: it is proportional to the torque, the amplitude is that at the rated torque"),
    ),
    confused_with=(),
    source="the residual's own spectrum over the input angle",
    inspect="What turns with this order: see what it might be. Record again, to see whether its phase stays.",
)
"""A model may contain several terms of it; no search names it."""
