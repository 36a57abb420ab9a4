"""The torque is measured with a wrong gain."""

from __future__ import annotations

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Values
from hd_diag.effects.excitation import torque_known, torque_varies
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals


def _torque(signals: Signals, nonlinear: Values) -> Floats:
    return signals.torque[:, None]


EFFECT = MeshTorque(
    name="torque_gain",
    cause="The torque sensor's gain is wrong, or the constant that makes a torque of the motor's current.",
    formula="``T' = (1 + a) T``.",
    kind="sensor",
    frame="torque",
    needs=("wave_generator_angle", "torque"),
    excitation=(torque_known, torque_varies),
    shape=_torque,
    quantities=(Quantity("relative_error", "-", -0.9, 9.0, 0.1, "a, real over reported torque, less one"),),
    confused_with=("torsional_hardening", "torque_offset"),
    always_confused=("tooth_compliance", "cup_compliance"),
    source="the model's own torsion under the real torque",
    inspect=(
        "Hang a known mass on the link at a known arm and compare. Only a stiffness that is known from "
        "elsewhere tells a wrong gain from a gear that is stiffer or softer than its catalogue."
    ),
)
