"""The closed forms of ``clearance`` and ``load_sharing`` as scalar code for numba.

Imported by ``compiled`` when first needed, for it imports numba. The kernels stand in one file because numba's
cache looks only at the file of the function that is called. Contact angles stay sines and cosines as long as
they can and choices are selections, so that the compiler can work on several flanks at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Complexes = npt.NDArray[np.complex128]

# Sines up to here become angles by the arcsine's series to x^15, exact to rounding [-].
_SMALL_SINE = 0.125

# A torsion is found when an iteration moves it by less than this share of itself [-], or of the least one [rad].
_ROUNDING = 1e-15
_LEAST_TORSION = 1e-3


def _jit(function: Callable[..., Any]) -> Any:
    """Compile when first called; keep the machine code on disk if any cache folder can be written."""
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # numba can write neither beside the package nor in the user's cache folder
        return numba.njit(nogil=True, error_model="numpy")(function)


def _inline(function: Callable[..., Any]) -> Any:
    """Part of a loop that the compiler may spread over several flanks: it must see it whole."""
    return numba.njit(nogil=True, error_model="numpy", forceinline=True)(function)


class Arc(NamedTuple):
    """Arc: centre, its distance from the origin, radius [m]."""

    x: float
    y: float
    distance: float
    radius: float


class Line(NamedTuple):
    """Common tangent: unit normal, distance from the origin, end points and (wall) their radii [m]."""

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
    """What the kernels need of a geometry [m, rad]; the wall is placed about the axis, the tooth is not."""

    semi_major: float
    semi_minor: float
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
    tooth_line: Line
    wall_addendum: Arc
    wall_dedendum: Arc
    wall_line: Line
    wall_tip: float
    wall_tip_x: float
    wall_tip_y: float
    wall_tip_datum: float
    flexspline_teeth: int
    circular_spline_teeth: int


class Tables(NamedTuple):
    """Arrays of a geometry: the curve's harmonics, cos and sin of whole pitches, the curve's distances."""

    harmonics: Floats
    pitches: Floats
    distances: Floats


class Point(NamedTuple):
    """Point of the tooth about the axis, tooth axis at angle zero: place, radius, 1 / radius."""

    x: float
    y: float
    radius: float
    inverse: float


class Touch(NamedTuple):
    """A possible contact, flank closed, slot frame.

    Sine of the tooth axis' angle; contact and normal; derivatives of half the squared lever arm by the tooth's
    height and offset and by the datum radius [m]; derivative of the angle by it, times the lever arm [-].
    """

    sine: float
    x: float
    y: float
    normal_x: float
    normal_y: float
    lever_height: float
    lever_offset: float
    lever_datum: float
    datum: float


@_inline
def _point(x: float, y: float) -> Point:
    radius = math.sqrt(x * x + y * y)
    return Point(x, y, radius, 1.0 / radius)


@_inline
def _lens(p: float, inverse: float, q: float, distance: float, side: float) -> tuple[float, float]:
    """Cosine and (signed) sine of the angle between points at radii p and q that are so far apart."""
    half = (distance - p + q) * (distance + p - q) * inverse * (0.25 / q)
    return 1.0 - 2.0 * half, 2.0 * side * math.sqrt(half * (1.0 - half))


@_inline
def _arcs(
    moving: Point, x: float, y: float, q: float, distance: float, side: float, reach: float
) -> Touch:
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


@_inline
def _arc_on_line(moving: Point, line: Line, radius: float) -> Touch:
    """A point of the tooth comes to lie ``radius`` before the wall's line."""
    near = line.distance - radius
    lever = math.sqrt(moving.radius * moving.radius - near * near)
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


@_inline
def _line_on_arc(line: Line, distance: float, wall: Arc) -> Touch:
    """The tooth's line, ``distance`` from the axis, touches the wall's convex arc."""
    beyond, unit = distance + wall.radius, 1.0 / (wall.distance * wall.distance)
    lever = math.sqrt(wall.distance * wall.distance - beyond * beyond)
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


