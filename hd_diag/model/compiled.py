"""The contact model compiled: the numbers of ``clearance`` and ``load_sharing``, some twenty times as fast.

``torsion`` and ``torsion_map`` choose it where they can. numba is optional: where it is missing
:func:`available` is False and they keep to numpy. It is imported when something is first computed, which
takes some 0.3 s; compiling takes some 15 s once, for the machine code is kept on disk. :func:`warm_up` does
both beforehand. Large batches are spread over the cores that the process may use.
"""

from __future__ import annotations

import functools
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Complexes, Floats
from hd_diag.model.clearance import Contact
from hd_diag.model.geometry import Geometry
from hd_diag.model.threads import spread

if TYPE_CHECKING:
    from hd_diag.model.kernel.teeth import MeshData


# Rows that a thread takes at a time: some 0.4 ms of work, where a thread costs 0.1 ms.
_MOMENTS = 50
_SAMPLES = 10_000
_BEYOND = 1.0  # both sides of zero are solved, also without torque [N m]

# What the columns of a gradient are taken by.
PARAMETERS = (
    "eccentricity.x",
    "eccentricity.y",
    "circular_spline_datum",
    "tooth_compliance",
    "arc_offset",
    "torque",
    "wave_generator_angle",
)


@functools.cache
@functools.cache
def _kernel() -> ModuleType:
    from hd_diag.model.kernel import entry

    return entry


@functools.cache
def available() -> bool:
    """Whether numba is there and works with this numpy; the first call imports it."""
    try:
        _kernel()
    except ImportError:
        return False
    return True


def warm_up(gradient: bool = False) -> None:
    """Compile now, or read from the disk, what predictions and maps need; nothing where numba is missing.

    Parameters
    ----------
    gradient : bool
        Also what fits need.
    """
    if not available():
        return
    from hd_diag.model.kernel.constants import blank

    kernel, mesh, row, rows = _kernel(), blank(), np.empty(0), np.zeros((2, 2))
    center = row.astype(np.complex128)
    kernel.torsion(mesh, row, center, row, row, 0, 0)
    kernel.torsion_table(mesh, row, center, row, 0)
    kernel.curves(mesh, row, center, 0.0)
    kernel.contacts(mesh, row, center, 0.0)
    kernel.mesh_state(mesh, row, center, row, np.empty((3, 0, 2, 0)), np.empty((3, 0)), 0, 0)
    kernel.interpolate(*table(rows, rows), 0.0, row, row, row, 0, 0)
    if gradient:
        kernel.torsion_and_gradient(mesh, row, center, row)
        kernel.torsion_along(mesh, row, center, 0.0, row.astype(np.int64), row, row)


def torsion(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    cup_torque: float | Floats,
) -> Floats:
    """Torsion at one torque per moment, as ``load_sharing.torsion`` gives it.

    Parameters
    ----------
    geometry : Geometry
    tooth_compliance : float
        K1 + K2 of a tooth pair [m/N].
    wave_generator_angle : ndarray, shape (n,)
        theta_W [rad].
    eccentricity : complex or ndarray of complex, shape (n,)
        Displacement of the wave generator's centre in the housing, runout included, x + iy [m].
    arc_offset : float
        s_0 [m].
    cup_torque : float or ndarray, shape (n,)
        M [N m].

    Returns
    -------
    ndarray, shape (n,)
        beta [rad]; the middle of a true gap at zero torque; nan if no flank can bear the torque.
    """
    moments = _moments(wave_generator_angle, eccentricity, cup_torque)
    beta = np.empty(moments[0].size)
    mesh = _mesh(geometry, tooth_compliance, arc_offset)
    spread(partial(_kernel().torsion, mesh, *moments, beta), beta.size, _MOMENTS)
    return beta


def torsion_table(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    cup_torque: Floats,
    branch: int = 0,
) -> Floats:
    """Torsion at the same rising torques at every moment: the contacts are solved and sorted once per moment.

    Parameters
    ----------
    geometry, tooth_compliance, wave_generator_angle, eccentricity, arc_offset
        As for :func:`torsion`.
    cup_torque : ndarray, shape (q,)
        M [N m], rising.
    branch : {-1, 0, 1}
        What stands at zero torque in a true gap: its lower end (limit from below), middle, upper end.

    Returns
    -------
    ndarray, shape (n, q)
        beta [rad].

    Raises
    ------
    ValueError
        If the torques do not rise.
    """
    torque = _contiguous(cup_torque)
    if not np.all(torque[1:] >= torque[:-1]):
        raise ValueError("torsion_table: cup_torque must rise [N m]")
    turn, center, _ = _moments(wave_generator_angle, eccentricity, 0.0)
    mesh = _mesh(geometry, tooth_compliance, arc_offset)
    beta: Floats = _kernel().torsion_table(mesh, turn, center, torque, int(branch))
    return beta


