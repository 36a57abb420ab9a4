"""The torque is measured with an offset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Stepped, Values
from hd_diag.effects.excitation import torque_through_zero
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals

_STEP = 4e-3  # of the rated torque, by which the compliance is taken: a change of flanks is a step


@dataclass(frozen=True, kw_only=True)
class TorqueOffset(Effect):
    """``T' = T + a``: to first order ``a dTE/dT``, at full size the difference of both predictions."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Compliance of the model; see :meth:`Effect.columns`."""
        return signals.predicted_torque_slope[:, None]

    def slopes(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """Compliance under the real torque: between both zeros the teeth change flanks."""
        offset, step = float(coefficients[0]), _STEP * signals.rated_torque
        ends = [signals.contact.under_more_torque(offset + sign * step) for sign in (-1.0, 1.0)]
        return ((ends[1] - ends[0]) / (2.0 * step))[:, None]

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """The model under the real torque; see :meth:`Effect.step`."""
        return signals.contact.under_more_torque(float(coefficients[0])), state


EFFECT = TorqueOffset(
    name="torque_offset",
    cause="The torque's zero is wrong, or a constant load such as gravity is missing in it.",
    kind="sensor",
    frame="torque",
    needs=("wave_generator_angle", "torque"),
    excitation=(torque_through_zero,),
    proportional=False,
    own_slopes=True,
    shifts_torque=True,
    quantities=(Quantity("offset", "N m", -1e3, 1e3, 2.0, "a, real less reported torque"),),
    confused_with=("coulomb_windup", "wear_backlash", "hysteresis", "thermal_drift"),
    source="first order of the model's own torsion over torque",
    inspect=(
        "Zero of the torque sensor with the link hanging free or taken off; gravity in the torque that the "
        "controller reports. The stiffness curve's symmetry centre must move to zero torque once the offset "
        "is taken away."
    ),
)
