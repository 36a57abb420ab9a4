"""The circular spline is out of round: slots are displaced radially."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Stepped, Values
from hd_diag.effects.excitation import enough_input_turns, torque_varies
from hd_diag.effects.quantity import harmonic_sum, harmonics, lobes, switch
from hd_diag.effects.signals import Signals

ORDERS = (2, 4, 6)


class CircularSplineForm(Effect):
    """A radial displacement of the slots, ``u = sum a_k cos k (phi - d_k)``, as the teeth in contact feel it.

    A bent ring keeps its circumference, so its slots also move along it, by v with ``dv/dphi = -u``.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to every lobe number; see :meth:`Effect.columns`."""
        (bending,), contact = nonlinear, signals.contact
        found = contact.harmonics("radial", ORDERS)
        if bending:
            found = found + 1j * bending / np.array(ORDERS) * contact.harmonics("slot", ORDERS)
        return harmonics(found)

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Response to slots displaced at full size; see :meth:`Effect.step`."""
        cosine, sine = coefficients[::2], coefficients[1::2]
        # A cosine's integral is a sine over k.
        along = nonlinear[0] * np.stack((sine, -cosine), axis=1) / np.array(ORDERS)[:, None]
        angle = signals.contact.slot_angles
        outward = harmonic_sum(coefficients, ORDERS, angle)
        return signals.contact.displaced(harmonic_sum(along.ravel(), ORDERS, angle), outward), state


EFFECT = CircularSplineForm(
    name="circular_spline_form",
    cause="The circular spline is out of round: oval, or pulled to four or six lobes by its screws.",
    kind="kinematic",
    frame="housing",
    needs=("wave_generator_angle", "torque"),
    excitation=(partial(enough_input_turns, turns=3.0), torque_varies),
    grid=((0.0,), (1.0,)),
    of_teeth=True,
    proportional=False,
    quantities=(
        *lobes("radial", ORDERS, "radial form error with {} lobes", "angle in the circular spline of a lobe"),
        switch("bending", "0: cut out of round, 1: bent, so that the circumference keeps its length"),
    ),
    confused_with=(
        "circular_spline_pitch",
        "coupling_misalignment",
        "encoder_interpolation",
        "flexspline_pitch",
    ),
    source=(
        "radial motion of the slot against the pressure angle of the contacts that bear (see contact_weights)"
    ),
    inspect=(
        "Roundness of the circular spline in its housing, screws tightened, with a ball between slots: the "
        "amplitude is half of largest less smallest radius. Loosen and retighten its screws crosswise: a "
        "pulled ring changes, a cut one does not. Reversing the torque turns the sign of a radial error, "
        "not that of a pitch error."
    ),
)