def limited_curves(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    torque_limit: float,
) -> tuple[Floats, Floats]:
    """Piecewise-linear torsion over torque at every moment, as ``torsion.limited_curves`` gives it.

    Parameters
    ----------
    geometry, tooth_compliance, wave_generator_angle, eccentricity, arc_offset
        As for :func:`torsion`.
    torque_limit : float
        [N m]

    Returns
    -------
    torque, torsion : ndarray, shape (n, breakpoints)
        M [N m] and beta [rad], rising; rows with fewer breakpoints end with more of the limit.
    """
    turn, center, _ = _moments(wave_generator_angle, eccentricity, 0.0)
    mesh = _mesh(geometry, tooth_compliance, arc_offset)
    torque, beta = _kernel().curves(mesh, turn, center, float(torque_limit))
    return torque, beta


class Table(NamedTuple):
    """A map as :func:`interpolate` reads it: torques [N m], torsions [rad] (rows, columns), an index."""

    breakpoints: Floats
    values: Floats
    near: npt.NDArray[np.int16]


def table(breakpoints: Floats, values: Floats) -> Table:
    """What :func:`interpolate` takes.

    Parameters
    ----------
    breakpoints, values : ndarray, shape (rows, columns)
        The map's torques [N m] and torsions [rad].

    Returns
    -------
    Table
    """
    torque = _contiguous(breakpoints)
    return Table(torque, _contiguous(values), _kernel().index(torque))


def interpolate(table: Table, torque_limit: float, wave_generator_angle: Floats, torque: Floats) -> Floats:
    """Torsion by a ``TorsionMap``, equal to the last bit.

    Parameters
    ----------
    table : Table
    torque_limit : float
        [N m]
    wave_generator_angle, torque : ndarray, shape (n,)
        theta_W [rad], M [N m].

    Returns
    -------
    ndarray, shape (n,)
        beta [rad]; nan beyond the limit.
    """
    turn, load = _contiguous(wave_generator_angle), _contiguous(torque)
    if turn.shape != load.shape:
        raise ValueError(f"interpolate: {turn.size} wave generator angles, but {load.size} torques")
    beta = np.empty(turn.size)
    read = partial(_kernel().interpolate, *table, float(torque_limit), turn, load, beta)
    spread(read, beta.size, _SAMPLES)
    return beta


def interpolate_rows(
    table: Table,
    torque_limit: float,
    wave_generator_angle: Floats,
    torque: Floats,
    beta: Floats,
    first: int,
    last: int,
) -> None:
    """Set some of the torsions [rad] as :func:`interpolate` does; all are contiguous already."""
    _kernel().interpolate(*table, torque_limit, wave_generator_angle, torque, beta, first, last)


def torsion_and_gradient(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    cup_torque: float | Floats,
) -> tuple[Floats, Floats, Floats]:
    """Torsion, its stiffness and its derivatives by every parameter of the mesh, in one pass.

    Parameters
    ----------
    geometry, tooth_compliance, wave_generator_angle, eccentricity, arc_offset, cup_torque
        As for :func:`torsion`.

    Returns
    -------
    torsion : ndarray, shape (n,)
        beta [rad].
    stiffness : ndarray, shape (n,)
        dM/dbeta [N m/rad]; zero in a true gap.
    gradient : ndarray, shape (n, 7)
        Derivatives of beta by :data:`PARAMETERS`: E_x, E_y in the housing [rad/m], r_0 [rad/m],
        K1 + K2 [rad N/m], s_0 [rad/m], M [rad/(N m)] (infinite in a true gap), theta_W at constant E [-].

    Notes
    -----
    ``K d beta`` is the sum of ``k db - (beta - b) dk`` over the loaded + flanks less that of
    ``k db - (-beta - b) dk`` over the loaded - flanks. By the envelope theorem db is the tooth's motion
    against the contact's normal over the lever arm; ``k = (r cos alpha)^2 / (K1 + K2)`` changes too, for
    conformal arcs turn their normal fast. Tip radii stay when the datum moves. beta has kinks where a flank
    begins to bear; there the gradient is that of one side.
    """
    moments = _moments(wave_generator_angle, eccentricity, cup_torque)
    mesh = _mesh(geometry, tooth_compliance, arc_offset)
    beta, stiffness, gradient = _kernel().torsion_and_gradient(mesh, *moments)
    return beta, stiffness, gradient


