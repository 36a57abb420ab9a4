"""First contact of a flank with the slot's wall, in closed form.

The flexspline's flank is an arc, a line, an arc and a tip corner; so is the slot's wall. Turning one
primitive about the circular spline's axis until it touches another has a closed form for every pair:

- Two arcs touch when their centres are d apart: the difference of the radii for hollow on convex, their sum
  for convex on convex. With the centres p and q from the axis, the angle between them is then ``2 arcsin
  sqrt((d - p + q) (d + p - q) / (4 p q))``.
- An arc of radius a touches the line ``n . x = c`` when its centre, at distance p from the axis, is
  ``arccos((c - a) / p)`` behind the normal's direction.
- A tip corner is an arc of radius zero.

The gap is the wall angle less the flank angle, as a function of the radius. Each tangency is a stationary
point of the gap and each corner an end of its range, so the least of them is the rotation that closes the
flank. Angles stay sines and cosines, and selections replace branches, so that the compiler can process
several flanks at once. A - flank is the + flank of the mirrored tooth.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hd_diag.model.kernel.formula import choose, formula, larger, smaller
from hd_diag.model.kernel.mesh_data import Arc, CommonTangent, Constants


class Point(NamedTuple):
    """Point of the tooth from the axis, with the tooth axis at angle zero: place, radius, 1 / radius."""

    x: float
    y: float
    radius: float
    inverse: float


class Touch(NamedTuple):
    """A possible contact with the flank closed, in the slot frame; arrays stand for several flanks at once.

    Sine of the tooth axis' angle; contact point; normal; derivatives of half the squared lever arm by the
    tooth's height, by its offset and by the datum radius [m]; derivative of the angle by the datum radius,
    times the lever arm [-].
    """

    sine: Any
    x: Any
    y: Any
    normal_x: Any
    normal_y: Any
    lever_height: Any
    lever_offset: Any
    lever_datum: Any
    datum: Any


@formula
def _point(x: float, y: float) -> Point:
    radius = np.sqrt(x * x + y * y)
    return Point(x, y, radius, 1.0 / radius)


@formula
def _lens(p: float, inverse: float, q: float, distance: float, side: float) -> tuple[float, float]:
    """Cosine and (signed) sine of the angle between points at radii p and q that are `distance` apart."""
    half = (distance - p + q) * (distance + p - q) * inverse * (0.25 / q)
    return 1.0 - 2.0 * half, 2.0 * side * np.sqrt(half * (1.0 - half))


@formula
def _arcs(moving: Point, x: float, y: float, q: float, distance: float, side: float, reach: float) -> Touch:
    """A point of the tooth comes to lie ``distance`` from the wall's centre (x, y) at radius q."""
    cosine, sine = _lens(moving.radius, moving.inverse, q, distance, side)
    unit, scale = 1.0 / q, side / distance
    at_x, at_y = unit * x * cosine - unit * y * sine, unit * y * cosine + unit * x * sine
    normal_x, normal_y = scale * (moving.radius * at_x - x), scale * (moving.radius * at_y - y)
    share = 0.5 * (q * q - moving.radius * moving.radius) * (scale * scale)
    return Touch(
        (at_y * moving.x - at_x * moving.y) * moving.inverse,
        x + reach * normal_x,
        y + reach * normal_y,
        normal_x,
        normal_y,
        (0.5 + share) * moving.x,
        (0.5 + share) * moving.y,
        (0.5 - share) * x,
        normal_x,
    )


@formula
def _arc_on_line(moving: Point, line: CommonTangent, radius: float) -> Touch:
    """A point of the tooth comes to lie ``radius`` before the wall's line."""
    near = line.distance - radius
    lever = np.sqrt(moving.radius * moving.radius - near * near)
    x, y = line.normal_x * near + line.normal_y * lever, line.normal_y * near - line.normal_x * lever
    return Touch(
        (y * moving.x - x * moving.y) * (moving.inverse * moving.inverse),
        x + radius * line.normal_x,
        y + radius * line.normal_y,
        line.normal_x,
        line.normal_y,
        moving.x,
        moving.y,
        -near * line.normal_x,
        line.normal_x,
    )


@formula
def _line_on_arc(line: CommonTangent, distance: float, wall: Arc) -> Touch:
    """The tooth's line, ``distance`` from the axis, touches the wall's convex arc."""
    beyond, unit = distance + wall.radius, 1.0 / (wall.distance * wall.distance)
    lever = np.sqrt(wall.distance * wall.distance - beyond * beyond)
    normal_x = unit * (beyond * wall.x - lever * wall.y)
    normal_y = unit * (beyond * wall.y + lever * wall.x)
    return Touch(
        normal_y * line.normal_x - normal_x * line.normal_y,
        wall.x - wall.radius * normal_x,
        wall.y - wall.radius * normal_y,
        normal_x,
        normal_y,
        -beyond * line.normal_x,
        -beyond * line.normal_y,
        wall.x,
        normal_x,
    )


@formula
def _tooth_tip(c: Constants, tip: Point) -> Touch:
    """The flexspline's tip corner against the wall: arc, line or hollow arc, by its radius."""
    inner, outer = tip.radius <= c.wall_line.inner_radius, tip.radius >= c.wall_line.outer_radius
    x, y, q, radius = choose(inner, c.wall_dedendum, c.wall_addendum)
    side = choose(inner, -1.0, 1.0)
    on_arc, on_line = _arcs(tip, x, y, q, radius, side, side * radius), _arc_on_line(tip, c.wall_line, 0.0)
    return choose(inner | outer, on_arc, on_line)


