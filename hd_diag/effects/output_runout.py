"""Once per turn of the output: the output flange or its seat runs out."""

from __future__ import annotations

from dataclasses import dataclass

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values, amplitude, direction, turning
from hd_diag.effects.excitation import enough_output_turns
from hd_diag.effects.signals import Signals
from hd_diag.model.torsion_map import ARCSEC


@dataclass(frozen=True)
class OutputRunout(Effect):
    """``a cos(theta_o - d)``."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Once per output turn; see :meth:`Effect.columns`."""
        return turning(signals.output_angle)

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """One turn of the output."""
        return enough_output_turns(signals, 1.0)


EFFECT = OutputRunout(
    name="output_runout",
    cause=(
        "The output flange, its bearing or its seat is off centre, so the output leads and lags once per "
        "turn."
    ),
    kind="kinematic",
    frame="output",
    needs=("output_angle",),
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
