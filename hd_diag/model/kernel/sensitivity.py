"""Derivatives of the torsion by parameters of the mesh, computed together with the torsion.

K is the stiffness of the loaded flanks. ``K d beta`` is the sum of ``k db - (beta - b) dk`` over the loaded +
flanks less the sum of ``k db - (-beta - b) dk`` over the loaded - flanks. By the envelope theorem db is the
tooth's motion against the contact's normal, over the lever arm; the contact's own motion does not count. ``k
= (r cos alpha)^2 / (K1 + K2)`` changes too, because the normal of conformal arcs turns fast. Tip radii stay
fixed when the datum moves. beta has kinks where a flank begins to bear; the derivative there is one-sided.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model.kernel.compiler import inline, part
from hd_diag.model.kernel.load_sharing import (
    Flanks,
    Scratch,
    Side,
    arms,
    balance,
    most_columns,
)
from hd_diag.model.kernel.mesh_data import MeshData


@part
def parameters(mesh: MeshData) -> int:
    """Number of the parameters: E_x, E_y in the wave generator's frame, r_0, with sections the tilt's two.

    A tilt is a displacement proportional to z. Derivatives by other parameters follow from dbeta/dM.
    """
    return 5 if mesh.tables.section_place.size > 1 else 3


@inline
def _slopes(work: Scratch, flank: int, i: int, weight: float, release: float) -> tuple[float, float, float]:
    """Contribution of a tooth's flank (0: +, 1: -) to K d beta/dp for E_x, E_y, r_0.

    It is ``weight`` times db/dp, less ``release`` times the derivative of half the squared lever arm.
    """
    touch, teeth, side = work.contacts, work.teeth, 1.0 - 2.0 * flank
    normal_x, normal_y, sine = touch.normal_x[flank, i], touch.normal_y[flank, i], touch.sine[flank, i]
    _, _, lever = arms(touch, flank, i)
    share, cosine = weight / lever, math.sqrt(1.0 - sine * sine)
    height = -share * (normal_x * cosine + normal_y * sine) - release * touch.lever_height[flank, i]
    offset = -share * (normal_y * cosine - normal_x * sine) - release * touch.lever_offset[flank, i]
    height *= side
    return (
        height * teeth.cosine[i] - offset * teeth.sine[i],
        height * teeth.sine[i] + offset * teeth.cosine[i],
        side * (share * touch.datum[flank, i] - release * touch.lever_datum[flank, i]),
    )


@inline
def _add(
    work: Scratch, i: int, slopes: tuple[float, float, float], sums: Floats, at: int, count: int
) -> None:
    """Add a tooth's contribution by `count` parameters to `sums`, from index `at` on."""
    sums[at] += slopes[0]
    sums[at + 1] += slopes[1]
    sums[at + 2] += slopes[2]
    if count > 3:
        sums[at + 3] += work.teeth.z[i] * slopes[0]
        sums[at + 4] += work.teeth.z[i] * slopes[1]


@inline
def to_housing(gradient: Floats, count: int, turned: complex) -> None:
    """Turn derivatives by `count` parameters into the housing; `turned` is the wave generator's direction."""
    for k in range(0, count, 3):  # the displacement, and after r_0 the tilt
        housing = complex(gradient[k], gradient[k + 1]) * turned
        gradient[k], gradient[k + 1] = housing.real, housing.imag


@inline
def carried(gradient: Floats, count: int, displacement: complex, tilt: complex) -> float:
    """Change of the torsion for a change of displacement and tilt in the wave generator's frame."""
    change: float = gradient[0] * displacement.real + gradient[1] * displacement.imag
    if count > 3:
        change += gradient[3] * tilt.real + gradient[4] * tilt.imag
    return change


