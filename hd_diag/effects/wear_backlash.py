"""All tooth flanks worn equally: a wider dead zone."""

from __future__ import annotations

from functools import partial
from typing import Any

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Stepped, Values
from hd_diag.effects.excitation import enough_input_turns, torque_through_zero
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals


class WearBacklash(Effect):
    """The same additional clearance at every flank, to first order: the dead zone becomes wider."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to added clearance; see :meth:`Effect.columns`."""
        return signals.contact.clearance()[:, None]

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Response to flanks worn at full size; see :meth:`Effect.step`."""
        return signals.contact.displaced(clearance=float(coefficients[0])), state


EFFECT = WearBacklash(
    name="wear_backlash",
    cause="All tooth flanks are worn, so the output turns freely by more before it bears.",
    kind="kinematic",
    frame="torque",
    needs=("wave_generator_angle", "torque"),
    excitation=(partial(enough_input_turns, turns=1.0), torque_through_zero),
    of_teeth=True,
    proportional=False,
    quantities=(Quantity("clearance", "m", -2e-5, 1e-4, 3e-6, "circumferential, added to every flank"),),
    confused_with=("torsional_hardening", "hysteresis", "torque_offset"),
    always_confused=("circular_spline_datum",),
    source="share of the stiffness of every flank (see contact_weights)",
    inspect=(
        "Lost motion at the output within 4 % of the rated torque, at eight angles: 1 µm on every flank "
        "adds about 13 arcsec. Then the flanks' bright bands and the grease's metal. Compare with the same "
        "joint's earlier records: wear grows, a wrong datum radius was always there."
    ),
)
