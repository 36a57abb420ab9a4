"""What a drive is, in the numbers of its catalogue page and of its assembly: what a user can compare."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import Drive
from hd_diag.model.geometry import Geometry
from hd_diag.model.load_sharing import mesh_state
from hd_diag.model.mesh import Mesh, largest_displacement
from hd_diag.model.torsion import torsion, torsion_table

T1_SHARE, T2_SHARE = 0.25, 0.86
"""Torques T1 and T2 over the rated torque where no page gives them [-]."""

SMALLEST_SHARE = 1.0 / 14.0
"""Torque over T1 from which K1 is measured [-]: below it the gap is taken up."""

ECCENTRICITY = 10e-6
"""At which the error per eccentricity is taken [m]."""

_PHASES = 16  # in a slot pitch
_MOMENTS = 128  # of a turn
_ERROR_MOMENTS = 1009  # of a turn, a prime: no order of the teeth looks like order 2


@dataclass(frozen=True)
class Characteristics:
    """A drive as it is configured, over a turn of the wave generator.

    Attributes
    ----------
    module : float
        Of the flexspline's neutral layer, 2 R_b / Z_R [m].
    t1, t2 : float
        Torques of the steps of the stiffness [N m].
    stiffness : ndarray, shape (3,)
        K1, K2, K3, secants T1/14 to T1, T1 to T2, T2 to 2 T2 of the mean torsion [N m/rad]; nan where the
        teeth cannot bear the torque.
    lost_motion : float
        Greatest gap without torque [rad].
    least_backlash : float
        Of all teeth without torque, cup in the middle as built [m]; negative: interference at a lobe.
    overlap : float
        By which both lobes press against each other without torque [m]; negative: clearance.
    idle_load, rated_load : float
        Largest force on a flank without torque, and at the rated torque [N]; nan: cannot be borne.
    error_per_eccentricity : float
        Amplitude of order 2 of the wave generator at half the rated torque, over the eccentricity [rad/m].
    """

    module: float
    t1: float
    t2: float
    stiffness: Floats
    lost_motion: float
    least_backlash: float
    overlap: float
    idle_load: float
    rated_load: float
    error_per_eccentricity: float


class ToothLoads(NamedTuple):
    """What teeth bear over a turn of the wave generator, and by what the lobes press against each other.

    Attributes
    ----------
    overlap : float
        Without torque [m]; negative: clearance.
    idle, rated : float
        Largest force on a flank without torque, and at the rated torque [N]; nan: cannot be borne.
    """

    overlap: float
    idle: float
    rated: float


@lru_cache(maxsize=512)
def tooth_loads(drive: Drive) -> ToothLoads:
    """What the teeth of a drive bear."""
    angle = _turn(_MOMENTS)
    idle = mesh_state(drive.mesh, angle, np.zeros(angle.size))
    rated = mesh_state(drive.mesh, angle, np.full(angle.size, drive.rated_torque))
    return ToothLoads(
        float(idle.overlap.max()),
        float(idle.peak_load.max()),
        float(rated.peak_load.max()) if np.isfinite(rated.torsion).all() else math.nan,
    )


def characteristics(drive: Drive, t1: float = 0.0, t2: float = 0.0) -> Characteristics:
    """Characteristics of a drive; T1 and T2 [N m] are shares of the rated torque where they are zero."""
    t1, t2 = t1 or T1_SHARE * drive.rated_torque, t2 or T2_SHARE * drive.rated_torque
    mesh, angle = drive.mesh, _turn(_MOMENTS)
    idle, found = mesh_state(mesh, angle, np.zeros(angle.size)), tooth_loads(drive)
    return Characteristics(
        mesh.geometry.module,
        t1,
        t2,
        secant_stiffness(mesh, drive.cup_compliance, t1, t2, angle),
        float(idle.lost_motion.max()),
        float(idle.minimum_backlash.min()),
        found.overlap,
        found.idle,
        found.rated,
        _error_per_eccentricity(drive),
    )


def secant_stiffness(mesh: Mesh, cup: float, t1: float, t2: float, angle: Floats | None = None) -> Floats:
    """K1, K2, K3 (3,) [N m/rad]: secants of the torsion, its mean over wave generator angles [rad].

    The cup's compliance [rad/(N m)] is added to the teeth's. Angles are by default those of a slot pitch,
    over which all repeats without eccentricity.
    """
    torque = np.array([SMALLEST_SHARE * t1, t1, t2, 2.0 * t2])
    turn = slot_phases(mesh.geometry) if angle is None else angle
    beta = torsion_table(mesh, turn, torque).mean(axis=0) + cup * torque
    return np.asarray(np.diff(torque) / np.diff(beta), dtype=np.float64)


def slot_shift(known: Geometry, geometry: Geometry) -> float:
    """By how much a similar geometry's slots lie further out than the module alone has them [m]."""
    deep = (known.semi_major - known.circular_spline_datum) * geometry.module / known.module
    return geometry.circular_spline_datum - (geometry.semi_major - deep)


def slot_phases(geometry: Geometry) -> Floats:
    """Wave generator angles [rad] in a slot pitch of the circular spline."""
    return geometry.slot_pitch / _PHASES * np.arange(_PHASES, dtype=np.float64)


def _turn(count: int) -> Floats:
    """Angles of a turn [rad] by golden section: they meet every phase of the teeth evenly."""
    share: Floats = 0.6180339887498949 * np.arange(count, dtype=np.float64) % 1.0
    return 2.0 * np.pi * share


def _error_per_eccentricity(drive: Drive) -> float:
    size = min(ECCENTRICITY, 0.5 * largest_displacement(drive.mesh.geometry)[0])
    mesh = replace(drive.mesh, eccentricity=size, runout=0.0)
    angle = 2.0 * np.pi * np.arange(_ERROR_MOMENTS) / _ERROR_MOMENTS
    beta = torsion(mesh, angle, 0.5 * drive.rated_torque)
    return float(2.0 * abs(np.mean(beta * np.exp(-2j * angle))) / size)
