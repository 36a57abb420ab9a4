"""A misaligned coupling between motor and wave generator: twice per turn, as a universal joint."""

from __future__ import annotations

from functools import partial

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.excitation import both_directions, enough_input_turns, torque_varies
from hd_diag.effects.quantity import Quantity, direction, switch
from hd_diag.effects.signals import Signals

_STILL = 0.1  # speed of the input at which play changes its side [rad/s]
_MOST_PLAY = 6.5e-4  # [rad]; a coupling has no more, but dry friction imitates play


class CouplingMisalignment(Effect):
    """``(gamma^2 / 4) sin 2 (theta_in - d) / N``, less half of the play while the joint moves forward.

    The coefficients are gamma^2 cos 2d, gamma^2 sin 2d and the play.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Waves twice per input turn, and play by the input's direction; see :meth:`Effect.columns`."""
        twice = 2.0 * signals.input_angle
        way = nonlinear[0] * np.tanh(signals.speed / _STILL)
        return np.stack((np.sin(twice), -np.cos(twice), -2.0 * way), axis=1) / (4.0 * signals.ratio)


EFFECT = CouplingMisalignment(
    name="coupling_misalignment",
    cause="The coupling between motor and wave generator is bent and turns unevenly, twice per turn.",
    kind="kinematic",
    frame="input",
    needs=("output_angle", "torque"),
    excitation=(partial(enough_input_turns, turns=3.0), torque_varies, both_directions),
    grid=((0.0,), (1.0,)),
    quantities=(
        Quantity(
            "angle",
            "rad",
            0.0,
            0.2,
            0.03,
            "gamma, between the motor's shaft and the wave generator's",
            power=2,
        ),
        direction("direction", "input angle at which the wave generator begins to lead", 2),
        Quantity(
            "play", "rad", 0.0, _MOST_PLAY, 2e-4, "free angle between the shafts in the coupling", strict=True
        ),
        switch("plays", "1: with play"),
    ),
    confused_with=("circular_spline_pitch", "circular_spline_form", "flexspline_pitch"),
    source=(
        "universal joint: Seherr-Thoss, Schmelz, Aucktor, Universal Joints and Driveshafts, 2nd ed., "
        "Springer 2006"
    ),
    inspect=(
        "Play and wear of the Oldham coupling, then the motor's flange: square within 0.1 mm per 100 mm (1 "
        "mrad). Only a bend of some degrees is seen at the output (3.5°: 2 arcsec at ratio 100); play "
        "shows when the joint reverses. The amplitude must not change with torque; a pitch error falls. A "
        "motor's encoder may read twice per turn, too: up to 10 arcmin at the input are usual."
    ),
)
