"""A drive: mesh, kinematics and values, and what can be computed of it at reported angles and torques."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.model import compiled
from hd_diag.model.clearance import all_teeth
from hd_diag.model.load_sharing import forces
from hd_diag.model.torsion import Mesh, torsion
from hd_diag.model.torsion_map import TorsionMap
from hd_diag.model.transmission_error import Frame, Kinematics


@dataclass(frozen=True)
class Drive:
    """A harmonic drive in a joint.

    Parameters
    ----------
    mesh : Mesh
        Geometry, tooth compliance, eccentricity and runout.
    kinematics : Kinematics
        Ratio, which member is the output, phase.
    rated_torque : float
        [N m], positive.
    cup_compliance : float
        c_cup, torsion of cup and output per torque beyond the teeth's [rad/(N m)], not negative.

    Raises
    ------
    ValueError
        Naming what cannot be: the ratio against the teeth, a sign.
    """

    mesh: Mesh
    kinematics: Kinematics
    rated_torque: float
    cup_compliance: float = 0.0

    def __post_init__(self) -> None:
        self.kinematics.check(self.mesh.geometry)
        if not 0.0 < self.rated_torque < np.inf:
            raise ValueError(f"rated_torque must be positive, not {self.rated_torque} N m")
        if not 0.0 <= self.cup_compliance < np.inf:
            raise ValueError(f"cup_compliance must not be negative, not {self.cup_compliance} rad/(N m)")

    @cached_property
    def frame(self) -> Frame[float]:
        """How reported numbers map to the mesh and back."""
        return self.kinematics.frame(self.mesh.geometry, self.cup_compliance)


@dataclass(frozen=True)
class MeshState:
    """All tooth pairs at some moments. Flanks (+, -): counter-clockwise, clockwise.

    Attributes
    ----------
    backlash : ndarray, shape (moments, 2, Z_R)
        Circumferential, at zero torsion [m]; negative: interference; nan: cannot touch.
    load : ndarray, shape (moments, 2, Z_R)
        Normal forces [N].
    pressure_angle : ndarray, shape (moments, 2, Z_R)
        [rad]; nan where the pair cannot touch.
    torsion : ndarray, shape (moments,)
        Rotation of the cup [rad].
    lost_motion : ndarray, shape (moments,)
        Gap at zero torque [rad].
    overlap : ndarray, shape (moments,)
        How far the lobes press against each other at zero torque: circumferential, at the contacts [m];
        negative: the clearance that is left.
    """

    backlash: Floats
    load: Floats
    pressure_angle: Floats
    torsion: Floats
    lost_motion: Floats
    overlap: Floats

    @property
    def loaded_pairs(self) -> npt.NDArray[np.int64]:
        """Number of flanks that bear load, shape (moments,)."""
        return np.asarray(np.count_nonzero(self.load > 0.0, axis=(1, 2)), dtype=np.int64)

    @property
    def peak_load(self) -> Floats:
        """Largest normal force [N], shape (moments,)."""
        return np.asarray(self.load.max(axis=(1, 2)))

    @property
    def load_concentration(self) -> Floats:
        """Largest force over the mean of the loaded flanks [-], 1 where none is loaded; shape (moments,)."""
        loaded = np.maximum(self.loaded_pairs, 1)
        mean = self.load.sum(axis=(1, 2)) / loaded
        return np.where(mean > 0.0, self.peak_load / np.where(mean > 0.0, mean, 1.0), 1.0)

    @property
    def minimum_backlash(self) -> Floats:
        """Least backlash over all flanks [m], shape (moments,)."""
        return np.asarray(np.nanmin(self.backlash, axis=(1, 2)))

    @property
    def interference(self) -> npt.NDArray[np.bool_]:
        """Whether no rotation of the cup frees all teeth: the lobes press against each other; (moments,)."""
        return np.asarray(self.overlap > 0.0)


def mesh_state(drive: Drive, input_angle: Floats, cup_torque: Floats) -> MeshState:
    """Backlash and load of every tooth.

    Parameters
    ----------
    drive : Drive
    input_angle : ndarray, shape (moments,)
        As reported [rad].
    cup_torque : ndarray, shape (moments,)
        Torque that turns the cup [N m]; :meth:`Frame.cup_torque` gives it from the link's.

    Returns
    -------
    MeshState
    """
    mesh = drive.mesh
    turn = drive.frame.wave_generator_angle(input_angle)
    if not compiled.available():
        return _mesh_state(mesh, turn, cup_torque)
    found = compiled.mesh_state(
        mesh.geometry, mesh.tooth_compliance, turn, mesh.displacement(turn), mesh.arc_offset, cup_torque
    )
    teeth = found.backlash, found.load, found.pressure_angle, found.torsion
    return MeshState(*teeth, lost_motion=np.maximum(found.gap, 0.0), overlap=-found.gap * found.radius)


def _mesh_state(mesh: Mesh, turn: Floats, cup_torque: Floats) -> MeshState:
    """The same by numpy."""
    geometry, contact = mesh.geometry, mesh.contacts(turn)
    beta = mesh.share_load(contact, cup_torque).torsion
    gap = np.fmin.reduce(contact.rotation, axis=2, initial=np.inf).sum(axis=1)
    return MeshState(
        backlash=all_teeth(geometry, contact, contact.backlash),
        load=all_teeth(geometry, contact, forces(contact, mesh.tooth_compliance, beta), missing=0.0),
        pressure_angle=all_teeth(geometry, contact, contact.pressure_angle),
        torsion=beta,
        lost_motion=np.maximum(gap, 0.0),
        overlap=-gap * np.nanmean(contact.radius, axis=(1, 2)),
    )


def transmission_error(
    drive: Drive, input_angle: Floats, torque: Floats, table: TorsionMap | None = None
) -> Floats:
    """Predicted transmission error.

    Parameters
    ----------
    drive : Drive
    input_angle : ndarray, shape (n,)
        As reported [rad].
    torque : ndarray, shape (n,)
        What the drive exerts on the link [N m].
    table : TorsionMap, optional
        Map of this drive's mesh; where it does not reach, and without one, the solution is exact.

    Returns
    -------
    ndarray, shape (n,)
        ``theta_out - theta_in / ratio`` [rad].
    """
    angle = drive.frame.wave_generator_angle(input_angle)
    cup_torque = drive.frame.cup_torque(torque)
    if table is None:
        beta = torsion(drive.mesh, angle, cup_torque)
    else:
        beta = table(angle, cup_torque)
        beyond = np.isnan(beta)
        if beyond.any():
            beta[beyond] = torsion(drive.mesh, angle[beyond], cup_torque[beyond])
    return drive.frame.transmission_error(beta, torque)


class Drives:
    """Several drives: what :func:`transmission_error` gives for each, to the last bit.

    Parameters
    ----------
    drives : sequence of Drive
        The k drives.
    """

    def __init__(self, drives: Sequence[Drive]) -> None:
        self._meshes = [drive.mesh for drive in drives]
        self._columns = np.array([astuple(drive.frame) for drive in drives]).T
        self._numbers = np.arange(len(drives) + 1)

    def transmission_error(
        self, number: Integers, input_angle: Floats, torque: Floats, tables: Sequence[TorsionMap | None]
    ) -> Floats:
        """Predicted transmission error of samples of any of the drives.

        Parameters
        ----------
        number : ndarray of int64, shape (n,)
            Of the sample's drive, 0 to k - 1.
        input_angle, torque : ndarray, shape (n,)
            As reported [rad]; what the drives exert on their links [N m].
        tables : sequence of k TorsionMap or None
            Maps of the drives' meshes.

        Returns
        -------
        ndarray, shape (n,)
            [rad]
        """
        frame = self._frame(number)
        order = np.argsort(number, kind="stable")
        turn = frame.wave_generator_angle(input_angle).take(order)
        cup_torque = frame.cup_torque(torque).take(order)
        found, beta = np.full(number.size, np.nan), np.empty(number.size)
        ends = number.take(order).searchsorted(self._numbers).tolist()
        for table, first, last in zip(tables, ends[:-1], ends[1:], strict=True):
            if table is not None and first < last:
                table.read(turn, cup_torque, found, first, last)
        if math.isnan(found.sum()):
            self._solve(number.take(order), turn, cup_torque, found)
        beta[order] = found
        return frame.transmission_error(beta, torque)

    def measured_error(self, number: Integers, input_angle: Floats, output_angle: Floats) -> Floats:
        """Measured error of samples [rad], shape (n,)."""
        return self._frame(number).measured_error(input_angle, output_angle)

    def _frame(self, number: Integers) -> Frame[Floats]:
        return Frame(*self._columns.take(number, axis=1))

    def _solve(self, number: Integers, turn: Floats, cup_torque: Floats, beta: Floats) -> None:
        """Set the torsions that no map gave."""
        missing = np.isnan(beta)
        for mesh, drive in zip(self._meshes, self._numbers, strict=False):
            rows = np.flatnonzero(missing & (number == drive))
            if rows.size:
                beta[rows] = torsion(mesh, turn[rows], cup_torque[rows])
