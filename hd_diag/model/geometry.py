"""Geometry of a harmonic drive, checked as a whole, in every section along its width."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.cams import Cam, curve_on
from hd_diag.model.flank_chain import FlankChain
from hd_diag.model.neutral_curve import NeutralCurve
from hd_diag.model.tooth_profile import DoubleArc


@dataclass(frozen=True)
class Geometry:
    """Teeth, neutral curve and their places.

    Parameters
    ----------
    flexspline_teeth, circular_spline_teeth : int
        Z_R and Z_G.
    neutral_curve : Cam
        Cam that shapes the flexspline's neutral layer in the middle section.
    flexspline_tooth : DoubleArc or FlankChain
        Flank in the tooth frame; x from the neutral layer [m].
    flexspline_root, flexspline_tip : float
        Heights x above the neutral layer where the flank begins and ends [m].
    circular_spline_slot : DoubleArc or FlankChain
        Wall of the slot; x from the datum radius [m].
    circular_spline_datum : float
        r_0, radius at the origin of the slot's x [m].
    circular_spline_tip_radius : float
        Radius at which the slot's wall begins [m].
    face_width : float
        b, width of the teeth [m]; with 0 the middle section stands for the whole width.
    cup_length : float
        L, distance from the cup's bottom, which stays round, to the middle section [m]. With 0 all sections
        are deformed alike, as in a ring.
    sections : int
        Number of sections along the width, at Gauss-Legendre points.

    Raises
    ------
    ValueError
        If a value is impossible; the message names the first one.
    """

    flexspline_teeth: int
    circular_spline_teeth: int
    neutral_curve: Cam
    flexspline_tooth: DoubleArc | FlankChain
    flexspline_root: float
    flexspline_tip: float
    circular_spline_slot: DoubleArc | FlankChain
    circular_spline_datum: float
    circular_spline_tip_radius: float
    face_width: float = 0.0
    cup_length: float = 0.0
    sections: int = 1

    def __post_init__(self) -> None:
        _check_teeth(self)
        _check_width(self)
        _check_flank("flexspline_tooth", self.flexspline_tooth, self.flexspline_root, self.flexspline_tip)
        _check_mating(self)
        _check_engagement(self)

    @cached_property
    def curve(self) -> NeutralCurve:
        """Neutral curve of the flexspline in the middle section."""
        return curve_on(self.neutral_curve)

    @cached_property
    def section_curves(self) -> tuple[NeutralCurve, ...]:
        """Neutral curve in every section: a cup's generators stay straight, ``w(z) = w(0) (1 + z / L)``."""
        if not self.cup_length:
            return (self.curve,) * self.sections
        factors = 1.0 + self.section_places / self.cup_length
        return tuple(self.curve if k == 1.0 else self.curve.deformed(k) for k in factors.tolist())

    @cached_property
    def section_places(self) -> Floats:
        """Places z of the sections from the middle one, positive towards the open end [m], (sections,)."""
        return np.asarray(0.5 * self.face_width * np.polynomial.legendre.leggauss(self.sections)[0])

    @cached_property
    def section_weights(self) -> Floats:
        """Share of every section in the width [-], shape (sections,)."""
        return np.asarray(0.5 * np.polynomial.legendre.leggauss(self.sections)[1])

    @property
    def semi_major(self) -> float:
        """Distance from the centre to the middle section's neutral curve along the long axis [m]."""
        return self.curve.semi_major

    @property
    def semi_minor(self) -> float:
        """Distance from the centre to the middle section's neutral curve along the short axis [m]."""
        return self.curve.semi_minor

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
        """Height above the datum where the slot's wall meets the slot's axis, or a chain ends [m]."""
        slot = self.circular_spline_slot
        if isinstance(slot, FlankChain):
            return slot.end
        return slot.addendum_center[0] + math.sqrt(slot.addendum_radius**2 - slot.addendum_center[1] ** 2)


def _check_teeth(geometry: Geometry) -> None:
    difference = geometry.circular_spline_teeth - geometry.flexspline_teeth
    if geometry.flexspline_teeth < 20 or difference not in (2, 4) or geometry.flexspline_teeth % 2:
        raise ValueError(
            f"circular_spline_teeth ({geometry.circular_spline_teeth}) must exceed flexspline_teeth "
            f"({geometry.flexspline_teeth}, at least 20) by 2 or 4, and both must be even: "
            "a wave generator has two lobes, and each must find teeth opposite slots"
        )