@inline
def samples_of(begin: Integers, tooth: int, step: int, steps: int, corner: int) -> tuple[int, int]:
    """First sample, and the one after the last, of the cell that has a node at a corner.

    At corners 0 and 1 the node is of the tooth before the samples, at 2 and 3 of the tooth after them. At
    even corners it is at the step before them, at odd corners at the step after. (0, 0) without such a cell.
    """
    own = step - corner % 2
    if own < 0 or own == steps:
        return 0, 0
    cells = begin.size - 1
    cell = (tooth * steps + own - (corner // 2) * steps) % cells
    return begin[cell], begin[cell + 1]


@inline
def direction(turn: float) -> complex:
    """Direction of the housing's x axis in the wave generator's frame."""
    return complex(math.cos(turn), -math.sin(turn))


# At one torque ---


@part
def fill(
    work: Scratch, compliance: float, flanks: Flanks, torque: float, beta: float, gradient: Floats
) -> None:
    """Set the derivatives of one moment by the parameters and, last, by M."""
    gradient[:] = 0.0 if math.isfinite(beta) else math.nan
    if torque == 0.0 and flanks.high > flanks.low:
        _add_edge(work, flanks.plus, flanks.high, 0, gradient)
        _add_edge(work, flanks.minus, flanks.low, 1, gradient)
        gradient[-1] = math.inf
    else:
        stiffness = _add_side(work, compliance, flanks.plus, beta, 0, gradient)
        stiffness += _add_side(work, compliance, flanks.minus, beta, 1, gradient)
        gradient /= stiffness
        gradient[-1] = 1.0 / stiffness


@part
def _add_side(
    work: Scratch, compliance: float, flanks: Side, beta: float, flank: int, gradient: Floats
) -> float:
    """Add the bearing flanks of one side, and return their stiffness."""
    stiffness = 0.0
    for j in range(flanks.start.size):
        overlap = (1.0 - 2.0 * flank) * (beta - flanks.start[j])
        if overlap > 0.0:
            i = flanks.column[j]
            release = 2.0 * overlap * work.teeth.weight[i] / compliance
            _add(work, i, _slopes(work, flank, i, flanks.gain[j], release), gradient, 0, gradient.size - 1)
            stiffness += flanks.gain[j]
    return stiffness


@part
def _add_edge(work: Scratch, flanks: Side, edge: float, flank: int, gradient: Floats) -> None:
    """Add one end of a true gap, with weight 0.5: the torsion is the gap's middle."""
    for j in range(flanks.start.size):
        if flanks.start[j] == edge:
            i = flanks.column[j]
            _add(work, i, _slopes(work, flank, i, 0.5, 0.0), gradient, 0, gradient.size - 1)
            return


# Over torque ---


class Pieces(NamedTuple):
    """Rising pieces of the torsion over torque: torque where each begins, and its loaded flanks.

    Columns of `sums`, over the loaded flanks: stiffness; stiffness times start; K d beta/dp of every
    parameter at zero torsion; its derivative by the torsion. `flank` has the same columns for each flank, +
    before -. `rank` is a flank's `start`, or infinite if no piece begins there. `order` holds the flanks'
    indices by rising rank, which hardly change from moment to moment.
    """

    begin: Floats
    sums: Floats
    flank: Floats
    start: Floats
    rank: Floats
    order: Integers


@part
def pieces_room(mesh: MeshData) -> Pieces:
    """Room for the flanks of all columns."""
    flanks, columns = 2 * most_columns(mesh), 2 + 2 * parameters(mesh)
    pieces = flanks + 4
    return Pieces(
        np.empty(pieces),
        np.empty((pieces, columns)),
        np.empty((flanks, columns)),
        np.empty(flanks),
        np.empty(flanks),
        np.arange(flanks),
    )


@part
def fill_pieces(
    work: Scratch, compliance: float, flanks: Flanks, low: float, high: float, room: Pieces
) -> int:
    """Set the pieces between two torques and return their number; 0 if the teeth cannot bear them."""
    lowest, highest = balance(flanks, low), balance(flanks, high)
    if not (math.isfinite(lowest) and math.isfinite(highest)):
        return 0
    plus = flanks.plus.start.size
    used = plus + flanks.minus.start.size
    _set_flanks(work, 2.0 / compliance, flanks.plus, 0, highest, 0, room)
    _set_flanks(work, 2.0 / compliance, flanks.minus, 1, lowest, plus, room)
    for j in range(room.start.size):
        inside = j < used and lowest <= room.start[j] < highest
        room.rank[j] = room.start[j] if inside else math.inf
    _sort(room.order, room.rank)
    if flanks.high <= flanks.low:
        return _append(flanks, lowest, highest, low, 0, room)
    size = 0
    if low < 0.0:
        size = _append(flanks, lowest, min(highest, flanks.low), low, 0, room)
    if high > 0.0:
        size = _append(flanks, max(lowest, flanks.high), highest, max(low, 0.0), size, room)
    return size


@part
def add(begin: Floats, sums: Floats, torque: float, weight: float, found: Floats) -> None:
    """Add to `found` the weighted derivatives at a torque, by the parameters and by it, then the torsion.

    Pieces (k,) begin at torques `begin` and have `sums` (k, 8 or 12). Where two pieces meet, the mean of both
    counts: in a true gap at zero torque that is the gap's middle.
    """
    at, end = 0, begin.size
    while end - at > 1:
        half = (at + end) // 2
        at, end = (half, end) if begin[half] <= torque else (at, half)
    if at > 0 and begin[at] == torque:
        weight = 0.5 * weight
        _add_piece(sums, at - 1, torque, weight, found)
    _add_piece(sums, at, torque, weight, found)


@inline
def _add_piece(sums: Floats, at: int, torque: float, weight: float, found: Floats) -> None:
    softness, count = 1.0 / sums[at, 0], found.size - 2
    beta, share = (torque + sums[at, 1]) * softness, weight * softness
    for k in range(count):
        found[k] += share * (sums[at, 2 + k] + beta * sums[at, 2 + count + k])
    found[count] += share
    found[count + 1] += weight * beta


@part
def _set_flanks(
    work: Scratch, softening: float, flanks: Side, flank: int, farthest: float, first: int, room: Pieces
) -> None:
    """Set the columns of a side's flanks that begin to bear before the farthest torsion."""
    side, count = 1.0 - 2.0 * flank, (room.flank.shape[1] - 2) // 2
    for j in range(flanks.start.size):
        start, i, own = flanks.start[j], flanks.column[j], room.flank[first + j]
        room.start[first + j] = start
        if side * start > side * farthest:
            continue
        for k in range(own.size):
            own[k] = 0.0
        own[0], own[1] = flanks.gain[j], flanks.gain[j] * start
        _add(work, i, _slopes(work, flank, i, flanks.gain[j], 0.0), own, 2, count)
        released = _slopes(work, flank, i, 0.0, softening * work.teeth.weight[i])
        _add(work, i, released, own, 2 + count, count)
        for k in range(2, 2 + count):
            own[count + k] *= side
            own[k] -= start * own[count + k]


@part
def _append(flanks: Flanks, lowest: float, highest: float, torque: float, size: int, room: Pieces) -> int:
    """Append the pieces between two torsions, the first from `torque` on; return their new number."""
    plus, sums = flanks.plus.start.size, room.sums
    for k in range(sums.shape[1]):
        sums[size, k] = 0.0
    for j in range(plus + flanks.minus.start.size):
        if room.start[j] <= lowest if j < plus else room.start[j] >= lowest:
            for k in range(sums.shape[1]):
                sums[size, k] += room.flank[j, k]
    room.begin[size] = torque
    for j in room.order:
        start = room.rank[j]
        if start >= highest:
            break
        if start < lowest or (start == lowest and j < plus):
            continue
        # Rounding must not give a torque that falls.
        room.begin[size + 1] = max(sums[size, 0] * start - sums[size, 1], room.begin[size])
        sign = 1.0 if j < plus else -1.0
        for k in range(sums.shape[1]):
            sums[size + 1, k] = sums[size, k] + sign * room.flank[j, k]
        size += 1
    return size + 1


@part
def _sort(order: Integers, rank: Floats) -> None:
    """Sort indices of flanks by rank, by insertion because they are nearly sorted."""
    for i in range(1, order.size):
        number, k = order[i], i
        while k > 0 and rank[order[k - 1]] > rank[number]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = number
