"""Entry points, called by ``compiled`` for many moments at once.

Those that threads may share work on the rows from ``first`` to before ``last`` and fill them in their result.
"""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.model.kernel import entry_point, inline
from hd_diag.model.kernel.gradient import fill
from hd_diag.model.kernel.gradient_curve import TAKEN_BY, add, fill_pieces, pieces_room
from hd_diag.model.kernel.load import balance, closing_angle, curve, flanks, middle, scratch, walk
from hd_diag.model.kernel.state import contacts_room, spread, touch_teeth
from hd_diag.model.kernel.table import BLOCK, Columns, cells, columns, find, read
from hd_diag.model.kernel.teeth import MeshData, Teeth, place, reach, room, width
from hd_diag.model.kernel.touch import Constants, close


@entry_point
def torsion(
    mesh: MeshData,
    turn: Floats,
    eccentricity: Complexes,
    torque: Floats,
    beta: Floats,
    first: int,
    last: int,
) -> None:
    """Torsion (n,) at one torque per moment."""
    work = scratch(mesh.constants)
    for i in range(first, last):
        beta[i] = balance(flanks(mesh, turn[i], eccentricity[i], work), torque[i])


@entry_point
def torsion_table(
    mesh: MeshData, turn: Floats, eccentricity: Complexes, torque: Floats, branch: int
) -> Floats:
    """Torsions (n, q) at rising torques (q,), the same at every moment."""
    work, beta = scratch(mesh.constants), np.empty((turn.size, torque.size))
    before, after = np.searchsorted(torque, 0.0), np.searchsorted(torque, 0.0, side="right")
    for i in range(turn.size):
        found = flanks(mesh, turn[i], eccentricity[i], work)
        first, last = (before, after) if found.high > found.low else (0, 0)
        idle = found.high if branch > 0 else (found.low if branch < 0 else middle(found))
        beta[i, first:last] = idle if math.isfinite(idle) else math.nan
        walk(found, torque[:first], beta[i, :first])
        walk(found, torque[last:], beta[i, last:])
    return beta


@entry_point
def curves(mesh: MeshData, turn: Floats, eccentricity: Complexes, limit: float) -> tuple[Floats, Floats]:
    """Breakpoints within a torque limit: torques and torsions (n, breakpoints)."""
    work, columns, used = scratch(mesh.constants), 2 * mesh.constants.flexspline_teeth + 4, 0
    torque, beta = np.empty((turn.size, columns)), np.empty((turn.size, columns))
    for i in range(turn.size):
        used = max(used, curve(flanks(mesh, turn[i], eccentricity[i], work), limit, torque[i], beta[i]))
    return torque[:, :used].copy(), beta[:, :used].copy()


@entry_point
def index(breakpoints: Floats) -> Columns:
    """What :func:`interpolate` needs of a table beside its rows."""
    return columns(breakpoints)


@entry_point
def interpolate(
    breakpoints: Floats,
    values: Floats,
    near: Columns,
    limit: float,
    turn: Floats,
    torque: Floats,
    beta: Floats,
    first: int,
    last: int,
) -> None:
    """Torsion (n,) by a table; nan beyond its limit."""
    found = cells()
    for begin in range(first, last, BLOCK):
        end = min(begin + BLOCK, last)
        find(breakpoints, values, near, limit, turn, torque, begin, end, found)
        read(breakpoints, values, torque, begin, end, found, beta)


@entry_point
def torsion_and_gradient(
    mesh: MeshData, turn: Floats, eccentricity: Complexes, torque: Floats
) -> tuple[Floats, Floats, Floats]:
    """Torsion (n,), stiffness (n,) and gradient (n, 7)."""
    work, n = scratch(mesh.constants), turn.size
    beta, stiffness, gradient = np.empty(n), np.empty(n), np.empty((n, 7))
    for i in range(n):
        # Contacts do not depend on the torque: at many of them they are solved once.
        if i == 0 or turn[i] != turn[i - 1] or eccentricity[i] != eccentricity[i - 1]:
            found = flanks(mesh, turn[i], eccentricity[i], work)
        beta[i] = balance(found, torque[i])
        stiffness[i] = fill(
            mesh, work.teeth, found, turn[i], eccentricity[i], torque[i], beta[i], gradient[i]
        )
    return beta, stiffness, gradient


