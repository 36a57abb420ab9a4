"""Pitch error of the flexspline, cumulative, by harmonics, through the weights of the contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values, amplitude, direction, harmonic, harmonic_sum
from hd_diag.effects.excitation import enough_output_turns, torque_varies, verdict
from hd_diag.effects.signals import Signals

ORDERS = (2, 4)  # two opposite lobes cancel the odd ones


@dataclass(frozen=True)
class FlexsplinePitch(Effect):
    """Circumferential displacement of the teeth ``sum a_k cos k (psi - d_k)``."""

    of_teeth: ClassVar[bool] = True

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to every harmonic; see :meth:`Effect.columns`."""
        return np.concatenate([harmonic(signals.contact.tooth_harmonic(k)) for k in ORDERS], axis=1)

    def response(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """The teeth displaced at their full size; see :meth:`Effect.response`."""
        first = self.columns(signals, nonlinear) @ coefficients
        return np.asarray(first + signals.contact.teeth_beyond(_displacement, coefficients))

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """One turn of the output: it parts orders 2 and 2 (1 + 1/N)."""
        return verdict(enough_output_turns(signals, 1.0), torque_varies(signals))


def _displacement(coefficients: Floats, angle: Floats) -> Floats:
    return harmonic_sum(coefficients, ORDERS, angle)


EFFECT = FlexsplinePitch(
    name="flexspline_pitch",
    cause="The teeth of the flexspline are cut with a cumulative pitch error.",
    kind="kinematic",
    frame="output",
    needs=("wave_generator_angle", "torque"),
    quantities=tuple(
        quantity
        for k in ORDERS
        for quantity in (
            amplitude(f"pitch_{k}", "m", 5e-5, 2e-6, f"cumulative pitch error, {k} periods around"),
            direction(f"pitch_direction_{k}", "angle in the flexspline where the teeth are most ahead", k),
        )
    ),
    confused_with=(
        "circular_spline_pitch",
        "circular_spline_form",
        "coupling_misalignment",
        "tooth_damage",
        "output_encoder_eccentricity",
    ),
    source=(
        "cumulative pitch deviation: ISO 1328-1:2013; response: share of the stiffness (see contact_weights)"
    ),
    inspect=(
        "Cumulative pitch deviation of the flexspline on a gear tester, by harmonics, or tooth marks on one "
        "side of it: 1 um reads about 6 arcsec at light load. Mount the output turned by half a turn on the "
        "flexspline: the direction moves with the flexspline. Its order is 2 (1 + 1/N), 2.02 at N = 100: "
        "short records show it as 2."
    ),
)
