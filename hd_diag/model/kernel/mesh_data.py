"""Numbers of a mesh as the kernels take them; computed once per geometry."""

from __future__ import annotations

import cmath
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.geometry import Geometry
from hd_diag.model.kernel.formula import formula
from hd_diag.model.neutral_curve import tooth_axes
from hd_diag.model.tooth_profile import DoubleArc

JOINT_SLACK = 1e-9
"""Contacts may lie this far outside a primitive [m].

The flank is smooth there, so the gap is the same to the square of it over the arc radius, and rounding cannot
make a contact fall between two primitives.
"""


class Arc(NamedTuple):
    """Arc: centre, its distance from the origin, radius [m]."""

    x: float
    y: float
    distance: float
    radius: float


class CommonTangent(NamedTuple):
    """Common tangent: unit normal, distance from the origin, end points and their distances from it [m]."""

    normal_x: float
    normal_y: float
    distance: float
    outer_x: float
    outer_y: float
    outer_radius: float
    inner_x: float
    inner_y: float
    inner_radius: float


class Constants(NamedTuple):
    """Numbers of a geometry [m, rad]; the wall is placed about the circular spline's axis, the tooth is not.

    ``wall_tip_datum`` is the derivative of the angle of the wall's tip by the datum radius [rad/m].
    """

    curve_radius: float
    tooth_pitch: float
    slot_pitch: float
    turn_ratio: float
    pitch_height: float
    slack: float
    tip_x: float
    tip_y: float
    tooth_addendum: Arc
    tooth_dedendum: Arc
    tooth_line: CommonTangent
    wall_addendum: Arc
    wall_dedendum: Arc
    wall_line: CommonTangent
    wall_tip: float
    wall_tip_x: float
    wall_tip_y: float
    wall_tip_datum: float
    flexspline_teeth: int
    circular_spline_teeth: int


class Tables(NamedTuple):
    """Arrays of a geometry.

    Series of the neutral curve in every section (sections, 3, k); z of the sections [m], their shares of the
    width [-]; cosine and sine of whole tooth pitches; angles from a lobe [rad] and how far a tooth's farther
    tip corner there is from the axis, at most in any section [m].
    """

    series: Floats
    section_place: Floats
    section_weight: Floats
    pitch_cos: Floats
    pitch_sin: Floats
    reach_angle: Floats
    reach_radius: Floats


class MeshData(NamedTuple):
    """A geometry's numbers, tooth compliance K1 + K2 [m/N], arc offset s_0 [m], tilt in the housing [rad]."""

    constants: Constants
    tables: Tables
    compliance: float
    arc_offset: float
    tilt: complex


@formula
def reach(mesh: MeshData, displacement: float) -> float:
    """Greatest angle from a lobe at which a tooth's tip can lie beyond the slots' tip radius [rad].

    At a displacement of the middle section, and in any section.
    """
    radius, k = mesh.tables.reach_radius, 0
    farthest = displacement + abs(mesh.tilt) * mesh.tables.section_place[-1]
    while k < radius.size - 1 and not radius[k] + farthest < mesh.constants.wall_tip:
        k += 1
    return float(mesh.tables.reach_angle[k])


