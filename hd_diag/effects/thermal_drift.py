"""The angle between input and output encoder follows the temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.excitation import temperature_varies
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

REFERENCE = 20.0
"""Temperature at which the drift is zero [degC]."""


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(Effect):
    """``g (Theta - 20 degC)``; nothing where the temperature is not measured."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Temperature above the reference; see :meth:`Effect.columns`."""
        if signals.temperature is None:
            return np.zeros((signals.size, 1))
        return (signals.temperature - REFERENCE)[:, None]


EFFECT = ThermalDrift(
    name="thermal_drift",
    cause="Housing, encoder carrier and gear grow differently with temperature and turn the readings apart.",
    kind="sensor",
    frame="time",
    needs=("temperature",),
    excitation=(temperature_varies,),
    quantities=(Quantity("drift", "rad/K", -1e-3, 1e-3, 1.0 * ARCSEC, "g, at the output per kelvin"),),
    confused_with=("ratio_error", "output_runout", "viscous_windup"),
    source="first order of the angle over temperature",
    inspect=(
        "How the encoders are held: glue, carriers of plastic, screws on one side. Stand still and warm the "
        "joint by 10 K: the angle between the encoders must drift by ten times the figure. Repeat the "
        "motion cold: it must come back."
    ),
)
