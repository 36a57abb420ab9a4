"""Once and twice per turn of the output: the output encoder reads off its centre."""

from __future__ import annotations

from functools import partial

from hd_diag.effects.excitation import enough_output_turns
from hd_diag.effects.harmonic import Harmonic
from hd_diag.effects.quantity import amplitude, direction
from hd_diag.formatting import ARCSEC

EFFECT = Harmonic(
    name="output_encoder_eccentricity",
    cause="The output encoder's disc or magnet is off centre or tilted, so the output angle is read wrongly.",
    formula="``a cos(theta_o - d) + a_2 cos 2 (theta_o - d_2)``.",
    kind="sensor",
    frame="output",
    needs=("output_angle",),
    angle="output_angle",
    orders=(1, 2),
    excitation=(partial(enough_output_turns, turns=1.0),),
    quantities=(
        amplitude("amplitude", "rad", 1e-2, 15.0 * ARCSEC, "reading error once per turn, e / R"),
        direction("direction", "output angle at which it reads most too far"),
        amplitude("second_amplitude", "rad", 1e-2, 3.0 * ARCSEC, "reading error twice per turn, from tilt"),
        direction("second_direction", "output angle at which that is greatest", 2),
    ),
    confused_with=("output_runout", "ratio_error", "thermal_drift", "flexspline_pitch"),
    always_confused=("output_runout",),
    source="Heidenhain, Rotary Encoders (brochure): error by eccentricity, 412 e / D [arcsec, µm, mm]",
    inspect=(
        "Centring of the encoder's disc: 5 µm on a graduation radius of 25 mm read 41 arcsec. Two heads "
        "opposite each other cancel it; take the encoder off, turn it by half a turn on its hub and repeat: "
        "the error changes sign if the encoder is the cause."
    ),
)
