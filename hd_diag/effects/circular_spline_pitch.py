"""Pitch error of the circular spline, cumulative, by harmonics, through the weights of the contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values, amplitude, direction, harmonic, harmonic_sum
from hd_diag.effects.excitation import enough_input_turns, torque_varies, verdict
from hd_diag.effects.signals import Signals

ORDERS = (2, 4)  # two opposite lobes cancel the odd ones


@dataclass(frozen=True)
class CircularSplinePitch(Effect):
    """Circumferential displacement of the slots ``sum a_k cos k (phi - d_k)``."""

    of_teeth: ClassVar[bool] = True

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to every harmonic; see :meth:`Effect.columns`."""
        return np.concatenate([harmonic(signals.contact.slot_harmonic(k)) for k in ORDERS], axis=1)

    def response(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """The slots displaced at their full size; see :meth:`Effect.response`."""
        contact = signals.contact
        return contact.displaced(circumferential=harmonic_sum(coefficients, ORDERS, contact.slot_angles))

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """A few turns at two torques."""
        return verdict(enough_input_turns(signals, 5.0), torque_varies(signals))


EFFECT = CircularSplinePitch(
    name="circular_spline_pitch",
    cause="The slots of the circular spline are cut with a cumulative pitch error.",
    kind="kinematic",
    frame="housing",
    needs=("wave_generator_angle", "torque"),
    quantities=tuple(
        quantity
        for k in ORDERS
        for quantity in (
            amplitude(f"pitch_{k}", "m", 5e-5, 2e-6, f"cumulative pitch error, {k} periods around"),
            direction(
                f"pitch_direction_{k}", "angle in the circular spline where the slots are most ahead", k
            ),
        )
    ),
    confused_with=("circular_spline_form", "coupling_misalignment", "flexspline_pitch", "tooth_damage"),
    source=(
        "cumulative pitch deviation: ISO 1328-1:2013; response: share of the stiffness (see contact_weights)"
    ),
    inspect=(
        "Cumulative pitch deviation of the circular spline on a gear tester, by harmonics: 1 um reads about "
        "6 arcsec at light load. Turn the circular spline in its housing by a quarter turn: the direction "
        "must follow. Lower under load, where more pairs share it; what a coupling or encoder adds is not."
    ),
)
