"""Cumulative pitch error of the flexspline, by harmonics: weighted by load, or equal at any torque."""

from __future__ import annotations

from functools import partial
from typing import Any

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Stepped, Values
from hd_diag.effects.excitation import enough_output_turns, torque_varies
from hd_diag.effects.quantity import harmonics, lobes, switch
from hd_diag.effects.signals import Signals

ORDERS = (2, 4)  # two opposite lobes cancel the odd ones


class FlexsplinePitch(Effect):
    """Circumferential displacement of the teeth, ``sum a_k cos k (psi - d_k)``, as the contacts feel it.

    If both flanks are preloaded, the torque does not change it: ``-sum a_k cos k (theta_F - d_k) / r``.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to every harmonic; see :meth:`Effect.columns`."""
        contact, (even,) = signals.contact, nonlinear
        return harmonics(contact.even_harmonics(ORDERS) if even else contact.harmonics("tooth", ORDERS))

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Response to teeth displaced at full size; see :meth:`Effect.step`."""
        first = self.columns(signals, nonlinear) @ coefficients
        return first + (0.0 if nonlinear[0] else signals.contact.teeth_beyond(ORDERS, coefficients)), state


EFFECT = FlexsplinePitch(
    name="flexspline_pitch",
    cause="The teeth of the flexspline are cut with a cumulative pitch error.",
    kind="kinematic",
    frame="output",
    needs=("wave_generator_angle", "torque"),
    excitation=(partial(enough_output_turns, turns=1.0), torque_varies),  # separates 2 and 2 (1 + 1/N)
    of_teeth=True,
    proportional=False,
    grid=((0.0,), (1.0,)),
    quantities=(
        *lobes(
            "pitch",
            ORDERS,
            "cumulative pitch error, {} periods around",
            "angle in the flexspline where the teeth are most ahead",
        ),
        switch("even", "0: as the pairs that bear have it, 1: alike under any torque, as by a preload"),
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
        "side of it: 1 µm reads about 6 arcsec at light load. Mount the output turned by half a turn on the "
        "flexspline: the direction moves with the flexspline. Its order is 2 (1 + 1/N), 2.02 at N = 100: "
        "short records show it as 2."
    ),
)
