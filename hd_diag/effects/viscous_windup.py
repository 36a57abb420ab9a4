"""Friction that grows with speed winds the drive up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.excitation import several_speeds
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals


@dataclass(frozen=True, kw_only=True)
class ViscousWindup(Effect):
    """``-c omega``."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Lag by speed; see :meth:`Effect.columns`."""
        return -signals.forward_speed[:, None]


EFFECT = ViscousWindup(
    name="viscous_windup",
    cause=(
        "Friction of grease and seals behind the torque's measurement grows with speed and holds the output "
        "back."
    ),
    kind="friction",
    frame="torque",
    needs=("speed",),
    excitation=(partial(several_speeds, number=3),),
    broadband=True,
    quantities=(
        Quantity("lag", "s", -1e-4, 1e-4, 3e-7, "c, lag at the output per input speed [rad/(rad/s)]"),
    ),
    confused_with=("stream_delay", "coulomb_windup"),
    source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12(3), 1996, pp. 368-374",
    inspect=(
        "Grease: amount, age, temperature; repeat after half an hour's running: it falls with the grease's "
        "viscosity, a delay does not. No-load running torque over speed must rise alike."
    ),
)
