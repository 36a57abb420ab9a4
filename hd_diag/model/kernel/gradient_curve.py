"""Torsion and its derivatives over torque at one wave generator angle, piece by piece."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.kernel import part
from hd_diag.model.kernel.gradient import along, slopes
from hd_diag.model.kernel.load import Flanks, Side, balance
from hd_diag.model.kernel.teeth import MeshData, Teeth

TAKEN_BY = 3
"""E_x and E_y in the wave generator's frame, r_0."""


class Pieces(NamedTuple):
    """Pieces of the torsion over torque, rising: torque at which each begins, and what bears on it.

    The sums over its flanks are, in columns: stiffness; stiffness times start; K d beta by every parameter
    at zero torsion; its change with the torsion. Flanks, + before -, have the same of their own.
    """

    begin: Floats
    sums: Floats
    flank: Floats
    start: Floats


@part
def pieces_room(flexspline_teeth: int) -> Pieces:
    """Room for as many flanks as there are teeth."""
    flanks, columns = 2 * flexspline_teeth, 2 + 2 * TAKEN_BY
    pieces = flanks + 4
    return Pieces(
        np.empty(pieces), np.empty((pieces, columns)), np.empty((flanks, columns)), np.empty(flanks)
    )


@part
def fill_pieces(mesh: MeshData, teeth: Teeth, flanks: Flanks, limit: float, room: Pieces) -> int:
    """Set the pieces from -limit to limit and give their number; none where the teeth cannot bear it."""
    lowest, highest = balance(flanks, -limit), balance(flanks, limit)
    if not (math.isfinite(lowest) and math.isfinite(highest)):
        return 0
    _set_flanks(mesh, teeth, flanks.plus, 1.0, highest, 0, room)
    _set_flanks(mesh, teeth, flanks.minus, -1.0, lowest, flanks.plus.start.size, room)
    if flanks.high > flanks.low:
        size = _append(flanks, lowest, flanks.low, -limit, 0, room)
        return _append(flanks, flanks.high, highest, 0.0, size, room)
    return _append(flanks, lowest, highest, -limit, 0, room)


@part
def add(room: Pieces, size: int, torque: float, weight: float, found: Floats) -> None:
    """Add the weighted derivatives at a torque, by the parameters and by itself, then the torsion.

    Between two pieces that meet it is the middle: that of a true gap at zero torque.
    """
    at = max(int(np.searchsorted(room.begin[:size], torque, side="right")) - 1, 0)
    if at > 0 and room.begin[at] == torque:
        _add_piece(room.sums[at - 1], torque, 0.5 * weight, found)
        weight = 0.5 * weight
    _add_piece(room.sums[at], torque, weight, found)


@part
def _add_piece(sums: Floats, torque: float, weight: float, found: Floats) -> None:
    beta = (torque + sums[1]) / sums[0]
    share = weight / sums[0]
    for k in range(TAKEN_BY):
        found[k] += share * (sums[2 + k] + beta * sums[2 + TAKEN_BY + k])
    found[TAKEN_BY] += share
    found[TAKEN_BY + 1] += weight * beta


@part
def _set_flanks(
    mesh: MeshData, teeth: Teeth, flanks: Side, side: float, farthest: float, first: int, room: Pieces
) -> None:
    """Set what a side's flanks have of their own, where they begin before the farthest torsion."""
    softening = 2.0 / mesh.compliance
    for j in range(flanks.start.size):
        room.start[first + j] = flanks.start[j]
        if side * flanks.start[j] > side * farthest:
            continue
        i, own = flanks.column[j], room.flank[first + j]
        height, offset = teeth.height[i], teeth.offset[i]
        at_rest = slopes(mesh.constants, height, offset, side, flanks.gain[j], 0.0)
        released = slopes(mesh.constants, height, offset, side, 0.0, softening)
        own[0], own[1] = flanks.gain[j], flanks.gain[j] * flanks.start[j]
        x, y = along(teeth, i, at_rest)
        x_turning, y_turning = along(teeth, i, released)
        own[5], own[6], own[7] = side * x_turning, side * y_turning, side * released.datum
        own[2], own[3] = x - flanks.start[j] * own[5], y - flanks.start[j] * own[6]
        own[4] = at_rest.datum - flanks.start[j] * own[7]


@part
def _append(flanks: Flanks, lowest: float, highest: float, torque: float, size: int, room: Pieces) -> int:
    """Append the pieces between two torsions, the first of which begins at a torque."""
    plus = flanks.plus.start.size
    sums = room.sums[size]
    sums[:] = 0.0
    changing, found = np.empty(plus + flanks.minus.start.size, dtype=np.int64), 0
    for j in range(changing.size):
        start = room.start[j]
        if start <= lowest if j < plus else start >= lowest:
            for k in range(sums.size):
                sums[k] += room.flank[j, k]
        if (lowest < start < highest) if j < plus else (lowest <= start < highest):
            changing[found] = j
            found += 1
    room.begin[size] = torque
    order = np.argsort(room.start[changing[:found]])
    for j in changing[order]:
        before, after = room.sums[size], room.sums[size + 1]
        # Rounding must not give a torque that falls.
        room.begin[size + 1] = max(before[0] * room.start[j] - before[1], room.begin[size])
        sign = 1.0 if j < plus else -1.0
        for k in range(before.size):
            after[k] = before[k] + sign * room.flank[j, k]
        size += 1
    return size + 1
