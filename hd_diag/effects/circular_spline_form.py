"""The circular spline is out of round: what its slots do that stand nearer or farther out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Quantity, Values, amplitude, direction, harmonic, harmonic_sum
from hd_diag.effects.excitation import enough_input_turns, torque_varies, verdict
from hd_diag.effects.signals import Signals

ORDERS = (2, 4, 6)


@dataclass(frozen=True)
class CircularSplineForm(Effect):
    """Radial slot displacement ``u = sum a_k cos k (phi - d_k)`` through the contact's weights.

    A ring that is bent keeps its circumference: its slots also move along it, by v with ``dv/dphi = -u``.
    """

    of_teeth: ClassVar[bool] = True

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Response to every lobe number; see :meth:`Effect.columns`."""
        (bending,), contact = nonlinear, signals.contact
        found = []
        for k in ORDERS:
            response = contact.radial_harmonic(k)
            if bending:
                response = response + 1j * bending / k * contact.slot_harmonic(k)
            found.append(harmonic(response))
        return np.concatenate(found, axis=1)

    def grid(self, signals: Signals) -> list[Values]:
        """Cut out of round, or bent."""
        return [(0.0,), (1.0,)]

    def beside(self, signals: Signals, nonlinear: Values) -> list[Values]:
        """The other way to be out of round."""
        return [other for other in self.grid(signals) if other != nonlinear]

    def response(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """The slots displaced at their full size; see :meth:`Effect.response`."""
        contact = signals.contact
        along = np.zeros(coefficients.size)
        for index, k in enumerate(ORDERS):  # a cosine's integral is a sine over k
            cosine, sine = coefficients[2 * index : 2 * index + 2]
            along[2 * index : 2 * index + 2] = nonlinear[0] / k * np.array([sine, -cosine])
        return contact.displaced(
            harmonic_sum(along, ORDERS, contact.slot_angles),
            harmonic_sum(coefficients, ORDERS, contact.slot_angles),
        )

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """A few turns at two torques."""
        return verdict(enough_input_turns(signals, 3.0), torque_varies(signals))


_LOBES = tuple(
    quantity
    for k in ORDERS
    for quantity in (
        amplitude(f"radial_{k}", "m", 5e-5, 2e-6, f"radial form error with {k} lobes"),
        direction(f"radial_direction_{k}", "angle in the circular spline of a lobe", k),
    )
)
_BENDING = Quantity(
    "bending",
    "-",
    0.0,
    1.0,
    1.0,
    "0: cut out of round, 1: bent, so that the circumference keeps its length",
    linear=False,
    discrete=True,
)

EFFECT = CircularSplineForm(
    name="circular_spline_form",
    cause="The circular spline is out of round: oval, or pulled to four or six lobes by its screws.",
    kind="kinematic",
    frame="housing",
    needs=("wave_generator_angle", "torque"),
    quantities=(*_LOBES, _BENDING),
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
