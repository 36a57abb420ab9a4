"""Numbers of a mesh in the form that the kernels take; computed once per geometry."""

from __future__ import annotations

import cmath
import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.flank_chain import FlankChain, chained
from hd_diag.model.geometry import Geometry
from hd_diag.model.kernel.formula import formula
from hd_diag.model.neutral_curve import tooth_axes
from hd_diag.model.tooth_profile import DoubleArc

JOINT_SLACK = 1e-9
"""Contacts may lie this far outside a primitive [m].

The flank is smooth there, so the gap changes only by the slack squared over the arc radius. The slack keeps
rounding from making a contact fall between two primitives.
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
    """Numbers of a geometry [m, rad]; the wall is about the circular spline's axis, the tooth in its frame.

    ``wall_tip_datum`` is the derivative of the angle of the wall's tip by the datum radius [rad/m]. If either
    flank is a chain, both chains have rows (pieces, 7): signed radius, centre (of a line its unit normal),
    ends towards root and tip. The arcs and lines of double arcs are then not used.
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
    tooth_chain: Floats
    wall_chain: Floats


class Tables(NamedTuple):
    """Arrays of a geometry.

    Series of the neutral curve in every section (sections, 3, k); z of the sections [m], their shares of the
    width [-]; cosine and sine of whole tooth pitches; angles from a lobe [rad], and at each the distance from
    the axis of a tooth's farther tip corner, the greatest over the sections [m].
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
    """Greatest angle from a lobe where a tooth's tip can lie beyond the slots' tip radius [rad].

    The displacement is that of the middle section [m]; the angle covers all sections.
    """
    radius, k = mesh.tables.reach_radius, 0
    farthest = displacement + abs(mesh.tilt) * mesh.tables.section_place[-1]
    while k < radius.size - 1 and not radius[k] + farthest < mesh.constants.wall_tip:
        k += 1
    return float(mesh.tables.reach_angle[k])


@formula
def width(c: Constants, angle: float) -> int:
    """Number of teeth at each lobe within an angle from it [rad]."""
    return min(int(2.0 * angle / c.tooth_pitch) + 1, c.flexspline_teeth // 2)


_NO_CHAIN = np.zeros((0, 7))


def blank() -> MeshData:
    """Numbers of the right types but of no gear: enough to compile for."""
    arc, line = Arc(*[1.0] * 4), CommonTangent(*[1.0] * 9)
    constants = Constants._make(
        [*[1.0] * 8, arc, arc, line, arc, arc, line, *[1.0] * 4, 0, 0, *[_NO_CHAIN] * 2]
    )
    return MeshData(constants, Tables(np.ones((1, 3, 1)), *[np.ones(1)] * 6), 1.0, 0.0, 0j)


@lru_cache(maxsize=64)
def numbers(geometry: Geometry) -> tuple[Constants, Tables]:
    """Constants and tables that all meshes of a geometry share; cached."""
    return _constants(geometry), _tables(geometry)


def _constants(geometry: Geometry) -> Constants:
    curve, datum, tip = geometry.curve, geometry.circular_spline_datum, geometry.circular_spline_tip_radius
    tooth, wall = geometry.flexspline_tooth, geometry.circular_spline_slot
    tooth_chain, wall_chain = _chains(geometry)
    wall_primitives = _primitives("wall", wall, datum)
    if wall_chain.size:
        wall_tip, normal = _chain_tip(wall_chain, tip)
    else:
        wall_dedendum = wall_primitives["wall_dedendum"]
        wall_tip = _wall_tip(wall_dedendum, tip)
        normal = wall_tip - complex(wall_dedendum.x, wall_dedendum.y)
    return Constants(
        curve_radius=curve.radius,
        tooth_pitch=geometry.tooth_pitch,
        slot_pitch=geometry.slot_pitch,
        turn_ratio=1.0 + 1.0 / geometry.reduction,
        pitch_height=0.5 * (geometry.flexspline_root + geometry.flexspline_tip),
        slack=JOINT_SLACK,
        tip_x=geometry.flexspline_tip,
        tip_y=tooth.half_width(geometry.flexspline_tip),
        **_primitives("tooth", tooth, 0.0),
        **wall_primitives,
        wall_tip=tip,
        wall_tip_x=wall_tip.real,
        wall_tip_y=wall_tip.imag,
        wall_tip_datum=normal.real / (wall_tip.real * normal.imag - wall_tip.imag * normal.real),
        flexspline_teeth=geometry.flexspline_teeth,
        circular_spline_teeth=geometry.circular_spline_teeth,
        tooth_chain=tooth_chain,
        wall_chain=wall_chain,
    )


def _chains(geometry: Geometry) -> tuple[Floats, Floats]:
    """Rows of both flanks if either is a chain; empty if both are double arcs."""
    flanks = geometry.flexspline_tooth, geometry.circular_spline_slot
    if not any(isinstance(flank, FlankChain) for flank in flanks):
        return _NO_CHAIN, _NO_CHAIN
    datum = geometry.circular_spline_datum
    tooth = chained(flanks[0], geometry.flexspline_root, geometry.flexspline_tip)
    wall = chained(flanks[1], geometry.circular_spline_tip_radius - datum, geometry.slot_end)
    return _rows(tooth, 0.0), _rows(wall, datum)


def _rows(chain: FlankChain, datum: float) -> Floats:
    """Rows (pieces, 7) of a chain, moved outwards by a datum radius [m]; see `Constants`."""
    table = np.zeros((len(chain.pieces), 7))
    for row, piece in zip(table, chain.pieces, strict=True):
        shift = datum if piece.radius else 0.0
        row[:3] = piece.radius, piece.x + shift, piece.y
        row[3:] = piece.start.real + datum, piece.start.imag, piece.end.real + datum, piece.end.imag
    return table


def _chain_tip(rows: Floats, tip: float) -> tuple[complex, complex]:
    """Point where a wall begins, x + iy about the axis [m], and the wall's unit normal there."""
    beyond = np.hypot(rows[:, 5], rows[:, 6]) >= tip
    radius, x, y, *ends = rows[int(np.argmax(beyond))].tolist()
    if not radius:
        distance = x * ends[0] + y * ends[1]
        normal = complex(x, y)
        return normal * complex(distance, -math.sqrt(tip**2 - distance**2)), normal
    center = complex(x, y)
    half = (radius**2 - (abs(center) - tip) ** 2) / (4.0 * abs(center) * tip)
    turn = math.copysign(2.0 * math.asin(math.sqrt(half)), radius)
    place = cmath.rect(tip, cmath.phase(center) + turn)
    return place, (place - center) / radius


def _primitives(name: str, flank: DoubleArc | FlankChain, datum: float) -> dict[str, Any]:
    """Arcs and line of a double arc; for a chain, zeros that nothing uses."""
    if isinstance(flank, FlankChain):
        none = Arc(*[0.0] * 4), Arc(*[0.0] * 4), CommonTangent(*[0.0] * 9)
        return dict(zip((f"{name}_addendum", f"{name}_dedendum", f"{name}_line"), none, strict=True))
    arcs = (flank.addendum_center, flank.addendum_radius), (flank.dedendum_center, flank.dedendum_radius)
    addendum, dedendum = (_arc(center, radius, datum) for center, radius in arcs)
    return {f"{name}_addendum": addendum, f"{name}_dedendum": dedendum, f"{name}_line": _line(flank, datum)}


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
    """Point where the slot's wall begins, x + iy in the slot frame about the axis [m]."""
    p, q, d = tip, dedendum.distance, dedendum.radius
    lens = 2.0 * math.asin(math.sqrt((d - p + q) * (d + p - q) / (4.0 * p * q)))
    return cmath.rect(p, math.atan2(dedendum.y, dedendum.x) - lens)
