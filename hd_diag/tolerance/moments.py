"""Everything that is judged of a mesh, at many moments and torques at once."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.model import clearance, compiled, load_sharing
from hd_diag.model.clearance import Contact
from hd_diag.model.torsion import Mesh

_SIDES = np.array([1.0, -1.0])[:, None]  # of flanks +, -


@dataclass(frozen=True)
class Moments:
    """Quantities of n moments, those under load at q torques.

    Attributes
    ----------
    interference : ndarray, shape (n,)
        How far the teeth at lobe 0 overlap with the slots, circumferential [m]: the least backlash of their
        flanks with the opposite sign, the tooth at the lobe held on the axis (see :func:`evaluate`).
    overlap : ndarray, shape (n,)
        How far both lobes press against each other at zero torque, circumferential [m]; negative: clearance.
        Above zero no rotation of the cup frees all teeth.
    torsion : ndarray, shape (n, q)
        beta [rad].
    stiffness : ndarray, shape (n, q)
        dM/dbeta of the teeth [N m/rad].
    peak_load : ndarray, shape (n, q)
        Largest normal force on a flank [N].
    load_concentration : ndarray, shape (n, q)
        Largest over mean force of the loaded flanks [-]; 1 where none is.
    """

    interference: Floats
    overlap: Floats
    torsion: Floats
    stiffness: Floats
    peak_load: Floats
    load_concentration: Floats


def evaluate(
    mesh: Mesh,
    wave_generator_angle: Floats,
    displacement: Complexes,
    torque: Floats,
    slot_angle: Floats | None = None,
) -> Moments:
    """Quantities of a mesh at any number of moments.

    Parameters
    ----------
    mesh : Mesh
        Gives geometry and compliance; its eccentricity and runout do not count.
    wave_generator_angle : ndarray, shape (n,)
        theta_W [rad].
    displacement : ndarray of complex, shape (n,)
        Of the wave generator's centre in the housing, x + iy [m].
    torque : ndarray, shape (q,)
        M on the cup [N m].
    slot_angle : ndarray, shape (Z_G,), optional
        By how much each slot stands counter-clockwise of its place [rad].

    Returns
    -------
    Moments
        nan where no flank can bear the torque.

    Notes
    -----
    Interference as in Dong et al. (2019), section 4.2: tooth 0 stays on the axis although the wave generator
    is displaced across it (eq. 1), hence the arc offset ``s_0 = -E_across``; a tooth's backlash is the lesser
    of its two flanks; the least of the lobe at tooth 0 counts, for at the other lobe the displacement points
    the other way.
    """
    turn = np.ascontiguousarray(wave_generator_angle, dtype=np.float64)
    center = np.ascontiguousarray(displacement, dtype=np.complex128)
    across: Floats = np.imag(center * np.exp(-1j * turn))
    slots = np.zeros(mesh.geometry.circular_spline_teeth) if slot_angle is None else slot_angle
    solve = _compiled if compiled.available() else _by_numpy
    return solve(mesh, turn, center, -across, slots, np.asarray(torque, dtype=np.float64))


def warm_up() -> None:
    """Compile now, or read from the disk, the model's kernels and that of :func:`evaluate`.

    Does nothing where numba is missing.
    """
    if not compiled.available():
        return
    compiled.warm_up()
    from hd_diag.model.kernel.constants import blank

    row = np.empty(0)
    _kernel().moments(blank(), row, row.astype(np.complex128), row, row, row)


@functools.cache
def _kernel() -> ModuleType:
    from hd_diag.tolerance import kernel

    return kernel


def _compiled(
    mesh: Mesh, turn: Floats, center: Complexes, anchor: Floats, slots: Floats, torque: Floats
) -> Moments:
    from hd_diag.model.kernel.constants import mesh as numbers

    data = numbers(mesh.geometry, mesh.tooth_compliance, mesh.arc_offset)
    arrays = (np.ascontiguousarray(a).copy() for a in (anchor, slots, torque))
    geometry, loads = _kernel().moments(data, turn, center, *arrays)
    gap, least, radius = geometry.T
    return Moments(-least, -gap * radius, *(loads[:, :, k] for k in range(4)))


def _by_numpy(
    mesh: Mesh, turn: Floats, center: Complexes, anchor: Floats, slots: Floats, torque: Floats
) -> Moments:
    contact = _displaced(clearance.contacts(mesh.geometry, turn, center, mesh.arc_offset), slots)
    stiffness = load_sharing.flank_stiffness(contact, mesh.tooth_compliance)
    beta = load_sharing.torsion(load_sharing.torque_curve(contact.rotation, stiffness), torque)
    load = [_load(mesh, contact, stiffness, column) for column in beta.T]
    gap = np.fmin.reduce(contact.rotation, axis=2, initial=np.inf).sum(axis=1)
    least, radius = _lobe(mesh, turn, center, anchor, slots)
    columns = (np.stack(part, axis=1) for part in zip(*load, strict=True))
    idle = (torque == 0.0) & (gap > 0.0)[:, None]
    bearing, peak, concentration = columns
    return Moments(-least, -gap * radius, beta, np.where(idle, 0.0, bearing), peak, concentration)


def _displaced(contact: Contact, slot_angle: Floats) -> Contact:
    shift = slot_angle[contact.slots][:, None, :] * _SIDES
    return dataclasses.replace(contact, rotation=contact.rotation + shift)


def _load(mesh: Mesh, contact: Contact, stiffness: Floats, beta: Floats) -> tuple[Floats, Floats, Floats]:
    """Stiffness of the loaded flanks, peak force, peak over mean force, each (n,)."""
    force = load_sharing.forces(contact, mesh.tooth_compliance, beta)
    loaded, total = force > 0.0, force.sum(axis=(1, 2))
    peak: Floats = force.max(axis=(1, 2))
    mean = total / np.maximum(np.count_nonzero(loaded, axis=(1, 2)), 1)
    concentration = np.where(mean > 0.0, peak / np.where(mean > 0.0, mean, 1.0), 1.0)
    bearing = np.sum(np.where(loaded, stiffness, 0.0), axis=(1, 2))
    known = np.isfinite(beta)
    return bearing, np.where(known, peak, np.nan), np.where(known, concentration, np.nan)


def _lobe(
    mesh: Mesh, turn: Floats, center: Complexes, anchor: Floats, slots: Floats
) -> tuple[Floats, Floats]:
    """Least backlash at lobe 0 and mean radius of the contacts there [m], each (n,)."""
    # One arc offset per moment: it broadcasts, though the model asks for one.
    held = clearance.contacts(mesh.geometry, turn, center, anchor)  # type: ignore[arg-type]
    held = _displaced(held, slots)
    lobe = slice(held.teeth.shape[1] // 2)
    return np.nanmin(held.backlash[:, :, lobe], axis=(1, 2)), np.nanmean(held.radius[:, :, lobe], axis=(1, 2))
