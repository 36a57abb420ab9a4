"""The input encoder reads off its centre: once and twice per turn of the input."""

from __future__ import annotations

from functools import partial

from hd_diag.effects.excitation import enough_input_turns, torque_varies
from hd_diag.effects.harmonic import Harmonic
from hd_diag.effects.quantity import amplitude, direction
from hd_diag.formatting import ARCSEC

EFFECT = Harmonic(
    name="input_encoder_eccentricity",
    cause=("The input encoder's disc or magnet is off centre or tilted, so the input angle is read wrongly."),
    formula=(
        "The input reads ``a cos(theta_in - d) + a_2 cos 2 (theta_in - d_2)`` too far, so the output "
        "seems to lag by that over N."
    ),
    kind="sensor",
    frame="input",
    needs=("output_angle", "torque"),
    angle="input_angle",
    orders=(1, 2),
    excitation=(partial(enough_input_turns, turns=3.0), torque_varies),
    quantities=(
        amplitude("amplitude", "rad", 0.2, 300.0 * ARCSEC, "a, reading error at the input, e / R"),
        direction("direction", "input angle at which it reads most too far"),
        amplitude("second_amplitude", "rad", 0.2, 60.0 * ARCSEC, "a_2, twice per turn, from tilt"),
        direction("second_direction", "input angle at which that is greatest", 2),
    ),
    confused_with=("coupling_misalignment", "encoder_interpolation", "output_encoder_interpolation"),
    source="Heidenhain, Rotary Encoders (brochure): error by eccentricity, 412 e / D [arcsec, µm, mm]",
    inspect=(
        "Centring of the motor's encoder: magnet or disc against the shaft; 0.1 mm of a magnet on 5 mm "
        "reads 1.1°, 41 arcsec at the output of ratio 100. It does not change with torque; an eccentric "
        "wave generator's order 1 falls with it. Turn the magnet by half a turn: the direction follows."
    ),
)