@_inline
def _tooth_tip(c: Constants, tip: Point) -> Touch:
    """The flexspline's tip corner against the wall: arc, line or hollow arc, by its radius."""
    inner, outer = tip.radius <= c.wall_line.inner_radius, tip.radius >= c.wall_line.outer_radius
    x = c.wall_dedendum.x if inner else c.wall_addendum.x
    y = c.wall_dedendum.y if inner else c.wall_addendum.y
    q = c.wall_dedendum.distance if inner else c.wall_addendum.distance
    radius = c.wall_dedendum.radius if inner else c.wall_addendum.radius
    side = -1.0 if inner else 1.0
    on_arc = _arcs(tip, x, y, q, radius, side, side * radius)
    return _either(inner | outer, on_arc, _arc_on_line(tip, c.wall_line, 0.0))


@_inline
def _slot_tip(
    c: Constants, addendum: Point, dedendum: Point, distance: float, inner: bool, outer: bool
) -> Touch:
    """The circular spline's tip corner against the tooth's flank."""
    p = dedendum.radius if inner else addendum.radius
    x, y = dedendum.x if inner else addendum.x, dedendum.y if inner else addendum.y
    inverse = dedendum.inverse if inner else addendum.inverse
    radius = c.tooth_dedendum.radius if inner else c.tooth_addendum.radius
    side = -1.0 if inner else 1.0
    lens_cos, lens_sin = _lens(p, inverse, c.wall_tip, radius, side)
    unit, line = 1.0 / c.wall_tip, c.tooth_line
    curved = inner | outer
    # Place of that radius on the flank, tooth axis at angle zero: unit vector.
    lever = math.sqrt(c.wall_tip * c.wall_tip - distance * distance)
    on_line_x = unit * (line.normal_x * distance + line.normal_y * lever)
    on_line_y = unit * (line.normal_y * distance - line.normal_x * lever)
    on_x = inverse * (x * lens_cos - y * lens_sin) if curved else on_line_x
    on_y = inverse * (y * lens_cos + x * lens_sin) if curved else on_line_y
    tip_x, tip_y = unit * c.wall_tip_x, unit * c.wall_tip_y
    sine, cosine = tip_y * on_x - tip_x * on_y, tip_x * on_x + tip_y * on_y
    scale = side / radius
    arc_x = scale * (c.wall_tip * on_x - x)
    arc_y = scale * (c.wall_tip * on_y - y)
    normal_x, normal_y = arc_x if curved else line.normal_x, arc_y if curved else line.normal_y
    normal_x, normal_y = normal_x * cosine - normal_y * sine, normal_x * sine + normal_y * cosine
    share = 0.5 + 0.5 * (c.wall_tip * c.wall_tip - p * p) * (scale * scale)
    return Touch(
        sine,
        c.wall_tip_x,
        c.wall_tip_y,
        normal_x,
        normal_y,
        share * x if curved else -distance * line.normal_x,
        share * y if curved else -distance * line.normal_y,
        0.0,
        c.wall_tip_datum * (c.wall_tip_x * normal_y - c.wall_tip_y * normal_x),
    )


@_inline
def _either(which: bool, one: Touch, other: Touch) -> Touch:
    return Touch(
        one.sine if which else other.sine,
        one.x if which else other.x,
        one.y if which else other.y,
        one.normal_x if which else other.normal_x,
        one.normal_y if which else other.normal_y,
        one.lever_height if which else other.lever_height,
        one.lever_offset if which else other.lever_offset,
        one.lever_datum if which else other.lever_datum,
        one.datum if which else other.datum,
    )


@_inline
def _nearer(best: Touch, new: Touch, low: float, high: float) -> Touch:
    """The new contact if it closes first and lies between these radii [m], its normal the right way."""
    square = new.x * new.x + new.y * new.y
    valid = (square >= low * low) & (square <= high * high) & (new.x * new.normal_y > new.y * new.normal_x)
    return _either(valid & (new.sine < best.sine), new, best)


