"""Once and twice per turn of the output: the output encoder reads off its centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values, amplitude, direction, turning
from hd_diag.effects.excitation import enough_output_turns
from hd_diag.effects.signals import Signals
from hd_diag.model.torsion_map import ARCSEC


@dataclass(frozen=True)
class OutputEncoderEccentricity(Effect):
    """``a cos(theta_o - d) + a_2 cos 2 (theta_o - d_2)``."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Once and twice per output turn; see :meth:`Effect.columns`."""
        angle = signals.output_angle
        return np.concatenate((turning(angle), turning(2.0 * angle)), axis=1)

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """One turn of the output."""
        return enough_output_turns(signals, 1.0)


EFFECT = OutputEncoderEccentricity(
    name="output_encoder_eccentricity",
    cause="The output encoder's disc or magnet is off centre or tilted, so the output angle is read wrongly.",
    kind="sensor",
    frame="output",
    needs=("output_angle",),
    quantities=(
        amplitude("amplitude", "rad", 1e-2, 15.0 * ARCSEC, "reading error once per turn, e / R"),
        direction("direction", "output angle at which it reads most too far"),
        amplitude("second_amplitude", "rad", 1e-2, 3.0 * ARCSEC, "reading error twice per turn, from tilt"),
        direction("second_direction", "output angle at which that is greatest", 2),
    ),
    confused_with=("output_runout", "ratio_error", "thermal_drift", "flexspline_pitch"),
    always_confused=("output_runout",),
    source="Heidenhain, Rotary Encoders (brochure): error by eccentricity, 412 e / D [arcsec, um, mm]",
    inspect=(
        "Centring of the encoder's disc: 5 um on a graduation radius of 25 mm read 41 arcsec. Two heads "
        "opposite each other cancel it; take the encoder off, turn it by half a turn on its hub and repeat: "
        "the error changes sign if the encoder is the cause."
    ),
)
