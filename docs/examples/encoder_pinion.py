"""The output encoder is driven by a pinion on a toothed ring, and the pinion is off centre."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.excitation import enough_output_turns
from hd_diag.effects.quantity import amplitude, direction, turning
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

PINION_RATIO = 22.5
"""Turns of the pinion per turn of the output: 360 teeth on 16 [-]."""


@dataclass(frozen=True, kw_only=True)
class EncoderPinion(Effect):
    """``a cos(22.5 theta_o - d)``."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Once per turn of the pinion; see :meth:`Effect.columns`."""
        return turning(PINION_RATIO * signals.output_angle)


EFFECT = EncoderPinion(
    name="encoder_pinion",
    cause="The pinion that drives the output encoder is off centre.",
    kind="sensor",
    frame="output",
    needs=("output_angle",),
    excitation=(partial(enough_output_turns, turns=10.0 / PINION_RATIO),),
    quantities=(
        amplitude(
            "amplitude", "rad", 1e-2, 15.0 * ARCSEC, "largest lead over a turn of the pinion, at the output"
        ),
        direction("direction", "angle of the pinion at which the reading leads most"),
    ),
    confused_with=("bearing_passage",),
    source="arc over radius: an off-centre e on the pinion's pitch radius R reads e / (22.5 R) at the output",
    inspect=(
        "Dial gauge on the pinion over one of its turns. Mesh it again half a turn of the pinion further "
        "on the ring: the direction must follow by 180 degrees."
    ),
)
