"""One torsion for all teeth: ``load_sharing`` solved from piece to piece, or in one walk for many torques."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model.kernel import inline, part
from hd_diag.model.kernel.teeth import MeshData, Teeth, place, reach, room
from hd_diag.model.kernel.touch import Constants, close

# Sines up to here become angles by the arcsine's series to x^15, exact to rounding [-].
_SMALL_SINE = 0.125

# A torsion is found when an iteration moves it by less than this share of itself [-], or of this one [rad].
_ROUNDING = 1e-15
_SMALL_TORSION = 1e-3


class Side(NamedTuple):
    """Flanks of one side that can bear: torsion at which each begins [rad], stiffness [N m/rad], column."""

    start: Floats
    gain: Floats
    column: Integers


class Flanks(NamedTuple):
    """Both sides, and the torsions at which the first flank of either loses contact [rad]."""

    plus: Side
    minus: Side
    low: float
    high: float


class Scratch(NamedTuple):
    """Room for one moment, used again at the next; sines and lever arms are (2, teeth)."""

    teeth: Teeth
    sine: Floats
    lever: Floats
    plus: Side
    minus: Side


@part
def scratch(c: Constants) -> Scratch:
    """Room for as many flanks as there are teeth."""
    n = c.flexspline_teeth
    plus = Side(np.empty(n), np.empty(n), np.empty(n, dtype=np.int64))
    minus = Side(np.empty(n), np.empty(n), np.empty(n, dtype=np.int64))
    return Scratch(room(c), np.empty((2, n)), np.empty((2, n)), plus, minus)


@part
def flanks(mesh: MeshData, turn: float, eccentricity: complex, work: Scratch) -> Flanks:
    """Solve the contacts of one moment; none where a number is not finite."""
    count = place_teeth(mesh, turn, eccentricity, work.teeth)
    height, offset = work.teeth.height, work.teeth.offset
    _levers(mesh.constants, height, offset, count, 1.0, work.sine[0], work.lever[0])
    _levers(mesh.constants, height, offset, count, -1.0, work.sine[1], work.lever[1])
    return sides(mesh, work, count, work.sine, work.lever)


@part
def place_teeth(mesh: MeshData, turn: float, eccentricity: complex, teeth: Teeth) -> int:
    """Set the poses of the teeth within reach and give their number; 0 where a number is not finite."""
    if not (math.isfinite(turn) and math.isfinite(eccentricity.real) and math.isfinite(eccentricity.imag)):
        return 0
    angle = reach(mesh, abs(eccentricity))
    center = eccentricity * complex(math.cos(turn), -math.sin(turn))
    return place(mesh, turn, center, angle, teeth)


@part
def sides(mesh: MeshData, work: Scratch, count: int, sine: Floats, lever: Floats) -> Flanks:
    """Flanks that can bear, by the sines of their closing angles and their lever arms (2, teeth)."""
    plus = _side(mesh, work.teeth.lead, count, 1.0, sine[0], lever[0], work.plus)
    minus = _side(mesh, work.teeth.lead, count, -1.0, sine[1], lever[1], work.minus)
    low, high = -math.inf, math.inf
    for start in minus.start:
        low = max(low, start)
    for start in plus.start:
        high = min(high, start)
    return Flanks(plus, minus, low, high)


@part
def _side(
    mesh: MeshData, lead: Floats, count: int, side: float, sine: Floats, levers: Floats, room: Side
) -> Side:
    found = 0
    for j in range(count):
        lever = levers[j]
        if not math.isnan(lever):
            room.start[found] = side * closing_angle(sine[j]) - lead[j]
            room.gain[found] = lever * lever / mesh.compliance
            room.column[found] = j
            found += 1
    return Side(room.start[:found], room.gain[:found], room.column[:found])


@part
def _levers(
    c: Constants, height: Floats, offset: Floats, count: int, side: float, sine: Floats, lever: Floats
) -> None:
    """Sine of the closing angle and lever arm [m] of one side's flanks; the compiler does several at once."""
    for j in range(count):
        touch = close(c, height[j], side * offset[j])
        sine[j] = touch.sine
        lever[j] = touch.x * touch.normal_y - touch.y * touch.normal_x


@inline
def closing_angle(sine: float) -> float:
    """Arcsine, mostly by its series [rad]."""
    if abs(sine) > _SMALL_SINE:
        return math.asin(sine)
    x = sine * sine
    low = 1 / 6 + x * (3 / 40 + x * (5 / 112 + x * 35 / 1152))
    return sine + sine * x * (low + x * x * x * x * (63 / 2816 + x * (231 / 13312 + x * 143 / 10240)))


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
def _first_guess(flanks: Flanks, torque: float) -> float:
    """Within the preload, or (true gap) as if every flank of the loaded side bore: beyond the solution."""
    if flanks.low >= flanks.high:
        return 0.5 * (flanks.low + flanks.high)
    stiffness, moment = bearing(flanks, math.inf if torque > 0.0 else -math.inf)
    return (torque + moment) / stiffness if stiffness > 0.0 else math.nan


@part
def balance(flanks: Flanks, torque: float) -> float:
    """Torsion at one torque: Newton's iteration over the pieces, kept in a bracket; exact where it rests."""
    if torque == 0.0 and flanks.high > flanks.low:
        return middle(flanks)
    beta = _first_guess(flanks, torque) if not math.isnan(torque) else math.nan
    low, high = -math.inf, math.inf
    while math.isfinite(beta):
        stiffness, moment = bearing(flanks, beta)
        new = (torque + moment) / stiffness
        low, high = (low, beta) if new < beta else (beta, high)
        resting = _ROUNDING * (abs(beta) + _SMALL_TORSION)
        if abs(new - beta) <= resting or high - low <= resting:
            return new
        beta = new if low < new < high else 0.5 * (low + high)
    return beta


@part
def walk(flanks: Flanks, torque: Floats, beta: Floats) -> None:
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
    """Breakpoints of one moment from -limit to limit, which fills the rest; nan if no flank can bear it."""
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
    """Set the breakpoints between two torsions and their torques, and give the number."""
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
    """Breakpoints between two torsions, rising, and by how much the stiffness grows at each."""
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
