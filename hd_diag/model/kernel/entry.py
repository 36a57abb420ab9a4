"""Entry points: what Python calls, for many moments at once.

Entry points that threads may share fill the rows from ``first`` to before ``last`` of their result.
Arrays have one value per moment: wave generator angle [rad], displacement of its centre in the housing [m],
torque on the cup [N m].
"""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.model.kernel.chain import first_contact
from hd_diag.model.kernel.compiler import entry_point
from hd_diag.model.kernel.interpolation import columns, interpolate
from hd_diag.model.kernel.load_sharing import (
    arms,
    balance,
    balance_all,
    both,
    curve,
    flanks,
    given_side,
    most_columns,
    scratch,
    side_room,
)
from hd_diag.model.kernel.mesh_data import Constants, MeshData, blank
from hd_diag.model.kernel.sensitivity import (
    add,
    carried,
    direction,
    fill,
    fill_pieces,
    parameters,
    pieces_room,
    samples_of,
    to_housing,
)


@entry_point
def torsion(
    mesh: MeshData, turn: Floats, eccentricity: Complexes, torque: Floats, beta: Floats, first: int, last: int
) -> None:
    """Torsion (n,) at one torque per moment."""
    work = scratch(mesh)
    for i in range(first, last):
        beta[i] = balance(flanks(mesh, turn[i], eccentricity[i], work), torque[i])


@entry_point
def torsion_table(mesh: MeshData, turn: Floats, eccentricity: Complexes, torque: Floats) -> Floats:
    """Torsions (n, q) at rising torques (q,), which are the same at every moment."""
    work, beta = scratch(mesh), np.empty((turn.size, torque.size))
    for i in range(turn.size):
        balance_all(flanks(mesh, turn[i], eccentricity[i], work), torque, beta[i])
    return beta


@entry_point
def torsion_of_flanks(rotation: Floats, stiffness: Floats, torque: Floats) -> Floats:
    """Torsions (n, q) of flanks with given closing rotations and stiffness (n, 2, flanks)."""
    plus, minus = side_room(rotation.shape[2]), side_room(rotation.shape[2])
    beta = np.empty((rotation.shape[0], torque.size))
    for i in range(beta.shape[0]):
        ahead = given_side(rotation[i, 0], stiffness[i, 0], 1.0, plus)
        balance_all(both(ahead, given_side(rotation[i, 1], stiffness[i, 1], -1.0, minus)), torque, beta[i])
    return beta


@entry_point
def touches(c: Constants, height: Floats, offset: Floats) -> Floats:
    """First contacts (9, n), rows as in `Touch`, of + flanks of teeth at heights and offsets (n,) [m]."""
    found = np.empty((9, height.size))
    for i in range(height.size):
        touch = first_contact(c, height[i], offset[i])
        for k in range(9):
            found[k, i] = touch[k]
    return found


@entry_point
def curves(mesh: MeshData, turn: Floats, eccentricity: Complexes, limit: float) -> tuple[Floats, Floats]:
    """Breakpoints within a torque limit: torques and torsions (n, breakpoints)."""
    work, columns, used = scratch(mesh), 2 * most_columns(mesh) + 4, 0
    torque, beta = np.empty((turn.size, columns)), np.empty((turn.size, columns))
    for i in range(turn.size):
        used = max(used, curve(flanks(mesh, turn[i], eccentricity[i], work), limit, torque[i], beta[i]))
    return torque[:, :used].copy(), beta[:, :used].copy()


@entry_point
def torsion_and_gradient(
    mesh: MeshData, turn: Floats, eccentricity: Complexes, torque: Floats
) -> tuple[Floats, Floats]:
    """Torsion (n,); derivatives (n, 4 or 6) by E_x, E_y, r_0, with sections the tilt's x and y, by M."""
    work, n = scratch(mesh), turn.size
    count = parameters(mesh)
    beta, gradient = np.empty(n), np.empty((n, count + 1))
    for i in range(n):
        # Contacts do not depend on the torque: solve them once for moments that differ only in torque.
        if i == 0 or turn[i] != turn[i - 1] or eccentricity[i] != eccentricity[i - 1]:
            found = flanks(mesh, turn[i], eccentricity[i], work)
        beta[i] = balance(found, torque[i])
        fill(work, mesh.compliance, found, torque[i], beta[i], gradient[i])
        to_housing(gradient[i], count, complex(math.cos(turn[i]), math.sin(turn[i])))
    return beta, gradient


@entry_point
def pieces_along(
    mesh: MeshData,
    turn: Floats,
    eccentricity: Complexes,
    steps: int,
    blends: bool,
    begin: Integers,
    low: float,
    high: float,
) -> tuple[Integers, Floats, Floats]:
    """Pieces of the torsion between two torques, at every angle where :func:`torsion_along` has samples.

    Returns
    -------
    first : ndarray of int64, shape (angles + 1,)
        Index of every angle's first piece. An angle without samples, or whose teeth cannot bear the torques,
        has no pieces.
    torque, sums : ndarray, shape (pieces,) and (pieces, 8 or 12)
        Torque where each piece begins, and the sums over its flanks.
    """
    work, room, nodes = scratch(mesh), pieces_room(mesh), turn.size
    first, total = np.zeros(nodes + 1, np.int64), 0
    torque, sums = np.empty(32 * nodes), np.empty((32 * nodes, room.sums.shape[1]))
    for node in range(nodes):
        size, tooth, step = 0, node // (steps + 1), node % (steps + 1)
        for corner in range(4 if blends else 2):
            start, end = samples_of(begin, tooth, step, steps, corner)
            if start < end:
                found = flanks(mesh, turn[node], eccentricity[node], work)
                size = fill_pieces(work, mesh.compliance, found, low, high, room)
                break
        while total + size > torque.size:
            torque, sums = np.concatenate((torque, torque)), np.concatenate((sums, sums))
        for k in range(size):
            torque[total + k], sums[total + k] = room.begin[k], room.sums[k]
        total += size
        first[node + 1] = total
    return first, torque[:total].copy(), sums[:total].copy()


