"""Stiffness that changes beyond two torques: a function of torque alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Starts, Values
from hd_diag.effects.excitation import torque_beyond
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals

_FIRST, _SECOND = (0.08, 0.16, 0.35), (0.45, 0.65, 0.9)  # of the greatest torque
_LEAST = 0.25  # of the rated torque, that the record must reach


@dataclass(frozen=True, kw_only=True)
class TorsionalHardening(Effect):
    """``-sgn T [a max(0, abs T - T1) + b max(0, abs T - T2)]``; negative a, b: harder."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Ramps from both knees; see :meth:`Effect.columns`."""
        beyond = np.abs(signals.torque)[:, None] - np.asarray(nonlinear)
        return np.asarray(-np.sign(signals.torque)[:, None] * np.maximum(beyond, 0.0))

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Knees within the torques that the record has [N m]."""
        greatest = float(np.max(np.abs(signals.torque), initial=0.0))
        return Starts.grid((one * greatest, two * greatest) for one in _FIRST for two in _SECOND)


EFFECT = TorsionalHardening(
    name="torsional_hardening",
    cause=(
        "The cup, the wave generator or the housing grows stiffer, or softer, with load, beyond the teeth's "
        "own."
    ),
    kind="torsion",
    frame="torque",
    needs=("torque",),
    excitation=(partial(torque_beyond, fraction=_LEAST),),
    quantities=(
        Quantity(
            "first_compliance", "rad/(N m)", -1e-3, 1e-3, 3e-6, "a, compliance added beyond the first knee"
        ),
        Quantity(
            "second_compliance", "rad/(N m)", -1e-3, 1e-3, 3e-6, "b, compliance added beyond the second knee"
        ),
        Quantity("first_knee", "N m", 0.0, 1e5, 10.0, "T1, torque of the first knee", linear=False),
        Quantity("second_knee", "N m", 0.0, 1e5, 30.0, "T2, torque of the second knee", linear=False),
    ),
    confused_with=("hysteresis", "wear_backlash"),
    source=(
        "Tuttle, Understanding and Modeling the Behavior of a Harmonic Drive Gear Transmission, MIT AI TR "
        "1365, 1992"
    ),
    inspect=(
        "Torsion test with the input held: K1, K2 and K3 of the catalogue between the knees. Screws of the "
        "flexspline and the circular spline first: a joint that slips grows softer beyond a torque. The "
        "curve must be the same at every angle and the same up and down."
    ),
)
