"""Compiled parts of :func:`hd_diag.tolerance.evaluation.evaluate`; this module imports numba."""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.model.kernel.compiler import entry_point, part
from hd_diag.model.kernel.load_sharing import (
    Flanks,
    Scratch,
    Side,
    arms,
    balance,
    bearing,
    both,
    find,
    flanks,
    scratch,
)
from hd_diag.model.kernel.mesh_data import MeshData
from hd_diag.model.kernel.poses import Teeth, place


@entry_point
def loads(
    mesh: MeshData, turn: Floats, center: Complexes, tilt: Complexes, slot_angle: Floats, torque: Floats
) -> tuple[Floats, Floats]:
    """Gap between both lobes (n,) [rad]; values of `_load` at every torque (n, q, 4).

    ``tilt`` (n,) replaces the mesh's [rad]; ``slot_angle`` (Z_G,) is the counter-clockwise deviation of each
    slot from its place [rad].
    """
    work, gap = scratch(mesh), np.empty(turn.size)
    loads, force = np.empty((turn.size, torque.size, 4)), np.empty((2, mesh.constants.flexspline_teeth))
    for i in range(turn.size):
        leant = MeshData(mesh.constants, mesh.tables, mesh.compliance, mesh.arc_offset, tilt[i])
        found = flanks(leant, turn[i], center[i], work)
        _turn(found.plus, work.teeth, slot_angle)
        _turn(found.minus, work.teeth, slot_angle)
        found = both(found.plus, found.minus)
        for j in range(torque.size):
            _load(mesh.compliance, work.teeth, found, torque[j], force, loads[i, j])
        gap[i] = found.high - found.low
    return gap, loads


@entry_point
def lobes(
    mesh: MeshData, turn: Floats, center: Complexes, tilt: Complexes, anchor: Floats, slot_angle: Floats
) -> Floats:
    """Least backlash and mean contact radius at lobe 0 (n, 2) [m].

    Arguments as for :func:`loads`; ``anchor`` (n,) is the arc offset at which the backlash counts [m].
    """
    work, found = scratch(mesh), np.empty((turn.size, 2))
    for i in range(turn.size):
        held = MeshData(mesh.constants, mesh.tables, mesh.compliance, anchor[i], tilt[i])
        found[i, 0], found[i, 1] = _lobe(held, turn[i], center[i], slot_angle, work)
    return found


@part
def _turn(side: Side, teeth: Teeth, slot_angle: Floats) -> None:
    """Turn the slots: the torsion at which a flank begins to bear rises by its slot's angle."""
    for j in range(side.start.size):
        side.start[j] += slot_angle[int(teeth.slot[side.column[j]]) % slot_angle.size]


@part
def _load(compliance: float, teeth: Teeth, found: Flanks, torque: float, force: Floats, out: Floats) -> None:
    """Torsion [rad], stiffness [N m/rad], peak force [N], peak over mean force [-] at one torque.

    ``force`` (2, Z_R) is working space for forces on teeth, which are sums over the sections.
    """
    beta = balance(found, torque)
    force[:] = 0.0
    for flank in range(2):
        side, bears = 1.0 - 2.0 * flank, found.minus if flank else found.plus
        for j in range(bears.start.size):
            overlap = side * (beta - bears.start[j])
            if overlap > 0.0:
                i = bears.column[j]
                tooth = int(teeth.number[i]) % force.shape[1]
                force[flank, tooth] += overlap * math.sqrt(bears.gain[j] * teeth.weight[i] / compliance)
    peak, total, count = 0.0, 0.0, 0
    for one in force.flat:
        if one > 0.0:
            peak, total, count = max(peak, one), total + one, count + 1
    idle = torque == 0.0 and found.high > found.low
    out[0] = beta
    out[1] = 0.0 if idle else bearing(found, beta)[0]
    out[2] = peak if math.isfinite(beta) else math.nan
    out[3] = peak * count / total if total > 0.0 else (1.0 if math.isfinite(beta) else math.nan)


@part
def _lobe(
    mesh: MeshData, turn: float, eccentricity: complex, slot_angle: Floats, work: Scratch
) -> tuple[float, float]:
    """Least backlash of the teeth at lobe 0, and mean radius of their contacts [m]."""
    teeth, seen = work.teeth, work.contacts
    # The first half of the columns is the lobe on the long axis.
    count = place(mesh, turn, eccentricity, teeth) // 2
    find(mesh.constants, teeth, count, seen)
    least, total, touching = math.inf, 0.0, 0
    for flank in range(2):
        side = 1.0 - 2.0 * flank
        for j in range(count):
            if math.isfinite(seen.sine[flank, j]):
                radius, _, _ = arms(seen, flank, j)
                shift = slot_angle[int(teeth.slot[j]) % slot_angle.size]
                least = min(least, radius * (math.asin(seen.sine[flank, j]) + side * (shift - teeth.lead[j])))
                total, touching = total + radius, touching + 1
    return (least, total / touching) if touching else (math.nan, math.nan)
