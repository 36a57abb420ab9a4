"""Once per turn of the output: the output flange or its seat runs out."""

from __future__ import annotations

from functools import partial

from hd_diag.effects.excitation import enough_output_turns
from hd_diag.effects.harmonic import Harmonic
from hd_diag.effects.quantity import amplitude, direction
from hd_diag.formatting import ARCSEC

EFFECT = Harmonic(
    name="output_runout",
    cause=(
        "The output flange, its bearing or its seat is off centre, so the output leads and lags once per "
        "turn."
    ),
    formula="``a cos(theta_o - d)``.",
    kind="kinematic",
    frame="output",
    needs=("output_angle",),
    angle="output_angle",
    orders=(1,),
    excitation=(partial(enough_output_turns, turns=1.0),),
    quantities=(
        amplitude("amplitude", "rad", 1e-2, 15.0 * ARCSEC, "largest lead over an output turn"),
        direction("direction", "output angle at which the output leads most"),
    ),
    confused_with=("output_encoder_eccentricity", "ratio_error", "thermal_drift"),
    always_confused=("output_encoder_eccentricity",),
    source="Nye and Kraml, Harmonic drive gear error, 25th Aerospace Mechanisms Symposium, 1991",
    inspect=(
        "Dial gauge on the output flange's centring diameter over one turn: an off-centre e on the radius R "
        "of the angle reading gives e / R. Turn the flange by half a turn on the flexspline and repeat: "
        "runout of the flange follows it, an eccentric encoder disc follows its own hub."
    ),
)
