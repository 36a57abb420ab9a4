"""Stiffness that changes beyond two torques: a function of torque alone."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Starts, Values
from hd_diag.effects.excitation import torque_beyond
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals

_FIRST, _SECOND = (0.08, 0.18, 0.35), (0.5, 0.8)  # start values of the knees over the greatest torque
_WIDTHS = (0.01, 0.5)  # start widths of the bends over their knees
_SHARP = 1e-6  # least width of a bend [N m]
_MOST = 100.0  # greatest added compliance over the usual; beyond it no torque comes near the knee
_PLACES = 24  # torques at which the added compliance is checked
_LEAST = 0.25  # share of the rated torque that the record must reach


class TorsionalHardening(Effect):
    """``-sgn T [a ramp(abs T - T1) + b ramp(abs T - T2)]``. Negative a and b make the drive stiffer.

    A ramp begins gradually, over a width of ``w T1`` or ``w T2`` around its knee: a small w gives a sharp
    knee, a large one a cubic. If a and b have different signs, a compliance ends at T2.
    """

    def sensible(self, coefficients: Floats, nonlinear: Values) -> bool:
        """Whether the added compliance is plausible at torques up to the knees; see :meth:`Effect.sensible`.

        The sum is checked, because wide bends may make a small compliance from two large coefficients.
        """
        *knees, width = nonlinear
        torque = np.linspace(0.0, max(knees), _PLACES)
        added = sum(
            a * _step(torque, knee, width * knee) for a, knee in zip(coefficients, knees, strict=True)
        )
        return bool(np.all(np.abs(added) < _MOST * self.usual[0]))

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Ramps from both knees; see :meth:`Effect.columns`."""
        *knees, width = nonlinear
        return np.stack([-_ramp(signals.torque, knee, width * knee) for knee in knees], axis=1)

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Knees within the record's torques [N m], with widths."""
        greatest = float(np.max(np.abs(signals.torque), initial=0.0))
        pairs = [(one * greatest, two * greatest) for one in _FIRST for two in _SECOND]
        return Starts.grid((*pair, width) for pair in pairs for width in _WIDTHS)


def _step(torque: Floats, knee: float, width: float) -> Floats:
    """Derivative of :func:`_ramp` by the torque [-]."""
    width = max(width, _SHARP)
    return np.asarray(
        1.0 + 0.5 * (np.tanh(0.5 * (torque - knee) / width) - np.tanh(0.5 * (torque + knee) / width))
    )


def _ramp(torque: Floats, knee: float, width: float) -> Floats:
    """Smooth ramps beyond plus and minus the knee, odd in the torque [N m]."""
    width = max(width, _SHARP)
    return np.asarray(
        width * (np.logaddexp(0.0, (torque - knee) / width) - np.logaddexp(0.0, (-torque - knee) / width))
    )


EFFECT = TorsionalHardening(
    name="torsional_hardening",
    cause=(
        "The cup, the wave generator or the housing grows stiffer, or softer, with load, beyond the teeth's "
        "own."
    ),
    kind="torsion",
    frame="torque",
    needs=("torque",),
    excitation=(partial(torque_beyond, fraction=_LEAST),),
    quantities=(
        Quantity(
            "first_compliance", "rad/(N m)", -1.0, 1.0, 3e-6, "a, compliance added beyond the first knee"
        ),
        Quantity(
            "second_compliance", "rad/(N m)", -1.0, 1.0, 3e-6, "b, compliance added beyond the second knee"
        ),
        Quantity("first_knee", "N m", 0.0, 1e5, 10.0, "T1, torque of the first knee", linear=False),
        Quantity("second_knee", "N m", 0.0, 1e5, 30.0, "T2, torque of the second knee", linear=False),
        Quantity("width", "-", 1e-3, 1.0, 0.1, "w, of the bends, over their knees", linear=False, shape=True),
    ),
    confused_with=("hysteresis", "wear_backlash"),
    source=(
        "Tuttle, Understanding and Modeling the Behavior of a Harmonic Drive Gear Transmission, MIT AI TR "
        "1365, 1992"
    ),
    inspect=(
        "Torsion test with the input held: K1, K2 and K3 of the catalogue between the knees. Screws of the "
        "flexspline and the circular spline first: a joint that slips grows softer beyond a torque. The "
        "curve must be the same at every angle and the same up and down."
    ),
)
