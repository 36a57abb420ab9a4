"""Backlash of every tooth pair on both flanks, in closed form.

The flexspline's flank is an arc, a line, an arc and a tip corner; so is the slot's wall. Turning one
primitive about the circular spline's axis until it touches another has a closed form for every pair. As
functions of the radius, wall angle less flank angle is the gap; each tangency is a stationary point of that
gap and each corner an end of its range, so the least of them is the rotation that closes the flank.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.model.geometry import Geometry
from hd_diag.model.neutral_curve import tooth_axes

JOINT_SLACK = 1e-9
"""Contacts may lie this far outside a primitive [m].

The flank is smooth there, so the gap is the same to the square of it over the arc radius, and rounding cannot
make a contact fall between two primitives.
"""


@dataclass(frozen=True)
class Contact:
    """Where and when the flanks of tooth pairs meet. Arrays of shape (moments, 2, teeth), flanks (+, -).

    Attributes
    ----------
    teeth : ndarray of int, shape (moments, teeth)
        Which tooth of the flexspline each column is.
    slots : ndarray of int, shape (moments, teeth)
        The slot that it meets.
    rotation : ndarray
        b, rotation of the cup that closes the gap, in the flank's own direction [rad]; nan: cannot touch.
    radius : ndarray
        r, distance of the contact from the axis [m].
    pressure_angle : ndarray
        alpha [rad].
    position : ndarray
        Polar angle of the contact in the housing [rad].
    """

    teeth: Integers
    slots: Integers
    rotation: Floats
    radius: Floats
    pressure_angle: Floats
    position: Floats

    @property
    def backlash(self) -> Floats:
        """Circumferential backlash D = r b [m]."""
        return self.radius * self.rotation


class _Polar(NamedTuple):
    """Points about the circular spline's axis: distance [m] and angle [rad]."""

    radius: Floats
    angle: Floats


class _Tooth(NamedTuple):
    """One flank's primitives about the axis, tooth axis at angle zero, mirrored so that it is a + flank."""

    addendum: _Polar
    dedendum: _Polar
    tip: _Polar
    line_normal: float
    line_distance: Floats
    addendum_joint: Floats
    dedendum_joint: Floats


class _Slot(NamedTuple):
    """The wall's primitives about the axis, slot axis at angle zero."""

    addendum: tuple[float, float]
    dedendum: tuple[float, float]
    line_normal: float
    line_distance: float
    addendum_joint: float
    dedendum_joint: float
    tip: float
    tip_angle: float


class _Touch(NamedTuple):
    """Contact of two primitives: tooth axis' angle from the slot's, point and normal in the slot frame."""

    tooth_angle: Floats
    x: Floats
    y: Floats
    normal_x: Floats
    normal_y: Floats


