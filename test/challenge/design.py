"""Drives of the records: the paper's, and others similar to it."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from reference import polyline
from scipy.optimize import brentq

Array = NDArray[np.float64]

CUP_SPREAD = 5e-6  # [rad/(N m)], for a size 25


@dataclass(frozen=True)
class Design:
    """A drive as its maker intends it.

    Attributes
    ----------
    name : used in file names
    shape : flanks, neutral curve and teeth; its compliance is that of a tooth pair [m/N]
    rated : torque [N m]
    cup : torsion of the cup in addition to the teeth's [rad/(N m)]
    """

    name: str = "25/100"
    shape: polyline.Drive = polyline.DEFAULT
    rated: float = 87.0
    cup: float = 0.0

    @property
    def teeth(self) -> int:
        """Teeth of the flexspline."""
        return self.shape.flexspline_teeth

    @property
    def slots(self) -> int:
        """Teeth of the circular spline."""
        return self.shape.circular_spline_teeth

    @property
    def ratio(self) -> float:
        """Turns of the input per turn of the output."""
        return self.teeth / (self.slots - self.teeth)

    @property
    def tooth_pitch(self) -> float:
        """Angle between two teeth [rad]."""
        return 2 * np.pi / self.teeth

    @property
    def slot_pitch(self) -> float:
        """Angle between two slots [rad]."""
        return 2 * np.pi / self.slots

    @functools.cached_property
    def ring_radius(self) -> float:
        """Radius of the undeformed neutral circle [m]."""
        return polyline.ring_radius(self.shape)

    @functools.cached_property
    def module(self) -> float:
        """Size of a tooth relative to that of the paper's drive."""
        return self.ring_radius / polyline.ring_radius() * polyline.DEFAULT.flexspline_teeth / self.teeth

    @property
    def strength(self) -> float:
        """Rated torque relative to that of a size 25."""
        return self.rated / 87.0

    def scale(self, unit: str) -> float:
        """Factor from a quantity of a size 25 to that of this drive, by unit."""
        return {
            "um": self.module,
            "N m": self.strength,
            "N m at 1 rad/s": self.strength,
            "arcsec/(N m)": 1 / self.strength,
        }.get(unit, 1.0)


SIZE_25 = Design()


def similar(
    size: float, ratio: int, rated: float, datum: float = 0.0, compliance: float = 1e-6, cup: float = 0.0
) -> Design:
    """Drive of another size [0.1 inch] and ratio: pitch circle scaled by the size, teeth by the module.

    Parameters
    ----------
    size, ratio, rated : as printed on the catalogue page; rated torque [N m]
    datum : distance that the slots lie further out than by similarity [m]
    compliance, cup : [m/N], [rad/(N m)]
    """
    paper, teeth = polyline.DEFAULT, 2 * ratio
    radius = size / 25 * polyline.ring_radius()
    k = size / 25 * paper.flexspline_teeth / teeth
    major = radius + k * (paper.semi_major - polyline.ring_radius())

    def too_long(minor: float) -> float:
        return float(polyline._arc_table(major, minor)[1][-1] / (2 * np.pi)) - radius

    def scaled(profile: polyline.Profile) -> polyline.Profile:
        return polyline.Profile(*(k * value for value in dataclasses.astuple(profile)))

    shape = polyline.Drive(
        tooth=scaled(paper.tooth),
        slot=scaled(paper.slot),
        tooth_root=k * paper.tooth_root,
        tooth_tip=k * paper.tooth_tip,
        semi_major=major,
        semi_minor=float(brentq(too_long, 2 * radius - 2 * (major - radius) - major, major)),
        flexspline_teeth=teeth,
        circular_spline_teeth=teeth + 2,
        circular_spline_datum=major + k * (paper.circular_spline_datum - paper.semi_major) + datum,
        circular_spline_tip_radius=major + k * (paper.circular_spline_tip_radius - paper.semi_major) + datum,
        tooth_compliance=compliance,
    )
    return Design(f"{size}/{ratio}", shape, rated, cup)


# The datum leaves the paper's least backlash times the module. The compliances reproduce the stiffness of
# the catalogue page within 6 % (HFUC units: K1, K2, K3 of 14/50: 3.4, 4.7, 5.7; 20/160: 16, 25, 29; 32/120:
# 67, 110, 120 kN m/rad).
OTHERS = (
    similar(14, 50, 5.4, 29.2e-6, 0.594e-6, 81.1e-6),
    similar(20, 160, 40.0, -5.27e-6, 2.42e-6, 0.15e-6),
    similar(32, 120, 137.0, -4.95e-6, 0.779e-6, 1.61e-6),
)
