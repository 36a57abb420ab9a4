"""Cumulative pitch error of the circular spline, by harmonics, through the weights of the contact."""

from __future__ import annotations

from functools import partial
from typing import Any

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Stepped, Values
from hd_diag.effects.excitation import enough_input_turns, torque_varies
from hd_diag.effects.quantity import harmonic_sum, harmonics, lobes
from hd_diag.effects.signals import Signals

ORDERS = (1, 2, 3, 4, 5, 6, 7, 8)  # odd ones show if an eccentricity makes the lobes unequal


class CircularSplinePitch(Effect):
    """Circumferential displacement of the slots ``sum a_k cos k (phi - d_k)``."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to every harmonic; see :meth:`Effect.columns`."""
        return harmonics(signals.contact.harmonics("slot", ORDERS))

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Response to slots displaced at full size; see :meth:`Effect.step`."""
        contact = signals.contact
        return contact.displaced(harmonic_sum(coefficients, ORDERS, contact.slot_angles)), state


EFFECT = CircularSplinePitch(
    name="circular_spline_pitch",
    cause="The slots of the circular spline are cut with a cumulative pitch error.",
    kind="kinematic",
    frame="housing",
    needs=("wave_generator_angle", "torque"),
    excitation=(partial(enough_input_turns, turns=5.0), torque_varies),
    of_teeth=True,
    proportional=False,
    quantities=lobes(
        "pitch",
        ORDERS,
        "cumulative pitch error, {} periods around",
        "angle in the circular spline where the slots are most ahead",
    ),
    confused_with=("circular_spline_form", "coupling_misalignment", "flexspline_pitch", "tooth_damage"),
    source=(
        "cumulative pitch deviation: ISO 1328-1:2013; response: share of the stiffness (see contact_weights)"
    ),
    inspect=(
        "Cumulative pitch deviation of the circular spline on a gear tester, by harmonics: 1 µm reads about "
        "6 arcsec at light load. Turn the circular spline in its housing by a quarter turn: the direction "
        "must follow. Lower under load, where more pairs share it; what a coupling or encoder adds is not."
    ),
)
