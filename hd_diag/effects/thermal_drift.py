"""The angle between input and output encoder follows the temperature."""

from __future__ import annotations

import numpy as np

from hd_diag.effects.effect import Effect, Stepped, Values
from hd_diag.effects.excitation import temperature_varies
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.recursions import lag
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

REFERENCE = 20.0
"""Temperature at which the drift is zero [degC]."""

_AT_ONCE = 1e-9  # least lag [s], as good as none

# Time [s] of the last sample and y [degC]; None before the first temperature.
State = tuple[float, float] | None


class ThermalDrift(Effect):
    """``g (y - 20 degC)`` with ``tau dy/dt = Theta - y`` from a settled start. Zero without a temperature."""

    def advance(self, state: State, signals: Signals, nonlinear: Values) -> Stepped:
        """Lagged temperature less `REFERENCE`, zero where none is known; see :meth:`Effect.advance`."""
        heat, time = signals.temperature, signals.time
        known = np.zeros(signals.size, dtype=np.bool_) if heat is None else np.isfinite(heat)
        if heat is None or not known.any():
            return np.zeros((signals.size, 1)), state
        last, y = (float(time[0]), float(heat[known][0])) if state is None else state
        left = np.exp(-np.diff(time, prepend=last) / max(nonlinear[0], _AT_ONCE))
        kept = np.where(known, left, 1.0)
        added = np.where(known, (1.0 - left) * np.where(known, heat, 0.0), 0.0)
        follows = lag(y, kept, added)
        return np.where(known, follows - REFERENCE, 0.0)[:, None], (float(time[-1]), float(follows[-1]))


EFFECT = ThermalDrift(
    name="thermal_drift",
    cause="Housing, encoder carrier and gear grow differently with temperature and turn the readings apart.",
    kind="sensor",
    frame="time",
    needs=("time", "temperature", "run"),
    excitation=(temperature_varies,),
    remembers=True,
    broadband=True,
    grid=((1.0,), (60.0,), (300.0,)),
    quantities=(
        Quantity("drift", "rad/K", -1e-3, 1e-3, 1.0 * ARCSEC, "g, at the output per kelvin"),
        Quantity("lag", "s", 0.0, 3600.0, 60.0, "tau, with which it follows the sensor", linear=False),
    ),
    confused_with=("ratio_error", "output_runout", "viscous_windup"),
    source="first-order lag of what turns behind the sensor that is measured",
    inspect=(
        "How the encoders are held: glue, carriers of plastic, screws on one side. Stand still and warm the "
        "joint by 10 K: the angle between the encoders must drift by ten times the figure. Repeat the "
        "motion cold: it must come back."
    ),
)
