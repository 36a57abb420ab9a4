"""Entry points, called by ``compiled`` for many moments at once."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hd_diag.model.kernel import entry_point, inline
from hd_diag.model.kernel.gradient import fill
from hd_diag.model.kernel.load import balance, closing_angle, curve, flanks, middle, scratch, walk
from hd_diag.model.kernel.state import contacts_room, spread, touch_teeth
from hd_diag.model.kernel.table import interpolated
from hd_diag.model.kernel.teeth import MeshData, Teeth, place, reach, room, width
from hd_diag.model.kernel.touch import Constants, close

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Complexes = npt.NDArray[np.complex128]


@entry_point
def torsion(mesh: MeshData, turn: Floats, eccentricity: Complexes, torque: Floats) -> Floats:
    """Torsion (n,) at one torque per moment."""
    work, beta = scratch(mesh.constants), np.empty(turn.size)
    for i in range(turn.size):
        beta[i] = balance(flanks(mesh, turn[i], eccentricity[i], work), torque[i])
    return beta


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
def interpolate(breakpoints: Floats, values: Floats, limit: float, turn: Floats, torque: Floats) -> Floats:
    """Torsion (n,) by a table; nan beyond its limit."""
    beta, below_end, column = np.full(turn.size, math.nan), np.nextafter(breakpoints[0, -1], 0.0), 0
    for i in range(turn.size):
        if abs(torque[i]) <= limit:
            beta[i], column = interpolated(breakpoints, values, turn[i], torque[i], below_end, column)
    return beta


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
def mesh_state(
    mesh: MeshData, turn: Floats, eccentricity: Complexes, torque: Floats
) -> tuple[Floats, Floats]:
    """Backlash, load, pressure angle (3, n, 2, Z_R); torsion, gap, mean radius of the contacts (3, n)."""
    work, seen = scratch(mesh.constants), contacts_room(mesh.constants)
    teeth = np.empty((3, turn.size, 2, mesh.constants.flexspline_teeth))
    whole = np.empty((3, turn.size))
    for i in range(turn.size):
        count = touch_teeth(mesh, turn[i], eccentricity[i], work, seen)
        beta, gap, radius = spread(mesh, work, seen, count, torque[i], teeth[0, i], teeth[1, i], teeth[2, i])
        whole[0, i], whole[1, i], whole[2, i] = beta, gap, radius
    return teeth, whole


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
