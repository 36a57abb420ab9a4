"""The quantities of ``moments`` compiled: contacts and load distribution of many moments in one pass.

Imported when first needed, for it imports numba.
"""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.model.kernel import entry_point, part
from hd_diag.model.kernel.load import Flanks, Scratch, Side, balance, bearing, flanks, scratch
from hd_diag.model.kernel.teeth import MeshData, Teeth, place, reach
from hd_diag.model.kernel.touch import Constants, close


@entry_point
def moments(
    mesh: MeshData, turn: Floats, center: Complexes, anchor: Floats, slot_angle: Floats, torque: Floats
) -> tuple[Floats, Floats]:
    """Gap, least backlash and mean contact radius at lobe 0 (n, 3); `_load` at every torque (n, q, 4).

    ``anchor`` (n,) is the arc offset at which the backlash counts [m], ``slot_angle`` (Z_G,) by how much each
    slot stands counter-clockwise of its place [rad].
    """
    work, geometry = scratch(mesh.constants), np.empty((turn.size, 3))
    seen = np.empty((2, mesh.constants.flexspline_teeth))
    loads = np.empty((turn.size, torque.size, 4))
    for i in range(turn.size):
        found = _displaced(flanks(mesh, turn[i], center[i], work), work.teeth, slot_angle)
        for j in range(torque.size):
            _load(mesh.compliance, found, torque[j], loads[i, j])
        geometry[i, 0] = found.high - found.low
        held = MeshData(mesh.constants, mesh.tables, mesh.compliance, anchor[i])
        geometry[i, 1], geometry[i, 2] = _lobe(held, turn[i], center[i], slot_angle, work, seen)
    return geometry, loads


@part
def _displaced(found: Flanks, teeth: Teeth, slot_angle: Floats) -> Flanks:
    """The flanks with their slots turned: they begin to bear at as much greater a torsion."""
    low, high = -math.inf, math.inf
    _turn(found.minus, teeth, slot_angle)
    _turn(found.plus, teeth, slot_angle)
    for start in found.minus.start:
        low = max(low, start)
    for start in found.plus.start:
        high = min(high, start)
    return Flanks(found.plus, found.minus, low, high)


@part
def _turn(side: Side, teeth: Teeth, slot_angle: Floats) -> None:
    for j in range(side.start.size):
        side.start[j] += slot_angle[int(teeth.slot[side.column[j]]) % slot_angle.size]


@part
def _load(compliance: float, found: Flanks, torque: float, out: Floats) -> None:
    """Torsion [rad], stiffness [N m/rad], peak force [N], peak over mean force [-] at one torque."""
    beta = balance(found, torque)
    peak, total, count = 0.0, 0.0, 0
    for flank in range(2):
        side, flanks_ = (1.0, found.plus) if flank == 0 else (-1.0, found.minus)
        for j in range(flanks_.start.size):
            overlap = side * (beta - flanks_.start[j])
            if overlap > 0.0:
                force = overlap * math.sqrt(flanks_.gain[j] / compliance)
                peak, total, count = max(peak, force), total + force, count + 1
    idle = torque == 0.0 and found.high > found.low
    out[0] = beta
    out[1] = 0.0 if idle else bearing(found, beta)[0]
    out[2] = peak if math.isfinite(beta) else math.nan
    out[3] = peak * count / total if total > 0.0 else (1.0 if math.isfinite(beta) else math.nan)


@part
def _lobe(
    mesh: MeshData, turn: float, eccentricity: complex, slot_angle: Floats, work: Scratch, seen: Floats
) -> tuple[float, float]:
    """Least backlash of the teeth at lobe 0, and mean radius of their contacts [m]."""
    teeth, center = work.teeth, eccentricity * complex(math.cos(turn), -math.sin(turn))
    # The first half of the columns is the lobe on the long axis.
    count = place(mesh, turn, center, reach(mesh, abs(eccentricity)), teeth) // 2
    least, total, touching = math.inf, 0.0, 0
    for flank in range(2):
        side = 1.0 - 2.0 * flank
        _touch(mesh.constants, teeth.height, teeth.offset, count, side, seen)
        for j in range(count):
            if math.isfinite(seen[0, j]):
                radius, shift = math.sqrt(seen[1, j]), slot_angle[int(teeth.slot[j]) % slot_angle.size]
                least = min(least, radius * (math.asin(seen[0, j]) + side * (shift - teeth.lead[j])))
                total, touching = total + radius, touching + 1
    return (least, total / touching) if touching else (math.nan, math.nan)


@part
def _touch(c: Constants, height: Floats, offset: Floats, count: int, side: float, seen: Floats) -> None:
    """Sine of the closing angle and squared radius [m2] of one side's contacts; several are done at once."""
    sine, square = seen[0], seen[1]
    for j in range(count):
        touch = close(c, height[j], side * offset[j])
        sine[j] = touch.sine
        square[j] = touch.x * touch.x + touch.y * touch.y
