"""A drive's catalogue page."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats

TENTH_OF_AN_INCH = 2.54e-3
"""Unit of a gear's size, which is its pitch diameter [m]."""

T1_SHARE, T2_SHARE = 0.25, 0.86
"""Torques T1 and T2 over the rated torque where no page gives them [-]."""

ASSUMED_PROFILE = (
    "backlash of single teeth, the eccentricity of the first interference and forces on teeth are those of "
    "the assumed profile"
)
"""Note to show with these values of a drive from a page."""


class Page(NamedTuple):
    """A catalogue page: pitch diameter [m], ratio [-], torques [N m], stiffness [N m/rad]; the output.

    Lost motion is the whole gap [rad]; most pages give none.
    """

    pitch_diameter: float
    ratio: float
    rated_torque: float
    k1: float
    k2: float
    k3: float
    t1: float
    t2: float
    lost_motion: float = 0.0
    output: str = "flexspline"

    @property
    def stiffness(self) -> tuple[float, float, float]:
        """K1, K2, K3 [N m/rad]."""
        return self.k1, self.k2, self.k3

    @property
    def torques(self) -> Floats:
        """Torques (8,) for comparing a drive with the page [N m]: from T1/10 to 2 T2."""
        t1, t2 = self.t1, self.t2
        return np.array([0.1 * t1, 0.25 * t1, 0.5 * t1, t1, 0.5 * (t1 + t2), t2, 1.5 * t2, 2.0 * t2])

    def torsion(self, torque: Floats) -> Floats:
        """Torsion by the page at torques > 0 [rad]: half the lost motion, then K1, K2, K3."""
        first = np.minimum(torque, self.t1) / self.k1
        second = np.clip(torque - self.t1, 0.0, self.t2 - self.t1) / self.k2
        third = np.maximum(torque - self.t2, 0.0) / self.k3
        return np.asarray(0.5 * self.lost_motion + first + second + third)
