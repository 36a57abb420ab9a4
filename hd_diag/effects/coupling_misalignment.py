"""A misaligned coupling between motor and wave generator: twice per turn, as a universal joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hd_diag.effects.effect import Effect, Quantity, Values, direction
from hd_diag.effects.excitation import both_directions, enough_input_turns, torque_varies, verdict
from hd_diag.effects.signals import Signals

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class CouplingMisalignment(Effect):
    """``(gamma^2 / 4) sin 2 (theta_in - d) / N``: its coefficients are gamma^2 cos 2d and gamma^2 sin 2d."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Twice per input turn; see :meth:`Effect.columns`."""
        twice = 2.0 * signals.input_angle
        return np.stack((np.sin(twice), -np.cos(twice)), axis=1) / (4.0 * signals.ratio)

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """A few turns both ways at two torques."""
        return verdict(enough_input_turns(signals, 3.0), torque_varies(signals), both_directions(signals))

    @property
    def prior_scales(self) -> Floats:
        """Squares of the usual angle [rad^2], shape (2,)."""
        return np.full(2, self.quantities[0].prior_scale ** 2)

    def to_physical(
        self, coefficients: Sequence[float] | Floats, nonlinear: Values
    ) -> dict[str, tuple[float, str]]:
        """Angle of the bend instead of its square."""
        values = super().to_physical(coefficients, nonlinear)
        return values | {"angle": (float(np.sqrt(values["angle"][0])), "rad")}

    def from_physical(self, values: Mapping[str, float]) -> tuple[Floats, Values]:
        """See :meth:`Effect.from_physical`."""
        coefficients, nonlinear = super().from_physical(values)
        return coefficients * values["angle"], nonlinear


EFFECT = CouplingMisalignment(
    name="coupling_misalignment",
    cause="The coupling between motor and wave generator is bent and turns unevenly, twice per turn.",
    kind="kinematic",
    frame="input",
    needs=("output_angle", "torque"),
    quantities=(
        Quantity("angle", "rad", 0.0, 0.2, 0.03, "gamma, between the motor's shaft and the wave generator's"),
        direction("direction", "input angle at which the wave generator begins to lead", 2),
    ),
    confused_with=("circular_spline_pitch", "circular_spline_form", "flexspline_pitch"),
    source=(
        "universal joint: Seherr-Thoss, Schmelz, Aucktor, Universal Joints and Driveshafts, 2nd ed., "
        "Springer 2006"
    ),
    inspect=(
        "Play and wear of the Oldham coupling, then the motor's flange: square within 0.1 mm per 100 mm (1 "
        "mrad). Only a bend of some degrees is seen at the output (3.5 deg: 2 arcsec at ratio 100); play "
        "shows when the joint reverses. The amplitude must not change with torque; a pitch error falls."
    ),
)
