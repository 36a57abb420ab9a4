"""From reported angles and torque to the mesh and back: signs, frames, the exact transmission error.

Positions are as the robot reports them; ``ratio`` = reported input angle / reported output angle, signed.
``TE = theta_out - theta_in / ratio`` is positive when the output is ahead of the input.

Output at the flexspline (circular spline fixed): the wave generator turns against the output, so
``theta_W = -sign(ratio) theta_in + phase``. A torque M that the drive exerts on the link reacts on the cup as
-M, and the cup's rotation is the error: ``TE = beta(theta_W, -M) - c_cup M``.

Output at the circular spline (flexspline fixed): seen from the circular spline the wave generator turns by
``theta_W = sign(ratio) theta_in Z_R / Z_G + phase`` and the cup by beta, so the circular spline lags by it:
``TE = -beta(theta_W, M) - c_cup M``. The housing eccentricity then rides with the circular spline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hd_diag.arrays import Floats
from hd_diag.model.geometry import Geometry

Output = Literal["flexspline", "circular_spline"]

# A ratio may differ from the teeth's only by rounding in a configuration file [-].
_RATIO_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Frame:
    """How reported numbers map to the mesh and back.

    `turning` dtheta_W / dtheta_in [-]; `phase` theta_W at input angle zero [rad]; `torque_sign` torque on the
    cup over torque on the link [-]; `ratio` reported input angle over reported output angle, signed [-];
    `cup_compliance` c_cup [rad/(N m)].
    """

    turning: float
    phase: float
    torque_sign: float
    ratio: float
    cup_compliance: float

    def wave_generator_angle(self, input_angle: Floats) -> Floats:
        """Angle theta_W of the long axis, seen from the circular spline, at an input angle [rad]."""
        return self.phase + self.turning * input_angle

    def cup_torque(self, torque: Floats) -> Floats:
        """Torque that turns the cup [N m] for a torque that the drive exerts on the link [N m]."""
        return self.torque_sign * torque

    def transmission_error(self, torsion: Floats, torque: Floats) -> Floats:
        """TE [rad] from the mesh torsion at :meth:`cup_torque` [rad] and the torque on the link [N m]."""
        return -self.torque_sign * torsion - self.cup_compliance * torque


@dataclass(frozen=True)
class Kinematics:
    """How reported angles and torques map to the mesh.

    Parameters
    ----------
    ratio : float
        Reported input angle over reported output angle, signed [-].
    output : {"flexspline", "circular_spline"}
        Which member drives the link; the other is fixed.
    phase : float
        Angle of the wave generator's long axis at input angle zero [rad].
    of_teeth : bool
        Whether the ratio is that of the mesh's teeth; False for a gear with unknown teeth.
    """

    ratio: float
    output: Output = "flexspline"
    phase: float = 0.0
    of_teeth: bool = True

    def check(self, geometry: Geometry) -> None:
        """Refuse a ratio that the teeth cannot give.

        Raises
        ------
        ValueError
            If `of_teeth` and |ratio| is not Z_R / (Z_G - Z_R) (output at the flexspline) or Z_G /
            (Z_G - Z_R). The message names the output or the teeth that would have the ratio.
        """
        if self.output not in ("flexspline", "circular_spline"):
            raise ValueError(f"output must be 'flexspline' or 'circular_spline', not {self.output!r}")
        if not math.isfinite(self.phase):
            raise ValueError(f"wave_generator_phase must be finite, not {self.phase} rad")
        if not self.of_teeth:
            if not 1.0 < abs(self.ratio) < math.inf:
                raise ValueError(f"ratio must be finite and above 1, not {self.ratio:g}")
            return
        expected = {"flexspline": geometry.reduction, "circular_spline": geometry.reduction + 1.0}
        if not self._is(expected[self.output]):
            other = next((output for output, ratio in expected.items() if self._is(ratio)), "")
            advice = f"; output: {other} has this ratio" if other else self._teeth()
            raise ValueError(
                f"ratio {self.ratio:g} does not fit {geometry.flexspline_teeth} and "
                f"{geometry.circular_spline_teeth} teeth with the output at the "
                f"{self.output.replace('_', ' ')}: its magnitude must be {expected[self.output]:g}{advice}"
            )

    def _is(self, expected: float) -> bool:
        return abs(abs(self.ratio) - expected) <= _RATIO_TOLERANCE * expected

    def _teeth(self) -> str:
        """Error text on the teeth that have the ratio; empty if no Z_R with Z_G = Z_R + 2 has it."""
        flexspline = 2.0 * abs(self.ratio) - (2.0 if self.output == "circular_spline" else 0.0)
        if not (math.isfinite(flexspline) and flexspline >= 2.0 and flexspline % 1.0 == 0.0):
            return ""
        return (
            f"; a gear of {flexspline:.0f} and {flexspline + 2.0:.0f} teeth has this ratio: hd-diag gear "
            "makes its parameters from a catalogue page"
        )

    def frame(self, geometry: Geometry, cup_compliance: float = 0.0) -> Frame:
        """Frame for the teeth of a geometry and a compliance of the cup [rad/(N m)]."""
        turning, torque_sign = math.copysign(1.0, self.ratio), 1.0
        if self.output == "flexspline":
            turning, torque_sign = -turning, -1.0
        else:
            turning *= geometry.flexspline_teeth / geometry.circular_spline_teeth
        return Frame(turning, self.phase, torque_sign, self.ratio, cup_compliance)
