"""Geometry of a harmonic drive, checked as a whole."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from hd_diag.model.neutral_curve import NeutralCurve, neutral_curve
from hd_diag.model.tooth_profile import DoubleArc


@dataclass(frozen=True)
class Geometry:
    """Teeth, neutral curve and their places.

    Parameters
    ----------
    flexspline_teeth, circular_spline_teeth : int
        Z_R and Z_G.
    semi_major, semi_minor : float
        Semi-axes of the neutral curve [m].
    flexspline_tooth : DoubleArc
        Flank in the tooth frame; x from the neutral layer [m].
    flexspline_root, flexspline_tip : float
        Where the flank begins and ends: x above the neutral layer [m].
    circular_spline_slot : DoubleArc
        Wall of the slot; x from the datum radius [m].
    circular_spline_datum : float
        r_0, radius from which the slot's x is measured [m].
    circular_spline_tip_radius : float
        Radius at which the slot's wall begins [m].

    Raises
    ------
    ValueError
        Naming the first thing that cannot be.
    """

    flexspline_teeth: int
    circular_spline_teeth: int
    semi_major: float
    semi_minor: float
    flexspline_tooth: DoubleArc
    flexspline_root: float
    flexspline_tip: float
    circular_spline_slot: DoubleArc
    circular_spline_datum: float
    circular_spline_tip_radius: float

    def __post_init__(self) -> None:
        _check_teeth(self)
        _check_flank("flexspline_tooth", self.flexspline_tooth, self.flexspline_root, self.flexspline_tip)
        _check_mating(self)
        _check_engagement(self)

    @cached_property
    def curve(self) -> NeutralCurve:
        """Neutral curve of the flexspline."""
        return neutral_curve(self.semi_major, self.semi_minor)

    @property
    def reduction(self) -> float:
        """Z_R / (Z_G - Z_R): turns of the wave generator per turn of the flexspline."""
        return self.flexspline_teeth / (self.circular_spline_teeth - self.flexspline_teeth)

    @property
    def module(self) -> float:
        """Diameter of the circle with the neutral curve's perimeter, per tooth: 2 R_b / Z_R [m]."""
        return 2.0 * self.curve.radius / self.flexspline_teeth

    @property
    def slot_pitch(self) -> float:
        """Angle between the circular spline's slots [rad]."""
        return 2.0 * math.pi / self.circular_spline_teeth

    @property
    def tooth_pitch(self) -> float:
        """Angle between the flexspline's teeth, along the neutral curve [rad]."""
        return 2.0 * math.pi / self.flexspline_teeth

    @cached_property
    def slot_end(self) -> float:
        """Height above the datum at which the slot's wall meets the slot's axis [m]."""
        slot = self.circular_spline_slot
        return slot.addendum_center[0] + math.sqrt(slot.addendum_radius**2 - slot.addendum_center[1] ** 2)


def _check_teeth(geometry: Geometry) -> None:
    difference = geometry.circular_spline_teeth - geometry.flexspline_teeth
    if geometry.flexspline_teeth < 20 or difference not in (2, 4) or geometry.flexspline_teeth % 2:
        raise ValueError(
            f"circular_spline_teeth ({geometry.circular_spline_teeth}) must exceed flexspline_teeth "
            f"({geometry.flexspline_teeth}, at least 20) by 2 or 4, and both must be even: "
            "an ellipse has two lobes, and each must find teeth opposite slots"
        )


def _check_flank(name: str, flank: DoubleArc, start: float, end: float) -> None:
    lengths = (flank.addendum_radius, flank.dedendum_radius, *flank.addendum_center, *flank.dedendum_center)
    if not all(math.isfinite(value) for value in (*lengths, start, end)):
        raise ValueError(f"{name}: every length must be finite")
    if min(flank.addendum_radius, flank.dedendum_radius) <= 0:
        raise ValueError(f"{name}: arc radii must be positive")
    try:
        low, high = flank.dedendum_joint[0], flank.addendum_joint[0]
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    if not start < low <= high < end:
        raise ValueError(
            f"{name}: the flank must run root, inner arc, tangent, outer arc, tip; heights are "
            f"{start:.6g}, {low:.6g}, {high:.6g}, {end:.6g} m"
        )
    if not (flank.half_width(start) > 0 and flank.half_width(end) > 0):
        raise ValueError(
            f"{name}: the flank does not reach from {start:.6g} to {end:.6g} m, or its sides cross"
        )


def _check_mating(geometry: Geometry) -> None:
    slot = geometry.circular_spline_slot
    for outer, inner, name in (
        ("circular_spline_slot", "flexspline_tooth", "addendum_radius"),
        ("flexspline_tooth", "circular_spline_slot", "dedendum_radius"),
    ):
        wide, narrow = (getattr(getattr(geometry, part), name) for part in (outer, inner))
        if not wide > narrow:
            raise ValueError(
                f"{outer}.{name} ({wide:.6g} m) must exceed {inner}.{name} ({narrow:.6g} m), which runs in it"
            )
    if slot.addendum_radius <= abs(slot.addendum_center[1]):
        raise ValueError("circular_spline_slot: the outer arc must reach the slot's axis")


def _check_engagement(geometry: Geometry) -> None:
    curve, slot = geometry.curve, geometry.circular_spline_slot
    tip_radius, datum = geometry.circular_spline_tip_radius, geometry.circular_spline_datum
    root, tip = geometry.semi_major + geometry.flexspline_root, geometry.semi_major + geometry.flexspline_tip
    if not (math.isfinite(datum) and datum > 0 and math.isfinite(tip_radius)):
        raise ValueError(
            "circular_spline_datum and circular_spline_tip_radius must be positive and finite [m]"
        )
    _check_flank("circular_spline_slot", slot, tip_radius - datum, 0.999 * geometry.slot_end)
    if root >= tip_radius:
        raise ValueError(
            f"the flexspline's root ({root:.6g} m at the long axis) reaches the circular spline's tip radius "
            f"({tip_radius:.6g} m)"
        )
    if tip >= datum + geometry.slot_end:
        raise ValueError(
            "the flexspline's tip reaches the end of the circular spline's slot at the long axis"
        )
    if tip <= tip_radius:
        raise ValueError(
            "the flexspline's teeth do not reach into the circular spline's slots at the long axis"
        )
    if geometry.semi_minor + geometry.flexspline_tip >= tip_radius:
        raise ValueError("the flexspline's teeth do not come free of the circular spline at the short axis")
    widest = geometry.tooth_pitch * curve.radius / 2.0
    if geometry.flexspline_tooth.half_width(geometry.flexspline_root) >= widest:
        raise ValueError(
            f"flexspline_tooth: wider than its pitch ({2 * widest:.6g} m) at the root; "
            "the neutral curve is too short for this number of teeth"
        )
    if slot.half_width(tip_radius - datum) >= geometry.slot_pitch * tip_radius / 2.0:
        raise ValueError("circular_spline_slot: wider than its pitch at the tip radius")