def torsion_along(
    geometry: Geometry,
    tooth_compliance: float,
    node_angle: Floats,
    node_eccentricity: Complexes,
    arc_offset: float,
    place: Floats,
    cup_torque: Floats,
) -> tuple[Floats, Floats]:
    """Torsion and its derivatives along many samples, solved at nodes and straight between them.

    At a node they are exact at every torque; what breaks where a pair comes into load is blurred by one step.

    Parameters
    ----------
    geometry, tooth_compliance, arc_offset
        As for :func:`torsion`.
    node_angle : ndarray, shape (nodes,)
        theta_W [rad].
    node_eccentricity : ndarray of complex, shape (nodes,)
        Displacement of the wave generator's centre there [m].
    place : ndarray, shape (n,)
        Of the samples, in numbers of nodes, 0 to nodes - 1.
    cup_torque : ndarray, shape (n,)
        M [N m].

    Returns
    -------
    torsion : ndarray, shape (n,)
        beta [rad]; the middle of a true gap at zero torque; nan where no flank can bear the greatest torque.
    gradient : ndarray, shape (n, 4)
        By E_x, E_y in the housing [rad/m], r_0 [rad/m] and M [rad/(N m)].
    """
    turn, center, _ = _moments(node_angle, node_eccentricity, 0.0)
    cell = np.minimum(place.astype(np.int64), turn.size - 2)
    order = np.argsort(cell.astype(np.int32), kind="stable")
    share = (place - cell)[order]
    load = _contiguous(cup_torque[order])
    limit = float(np.max(np.abs(load), initial=0.0)) + _BEYOND
    mesh = _mesh(geometry, tooth_compliance, arc_offset)
    found = np.empty((place.size, 5))
    found[order] = _kernel().torsion_along(mesh, turn, center, limit, cell[order], share, load)
    return found[:, 4], found[:, :4]


class TeethState(NamedTuple):
    """All teeth at n moments.

    Backlash D [m], normal force F [N] and pressure angle alpha [rad] of every flank, (n, 2, Z_R); torsion
    beta [rad], gap at zero torque [rad] (negative: preload) and mean radius of the contacts [m], (n,).
    """

    backlash: Floats
    load: Floats
    pressure_angle: Floats
    torsion: Floats
    gap: Floats
    radius: Floats


def mesh_state(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    cup_torque: float | Floats,
) -> TeethState:
    """Backlash and load of every tooth, contacts and load distribution solved together.

    Parameters
    ----------
    geometry, tooth_compliance, wave_generator_angle, eccentricity, arc_offset, cup_torque
        As for :func:`torsion`.

    Returns
    -------
    TeethState
        As ``clearance`` and ``load_sharing`` give them; torsion as :func:`torsion`, to the last bit.
    """
    moments = _moments(wave_generator_angle, eccentricity, cup_torque)
    n = moments[0].size
    teeth, whole = np.empty((3, n, 2, geometry.flexspline_teeth)), np.empty((3, n))
    mesh = _mesh(geometry, tooth_compliance, arc_offset)
    spread(partial(_kernel().mesh_state, mesh, *moments, teeth, whole), n, _MOMENTS)
    return TeethState(*teeth, *whole)


def contacts(
    geometry: Geometry,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float = 0.0,
    farthest: float | None = None,
) -> Contact:
    """Contacts of the tooth pairs near both lobes, as ``clearance.contacts`` gives them.

    Parameters
    ----------
    geometry, wave_generator_angle, eccentricity, arc_offset, farthest
        As for ``clearance.contacts``.

    Returns
    -------
    Contact
    """
    turn, center, _ = _moments(wave_generator_angle, eccentricity, 0.0)
    if farthest is None:
        farthest = float(np.max(np.abs(center), initial=0.0))
    indices, values = _kernel().contacts(_mesh(geometry, 1.0, arc_offset), turn, center, float(farthest))
    return Contact(*indices, *values)


def _moments(
    turn: Floats, eccentricity: complex | Complexes, torque: float | Floats
) -> tuple[Floats, Complexes, Floats]:
    """One value per moment, in the layout that kernels are compiled for."""
    angle, load = _contiguous(turn), _contiguous(torque)
    center = np.ascontiguousarray(eccentricity, dtype=np.complex128)
    if center.shape != angle.shape or not center.flags.writeable:
        center = np.full(angle.shape, center)
    if load.shape != angle.shape:
        load = np.full(angle.shape, load)
    return angle, center, load


def _contiguous(values: float | Floats) -> Floats:
    """Contiguous and free to be written to: numba would compile anew for anything else."""
    found = np.ascontiguousarray(values, dtype=np.float64)
    return found if found.flags.writeable else found.copy()


def _mesh(geometry: Geometry, tooth_compliance: float, arc_offset: float) -> MeshData:
    from hd_diag.model.kernel.constants import mesh

    return mesh(geometry, float(tooth_compliance), float(arc_offset))