@entry_point
def torsion_along(
    turn: Floats,
    tilt: complex,
    fixed: complex,
    steps: int,
    blends: bool,
    begin: Integers,
    share: Floats,
    across: Floats,
    turned: Complexes,
    first: Integers,
    piece: Floats,
    sums: Floats,
    torque: Floats,
) -> Floats:
    """Derivatives as of `torsion_and_gradient`, then the torsion (n, 5 or 7), at places between angles.

    `turn` holds all steps of each solved tooth in turn, with pieces from :func:`pieces_along`. Samples are
    sorted by cell: `begin` is a cell's first sample, `share` a sample's place within its step. A sample is a
    whole number of teeth from its solved tooth, in the direction `turned`. There the displacement `fixed` in
    the housing and the `tilt` have other components in the wave generator's frame. The gradient of the solved
    tooth corrects for this. With `blends`, results of that tooth and the next are mixed by `across`.
    """
    count, nodes = (sums.shape[1] - 2) // 2, turn.size
    result, here = np.zeros((torque.size, count + 2)), np.empty(count + 2)
    for node in range(nodes):
        tooth, step = node // (steps + 1), node % (steps + 1)
        own = piece[first[node] : first[node + 1]], sums[first[node] : first[node + 1]]
        there = direction(turn[node])
        after = direction(turn[(node + steps + 1) % nodes]) - there
        before = there - direction(turn[node - steps - 1])
        for corner in range(4 if blends else 2):
            start, end = samples_of(begin, tooth, step, steps, corner)
            for i in range(start, end):
                weight = share[i] if corner % 2 else 1.0 - share[i]
                away = turned[i].conjugate() - there
                # Half the gradients' difference along the way corrects for curvature: exact for a parabola.
                if corner < 2:
                    weight *= 1.0 - across[i]
                    away -= 0.5 * across[i] * after
                else:
                    weight *= across[i]
                    away += 0.5 * (1.0 - across[i]) * before
                here[:] = 0.0 if own[0].size else math.nan
                if own[0].size:
                    add(*own, torque[i], weight, here)
                here[-1] += carried(here, count, away * fixed, away * tilt)
                to_housing(here, count, turned[i])
                for k in range(here.size):
                    result[i, k] += here[k]
    return result


@entry_point
def mesh_state(
    mesh: MeshData,
    turn: Floats,
    eccentricity: Complexes,
    torque: Floats,
    teeth: Floats,
    whole: Floats,
    first: int,
    last: int,
) -> None:
    """Backlash, load, pressure angle (3, n, sections, 2, Z_R); torsion, gap, mean contact radius (3, n)."""
    work = scratch(mesh)
    for i in range(first, last):
        found, seen, total = flanks(mesh, turn[i], eccentricity[i], work), work.contacts, 0.0
        beta, backlash, load, pressure = balance(found, torque[i]), teeth[0, i], teeth[1, i], teeth[2, i]
        backlash[:], load[:], pressure[:] = math.nan, 0.0, math.nan
        for flank in range(2):
            side, bears = 1.0 - 2.0 * flank, found.minus if flank else found.plus
            for k in range(bears.start.size):
                j, rotation = bears.column[k], side * bears.start[k]
                radius, push, lever = arms(seen, flank, j)
                tooth = int(work.teeth.number[j]) % mesh.constants.flexspline_teeth
                place, overlap = work.teeth.section[j], side * beta - rotation
                force = overlap * lever * work.teeth.weight[j] / mesh.compliance
                backlash[place, flank, tooth] = radius * rotation
                load[place, flank, tooth] = force if overlap > 0.0 else 0.0
                pressure[place, flank, tooth] = math.atan2(push, lever)
                total += radius
        touching = found.plus.start.size + found.minus.start.size
        whole[0, i], whole[1, i] = beta, found.high - found.low
        whole[2, i] = total / touching if touching else math.nan


def warm_up(gradient: bool) -> None:
    """Compile the kernels of predictions and maps, or load them from disk; with `gradient` also of fits."""
    mesh, row, rows, flat = blank(), np.empty(0), np.zeros((2, 2)), np.zeros((0, 2, 0))
    center = row.astype(np.complex128)
    torsion(mesh, row, center, row, row, 0, 0)
    torsion_table(mesh, row, center, row)
    curves(mesh, row, center, 0.0)
    mesh_state(mesh, row, center, row, np.empty((3, 0, 1, 2, 0)), np.empty((3, 0)), 0, 0)
    table, lines = rows.astype(np.int16), rows.astype(np.float32)
    interpolate(table, table, lines, columns(table), 1, 0.0, 0.0, row, row, row, 0, 0)
    if gradient:
        torsion_of_flanks(flat, flat, row)
        touches(mesh.constants, row, row)
        torsion_and_gradient(mesh, row, center, row)
        none = np.zeros(1, dtype=np.int64)
        pieces = pieces_along(mesh, row, center, 1, False, none, 0.0, 0.0)
        torsion_along(row, 0j, 0j, 1, False, none, row, row, center, *pieces, row)
