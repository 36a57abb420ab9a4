"""First contact of flanks that are chains of any number of arcs and lines, by the closed forms of `contact`.

Radii are signed as in a `Piece`: positive where the tooth or slot bulges. With these signs the centres are
``w - a`` apart when the tooth's arc of radius a touches the wall's arc of radius w, whichever is hollow. Two
pieces can touch only if the tooth's is more curved, ``1 / a > 1 / w``; a line has curvature zero.
"""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.kernel.contact import (
    Touch,
    _arc_on_line,
    _arcs,
    _line_on_arc,
    _nearer,
    _point,
    close,
)
from hd_diag.model.kernel.formula import choose, formula, larger, smaller
from hd_diag.model.kernel.mesh_data import Arc, CommonTangent, Constants


@formula
def _tangency(row: Floats, height: float, offset: float, wall: Floats) -> Touch:
    """Contact of a piece of the tooth with a piece of the wall, both extended without end."""
    radius, own = row[0], wall[0]
    moved_x, moved_y = row[1] + height, row[2] + offset
    if radius == 0.0:
        inner_x, inner_y = row[3] + height, row[4] + offset
        line = CommonTangent(row[1], row[2], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        arc = Arc(wall[1], wall[2], math.sqrt(wall[1] * wall[1] + wall[2] * wall[2]), -own)
        return _line_on_arc(line, row[1] * inner_x + row[2] * inner_y, arc)
    if own == 0.0:
        distance = wall[1] * wall[3] + wall[2] * wall[4]
        line = CommonTangent(wall[1], wall[2], distance, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return _arc_on_line(_point(moved_x, moved_y), line, radius)
    apart, reach = own - radius, math.sqrt(wall[1] * wall[1] + wall[2] * wall[2])
    side = 1.0 if apart > 0.0 else -1.0
    return _arcs(_point(moved_x, moved_y), wall[1], wall[2], reach, side * apart, side, own)


@formula
def _may_touch(radius: float, wall: float) -> bool:
    """Whether a piece of the tooth is more curved than one of the wall; signed radii, 0 for lines."""
    curvature = 1.0 / radius if radius != 0.0 else 0.0
    return curvature > (1.0 / wall if wall != 0.0 else 0.0)


@formula
def _tip_on_wall(row: Floats, tip_x: float, tip_y: float) -> Touch:
    """The tooth's tip corner comes to lie on a piece of the wall."""
    tip, own = _point(tip_x, tip_y), row[0]
    if own == 0.0:
        distance = row[1] * row[3] + row[2] * row[4]
        return _arc_on_line(tip, CommonTangent(row[1], row[2], distance, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0)
    reach, side = math.sqrt(row[1] * row[1] + row[2] * row[2]), 1.0 if own > 0.0 else -1.0
    return _arcs(tip, row[1], row[2], reach, side * own, side, own)


@formula
def _slot_tip(c: Constants, row: Floats, height: float, offset: float) -> Touch:
    """The circular spline's tip corner comes to lie on a piece of the tooth."""
    radius, unit = row[0], 1.0 / c.wall_tip
    if radius == 0.0:
        distance = row[1] * (row[3] + height) + row[2] * (row[4] + offset)
        lever = np.sqrt(c.wall_tip * c.wall_tip - distance * distance)
        on_x, on_y = unit * (row[1] * distance + row[2] * lever), unit * (row[2] * distance - row[1] * lever)
        across, along = row[1] + 0.0 * lever, row[2] + 0.0 * lever
        by_height, by_offset = -distance * row[1], -distance * row[2]
    else:
        center = _point(row[1] + height, row[2] + offset)
        half = radius * radius - (center.radius - c.wall_tip) * (center.radius - c.wall_tip)
        half = half * center.inverse * 0.25 * unit
        lens_cos, lens_sin = 1.0 - 2.0 * half, 2.0 * np.sqrt(half * (1.0 - half))
        lens_sin = lens_sin if radius > 0.0 else -lens_sin
        on_x = center.inverse * (center.x * lens_cos - center.y * lens_sin)
        on_y = center.inverse * (center.y * lens_cos + center.x * lens_sin)
        across, along = (c.wall_tip * on_x - center.x) / radius, (c.wall_tip * on_y - center.y) / radius
        share = 0.5 + 0.5 * (c.wall_tip * c.wall_tip - center.radius * center.radius) / (radius * radius)
        by_height, by_offset = share * center.x, share * center.y
    tip_x, tip_y = unit * c.wall_tip_x, unit * c.wall_tip_y
    sine, cosine = tip_y * on_x - tip_x * on_y, tip_x * on_x + tip_y * on_y
    normal_x, normal_y = across * cosine - along * sine, across * sine + along * cosine
    moved = c.wall_tip_datum * (c.wall_tip_x * normal_y - c.wall_tip_y * normal_x)
    place_x, place_y = c.wall_tip_x + 0.0 * sine, c.wall_tip_y + 0.0 * sine
    return Touch(sine, place_x, place_y, normal_x, normal_y, by_height, by_offset, 0.0 * sine, moved)


@formula
def _corner(best: Touch, new: Touch, here: bool) -> Touch:
    """`new`, a corner's contact, if it lies on the piece and closes first; else `best`."""
    return choose(here & (new.sine < best.sine), new, best)


@formula
def _reach(wall: Floats, j: int) -> tuple[float, float]:
    """Range of distances from the axis for piece j of the wall; end pieces extend without end [m]."""
    within = math.sqrt(wall[j, 3] * wall[j, 3] + wall[j, 4] * wall[j, 4])
    beyond = math.sqrt(wall[j, 5] * wall[j, 5] + wall[j, 6] * wall[j, 6])
    return within if j > 0 else 0.0, beyond if j < wall.shape[0] - 1 else math.inf


@formula
def close_chain(c: Constants, height: float, offset: float) -> Touch:
    """First contact of flanks that are chains; nan if the tooth does not reach the slots."""
    tooth, wall = c.tooth_chain, c.wall_chain
    tip_x, tip_y = c.tip_x + height, c.tip_y + offset
    tip, low = np.sqrt(tip_x * tip_x + tip_y * tip_y), c.wall_tip
    start, nan = choose(tip > low, math.inf, math.nan), math.nan
    empty = nan + 0.0 * tip
    best = Touch(start + 0.0 * tip, empty, empty, empty, empty, empty, empty, empty, empty)
    for i in range(tooth.shape[0]):
        inner_x, inner_y = tooth[i, 3] + height, tooth[i, 4] + offset
        outer_x, outer_y = tooth[i, 5] + height, tooth[i, 6] + offset
        inner = np.sqrt(inner_x * inner_x + inner_y * inner_y) if i > 0 else 0.0 * tip
        last = i == tooth.shape[0] - 1
        outer = tip if last else np.sqrt(outer_x * outer_x + outer_y * outer_y)
        for j in range(wall.shape[0]):
            if _may_touch(tooth[i, 0], wall[j, 0]):
                within, beyond = _reach(wall, j)
                touch = _tangency(tooth[i], height, offset, wall[j])
                least = larger(low + 0.0 * tip, larger(inner, within + 0.0 * tip) - c.slack)
                most = smaller(tip, smaller(outer, beyond + 0.0 * tip) + c.slack)
                best = _nearer(best, touch, least, most)
        best = _corner(best, _slot_tip(c, tooth[i], height, offset), (low >= inner) & (low <= outer))
    for j in range(wall.shape[0]):
        within, beyond = _reach(wall, j)
        best = _corner(best, _tip_on_wall(wall[j], tip_x, tip_y), (tip >= within) & (tip <= beyond))
    return best


@formula
def first_contact(c: Constants, height: float, offset: float) -> Touch:
    """First contact of one flank, chain or double arc; nan if the tooth does not reach the slots."""
    if c.tooth_chain.shape[0]:
        return close_chain(c, height, offset)
    return close(c, height, offset)
