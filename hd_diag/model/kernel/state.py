"""Backlash, load and pressure angle of every tooth: contacts and load of a moment solved together."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.kernel import part
from hd_diag.model.kernel.load import Scratch, balance, place_teeth, sides
from hd_diag.model.kernel.teeth import MeshData
from hd_diag.model.kernel.touch import Constants, close


class Contacts(NamedTuple):
    """First contacts of both flanks, each (2, teeth).

    Sine of the closing angle, lever arm [m], squared distance from the axis [m2], place along the normal [m].
    """

    sine: Floats
    lever: Floats
    square: Floats
    push: Floats


@part
def contacts_room(c: Constants) -> Contacts:
    """Room for the contacts of one moment."""
    n = c.flexspline_teeth
    return Contacts(np.empty((2, n)), np.empty((2, n)), np.empty((2, n)), np.empty((2, n)))


@part
def touch_teeth(mesh: MeshData, turn: float, eccentricity: complex, work: Scratch, seen: Contacts) -> int:
    """Set the contacts of the teeth within reach and give the number of these teeth."""
    count = place_teeth(mesh, turn, eccentricity, work.teeth)
    height, offset = work.teeth.height, work.teeth.offset
    _touch(
        mesh.constants, height, offset, count, 1.0, seen.sine[0], seen.lever[0], seen.square[0], seen.push[0]
    )
    _touch(
        mesh.constants, height, offset, count, -1.0, seen.sine[1], seen.lever[1], seen.square[1], seen.push[1]
    )
    return count


@part
def _touch(
    c: Constants,
    height: Floats,
    offset: Floats,
    count: int,
    side: float,
    sine: Floats,
    lever: Floats,
    square: Floats,
    push: Floats,
) -> None:
    """Contacts of one side's flanks; the compiler does several at once."""
    for j in range(count):
        touch = close(c, height[j], side * offset[j])
        sine[j] = touch.sine
        lever[j] = touch.x * touch.normal_y - touch.y * touch.normal_x
        square[j] = touch.x * touch.x + touch.y * touch.y
        push[j] = touch.x * touch.normal_x + touch.y * touch.normal_y


@part
def spread(
    mesh: MeshData,
    work: Scratch,
    seen: Contacts,
    count: int,
    torque: float,
    backlash: Floats,
    load: Floats,
    pressure: Floats,
) -> tuple[float, float, float]:
    """Set the values of all teeth (2, Z_R); give torsion and gap [rad] and the contacts' mean radius [m]."""
    backlash[:], load[:], pressure[:] = math.nan, 0.0, math.nan
    found = sides(mesh, work, count, seen.sine, seen.lever)
    beta, total = balance(found, torque), 0.0
    for flank in range(2):
        side, bears = 1.0 - 2.0 * flank, found.minus if flank else found.plus
        for k in range(bears.start.size):
            j, rotation = bears.column[k], side * bears.start[k]
            tooth, lever = int(work.teeth.number[j]) % mesh.constants.flexspline_teeth, seen.lever[flank, j]
            radius, overlap = math.sqrt(seen.square[flank, j]), side * beta - rotation
            backlash[flank, tooth] = radius * rotation
            load[flank, tooth] = overlap * lever / mesh.compliance if overlap > 0.0 else 0.0
            pressure[flank, tooth] = math.atan2(seen.push[flank, j], lever)
            total += radius
    touching = found.plus.start.size + found.minus.start.size
    return beta, found.high - found.low, total / touching if touching else math.nan