@formula
def width(c: Constants, angle: float) -> int:
    """Number of teeth at each lobe within an angle of reach."""
    return min(int(2.0 * angle / c.tooth_pitch) + 1, c.flexspline_teeth // 2)


def blank() -> MeshData:
    """Numbers of the right types that no gear has: enough to compile for."""
    arc, line = Arc(*[1.0] * 4), CommonTangent(*[1.0] * 9)
    constants = Constants._make([*[1.0] * 8, arc, arc, line, arc, arc, line, *[1.0] * 4, 0, 0])
    return MeshData(constants, Tables(np.ones((1, 3, 1)), *[np.ones(1)] * 6), 1.0, 0.0, 0j)


@lru_cache(maxsize=64)
def numbers(geometry: Geometry) -> tuple[Constants, Tables]:
    """What a mesh of this geometry has in common with all others."""
    return _constants(geometry), _tables(geometry)


def _constants(geometry: Geometry) -> Constants:
    curve, datum = geometry.curve, geometry.circular_spline_datum
    tooth, wall = geometry.flexspline_tooth, geometry.circular_spline_slot
    wall_dedendum = _arc(wall.dedendum_center, wall.dedendum_radius, datum)
    wall_tip = _wall_tip(wall_dedendum, geometry.circular_spline_tip_radius)
    normal_x, normal_y = wall_tip.real - wall_dedendum.x, wall_tip.imag - wall_dedendum.y
    return Constants(
        curve_radius=curve.radius,
        tooth_pitch=geometry.tooth_pitch,
        slot_pitch=geometry.slot_pitch,
        turn_ratio=1.0 + 1.0 / geometry.reduction,
        pitch_height=0.5 * (geometry.flexspline_root + geometry.flexspline_tip),
        slack=JOINT_SLACK,
        tip_x=geometry.flexspline_tip,
        tip_y=tooth.half_width(geometry.flexspline_tip),
        tooth_addendum=_arc(tooth.addendum_center, tooth.addendum_radius, 0.0),
        tooth_dedendum=_arc(tooth.dedendum_center, tooth.dedendum_radius, 0.0),
        tooth_line=_line(tooth, 0.0),
        wall_addendum=_arc(wall.addendum_center, wall.addendum_radius, datum),
        wall_dedendum=wall_dedendum,
        wall_line=_line(wall, datum),
        wall_tip=geometry.circular_spline_tip_radius,
        wall_tip_x=wall_tip.real,
        wall_tip_y=wall_tip.imag,
        wall_tip_datum=normal_x / (wall_tip.real * normal_y - wall_tip.imag * normal_x),
        flexspline_teeth=geometry.flexspline_teeth,
        circular_spline_teeth=geometry.circular_spline_teeth,
    )


def _tables(geometry: Geometry) -> Tables:
    pitches = np.arange(geometry.flexspline_teeth // 2) * geometry.tooth_pitch
    from_lobe = np.linspace(0.0, np.pi / 2, 181)
    half_width = geometry.flexspline_tooth.half_width(geometry.flexspline_tip)
    corners = []
    for curve in geometry.section_curves:
        _, height, offset = tooth_axes(curve, from_lobe)
        corners.append(np.hypot(height + geometry.flexspline_tip, np.abs(offset) + half_width))
    series = np.zeros((geometry.sections, 3, max(curve.series.shape[1] for curve in geometry.section_curves)))
    for own, curve in zip(series, geometry.section_curves, strict=True):
        own[:, : curve.series.shape[1]] = curve.series
    sections = series, geometry.section_places.copy(), geometry.section_weights.copy()
    return Tables(*sections, np.cos(pitches), np.sin(pitches), from_lobe, np.max(corners, axis=0))


def _arc(center: tuple[float, float], radius: float, datum: float) -> Arc:
    x, y = center[0] + datum, center[1]
    return Arc(x, y, math.hypot(x, y), radius)


def _line(flank: DoubleArc, datum: float) -> CommonTangent:
    (outer_x, outer_y), (inner_x, inner_y) = flank.addendum_joint, flank.dedendum_joint
    outer_x, inner_x = outer_x + datum, inner_x + datum
    distance = flank.normal[0] * outer_x + flank.normal[1] * outer_y
    outer, inner = (outer_x, outer_y), (inner_x, inner_y)
    return CommonTangent(*flank.normal, distance, *outer, math.hypot(*outer), *inner, math.hypot(*inner))


def _wall_tip(dedendum: Arc, tip: float) -> complex:
    """Where the slot's wall begins, x + iy in the slot frame about the axis [m]."""
    p, q, d = tip, dedendum.distance, dedendum.radius
    lens = 2.0 * math.asin(math.sqrt((d - p + q) * (d + p - q) / (4.0 * p * q)))
    return cmath.rect(p, math.atan2(dedendum.y, dedendum.x) - lens)