@entry_point
def torsion_along(
    mesh: MeshData,
    turn: Floats,
    eccentricity: Complexes,
    limit: float,
    cell: Integers,
    share: Floats,
    torque: Floats,
) -> Floats:
    """Gradient by E_x, E_y, r_0, M and torsion (n, 5) at places between angles, in rising cells."""
    work, room = scratch(mesh.constants), pieces_room(mesh.constants.flexspline_teeth)
    result, here = np.zeros((cell.size, TAKEN_BY + 2)), np.empty(TAKEN_BY + 2)
    before = now = 0
    for node in range(turn.size):
        after = now
        while after < cell.size and cell[after] == node:
            after += 1
        if after > before:
            found = flanks(mesh, turn[node], eccentricity[node], work)
            size = fill_pieces(mesh, work.teeth, found, limit, room)
            turned = complex(math.cos(turn[node]), math.sin(turn[node]))
            for i in range(before, after):
                here[:] = 0.0 if size else math.nan
                if size:
                    add(room, size, torque[i], share[i] if i < now else 1.0 - share[i], here)
                housing = complex(here[0], here[1]) * turned
                here[0], here[1] = housing.real, housing.imag
                for k in range(here.size):
                    result[i, k] += here[k]
        before, now = now, after
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
    """Backlash, load, pressure angle (3, n, 2, Z_R); torsion, gap, mean radius of the contacts (3, n)."""
    work, seen = scratch(mesh.constants), contacts_room(mesh.constants)
    for i in range(first, last):
        count = touch_teeth(mesh, turn[i], eccentricity[i], work, seen)
        beta, gap, radius = spread(mesh, work, seen, count, torque[i], teeth[0, i], teeth[1, i], teeth[2, i])
        whole[0, i], whole[1, i], whole[2, i] = beta, gap, radius


@entry_point
def contacts(
    mesh: MeshData, turn: Floats, eccentricity: Complexes, farthest: float
) -> tuple[Integers, Floats]:
    """Indices (2, n, teeth): teeth, slots; values (4, n, 2, teeth): b, r, alpha, position."""
    c, angle, teeth = mesh.constants, reach(mesh, farthest), room(mesh.constants)
    indices = np.empty((2, turn.size, 2 * width(c, angle)), dtype=np.int64)
    values = np.empty((4, turn.size, 2, indices.shape[2]))
    for i in range(turn.size):
        center = eccentricity[i] * complex(math.cos(turn[i]), -math.sin(turn[i]))
        for j in range(place(mesh, turn[i], center, angle, teeth)):
            indices[0, i, j] = int(teeth.number[j]) % c.flexspline_teeth
            indices[1, i, j] = int(teeth.slot[j]) % c.circular_spline_teeth
            for flank in range(2):
                rotation, radius, pressure_angle, position = _seen(c, teeth, j, 1.0 - 2.0 * flank)
                values[0, i, flank, j], values[1, i, flank, j] = rotation, radius
                values[2, i, flank, j], values[3, i, flank, j] = pressure_angle, position
    return indices, values


@inline
def _seen(c: Constants, teeth: Teeth, j: int, side: float) -> tuple[float, float, float, float]:
    """b, r, alpha, position of one flank."""
    touch = close(c, teeth.height[j], side * teeth.offset[j])
    x, y, normal_x, normal_y = touch.x, touch.y, touch.normal_x, touch.normal_y
    return (
        closing_angle(touch.sine) - side * teeth.lead[j],
        math.sqrt(x * x + y * y),
        math.atan2(x * normal_x + y * normal_y, x * normal_y - y * normal_x),
        teeth.slot[j] * c.slot_pitch + side * math.atan2(y, x),
    )
