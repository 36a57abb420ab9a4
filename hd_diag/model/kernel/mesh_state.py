"""Backlash, load and pressure angle of every tooth: contacts and load of a moment solved together."""

from __future__ import annotations

import math

from hd_diag.arrays import Floats
from hd_diag.model.kernel.compiler import part
from hd_diag.model.kernel.load_sharing import Flanks, Scratch, balance
from hd_diag.model.kernel.mesh_data import MeshData


@part
def spread(
    mesh: MeshData,
    work: Scratch,
    found: Flanks,
    torque: float,
    backlash: Floats,
    load: Floats,
    pressure: Floats,
) -> tuple[float, float, float]:
    """Set the values of all teeth (2, Z_R); give torsion and gap [rad] and the contacts' mean radius [m]."""
    backlash[:], load[:], pressure[:] = math.nan, 0.0, math.nan
    beta, total, seen = balance(found, torque), 0.0, work.contacts
    for flank in range(2):
        side, bears = 1.0 - 2.0 * flank, found.minus if flank else found.plus
        for k in range(bears.start.size):
            j, rotation = bears.column[k], side * bears.start[k]
            x, y = seen.x[flank, j], seen.y[flank, j]
            normal_x, normal_y = seen.normal_x[flank, j], seen.normal_y[flank, j]
            radius, lever = math.sqrt(x * x + y * y), x * normal_y - y * normal_x
            tooth = int(work.teeth.number[j]) % mesh.constants.flexspline_teeth
            overlap = side * beta - rotation
            backlash[flank, tooth] = radius * rotation
            load[flank, tooth] = overlap * lever / mesh.compliance if overlap > 0.0 else 0.0
            pressure[flank, tooth] = math.atan2(x * normal_x + y * normal_y, lever)
            total += radius
    touching = found.plus.start.size + found.minus.start.size
    return beta, found.high - found.low, total / touching if touching else math.nan
