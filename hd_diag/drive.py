"""A drive: mesh, kinematics and values, and what can be computed of it at reported angles and torques."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cached_property

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model import load_sharing
from hd_diag.model.load_sharing import MeshState as MeshState
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion
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
    accuracy : float
        Transmission error that the catalogue allows, peak to peak [rad], positive: what counts as normal.

    Raises
    ------
    ValueError
        Naming what cannot be: the ratio against the teeth, a sign.
    """

    mesh: Mesh
    kinematics: Kinematics
    rated_torque: float
    cup_compliance: float = 0.0
    accuracy: float = 4.3633e-4  # 1.5 arcmin

    def __post_init__(self) -> None:
        self.kinematics.check(self.mesh.geometry)
        if not 0.0 < self.rated_torque < np.inf:
            raise ValueError(f"rated_torque must be positive, not {self.rated_torque} N m")
        if not 0.0 <= self.cup_compliance < np.inf:
            raise ValueError(f"cup_compliance must not be negative, not {self.cup_compliance} rad/(N m)")
        if not 0.0 < self.accuracy < np.inf:
            raise ValueError(f"accuracy must be positive, not {self.accuracy} rad")

    @cached_property
    def frame(self) -> Frame[float]:
        """How reported numbers map to the mesh and back."""
        return self.kinematics.frame(self.mesh.geometry, self.cup_compliance)


def mesh_state(drive: Drive, input_angle: Floats, cup_torque: Floats) -> MeshState:
    """Backlash and load of every tooth at reported input angles [rad] and torques on the cup [N m].

    :meth:`Frame.cup_torque` gives these from torques on the link.
    """
    return load_sharing.mesh_state(drive.mesh, drive.frame.wave_generator_angle(input_angle), cup_torque)


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
    beta = np.full(angle.shape, np.nan) if table is None else table(angle, cup_torque)
    _solve(drive.mesh, np.flatnonzero(np.isnan(beta)), angle, cup_torque, beta)
    return drive.frame.transmission_error(beta, torque)


def _solve(mesh: Mesh, rows: Integers, turn: Floats, cup_torque: Floats, beta: Floats) -> None:
    """Set the torsions that no map gave."""
    if rows.size:
        beta[rows] = torsion(mesh, turn[rows], cup_torque[rows])


class Drives:
    """Several drives: what :func:`transmission_error` gives for each, to the last bit."""

    def __init__(self, drives: Sequence[Drive]) -> None:
        self._meshes = [drive.mesh for drive in drives]
        self._columns = np.array([astuple(drive.frame) for drive in drives]).T
        self._numbers = np.arange(len(drives) + 1)

    def frame(self, number: Integers) -> Frame[Floats]:
        """Frames of the drives with these numbers, 0 to k - 1, side by side; shape (n,)."""
        columns = self._columns if len(self._meshes) == 1 else self._columns.take(number, axis=1)
        return Frame(*columns)

    def transmission_error(
        self,
        frame: Frame[Floats],
        number: Integers,
        input_angle: Floats,
        torque: Floats,
        tables: Sequence[TorsionMap | None],
    ) -> Floats:
        """Predicted transmission error (n,) [rad] of samples of any of the drives.

        The frame of the numbers (n,); input angles [rad] and torques on the links [N m] as reported (n,); a
        map, or none, of each drive's mesh.
        """
        order = number.argsort(kind="stable") if len(self._meshes) > 1 else slice(None)
        by_drive = number[order]
        turn, cup_torque = frame.wave_generator_angle(input_angle)[order], frame.cup_torque(torque)[order]
        found, beta = np.full(number.size, np.nan), np.empty(number.size)
        ends = by_drive.searchsorted(self._numbers).tolist()
        for table, first, last in zip(tables, ends[:-1], ends[1:], strict=True):
            if table is not None and first < last:
                table.read(turn, cup_torque, found, first, last)
        if math.isnan(found.sum()):
            for drive, mesh in enumerate(self._meshes):
                missing = np.flatnonzero(np.isnan(found) & (by_drive == drive))
                _solve(mesh, missing, turn, cup_torque, found)
        beta[order] = found
        return frame.transmission_error(beta, torque)