@_inline
def _close(c: Constants, height: float, offset: float) -> Touch:
    """First contact of one flank; nan if the tooth does not reach the slots."""
    line = c.tooth_line
    addendum = _point(c.tooth_addendum.x + height, c.tooth_addendum.y + offset)
    dedendum = _point(c.tooth_dedendum.x + height, c.tooth_dedendum.y + offset)
    tip = _point(c.tip_x + height, c.tip_y + offset)
    distance = line.normal_x * (line.outer_x + height) + line.normal_y * (line.outer_y + offset)
    outer = math.sqrt((line.outer_x + height) ** 2 + (line.outer_y + offset) ** 2)
    inner = math.sqrt((line.inner_x + height) ** 2 + (line.inner_y + offset) ** 2)
    wall_a, wall_d, low, high = c.wall_addendum, c.wall_dedendum, c.wall_tip, tip.radius
    wall_outer, wall_inner = c.wall_line.outer_radius, c.wall_line.inner_radius
    a, d, slack = c.tooth_addendum.radius, c.tooth_dedendum.radius, c.slack
    start = math.inf if high > low else math.nan
    best = Touch(start, start, start, start, start, start, start, start, start)
    touch = _arcs(addendum, wall_a.x, wall_a.y, wall_a.distance, wall_a.radius - a, 1.0, wall_a.radius)
    best = _nearer(best, touch, max(low, max(outer, wall_outer) - slack), high)
    touch = _arcs(addendum, wall_d.x, wall_d.y, wall_d.distance, a + wall_d.radius, -1.0, -wall_d.radius)
    best = _nearer(best, touch, max(low, outer - slack), min(high, wall_inner + slack))
    touch = _arcs(dedendum, wall_d.x, wall_d.y, wall_d.distance, d - wall_d.radius, 1.0, -wall_d.radius)
    best = _nearer(best, touch, low, min(high, min(inner, wall_inner) + slack))
    touch = _arc_on_line(addendum, c.wall_line, a)
    best = _nearer(best, touch, max(low, max(outer, wall_inner) - slack), min(high, wall_outer + slack))
    touch = _line_on_arc(line, distance, wall_d)
    best = _nearer(best, touch, max(low, inner - slack), min(high, min(outer, wall_inner) + slack))
    touch = _tooth_tip(c, tip)
    best = _either(touch.sine < best.sine, touch, best)
    touch = _slot_tip(c, addendum, dedendum, distance, low <= inner, low >= outer)
    return _either(touch.sine < best.sine, touch, best)


@_inline
def _angle(sine: float) -> float:
    if abs(sine) > _SMALL_SINE:
        return math.asin(sine)
    x = sine * sine
    low = 1 / 6 + x * (3 / 40 + x * (5 / 112 + x * 35 / 1152))
    return sine + sine * x * (low + x**4 * (63 / 2816 + x * (231 / 13312 + x * 143 / 10240)))


@_inline
def _small_arctangent(tangent: float) -> float:
    """To rounding for ellipses up to 20 % apart, whose normals are within 0.12 rad of the parameter."""
    x = tangent * tangent
    low = -1 / 3 + x * (1 / 5 + x * (-1 / 7 + x / 9))
    return tangent + tangent * x * (low + x**4 * (-1 / 11 + x * (1 / 13 - x / 15)))


@_inline
def _small_cos_sin(angle: float) -> tuple[float, float]:
    """To rounding for angles up to 0.12 rad."""
    x = angle * angle
    cosine = 1.0 - x * (1 / 2 - x * (1 / 24 - x * (1 / 720 - x * (1 / 40320 - x / 3628800))))
    return cosine, angle * (1.0 - x * (1 / 6 - x * (1 / 120 - x * (1 / 5040 - x / 362880))))


class Axis(NamedTuple):
    """Tooth axis on the neutral curve: angle less u, its cos and sin, the foot point along and across it [m]."""

    lead: float
    cosine: float
    sine: float
    height: float
    offset: float
    curvature: float


@_inline
def _axis(c: Constants, harmonics: Floats, cosine: float, sine: float) -> Axis:
    """``neutral_curve.tooth_axes`` at a place u given by its cosine and sine."""
    double, later, last = 2.0 - 4.0 * sine * sine, 0.0, 0.0
    for k in range(harmonics.size - 1, -1, -1):  # Clenshaw's recurrence
        later, last = last, harmonics[k] + double * last - later
    excess = last * 2.0 * sine * cosine
    small_cos, small_sin = _small_cos_sin(excess)
    cos_t, sin_t = cosine * small_cos - sine * small_sin, sine * small_cos + cosine * small_sin
    a, b = c.semi_major, c.semi_minor
    x, y = b * cos_t, a * sin_t
    inverse = 1.0 / math.sqrt(x * x + y * y)
    slope = (a - b) * sin_t * cos_t / (b * cos_t * cos_t + a * sin_t * sin_t)
    offset = (b * b - a * a) * sin_t * cos_t * inverse
    curvature = a * b * inverse * inverse * inverse
    return Axis(excess + _small_arctangent(slope), x * inverse, y * inverse, a * b * inverse, offset, curvature)


