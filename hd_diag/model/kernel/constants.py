"""A geometry's numbers as the kernels take them."""

from __future__ import annotations

import cmath
import functools
import math

import numpy as np

from hd_diag.model.clearance import JOINT_SLACK, tip_distances
from hd_diag.model.geometry import Geometry
from hd_diag.model.kernel.teeth import MeshData, Tables
from hd_diag.model.kernel.touch import Arc, Constants, Line
from hd_diag.model.tooth_profile import DoubleArc


def mesh(geometry: Geometry, tooth_compliance: float, arc_offset: float) -> MeshData:
    """What the entry points take."""
    return MeshData(*_of(geometry), tooth_compliance, arc_offset)


def blank() -> MeshData:
    """Numbers of the right types that no gear has: enough to compile for."""
    arc, line = Arc(*[1.0] * 4), Line(*[1.0] * 9)
    constants = Constants._make([*[1.0] * 10, arc, arc, line, arc, arc, line, *[1.0] * 4, 0, 0])
    return MeshData(constants, Tables(*[np.ones(1)] * 5), 1.0, 0.0)


@functools.lru_cache(maxsize=64)
def _of(geometry: Geometry) -> tuple[Constants, Tables]:
    return _constants(geometry), _tables(geometry)


def _constants(geometry: Geometry) -> Constants:
    curve, datum = geometry.curve, geometry.circular_spline_datum
    tooth, wall = geometry.flexspline_tooth, geometry.circular_spline_slot
    wall_tip = _wall_tip(geometry)
    return Constants(
        semi_major=curve.semi_major,
        semi_minor=curve.semi_minor,
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
        wall_dedendum=_arc(wall.dedendum_center, wall.dedendum_radius, datum),
        wall_line=_line(wall, datum),
        wall_tip=geometry.circular_spline_tip_radius,
        wall_tip_x=wall_tip.real,
        wall_tip_y=wall_tip.imag,
        wall_tip_datum=_wall_tip_datum(geometry, wall_tip),
        flexspline_teeth=geometry.flexspline_teeth,
        circular_spline_teeth=geometry.circular_spline_teeth,
    )


def _tables(geometry: Geometry) -> Tables:
    pitches = np.arange(geometry.flexspline_teeth // 2) * geometry.tooth_pitch
    reach = tip_distances(geometry)
    harmonics = geometry.curve.harmonics.copy()  # kernels are compiled for arrays that can be written
    return Tables(harmonics, np.cos(pitches), np.sin(pitches), *reach)


def _arc(center: tuple[float, float], radius: float, datum: float) -> Arc:
    x, y = center[0] + datum, center[1]
    return Arc(x, y, math.hypot(x, y), radius)


def _line(flank: DoubleArc, datum: float) -> Line:
    (outer_x, outer_y), (inner_x, inner_y) = flank.addendum_joint, flank.dedendum_joint
    outer_x, inner_x = outer_x + datum, inner_x + datum
    distance = flank.normal[0] * outer_x + flank.normal[1] * outer_y
    return Line(
        *flank.normal,
        distance,
        outer_x,
        outer_y,
        math.hypot(outer_x, outer_y),
        inner_x,
        inner_y,
        math.hypot(inner_x, inner_y),
    )


def _wall_tip(geometry: Geometry) -> complex:
    """Where the slot's wall begins, slot frame about the axis [m]."""
    wall, tip = geometry.circular_spline_slot, geometry.circular_spline_tip_radius
    center = complex(wall.dedendum_center[0] + geometry.circular_spline_datum, wall.dedendum_center[1])
    q, distance = abs(center), wall.dedendum_radius
    lens = 2.0 * math.asin(math.sqrt((distance - tip + q) * (distance + tip - q) / (4.0 * tip * q)))
    return cmath.rect(tip, cmath.phase(center) - lens)


def _wall_tip_datum(geometry: Geometry, tip: complex) -> float:
    """Derivative of the wall's angle at its tip by the datum radius [rad/m]; the tip radius stays."""
    wall = geometry.circular_spline_slot
    normal = tip - complex(wall.dedendum_center[0] + geometry.circular_spline_datum, wall.dedendum_center[1])
    return normal.real / (tip.real * normal.imag - tip.imag * normal.real)