def _check_width(geometry: Geometry) -> None:
    width, length = geometry.face_width, geometry.cup_length
    if not (0.0 <= width < math.inf and 0.0 <= length < math.inf):
        raise ValueError(
            f"face_width ({width:g} m) and cup_length ({length:g} m) must be positive and finite, or 0"
        )
    if geometry.sections < 1:
        raise ValueError(f"sections must be at least 1, not {geometry.sections}")
    if geometry.sections > 1 and not width:
        raise ValueError(f"sections: {geometry.sections} sections lie along a width; give face_width [m]")
    if length and not length > 0.5 * width:
        raise ValueError(
            f"cup_length ({length:.6g} m), from the cup's bottom to the middle of the teeth, must exceed "
            f"half of face_width ({width:.6g} m)"
        )


def _check_flank(name: str, flank: DoubleArc | FlankChain, start: float, end: float) -> None:
    if isinstance(flank, DoubleArc):
        _check_double_arc(name, flank, start, end)
    elif not flank.covers(start, end):
        raise ValueError(
            f"{name}: the chain runs from {flank.start:.6g} to {flank.end:.6g} m, the flank from "
            f"{start:.6g} to {end:.6g} m"
        )
    if not (flank.half_width(start) > 0 and flank.half_width(end) > 0):
        raise ValueError(
            f"{name}: the flank does not reach from {start:.6g} to {end:.6g} m, or its sides cross"
        )


def _check_double_arc(name: str, flank: DoubleArc, start: float, end: float) -> None:
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


def _check_mating(geometry: Geometry) -> None:
    tooth, slot = geometry.flexspline_tooth, geometry.circular_spline_slot
    if isinstance(tooth, FlankChain) or isinstance(slot, FlankChain):
        return
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
    slot = geometry.circular_spline_slot
    tip_radius, datum = geometry.circular_spline_tip_radius, geometry.circular_spline_datum
    if not (math.isfinite(datum) and datum > 0 and math.isfinite(tip_radius)):
        raise ValueError(
            "circular_spline_datum and circular_spline_tip_radius must be positive and finite [m]"
        )
    _check_flank("circular_spline_slot", slot, tip_radius - datum, 0.999 * geometry.slot_end)
    for place, curve in zip(geometry.section_places.tolist(), geometry.section_curves, strict=True):
        _check_section(geometry, curve, f" of the section at {place * 1e3:.3g} mm" if place else "")
    widest = geometry.tooth_pitch * geometry.curve.radius / 2.0
    if geometry.flexspline_tooth.half_width(geometry.flexspline_root) >= widest:
        raise ValueError(
            f"flexspline_tooth: wider than its pitch ({2 * widest:.6g} m) at the root; "
            "the neutral curve is too short for this number of teeth"
        )
    if slot.half_width(tip_radius - datum) >= geometry.slot_pitch * tip_radius / 2.0:
        raise ValueError("circular_spline_slot: wider than its pitch at the tip radius")


def _check_section(geometry: Geometry, curve: NeutralCurve, where: str) -> None:
    tip_radius = geometry.circular_spline_tip_radius
    root, tip = curve.semi_major + geometry.flexspline_root, curve.semi_major + geometry.flexspline_tip
    if root >= tip_radius:
        raise ValueError(
            f"the flexspline's root ({root:.6g} m at the long axis{where}) reaches the circular spline's tip "
            f"radius ({tip_radius:.6g} m)"
        )
    if tip >= geometry.circular_spline_datum + geometry.slot_end:
        raise ValueError(
            f"the flexspline's tip reaches the end of the circular spline's slot at the long axis{where}"
        )
    if tip <= tip_radius:
        raise ValueError(
            f"the flexspline's teeth do not reach into the circular spline's slots at the long axis{where}"
        )
    if curve.semi_minor + geometry.flexspline_tip >= tip_radius:
        raise ValueError(
            f"the flexspline's teeth do not come free of the circular spline at the short axis{where}"
        )
