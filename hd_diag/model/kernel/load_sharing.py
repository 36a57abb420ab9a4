"""One torsion for all teeth, solved exactly.

A torsion beta needs the torque ``sum k+ (beta - b+)_+ - sum k- (-beta - b-)_+``, where each flank has ``k =
(r cos alpha)^2 / (K1 + K2)`` times its section's share of the width. This is Dong et al. (2019), eq. (8), in
the form that agrees with "loaded where the torsion exceeds the backlash". The torque rises with the torsion
and is linear between the torsions at which flanks begin to bear. Its inverse is therefore exact, piece by
piece, for one torque or for many in one walk.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model.kernel.chain import close_chain
from hd_diag.model.kernel.compiler import inline, part
from hd_diag.model.kernel.contact import Touch, close
from hd_diag.model.kernel.mesh_data import Constants, MeshData
from hd_diag.model.kernel.poses import Teeth, place, room

# The iteration ends at a step below this share [-] of |beta| plus a small torsion [rad].
_ROUNDING = 1e-15
_SMALL_TORSION = 1e-3

# Sines up to here become angles by the arcsine's series to x^15, exact to rounding [-].
_SMALL_SINE = 0.125


class Side(NamedTuple):
    """Flanks of one side that can bear: torsion where each begins [rad], stiffness [N m/rad], column."""

    start: Floats
    gain: Floats
    column: Integers


class Flanks(NamedTuple):
    """Both sides, and the torsions where the first flank of each loses contact [rad]."""

    plus: Side
    minus: Side
    low: float
    high: float


class Scratch(NamedTuple):
    """Working space for one moment, reused at the next."""

    teeth: Teeth
    contacts: Touch
    plus: Side
    minus: Side


@part
def most_columns(mesh: MeshData) -> int:
    """Greatest number of columns: all teeth in every section."""
    return mesh.constants.flexspline_teeth * mesh.tables.section_place.size


@part
def scratch(mesh: MeshData) -> Scratch:
    """Room for all columns."""
    n = most_columns(mesh)
    return Scratch(room(n), contacts_room(n), side_room(n), side_room(n))


@part
def side_room(count: int) -> Side:
    """Room for so many flanks of one side."""
    return Side(np.empty(count), np.empty(count), np.empty(count, dtype=np.int64))


@part
def contacts_room(columns: int) -> Touch:
    """Room for the first contacts of both flanks of all columns, each (2, columns)."""
    shape = (2, columns)
    return Touch(
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
    )


@part
def find(c: Constants, teeth: Teeth, count: int, found: Touch) -> None:
    """Set the contacts of the first `count` teeth; the compiler processes several double arcs at once."""
    height, offset = teeth.height, teeth.offset
    for flank in range(2):
        row = Touch(
            found.sine[flank],
            found.x[flank],
            found.y[flank],
            found.normal_x[flank],
            found.normal_y[flank],
            found.lever_height[flank],
            found.lever_offset[flank],
            found.lever_datum[flank],
            found.datum[flank],
        )
        side = 1.0 - 2.0 * flank
        if c.tooth_chain.shape[0]:
            for j in range(count):
                _keep(row, j, close_chain(c, height[j], side * offset[j]))
        else:
            for j in range(count):
                _keep(row, j, close(c, height[j], side * offset[j]))


@inline
def _keep(row: Touch, j: int, touch: Touch) -> None:
    row.sine[j], row.x[j], row.y[j] = touch.sine, touch.x, touch.y
    row.normal_x[j], row.normal_y[j] = touch.normal_x, touch.normal_y
    row.lever_height[j], row.lever_offset[j] = touch.lever_height, touch.lever_offset
    row.lever_datum[j], row.datum[j] = touch.lever_datum, touch.datum


@inline
def arms(found: Touch, flank: int, j: int) -> tuple[float, float, float]:
    """Distance of a contact from the axis, and its components along the normal and across it (lever) [m]."""
    x, y = found.x[flank, j], found.y[flank, j]
    normal_x, normal_y = found.normal_x[flank, j], found.normal_y[flank, j]
    return math.sqrt(x * x + y * y), x * normal_x + y * normal_y, x * normal_y - y * normal_x


@inline
def closing_angle(sine: float) -> float:
    """Arcsine, mostly by its series [rad]."""
    if abs(sine) > _SMALL_SINE:
        return math.asin(sine)
    x = sine * sine
    low = 1 / 6 + x * (3 / 40 + x * (5 / 112 + x * 35 / 1152))
    return sine + sine * x * (low + x * x * x * x * (63 / 2816 + x * (231 / 13312 + x * 143 / 10240)))


@part
def flanks(mesh: MeshData, turn: float, eccentricity: complex, work: Scratch) -> Flanks:
    """Solve the contacts of one moment and keep them in the scratch; none if an input is not finite."""
    count = 0
    if math.isfinite(turn) and math.isfinite(eccentricity.real) and math.isfinite(eccentricity.imag):
        count = place(mesh, turn, eccentricity, work.teeth)
    find(mesh.constants, work.teeth, count, work.contacts)
    plus = _side(mesh, work, count, 0, work.plus)
    return both(plus, _side(mesh, work, count, 1, work.minus))


@part
def _side(mesh: MeshData, work: Scratch, count: int, flank: int, room: Side) -> Side:
    seen, side, found = work.contacts, 1.0 - 2.0 * flank, 0
    for j in range(count):
        _, _, lever = arms(seen, flank, j)
        if not math.isnan(lever):
            room.start[found] = side * closing_angle(seen.sine[flank, j]) - work.teeth.lead[j]
            room.gain[found] = lever * lever * work.teeth.weight[j] / mesh.compliance
            room.column[found] = j
            found += 1
    return Side(room.start[:found], room.gain[:found], room.column[:found])


@part
def given_side(rotation: Floats, stiffness: Floats, side: float, room: Side) -> Side:
    """Flanks with given closing rotations [rad], not finite if they cannot touch, and stiffness [N m/rad]."""
    found = 0
    for j in range(rotation.size):
        if math.isfinite(rotation[j]):
            room.start[found], room.gain[found], room.column[found] = side * rotation[j], stiffness[j], j
            found += 1
    return Side(room.start[:found], room.gain[:found], room.column[:found])


@part
def both(plus: Side, minus: Side) -> Flanks:
    """Both sides together."""
    low, high = -math.inf, math.inf
    for start in minus.start:
        low = max(low, start)
    for start in plus.start:
        high = min(high, start)
    return Flanks(plus, minus, low, high)


@part
def bearing(flanks: Flanks, beta: float) -> tuple[float, float]:
    """Stiffness of the flanks in contact at a torsion [N m/rad]; the sum of stiffness times start [N m]."""
    stiffness = moment = 0.0
    for j in range(flanks.plus.start.size):
        gain = flanks.plus.gain[j] if flanks.plus.start[j] <= beta else 0.0
        stiffness += gain
        moment += gain * flanks.plus.start[j]
    for j in range(flanks.minus.start.size):
        gain = flanks.minus.gain[j] if flanks.minus.start[j] >= beta else 0.0
        stiffness += gain
        moment += gain * flanks.minus.start[j]
    return stiffness, moment


@part
def middle(flanks: Flanks) -> float:
    """Torsion at zero torque in a true gap; nan where one side has no flank to end it."""
    return 0.5 * (flanks.low + flanks.high) if math.isfinite(flanks.high - flanks.low) else math.nan


@part
def balance(flanks: Flanks, torque: float) -> float:
    """Torsion at one torque by bracketed Newton iteration over the pieces; exact where it converges."""
    if torque == 0.0 and flanks.high > flanks.low:
        return middle(flanks)
    least, most = -math.inf, math.inf
    if flanks.high > flanks.low:  # rounding must not leave a small torque in the gap, where no flank holds it
        least, most = (flanks.high, math.inf) if torque > 0.0 else (-math.inf, flanks.low)
    beta = _first_guess(flanks, torque) if not math.isnan(torque) else math.nan
    low, high = -math.inf, math.inf
    while math.isfinite(beta):
        beta = min(max(beta, least), most)
        stiffness, moment = bearing(flanks, beta)
        new = min(max((torque + moment) / stiffness, least), most)
        low, high = (low, beta) if new < beta else (beta, high)
        resting = _ROUNDING * (abs(beta) + _SMALL_TORSION)
        if abs(new - beta) <= resting or high - low <= resting:
            return new
        beta = new if low < new < high else 0.5 * (low + high)
    return beta


@part
def _first_guess(flanks: Flanks, torque: float) -> float:
    """Start of the iteration: middle of the preload, or (true gap) as if all flanks of the loaded side bore.

    In a true gap it is beyond the solution.
    """
    if flanks.low >= flanks.high:
        return 0.5 * (flanks.low + flanks.high)
    stiffness, moment = bearing(flanks, math.inf if torque > 0.0 else -math.inf)
    return (torque + moment) / stiffness if stiffness > 0.0 else math.nan


@part
def balance_all(flanks: Flanks, torque: Floats, beta: Floats) -> None:
    """Torsions at rising torques."""
    first = last = 0
    if flanks.high > flanks.low:
        first, last = int(np.searchsorted(torque, 0.0)), int(np.searchsorted(torque, 0.0, side="right"))
        beta[first:last] = middle(flanks)
    _walk(flanks, torque[:first], beta[:first])
    _walk(flanks, torque[last:], beta[last:])


@part
def _walk(flanks: Flanks, torque: Floats, beta: Floats) -> None:
    """Torsions at rising torques that do not cross a true gap; only breakpoints in between are sorted."""
    if torque.size == 0:
        return
    lowest, highest = balance(flanks, torque[0]), balance(flanks, torque[-1])
    if math.isnan(lowest):  # no flank can bear any of them
        beta[:] = math.nan
        return
    stiffness, moment = bearing(flanks, lowest)
    start, gain = _between(flanks, lowest, highest)
    passed = 0
    for j in range(torque.size):
        while passed < start.size and stiffness * start[passed] - moment < torque[j]:
            stiffness += gain[passed]
            moment += gain[passed] * start[passed]
            passed += 1
        beta[j] = (torque[j] + moment) / stiffness


@part
def curve(flanks: Flanks, limit: float, torque: Floats, beta: Floats) -> int:
    """Breakpoints of one moment from -limit to limit, padded with the limit; nan if no flank can bear it."""
    lowest, highest = balance(flanks, -limit), balance(flanks, limit)
    if math.isnan(lowest) or math.isnan(highest):
        torque[:], beta[:] = math.nan, math.nan
        return 2
    if flanks.high > flanks.low:
        size = _piece(flanks, lowest, flanks.low, -limit, 0.0, torque, beta)
        size += _piece(flanks, flanks.high, highest, 0.0, limit, torque[size:], beta[size:])
    else:
        size = _piece(flanks, lowest, highest, -limit, limit, torque, beta)
    torque[size:], beta[size:] = limit, highest
    return size


@part
def _piece(
    flanks: Flanks, lowest: float, highest: float, first: float, last: float, torque: Floats, beta: Floats
) -> int:
    """Set the breakpoints between two torsions and their torques, and return their number."""
    stiffness, moment = bearing(flanks, lowest)
    start, gain = _between(flanks, lowest, highest)
    torque[0], beta[0] = first, lowest
    for j in range(start.size):
        # Rounding must not give a torque beyond the ends, or one that falls.
        torque[j + 1] = min(max(stiffness * start[j] - moment, torque[j]), last)
        beta[j + 1] = start[j]
        stiffness += gain[j]
        moment += gain[j] * start[j]
    torque[start.size + 1], beta[start.size + 1] = last, highest
    return start.size + 2


@part
def _between(flanks: Flanks, lowest: float, highest: float) -> tuple[Floats, Floats]:
    """Rising breakpoints between two torsions, and the change of stiffness at each."""
    size = flanks.plus.start.size + flanks.minus.start.size
    start, gain, found = np.empty(size), np.empty(size), 0
    for j in range(flanks.plus.start.size):
        if lowest < flanks.plus.start[j] < highest:
            start[found], gain[found] = flanks.plus.start[j], flanks.plus.gain[j]
            found += 1
    for j in range(flanks.minus.start.size):
        if lowest <= flanks.minus.start[j] < highest:
            start[found], gain[found] = flanks.minus.start[j], -flanks.minus.gain[j]
            found += 1
    order = np.argsort(start[:found])
    return start[order], gain[order]