def contacts(
    geometry: Geometry,
    wave_generator_angle: Floats,
    eccentricity: complex | npt.NDArray[np.complex128],
    arc_offset: float = 0.0,
    farthest: float | None = None,
) -> Contact:
    """Contacts of the tooth pairs near both lobes, at any number of moments.

    Parameters
    ----------
    geometry : Geometry
    wave_generator_angle : ndarray, shape (moments,)
        theta_W [rad].
    eccentricity : complex or ndarray of complex, shape (moments,)
        Displacement of the wave generator's centre in the housing, x + iy [m].
    arc_offset : float
        s_0, shift of the teeth along the neutral curve [m].
    farthest : float, optional
        Greatest displacement that any moment may have [m]: it bounds the columns, so that they are the same
        however many moments are asked for at once. The greatest given, if left out.

    Returns
    -------
    Contact
        Columns are the teeth that can reach the slots; all others cannot touch.

    Notes
    -----
    Pose: Dong et al. (2019), eqs. (1)-(7); tooth i sits at
    ``s_i = R_b (theta_F + 2 pi i / Z_R - theta_W) + s_0``.
    """
    turn = np.asarray(wave_generator_angle, dtype=np.float64)
    center = np.broadcast_to(np.asarray(eccentricity, dtype=np.complex128), turn.shape)
    center = center * np.exp(-1j * turn)
    if farthest is None:
        farthest = float(np.max(np.abs(center), initial=0.0))
    teeth, u = _teeth_near_lobes(geometry, turn, arc_offset, farthest)
    axis, height, offset = tooth_axes(geometry.curve, u)
    cos_axis, sin_axis = np.cos(axis), np.sin(axis)
    height = height + center.real[:, None] * cos_axis + center.imag[:, None] * sin_axis
    offset = offset + center.imag[:, None] * cos_axis - center.real[:, None] * sin_axis
    axis = axis + turn[:, None]
    pitch_height = 0.5 * (geometry.flexspline_root + geometry.flexspline_tip)
    slots = np.rint((axis + np.arctan2(offset, height + pitch_height)) / geometry.slot_pitch)
    slot_angle = slots * geometry.slot_pitch
    lead = axis - slot_angle
    rotation, x, y, normal_x, normal_y = _close(
        geometry, height[:, None, :], _both_flanks(offset), _both_flanks(lead)
    )
    slot_angle = slot_angle[:, None, :] + _both_flanks(np.ones_like(lead)) * np.arctan2(y, x)
    return Contact(
        teeth=teeth,
        slots=slots.astype(np.int64) % geometry.circular_spline_teeth,
        rotation=rotation,
        radius=np.hypot(x, y),
        pressure_angle=np.arctan2(x * normal_x + y * normal_y, x * normal_y - y * normal_x),
        position=slot_angle,
    )


def all_teeth(geometry: Geometry, contact: Contact, values: Floats, missing: float = math.nan) -> Floats:
    """Spread per-contact values over every tooth of the flexspline.

    Parameters
    ----------
    geometry : Geometry
    contact : Contact
    values : ndarray, shape (moments, 2, contacts)
    missing : float
        For teeth far from both lobes.

    Returns
    -------
    ndarray, shape (moments, 2, Z_R)
    """
    spread = np.full((values.shape[0], 2, geometry.flexspline_teeth), missing)
    moments, flanks = np.arange(values.shape[0])[:, None, None], np.arange(2)[:, None]
    spread[moments, flanks, contact.teeth[:, None, :]] = values
    return spread


def _both_flanks(values: Floats) -> Floats:
    return np.stack((values, -values), axis=1)


