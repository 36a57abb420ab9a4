"""The torque is measured with an offset."""

from __future__ import annotations

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Values
from hd_diag.effects.excitation import torque_through_zero
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals


def _one(signals: Signals, nonlinear: Values) -> Floats:
    return np.ones((signals.size, 1))


EFFECT = MeshTorque(
    name="torque_offset",
    cause="The torque's zero is wrong, or a constant load such as gravity is missing in it.",
    formula="``T' = T + a``.",
    kind="sensor",
    frame="torque",
    needs=("wave_generator_angle", "torque"),
    excitation=(torque_through_zero,),
    shape=_one,
    quantities=(Quantity("offset", "N m", -1e3, 1e3, 2.0, "a, real less reported torque"),),
    confused_with=("coulomb_windup", "wear_backlash", "hysteresis", "thermal_drift"),
    source="the model's own torsion under the real torque",
    inspect=(
        "Zero of the torque sensor with the link hanging free or taken off; gravity in the torque that the "
        "controller reports. The stiffness curve's symmetry centre must move to zero torque once the offset "
        "is taken away."
    ),
)