@formula
def _slot_tip(
    c: Constants, addendum: Point, dedendum: Point, distance: float, inner: bool, outer: bool
) -> Touch:
    """The circular spline's tip corner against the tooth's flank."""
    x, y, p, inverse = choose(inner, dedendum, addendum)
    radius = choose(inner, c.tooth_dedendum.radius, c.tooth_addendum.radius)
    side = choose(inner, -1.0, 1.0)
    lens_cos, lens_sin = _lens(p, inverse, c.wall_tip, radius, side)
    unit, line = 1.0 / c.wall_tip, c.tooth_line
    curved = inner | outer
    # Unit vector to the flank's point at the wall tip's radius, tooth axis at angle zero.
    lever = np.sqrt(c.wall_tip * c.wall_tip - distance * distance)
    on_line_x = unit * (line.normal_x * distance + line.normal_y * lever)
    on_line_y = unit * (line.normal_y * distance - line.normal_x * lever)
    on_x = choose(curved, inverse * (x * lens_cos - y * lens_sin), on_line_x)
    on_y = choose(curved, inverse * (y * lens_cos + x * lens_sin), on_line_y)
    tip_x, tip_y = unit * c.wall_tip_x, unit * c.wall_tip_y
    sine, cosine = tip_y * on_x - tip_x * on_y, tip_x * on_x + tip_y * on_y
    scale = side / radius
    arc_x = scale * (c.wall_tip * on_x - x)
    arc_y = scale * (c.wall_tip * on_y - y)
    normal_x, normal_y = choose(curved, arc_x, line.normal_x), choose(curved, arc_y, line.normal_y)
    normal_x, normal_y = normal_x * cosine - normal_y * sine, normal_x * sine + normal_y * cosine
    share = 0.5 + 0.5 * (c.wall_tip * c.wall_tip - p * p) * (scale * scale)
    return Touch(
        sine,
        c.wall_tip_x,
        c.wall_tip_y,
        normal_x,
        normal_y,
        choose(curved, share * x, -distance * line.normal_x),
        choose(curved, share * y, -distance * line.normal_y),
        0.0,
        c.wall_tip_datum * (c.wall_tip_x * normal_y - c.wall_tip_y * normal_x),
    )


@formula
def _nearer(best: Touch, new: Touch, low: float, high: float) -> Touch:
    """`new` if it closes first, lies between the radii [m] and has the right normal; else `best`."""
    square = new.x * new.x + new.y * new.y
    valid = (square >= low * low) & (square <= high * high) & (new.x * new.normal_y > new.y * new.normal_x)
    return choose(valid & (new.sine < best.sine), new, best)


@formula
def close(c: Constants, height: float, offset: float) -> Touch:
    """First contact of one flank; nan if the tooth does not reach the slots."""
    line = c.tooth_line
    addendum = _point(c.tooth_addendum.x + height, c.tooth_addendum.y + offset)
    dedendum = _point(c.tooth_dedendum.x + height, c.tooth_dedendum.y + offset)
    tip = _point(c.tip_x + height, c.tip_y + offset)
    distance = line.normal_x * (line.outer_x + height) + line.normal_y * (line.outer_y + offset)
    outer = np.sqrt((line.outer_x + height) ** 2 + (line.outer_y + offset) ** 2)
    inner = np.sqrt((line.inner_x + height) ** 2 + (line.inner_y + offset) ** 2)
    wall_a, wall_d, low, high = c.wall_addendum, c.wall_dedendum, c.wall_tip, tip.radius
    wall_outer, wall_inner = c.wall_line.outer_radius, c.wall_line.inner_radius
    a, d, slack = c.tooth_addendum.radius, c.tooth_dedendum.radius, c.slack
    start = choose(high > low, math.inf, math.nan)
    nan = math.nan
    best = Touch(start, nan, nan, nan, nan, nan, nan, nan, nan)
    touch = _arcs(addendum, wall_a.x, wall_a.y, wall_a.distance, wall_a.radius - a, 1.0, wall_a.radius)
    best = _nearer(best, touch, larger(low, larger(outer, wall_outer) - slack), high)
    touch = _arcs(addendum, wall_d.x, wall_d.y, wall_d.distance, a + wall_d.radius, -1.0, -wall_d.radius)
    best = _nearer(best, touch, larger(low, outer - slack), smaller(high, wall_inner + slack))
    touch = _arcs(dedendum, wall_d.x, wall_d.y, wall_d.distance, d - wall_d.radius, 1.0, -wall_d.radius)
    best = _nearer(best, touch, low, smaller(high, smaller(inner, wall_inner) + slack))
    touch = _arc_on_line(addendum, c.wall_line, a)
    best = _nearer(
        best, touch, larger(low, larger(outer, wall_inner) - slack), smaller(high, wall_outer + slack)
    )
    touch = _line_on_arc(line, distance, wall_d)
    best = _nearer(best, touch, larger(low, inner - slack), smaller(high, smaller(outer, wall_inner) + slack))
    touch = _tooth_tip(c, tip)
    best = choose(touch.sine < best.sine, touch, best)
    touch = _slot_tip(c, addendum, dedendum, distance, low <= inner, low >= outer)
    return choose(touch.sine < best.sine, touch, best)
