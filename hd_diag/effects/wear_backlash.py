"""More clearance on all tooth pairs: soft about zero torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Quantity, Values
from hd_diag.effects.excitation import enough_input_turns, torque_through_zero, verdict
from hd_diag.effects.signals import Signals


@dataclass(frozen=True)
class WearBacklash(Effect):
    """Clearance of every flank grows by the same; first order of a widening dead zone."""

    of_teeth: ClassVar[bool] = True

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to more clearance; see :meth:`Effect.columns`."""
        return signals.contact.clearance()[:, None]

    def response(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """The flanks worn at their full size; see :meth:`Effect.response`."""
        contact = signals.contact
        return contact.displaced(clearance=float(coefficients[0]))

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Torque through zero."""
        return verdict(enough_input_turns(signals, 1.0), torque_through_zero(signals))


EFFECT = WearBacklash(
    name="wear_backlash",
    cause="All tooth flanks are worn, so the output turns freely by more before it bears.",
    kind="kinematic",
    frame="torque",
    needs=("wave_generator_angle", "torque"),
    quantities=(Quantity("clearance", "m", -2e-5, 1e-4, 3e-6, "circumferential, added to every flank"),),
    confused_with=("torsional_hardening", "hysteresis", "torque_offset"),
    always_confused=("circular_spline_datum",),
    source="share of the stiffness of every flank (see contact_weights)",
    inspect=(
        "Lost motion at the output within 4 % of the rated torque, at eight angles: 1 um on every flank "
        "adds about 13 arcsec. Then the flanks' bright bands and the grease's metal. Compare with the same "
        "joint's earlier records: wear grows, a wrong datum radius was always there."
    ),
)
