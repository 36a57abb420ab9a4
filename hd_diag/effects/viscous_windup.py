"""Friction that grows with speed winds the drive up."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Values
from hd_diag.effects.excitation import several_speeds
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals

REFERENCE = 100.0
"""Speed of the input at which the torque is given [rad/s]."""


def _friction(signals: Signals, nonlinear: Values) -> Floats:
    relative = signals.forward_speed / REFERENCE
    return np.asarray(np.sign(relative) * np.abs(relative) ** nonlinear[0])[:, None]


EFFECT = MeshTorque(
    name="viscous_windup",
    cause=(
        "Friction of grease and seals between gear and torque sensor grows with speed: the mesh bears it too."
    ),
    formula="``T' = T + c sgn(omega) |omega / 100 rad/s|^p``.",
    kind="friction",
    frame="torque",
    needs=("wave_generator_angle", "torque", "speed"),
    excitation=(partial(several_speeds, number=3),),
    broadband=True,
    shape=_friction,
    grid=((0.75,), (1.0,)),
    quantities=(
        Quantity("friction", "N m", 0.0, 1e3, 1.0, "c, at 100 rad/s of the input", strict=True),
        Quantity("exponent", "-", 0.5, 1.3, 1.0, "p, of the speed", linear=False, shape=True),
    ),
    confused_with=("stream_delay", "coulomb_windup"),
    source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12(3), 1996, pp. 368-374",
    inspect=(
        "Grease: amount, age, temperature; repeat after half an hour's running: it falls with the grease's "
        "viscosity, a delay does not. No-load running torque over speed must rise alike."
    ),
)
