"""A drive: mesh, kinematics and values; its mesh state and error at reported angles and torques."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hd_diag.arrays import Floats
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
        Peak-to-peak transmission error that the catalogue allows [rad], positive; it counts as normal.

    Raises
    ------
    ValueError
        If a value is impossible: a ratio that does not fit the teeth, or a wrong sign.
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

    def __repr__(self) -> str:
        geometry, ratio = self.mesh.geometry, self.kinematics.ratio
        return (
            f"<Drive: ratio {ratio:g}, {geometry.flexspline_teeth}/{geometry.circular_spline_teeth} teeth, "
            f"rated {self.rated_torque:g} N m, eccentricity {1e6 * abs(self.mesh.eccentricity):.3g} µm>"
        )

    @cached_property
    def frame(self) -> Frame:
        """How reported numbers map to the mesh and back."""
        return self.kinematics.frame(self.mesh.geometry, self.cup_compliance)


def mesh_state(drive: Drive, input_angle: Floats, cup_torque: Floats) -> MeshState:
    """Backlash and load of every tooth at reported input angles [rad] and torques on the cup [N m].

    :meth:`Frame.cup_torque` converts torques on the link to torques on the cup.
    """
    return load_sharing.mesh_state(drive.mesh, drive.frame.wave_generator_angle(input_angle), cup_torque)


def transmission_error(
    drive: Drive, input_angle: Floats, torque: Floats, table: TorsionMap | None = None
) -> Floats:
    """Predicted transmission error ``theta_out - theta_in / ratio`` (n,) [rad].

    Arguments are reported input angles (n,) [rad] and torques that the drive exerts on the link (n,) [N m].
    The table is a map of this drive's mesh. Without one, and beyond its range, the solution is exact.
    """
    angle = drive.frame.wave_generator_angle(input_angle)
    cup_torque = drive.frame.cup_torque(torque)
    beta = np.full(angle.shape, np.nan) if table is None else table(angle, cup_torque)
    missing = np.flatnonzero(np.isnan(beta))
    if missing.size:
        beta[missing] = torsion(drive.mesh, angle[missing], cup_torque[missing])
    return drive.frame.transmission_error(beta, torque)
