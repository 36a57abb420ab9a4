"""Torsion of a mesh: the pose, contact and load solution in one call, for any number of moments."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.model import clearance, compiled, load_sharing
from hd_diag.model.clearance import Contact
from hd_diag.model.geometry import Geometry


@dataclass(frozen=True)
class Mesh:
    """A geometry with what assembly and material add to it.

    Parameters
    ----------
    geometry : Geometry
    tooth_compliance : float
        K1 + K2 of a tooth pair [m/N].
    eccentricity : complex
        E, displacement of the wave generator's centre fixed in the housing, x + iy [m].
    runout : complex
        The part that turns with the wave generator, at theta_W = 0 [m].
    arc_offset : float
        s_0, shift of the teeth along the neutral curve [m].

    Raises
    ------
    ValueError
        Naming the value that cannot be; for eccentricity and runout together, the largest sum that can.
    """

    geometry: Geometry
    tooth_compliance: float = 1.0e-6
    eccentricity: complex = 0.0
    runout: complex = 0.0
    arc_offset: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.tooth_compliance < math.inf:
            raise ValueError(
                f"tooth_compliance must be positive and finite, not {self.tooth_compliance:g} m/N"
            )
        if not math.isfinite(self.arc_offset):
            raise ValueError(f"arc_offset must be finite, not {self.arc_offset:g} m")
        _check_displacement(self)

    def displacement(self, wave_generator_angle: Floats) -> npt.NDArray[np.complex128]:
        """Where the wave generator's centre is at theta_W [rad]: x + iy in the housing [m]."""
        turning: npt.NDArray[np.complex128] = np.exp(1j * wave_generator_angle)
        return self.eccentricity + self.runout * turning

    def contacts(self, wave_generator_angle: Floats) -> Contact:
        """Contacts at theta_W [rad], shape (moments,)."""
        displacement = self.displacement(wave_generator_angle)
        farthest = abs(self.eccentricity) + abs(self.runout)
        solve = compiled.contacts if compiled.available() else clearance.contacts
        return solve(self.geometry, wave_generator_angle, displacement, self.arc_offset, farthest)

    def share_load(self, contact: Contact, torque: Floats) -> load_sharing.LoadSharing:
        """Load distribution at the cup torque M [N m], shape (moments,)."""
        return load_sharing.share_load(contact, self.tooth_compliance, torque)


def _check_displacement(mesh: Mesh) -> None:
    geometry = mesh.geometry
    tip_radius = geometry.circular_spline_tip_radius
    slot_end = geometry.circular_spline_datum + geometry.slot_end
    largest, place = min(
        (tip_radius - geometry.semi_major - geometry.flexspline_root, "root at the long axis"),
        (slot_end - geometry.semi_major - geometry.flexspline_tip, "tip at the long axis"),
        (tip_radius - geometry.semi_minor - geometry.flexspline_tip, "tip at the short axis"),
    )
    eccentricity, runout = abs(mesh.eccentricity), abs(mesh.runout)
    if not eccentricity + runout < largest:
        raise ValueError(
            f"eccentricity ({eccentricity * 1e6:.6g} um) and runout ({runout * 1e6:.6g} um) must add up to "
            f"less than {largest * 1e6:.6g} um, at which the flexspline's {place} strikes the circular spline"
        )


def torsion(mesh: Mesh, wave_generator_angle: Floats, torque: Floats) -> Floats:
    """Exact torsion at one torque per moment.

    Parameters
    ----------
    mesh : Mesh
    wave_generator_angle : ndarray, shape (moments,)
        theta_W [rad].
    torque : ndarray, shape (moments,)
        M on the cup [N m].

    Returns
    -------
    ndarray, shape (moments,)
        beta [rad]; the middle of a true gap at zero torque; nan if no flank can bear the torque.
    """
    if compiled.available():
        return compiled.torsion(*_pose(mesh, wave_generator_angle), torque)
    return load_sharing.torsion(_curve(mesh, wave_generator_angle), torque[:, None])[:, 0]


def torsion_table(mesh: Mesh, wave_generator_angle: Floats, torque: Floats) -> Floats:
    """Exact torsion at every pair of moment and torque.

    Parameters
    ----------
    mesh : Mesh
    wave_generator_angle : ndarray, shape (moments,)
        theta_W [rad].
    torque : ndarray, shape (torques,)
        M on the cup [N m].

    Returns
    -------
    ndarray, shape (moments, torques)
        beta [rad]; the middle of a true gap at zero torque; nan if no flank can bear the torque.
    """
    if not compiled.available():
        return load_sharing.torsion(_curve(mesh, wave_generator_angle), torque)
    order = np.argsort(torque)
    table = compiled.torsion_table(*_pose(mesh, wave_generator_angle), torque[order])
    return table[:, np.argsort(order)]


def limited_curves(mesh: Mesh, wave_generator_angle: Floats, torque_limit: float) -> tuple[Floats, Floats]:
    """Exact piecewise-linear torsion over torque at every moment, within a torque limit.

    Parameters
    ----------
    mesh : Mesh
    wave_generator_angle : ndarray, shape (moments,)
        theta_W [rad].
    torque_limit : float
        [N m]

    Returns
    -------
    torque, torsion : ndarray, shape (moments, breakpoints)
        Breakpoints M [N m] and beta [rad], rising, from -torque_limit to torque_limit; a true gap has two at
        zero torque. nan where no flank can bear the limit.
    """
    if compiled.available():
        return compiled.limited_curves(*_pose(mesh, wave_generator_angle), torque_limit)
    curve = _curve(mesh, wave_generator_angle)
    limits = np.array([-torque_limit, torque_limit])
    ends = load_sharing.torsion(curve, limits)
    ends[np.isnan(ends).any(axis=1)] = np.nan
    return _between(curve.torque, np.where(np.isnan(ends), np.nan, limits)), _between(curve.torsion, ends)


def _between(values: Floats, ends: Floats) -> Floats:
    """Rows of values, kept within their ends and put between them."""
    low, high = ends[:, :1], ends[:, 1:]
    return np.concatenate((low, np.clip(values, low, high), high), axis=1)


def _pose(
    mesh: Mesh, wave_generator_angle: Floats
) -> tuple[Geometry, float, Floats, npt.NDArray[np.complex128], float]:
    displacement = mesh.displacement(wave_generator_angle)
    return mesh.geometry, mesh.tooth_compliance, wave_generator_angle, displacement, mesh.arc_offset


def _curve(mesh: Mesh, wave_generator_angle: Floats) -> load_sharing.TorqueCurve:
    contact = mesh.contacts(wave_generator_angle)
    return load_sharing.torque_curve(
        contact.rotation, load_sharing.flank_stiffness(contact, mesh.tooth_compliance)
    )