def _teeth_near_lobes(
    geometry: Geometry, turn: Floats, arc_offset: float, eccentricity: float
) -> tuple[Integers, Floats]:
    """Indices of the teeth within reach of the slots and their places u on the neutral curve [rad]."""
    reach = _angle_of_reach(geometry, eccentricity)
    pitch = geometry.tooth_pitch
    # theta_F - theta_W with theta_F = -theta_W (Z_G - Z_R) / Z_R, plus the arc offset
    start = -turn * (1.0 + 1.0 / geometry.reduction) + arc_offset / geometry.curve.radius
    width = min(int(2.0 * reach / pitch) + 1, geometry.flexspline_teeth // 2)
    lobes = np.array([0.0, np.pi])
    first = np.ceil((lobes - reach - start[:, None]) / pitch)
    index = (first[:, :, None] + np.arange(width)).reshape(turn.size, -1)
    u = start[:, None] + index * pitch
    return index.astype(np.int64) % geometry.flexspline_teeth, u


def _angle_of_reach(geometry: Geometry, eccentricity: float) -> float:
    """Greatest distance from a lobe at which a tooth's tip can lie beyond the slots' tip radius [rad]."""
    u, distance = tip_distances(geometry)
    free = distance + eccentricity < geometry.circular_spline_tip_radius
    first_free = int(np.argmax(free)) if free.any() else u.size - 1
    return float(u[first_free])


def tip_distances(geometry: Geometry) -> tuple[Floats, Floats]:
    """Angles u from a lobe [rad] and how far a tooth's farther tip corner there is from the axis [m]."""
    half_width = geometry.flexspline_tooth.half_width(geometry.flexspline_tip)
    u = np.linspace(0.0, np.pi / 2, 181)
    _, height, offset = tooth_axes(geometry.curve, u)
    return u, np.hypot(height + geometry.flexspline_tip, np.abs(offset) + half_width)


def _close(
    geometry: Geometry, height: Floats, offset: Floats, lead: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Least closing rotation [rad] over all pairs of primitives, contact point and normal (slot frame)."""
    slot = _slot(geometry)
    height = np.broadcast_to(height, offset.shape)
    tooth = _tooth(geometry, height, offset)
    engaged = tooth.tip.radius > slot.tip
    nowhere = np.full(engaged.shape, np.nan)
    best = _Touch(np.where(engaged, np.inf, np.nan), nowhere, nowhere, nowhere, nowhere)
    for touch, valid in _touches(geometry, tooth, slot):
        nearer = valid & (touch.tooth_angle < best.tooth_angle)
        best = _Touch(*(np.where(nearer, new, old) for new, old in zip(touch, best, strict=True)))
    rotation = np.where(np.isfinite(best.tooth_angle), best.tooth_angle, np.nan) - lead
    return rotation, best.x, best.y, best.normal_x, best.normal_y


def _slot(geometry: Geometry) -> _Slot:
    wall, datum = geometry.circular_spline_slot, geometry.circular_spline_datum
    addendum = _about(wall.addendum_center, datum)
    dedendum = _about(wall.dedendum_center, datum)
    joint = wall.addendum_joint
    tip = geometry.circular_spline_tip_radius
    return _Slot(
        addendum,
        dedendum,
        wall.normal_angle,
        wall.normal[0] * (joint[0] + datum) + wall.normal[1] * joint[1],
        _about(joint, datum)[0],
        _about(wall.dedendum_joint, datum)[0],
        tip,
        dedendum[1] - float(_lens_angle(np.asarray(tip), dedendum[0], wall.dedendum_radius)),
    )


def _about(point: tuple[float, float], datum: float) -> tuple[float, float]:
    return math.hypot(point[0] + datum, point[1]), math.atan2(point[1], point[0] + datum)


def _tooth(geometry: Geometry, height: Floats, offset: Floats) -> _Tooth:
    flank = geometry.flexspline_tooth
    tip = (geometry.flexspline_tip, flank.half_width(geometry.flexspline_tip))
    (joint_x, joint_y), (inner_x, inner_y) = flank.addendum_joint, flank.dedendum_joint
    return _Tooth(
        _polar(flank.addendum_center, height, offset),
        _polar(flank.dedendum_center, height, offset),
        _polar(tip, height, offset),
        flank.normal_angle,
        flank.normal[0] * (joint_x + height) + flank.normal[1] * (joint_y + offset),
        np.hypot(joint_x + height, joint_y + offset),
        np.hypot(inner_x + height, inner_y + offset),
    )


def _polar(point: tuple[float, float], height: Floats, offset: Floats) -> _Polar:
    x, y = point[0] + height, point[1] + offset
    return _Polar(np.hypot(x, y), np.arctan2(y, x))


def _touches(geometry: Geometry, tooth: _Tooth, slot: _Slot) -> list[tuple[_Touch, npt.NDArray[np.bool_]]]:
    """Every pair that can be the nearest: five tangencies, and both tip corners against the other's flank."""
    a, d = geometry.flexspline_tooth.addendum_radius, geometry.flexspline_tooth.dedendum_radius
    wall_a = geometry.circular_spline_slot.addendum_radius
    wall_d = geometry.circular_spline_slot.dedendum_radius
    inf = np.inf
    found = []
    # Convex addendum inside the slot's hollow arc: centres d = wall_a - a apart, tooth's centre ahead.
    touch = _arcs(tooth.addendum, slot.addendum, wall_a - a, 1.0, wall_a, 1.0)
    found.append((touch, _within(touch, tooth.addendum_joint, inf, slot.addendum_joint, inf)))
    # Convex addendum against the circular spline's convex addendum: tooth's centre behind.
    touch = _arcs(tooth.addendum, slot.dedendum, a + wall_d, -1.0, wall_d, -1.0)
    found.append((touch, _within(touch, tooth.addendum_joint, inf, 0.0, slot.dedendum_joint)))
    # Hollow dedendum around the circular spline's convex addendum: tooth's centre ahead.
    touch = _arcs(tooth.dedendum, slot.dedendum, d - wall_d, 1.0, wall_d, -1.0)
    found.append((touch, _within(touch, 0.0, tooth.dedendum_joint, 0.0, slot.dedendum_joint)))
    touch = _addendum_on_line(tooth, slot, a)
    found.append((touch, _within(touch, tooth.addendum_joint, inf, slot.dedendum_joint, slot.addendum_joint)))
    touch = _line_on_addendum(tooth, slot, wall_d)
    found.append(
        (touch, _within(touch, tooth.dedendum_joint, tooth.addendum_joint, 0.0, slot.dedendum_joint))
    )
    engaged = tooth.tip.radius > slot.tip
    found = [(touch, valid & _in_range(touch, slot.tip, tooth.tip.radius)) for touch, valid in found]
    found.append((_tooth_tip(geometry, tooth, slot), engaged))
    found.append((_slot_tip(geometry, tooth, slot), engaged))
    return found


def _in_range(touch: _Touch, low: float, high: Floats) -> npt.NDArray[np.bool_]:
    square = touch.x * touch.x + touch.y * touch.y
    return (square >= low * low) & (square <= high * high)


def _within(
    touch: _Touch, tooth_low: Floats | float, tooth_high: Floats | float, slot_low: float, slot_high: float
) -> npt.NDArray[np.bool_]:
    """Whether the contact lies on both primitives: they are told apart by the radius."""
    radius = np.sqrt(touch.x * touch.x + touch.y * touch.y)
    return (
        (radius >= np.maximum(tooth_low, slot_low) - JOINT_SLACK)
        & (radius <= np.minimum(tooth_high, slot_high) + JOINT_SLACK)
        & (touch.x * touch.normal_y > touch.y * touch.normal_x)
    )


def _lens_angle(p: Floats, q: float | Floats, distance: float | Floats) -> Floats:
    """Angle between points at radii p and q that are so far apart [rad]; nan if none is."""
    squared = (distance - p + q) * (distance + p - q) / (4.0 * p * q)
    with np.errstate(invalid="ignore"):
        return 2.0 * np.arcsin(np.sqrt(squared))


def _arcs(
    moving: _Polar,
    fixed: tuple[float, float],
    distance: float,
    side: float,
    wall_radius: float,
    wall_side: float,
) -> _Touch:
    """Two arcs touch when their centres are ``distance`` apart, the moving one on the given side."""
    radius, angle = fixed
    at = angle + side * _lens_angle(moving.radius, radius, distance)
    center_x, center_y = radius * math.cos(angle), radius * math.sin(angle)
    normal_x = side * (moving.radius * np.cos(at) - center_x) / distance
    normal_y = side * (moving.radius * np.sin(at) - center_y) / distance
    return _Touch(
        at - moving.angle,
        center_x + wall_side * wall_radius * normal_x,
        center_y + wall_side * wall_radius * normal_y,
        normal_x,
        normal_y,
    )


def _addendum_on_line(tooth: _Tooth, slot: _Slot, arc_radius: float) -> _Touch:
    center = tooth.addendum
    with np.errstate(invalid="ignore"):
        at = slot.line_normal - np.arccos((slot.line_distance - arc_radius) / center.radius)
    normal_x, normal_y = math.cos(slot.line_normal), math.sin(slot.line_normal)
    return _Touch(
        at - center.angle,
        center.radius * np.cos(at) + arc_radius * normal_x,
        center.radius * np.sin(at) + arc_radius * normal_y,
        np.full_like(at, normal_x),
        np.full_like(at, normal_y),
    )


def _line_on_addendum(tooth: _Tooth, slot: _Slot, arc_radius: float) -> _Touch:
    radius, angle = slot.dedendum
    with np.errstate(invalid="ignore"):
        at = angle - tooth.line_normal + np.arccos((tooth.line_distance + arc_radius) / radius)
    normal_x, normal_y = np.cos(at + tooth.line_normal), np.sin(at + tooth.line_normal)
    return _Touch(
        at,
        radius * math.cos(angle) - arc_radius * normal_x,
        radius * math.sin(angle) - arc_radius * normal_y,
        normal_x,
        normal_y,
    )


def _tooth_tip(geometry: Geometry, tooth: _Tooth, slot: _Slot) -> _Touch:
    """The flexspline's tip corner against the slot's wall: arc, line or hollow arc, by its radius."""
    wall = geometry.circular_spline_slot
    p = tooth.tip.radius
    inner, outer = p <= slot.dedendum_joint, p >= slot.addendum_joint
    center_radius = np.where(inner, slot.dedendum[0], slot.addendum[0])
    center_angle = np.where(inner, slot.dedendum[1], slot.addendum[1])
    arc = np.where(inner, wall.dedendum_radius, wall.addendum_radius)
    side = np.where(inner, -1.0, 1.0)
    on_arc = center_angle + side * _lens_angle(p, center_radius, arc)
    with np.errstate(invalid="ignore"):
        on_line = slot.line_normal - np.arccos(slot.line_distance / p)
    curved = inner | outer
    at = np.where(curved, on_arc, on_line)
    x, y = p * np.cos(at), p * np.sin(at)
    arc_x = side * (x - center_radius * np.cos(center_angle)) / arc
    arc_y = side * (y - center_radius * np.sin(center_angle)) / arc
    return _Touch(
        at - tooth.tip.angle,
        x,
        y,
        np.where(curved, arc_x, math.cos(slot.line_normal)),
        np.where(curved, arc_y, math.sin(slot.line_normal)),
    )


def _slot_tip(geometry: Geometry, tooth: _Tooth, slot: _Slot) -> _Touch:
    """The circular spline's tip corner against the tooth's flank; normal in the tooth frame, then turned."""
    flank = geometry.flexspline_tooth
    inner, outer = slot.tip <= tooth.dedendum_joint, slot.tip >= tooth.addendum_joint
    center = _Polar(
        np.where(inner, tooth.dedendum.radius, tooth.addendum.radius),
        np.where(inner, tooth.dedendum.angle, tooth.addendum.angle),
    )
    arc = np.where(inner, flank.dedendum_radius, flank.addendum_radius)
    side = np.where(inner, -1.0, 1.0)
    on_arc = center.angle + side * _lens_angle(center.radius, slot.tip, arc)
    with np.errstate(invalid="ignore"):
        on_line = tooth.line_normal - np.arccos(tooth.line_distance / slot.tip)
    curved = inner | outer
    turned = slot.tip_angle - np.where(curved, on_arc, on_line)
    x, y = slot.tip * math.cos(slot.tip_angle), slot.tip * math.sin(slot.tip_angle)
    arc_x = side * (x - center.radius * np.cos(center.angle + turned)) / arc
    arc_y = side * (y - center.radius * np.sin(center.angle + turned)) / arc
    return _Touch(
        turned,
        np.full_like(turned, x),
        np.full_like(turned, y),
        np.where(curved, arc_x, np.cos(tooth.line_normal + turned)),
        np.where(curved, arc_y, np.sin(tooth.line_normal + turned)),
    )
