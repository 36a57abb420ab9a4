"""Dry friction winds the drive up against its motion, more at the slowest speeds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Starts, Values
from hd_diag.effects.excitation import both_directions, enough_input_turns
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

_SPEEDS = (0.1, 0.6, 3.0)  # [rad/s] of the input
_STRIBECK = 10.0  # Stribeck speed over the speed at which the friction turns round


@dataclass(frozen=True, kw_only=True)
class CoulombWindup(Effect):
    """``-[a + b exp(-(omega / 10 omega_0)^2)] tanh(omega / omega_0)``."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Dry friction and what it is more at low speed; see :meth:`Effect.columns`."""
        relative = signals.forward_speed / nonlinear[0]
        sign = np.tanh(relative)
        return -np.stack((sign, sign * np.exp(-((relative / _STRIBECK) ** 2))), axis=1)

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Speeds at which the friction turns round [rad/s]."""
        return Starts.grid((speed,) for speed in _SPEEDS)


EFFECT = CoulombWindup(
    name="coulomb_windup",
    cause="Dry friction behind the torque's measurement (seal, output bearing, cable) holds the output back.",
    kind="friction",
    frame="torque",
    needs=("speed",),
    excitation=(both_directions, partial(enough_input_turns, turns=1.0)),
    broadband=True,
    quantities=(
        Quantity("amplitude", "rad", -1e-3, 1e-3, 5.0 * ARCSEC, "a, lag while the joint moves"),
        Quantity("stribeck_amplitude", "rad", -1e-3, 1e-3, 3.0 * ARCSEC, "b, more of it at low speed"),
        Quantity(
            "reversal_speed",
            "rad/s",
            1e-2,
            _SPEEDS[-1],
            1.0,
            "omega_0, input speed of the sign's change",
            linear=False,
        ),
    ),
    confused_with=("viscous_windup", "stream_delay", "hysteresis", "torque_offset"),
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994, pp. 1083-1138",
    inspect=(
        "Seal and output bearing: turn the link by hand with the motor off, then measure the torque to move "
        "it. The lag times the stiffness is the friction's torque. Drive the same stretch slowly both ways: "
        "half the distance of the two curves is the amplitude, at every angle alike."
    ),
)
