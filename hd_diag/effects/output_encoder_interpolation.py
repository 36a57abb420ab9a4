"""Division error of the output encoder."""

from __future__ import annotations

from functools import partial

from hd_diag.effects.encoder_interpolation import EncoderInterpolation, line_quantities
from hd_diag.effects.excitation import enough_output_turns
from hd_diag.formatting import ARCSEC

_LEAST, _MOST = 8, 1024  # beyond, every order of the gear is near a whole number of lines
_MULTIPLE = 4  # otherwise every input order with two decimals would be a number of lines

EFFECT = EncoderInterpolation(
    name="output_encoder_interpolation",
    cause="The output encoder divides its lines or pole pairs unevenly.",
    formula="``a cos(L theta_o - d) + b cos(2 L theta_o - e)``.",
    kind="sensor",
    frame="output",
    needs=("output_angle", "speed", "time"),
    angle="output_angle",
    least=_LEAST,
    most=_MOST,
    multiple=_MULTIPLE,
    excitation=(partial(enough_output_turns, turns=0.1),),
    quantities=line_quantities(5.0 * ARCSEC, _LEAST, _MOST, "output"),
    confused_with=(
        "input_encoder_eccentricity",
        "encoder_interpolation",
        "coupling_misalignment",
        "circular_spline_form",
        "flexspline_pitch",
        "bearing_passage",
    ),
    source="Heidenhain, Rotary Encoders (brochure): position error within one signal period",
    inspect=(
        "Number of lines or pole pairs in the link encoder's data sheet: it must be the order found, or half "
        "of it. It has the same phase in every recording, stays when the input stands still in its turn, and "
        "changes with neither torque nor direction."
    ),
)