@_jit
def reach(c: Constants, distances: Floats, eccentricity: float) -> float:
    """Greatest angle from a lobe at which a tooth can reach the slots [rad], as ``clearance`` has it."""
    k = 0
    while k < distances.shape[1] - 1 and not distances[1, k] + eccentricity < c.wall_tip:
        k += 1
    return distances[0, k]


@_jit
def width(c: Constants, reach: float) -> int:
    """Number of teeth at each lobe."""
    return min(int(2.0 * reach / c.tooth_pitch) + 1, c.flexspline_teeth // 2)


# Rows of the work array: one column per tooth near the lobes.
_HEIGHT, _OFFSET, _LEAD, _COS, _SIN, _CURVATURE, _SLOT, _TOOTH, _SINE, _LEVER = range(10)


@_jit
def _teeth(
    c: Constants, tables: Tables, turn: float, center: complex, arc_offset: float, reach: float, work: Floats
) -> int:
    """Poses of the teeth near both lobes, the wave generator's centre in its own frame; gives their number."""
    start = -turn * c.turn_ratio + arc_offset / c.curve_radius
    columns = width(c, reach)
    for lobe in range(2):
        first = math.ceil((lobe * math.pi - reach - start) / c.tooth_pitch)
        base_cos, base_sin = math.cos(start + first * c.tooth_pitch), math.sin(start + first * c.tooth_pitch)
        for j in range(columns):
            step_cos, step_sin = tables.pitches[0, j], tables.pitches[1, j]
            cosine, sine = base_cos * step_cos - base_sin * step_sin, base_sin * step_cos + base_cos * step_sin
            axis = _axis(c, tables.harmonics, cosine, sine)
            height = axis.height + center.real * axis.cosine + center.imag * axis.sine
            offset = axis.offset + center.imag * axis.cosine - center.real * axis.sine
            angle = start + (first + j) * c.tooth_pitch + axis.lead + turn
            slot = np.rint((angle + _small_arctangent(offset / (height + c.pitch_height))) / c.slot_pitch)
            column = lobe * columns + j
            work[_HEIGHT, column], work[_OFFSET, column] = height, offset
            work[_COS, column], work[_SIN, column] = axis.cosine, axis.sine
            work[_CURVATURE, column], work[_LEAD, column] = axis.curvature, angle - slot * c.slot_pitch
            work[_SLOT, column], work[_TOOTH, column] = slot, first + j
    return 2 * columns


@_jit
def _levers(
    c: Constants, height: Floats, offset: Floats, count: int, side: float, sine: Floats, lever: Floats
) -> None:
    """Sine of the closing angle and lever arm of every flank of one side [m]; nothing here may branch."""
    for j in range(count):
        touch = _close(c, height[j], side * offset[j])
        sine[j] = touch.sine
        lever[j] = touch.x * touch.normal_y - touch.y * touch.normal_x


@_jit
def _breakpoints(
    c: Constants, work: Floats, count: int, side: float, compliance: float, start: Floats, gain: Floats, column: Integers
) -> int:
    """Torsion at which each flank of one side begins to bear, its stiffness and its column; gives their number."""
    _levers(c, work[_HEIGHT], work[_OFFSET], count, side, work[_SINE], work[_LEVER])
    found = 0
    for j in range(count):
        lever = work[_LEVER, j]
        if not math.isnan(lever):
            start[found] = side * _angle(work[_SINE, j]) - work[_LEAD, j]
            gain[found] = lever * lever / compliance
            column[found] = j
            found += 1
    return found


class Flanks(NamedTuple):
    """Breakpoints [rad], stiffnesses [N m/rad] and columns of the flanks of both sides, and the gap [rad]."""

    plus: Floats
    plus_gain: Floats
    plus_column: Integers
    minus: Floats
    minus_gain: Floats
    minus_column: Integers
    low: float
    high: float


@_jit
def _flanks(
    c: Constants,
    tables: Tables,
    turn: float,
    eccentricity: complex,
    arc_offset: float,
    compliance: float,
    work: Floats,
    lists: Floats,
    columns: Integers,
) -> Flanks:
    plus = minus = 0
    if math.isfinite(turn) and math.isfinite(eccentricity.real) and math.isfinite(eccentricity.imag):
        far = reach(c, tables.distances, math.hypot(eccentricity.real, eccentricity.imag))
        center = eccentricity * complex(math.cos(turn), -math.sin(turn))
        count = _teeth(c, tables, turn, center, arc_offset, far, work)
        plus = _breakpoints(c, work, count, 1.0, compliance, lists[0], lists[1], columns[0])
        minus = _breakpoints(c, work, count, -1.0, compliance, lists[2], lists[3], columns[1])
    low, high = -math.inf, math.inf
    for j in range(plus):
        high = min(high, lists[0, j])
    for j in range(minus):
        low = max(low, lists[2, j])
    return Flanks(
        lists[0, :plus], lists[1, :plus], columns[0, :plus],
        lists[2, :minus], lists[3, :minus], columns[1, :minus], low, high,
    )


@_jit
def _bearing(flanks: Flanks, beta: float) -> tuple[float, float]:
    """Stiffness of the flanks in contact at a torsion [N m/rad], and the sum of stiffness times breakpoint [N m]."""
    stiffness = moment = 0.0
    for j in range(flanks.plus.size):
        gain = flanks.plus_gain[j] if flanks.plus[j] <= beta else 0.0
        stiffness += gain
        moment += gain * flanks.plus[j]
    for j in range(flanks.minus.size):
        gain = flanks.minus_gain[j] if flanks.minus[j] >= beta else 0.0
        stiffness += gain
        moment += gain * flanks.minus[j]
    return stiffness, moment


@_jit
def _first_guess(flanks: Flanks, torque: float) -> float:
    """Within the preload, or (true gap) as if every flank of the loaded side bore: beyond the solution."""
    if flanks.low >= flanks.high:
        return 0.5 * (flanks.low + flanks.high)
    edge = math.inf if torque > 0.0 else -math.inf
    stiffness, moment = _bearing(flanks, edge)
    return (torque + moment) / stiffness if stiffness > 0.0 else math.nan


@_jit
def _balance(flanks: Flanks, torque: float) -> float:
    """Torsion at one torque: Newton's iteration from piece to piece, kept within a bracket; exact when it rests."""
    if torque == 0.0 and flanks.high > flanks.low:
        return 0.5 * (flanks.low + flanks.high)
    beta = _first_guess(flanks, torque)
    low, high = -math.inf, math.inf
    while math.isfinite(beta):
        stiffness, moment = _bearing(flanks, beta)
        new = (torque + moment) / stiffness
        low, high = (low, beta) if new < beta else (beta, high)
        resting = _ROUNDING * (abs(beta) + _LEAST_TORSION)
        if abs(new - beta) <= resting or high - low <= resting:
            return new
        beta = new if low < new < high else 0.5 * (low + high)
    return beta


@_jit
def torsion(
    c: Constants,
    tables: Tables,
    compliance: float,
    arc_offset: float,
    turn: Floats,
    eccentricity: Complexes,
    torque: Floats,
    beta: Floats,
) -> None:
    """Fill beta (n,) with the torsion at one torque per moment."""
    work, lists, columns = _scratch(c)
    for i in range(turn.size):
        flanks = _flanks(c, tables, turn[i], eccentricity[i], arc_offset, compliance, work, lists, columns)
        beta[i] = _balance(flanks, torque[i])


@_jit
def _scratch(c: Constants) -> tuple[Floats, Floats, Integers]:
    teeth = c.flexspline_teeth
    return np.empty((10, teeth)), np.empty((4, teeth)), np.empty((2, teeth), dtype=np.int64)


@_jit
def _walk(
    start: Floats, gain: Floats, stiffness: float, moment: float, torque: Floats, beta: Floats
) -> None:
    """Torsions at rising torques, from the state before the first of the rising breakpoints."""
    passed = 0
    for j in range(torque.size):
        while passed < start.size and stiffness * start[passed] - moment < torque[j]:
            stiffness += gain[passed]
            moment += gain[passed] * start[passed]
            passed += 1
        beta[j] = (torque[j] + moment) / stiffness


@_jit
def _part(flanks: Flanks, torque: Floats, beta: Floats) -> None:
    """Torsions at rising torques that do not cross a true gap: only breakpoints between the ends are sorted."""
    if torque.size == 0:
        return
    lowest, highest = _balance(flanks, torque[0]), _balance(flanks, torque[-1])
    stiffness, moment = _bearing(flanks, lowest)
    start, gain = np.empty(flanks.plus.size + flanks.minus.size), np.empty(flanks.plus.size + flanks.minus.size)
    found = 0
    for j in range(flanks.plus.size):
        if lowest < flanks.plus[j] < highest:
            start[found], gain[found] = flanks.plus[j], flanks.plus_gain[j]
            found += 1
    for j in range(flanks.minus.size):
        if lowest <= flanks.minus[j] < highest:
            start[found], gain[found] = flanks.minus[j], -flanks.minus_gain[j]
            found += 1
    order = np.argsort(start[:found])
    _walk(start[order], gain[order], stiffness, moment, torque, beta)


@_jit
def torsion_table(
    c: Constants,
    tables: Tables,
    compliance: float,
    arc_offset: float,
    turn: Floats,
    eccentricity: Complexes,
    torque: Floats,
    branch: int,
    beta: Floats,
) -> None:
    """Fill beta (n, q) with the torsions at rising torques (q,), the same at every moment."""
    work, lists, columns = _scratch(c)
    before, after = np.searchsorted(torque, 0.0), np.searchsorted(torque, 0.0, side="right")
    for i in range(turn.size):
        flanks = _flanks(c, tables, turn[i], eccentricity[i], arc_offset, compliance, work, lists, columns)
        first, last = (before, after) if flanks.high > flanks.low else (0, 0)
        _part(flanks, torque[:first], beta[i, :first])
        middle = 0.5 * (flanks.low + flanks.high)
        beta[i, first:last] = flanks.high if branch > 0 else (flanks.low if branch < 0 else middle)
        _part(flanks, torque[last:], beta[i, last:])


@_jit
def contacts(
    c: Constants,
    tables: Tables,
    arc_offset: float,
    turn: Floats,
    eccentricity: Complexes,
    reach: float,
    indices: Integers,
    values: Floats,
) -> None:
    """Fill indices (2, n, width): teeth, slots; values (4, n, 2, width): b, r, alpha, position."""
    work = _scratch(c)[0]
    for i in range(turn.size):
        center = eccentricity[i] * complex(math.cos(turn[i]), -math.sin(turn[i]))
        for j in range(_teeth(c, tables, turn[i], center, arc_offset, reach, work)):
            indices[0, i, j] = int(work[_TOOTH, j]) % c.flexspline_teeth
            indices[1, i, j] = int(work[_SLOT, j]) % c.circular_spline_teeth
            for flank in range(2):
                side = 1.0 - 2.0 * flank
                touch = _close(c, work[_HEIGHT, j], side * work[_OFFSET, j])
                x, y, normal_x, normal_y = touch.x, touch.y, touch.normal_x, touch.normal_y
                values[0, i, flank, j] = math.asin(touch.sine) - side * work[_LEAD, j]
                values[1, i, flank, j] = math.sqrt(x * x + y * y)
                values[2, i, flank, j] = math.atan2(x * normal_x + y * normal_y, x * normal_y - y * normal_x)
                values[3, i, flank, j] = work[_SLOT, j] * c.slot_pitch + side * math.atan2(y, x)


class Slopes(NamedTuple):
    """Derivatives of beta by the tooth's pose, less the common stiffness: height, offset, lead; and the datum."""

    height: float
    offset: float
    lead: float
    datum: float


@_jit
def _slopes(
    c: Constants, height: float, offset: float, side: float, weight: float, release: float
) -> Slopes:
    """Share of one flank: ``weight`` times db/dp, less ``release`` times the change of half its lever squared."""
    touch = _close(c, height, side * offset)
    lever = touch.x * touch.normal_y - touch.y * touch.normal_x
    sine, cosine = touch.sine, math.sqrt(1.0 - touch.sine * touch.sine)
    # b falls as the tooth moves along the normal: envelope theorem, the contact's place does not count.
    along = -(touch.normal_x * cosine + touch.normal_y * sine) / lever
    across = -(touch.normal_y * cosine - touch.normal_x * sine) / lever
    return Slopes(
        side * (weight * along - release * touch.lever_height),
        weight * across - release * touch.lever_offset,
        -weight,
        side * (weight * touch.datum / lever - release * touch.lever_datum),
    )


@_jit
def _side_gradient(
    c: Constants,
    work: Floats,
    start: Floats,
    gain: Floats,
    column: Integers,
    beta: float,
    side: float,
    compliance: float,
    in_gap: bool,
    center: complex,
    gradient: Floats,
) -> float:
    """Add the flanks that bear (or, in a gap, the edge) to the gradient, not yet divided by the stiffness, given back."""
    stiffness = 0.0
    for j in range(start.size):
        overlap = side * (beta - start[j])
        if overlap > 0.0 or (in_gap and start[j] == beta):
            i = column[j]
            weight = 0.5 if in_gap else gain[j]
            release = 0.0 if in_gap else 2.0 * overlap / compliance
            height, offset, curvature = work[_HEIGHT, i], work[_OFFSET, i], work[_CURVATURE, i]
            slopes = _slopes(c, height, offset, side, weight, release)
            along_x = slopes.height * work[_COS, i] - slopes.offset * work[_SIN, i]
            along_y = slopes.height * work[_SIN, i] + slopes.offset * work[_COS, i]
            shift = curvature * (slopes.height * offset - slopes.offset * height + slopes.lead) + slopes.offset
            gradient[0] += along_x
            gradient[1] += along_y
            gradient[2] += slopes.datum
            gradient[4] += shift
            # The wave generator turns about its own centre, and the teeth slide back along its curve.
            slide = c.turn_ratio * c.curve_radius * shift
            gradient[6] += slopes.lead + along_x * center.imag - along_y * center.real - slide
            stiffness += gain[j]
    return stiffness


@_jit
def _gradient(
    c: Constants, work: Floats, flanks: Flanks, turn: float, eccentricity: complex, compliance: float, torque: float,
    beta: float, gradient: Floats,
) -> float:
    """Fill the gradient of one moment and give the stiffness [N m/rad]."""
    gradient[:] = 0.0
    turned = complex(math.cos(turn), math.sin(turn))
    center = eccentricity * turned.conjugate()
    in_gap = torque == 0.0 and flanks.high > flanks.low
    plus, minus = (flanks.high, flanks.low) if in_gap else (beta, beta)
    stiffness = _side_gradient(
        c, work, flanks.plus, flanks.plus_gain, flanks.plus_column, plus, 1.0, compliance, in_gap, center, gradient
    )
    stiffness += _side_gradient(
        c, work, flanks.minus, flanks.minus_gain, flanks.minus_column, minus, -1.0, compliance, in_gap, center, gradient
    )
    if in_gap:
        stiffness = 0.0
    else:
        gradient /= stiffness
    housing = complex(gradient[0], gradient[1]) * turned
    gradient[0], gradient[1] = housing.real, housing.imag
    gradient[5] = 1.0 / stiffness
    gradient[3] = 0.0 if in_gap else torque / compliance / stiffness
    return stiffness


@_jit
def torsion_and_gradient(
    c: Constants,
    tables: Tables,
    compliance: float,
    arc_offset: float,
    turn: Floats,
    eccentricity: Complexes,
    torque: Floats,
    beta: Floats,
    stiffness: Floats,
    gradient: Floats,
) -> None:
    """Fill beta (n,), stiffness (n,) and gradient (n, 7)."""
    work, lists, columns = _scratch(c)
    for i in range(turn.size):
        flanks = _flanks(c, tables, turn[i], eccentricity[i], arc_offset, compliance, work, lists, columns)
        beta[i] = _balance(flanks, torque[i])
        stiffness[i] = _gradient(
            c, work, flanks, turn[i], eccentricity[i], compliance, torque[i], beta[i], gradient[i]
        )
