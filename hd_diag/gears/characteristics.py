"""Characteristics of a drive that a user can compare: those of its catalogue page and of its assembly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import Drive
from hd_diag.gears.page import T1_SHARE, T2_SHARE
from hd_diag.model.contact import FLANKS, contacts
from hd_diag.model.geometry import Geometry
from hd_diag.model.load_sharing import FlankTorsion, flank_stiffness
from hd_diag.model.mesh import Mesh, largest_displacement

SMALLEST_SHARE = 1.0 / 14.0
"""Least torque over T1 at which K1 is measured [-]; below it the gap closes."""

ECCENTRICITIES = (5e-6, 10e-6, 20e-6)
"""Eccentricities at which the error is shown [m], because it is far from linear."""

_OF_ONE = 10e-6  # eccentricity at which the error per eccentricity is taken [m]

PHASES = 16
"""Wave generator angles in a slot pitch, if all slot pitches are alike."""

_MOMENTS = 128  # of a turn
_FINE_ECCENTRICITY = 0.02e-6  # resolution of the eccentricity that gives an overlap [m]
# Angles over half a turn (the error's period), and phases of a slot pitch at each: orders of teeth cancel.
_ERROR_MOMENTS, _ERROR_PHASES = 8, 3


class ToothLoads(NamedTuple):
    """Forces on teeth and overlap of the lobes, each the largest over a turn of the wave generator.

    Attributes
    ----------
    overlap : float
        Overlap of the lobes without torque [m]; negative for clearance.
    idle, rated : float
        Largest force on a flank without torque, and at the rated torque [N]; nan if it cannot be borne.
    """

    overlap: float
    idle: float
    rated: float


@dataclass(frozen=True)
class Characteristics:
    """Characteristics of a drive as configured, over a turn of the wave generator.

    Attributes
    ----------
    module : float
        Module of the flexspline's neutral layer, 2 R_b / Z_R [m].
    t1, t2 : float
        Torques at which the stiffness steps [N m].
    stiffness : ndarray, shape (3,)
        K1, K2, K3 [N m/rad]: secants of the mean torsion from T1/14 to T1, T1 to T2, T2 to 2 T2; nan where
        the teeth cannot bear the torque.
    lost_motion : float
        Greatest gap without torque [rad].
    least_backlash : float
        Least backlash of all teeth without torque, at zero torsion [m]; negative: interference at a lobe.
    loads : ToothLoads
    error_per_eccentricity : float
        Amplitude of order 2 of the wave generator at half the rated torque, over an eccentricity of 10 µm
        [rad/m].
    errors : tuple of (float, float)
        Eccentricities [m], each with that amplitude [rad].
    limit : (float, float)
        The eccentricity at which the overlap of the lobes is the most that an assembly may have [m], and its
        amplitude [rad]; nan if they overlap so far without eccentricity, or at none in the search range.
    """

    module: float
    t1: float
    t2: float
    stiffness: Floats
    lost_motion: float
    least_backlash: float
    loads: ToothLoads
    error_per_eccentricity: float
    errors: tuple[tuple[float, float], ...]
    limit: tuple[float, float]


class MeshOverTurn:
    """The teeth of a mesh at wave generator angles [rad] that stand for a whole turn.

    `torsion` gives rotations of the cup (moments, torques) [rad] at torques (torques,) [N m].
    """

    def __init__(self, mesh: Mesh, angle: Floats) -> None:
        # If both lobes are the same, one stands for both.
        is_same = mesh.is_centred and mesh.geometry.flexspline_teeth % 2 == 0
        self._lobes, self._sections = 2 - is_same, mesh.geometry.sections
        self._compliance, self._contact = mesh.tooth_compliance, contacts(mesh, angle, lobes=self._lobes)
        self._stiffness = flank_stiffness(self._contact, mesh.tooth_compliance)
        self.torsion = FlankTorsion(self._contact.rotation, (1.0 + is_same) * self._stiffness)

    def peak_load(self, torque: float) -> float:
        """Largest force on a flank [N]; nan if the teeth cannot bear the torque."""
        beta = self.torsion(np.array([torque]))[:, :, None]
        overlap = np.fmax(FLANKS * beta - self._contact.rotation, 0.0)
        weight = self._contact.weight
        force = overlap * np.sqrt(self._stiffness * weight / self._compliance)
        peak = float(force.reshape(*force.shape[:2], self._lobes, self._sections, -1).sum(axis=3).max())
        return peak if torque == 0.0 or np.isfinite(beta).all() else math.nan

    def lost_motion(self) -> float:
        """Greatest gap without torque [rad]."""
        return max(float(self.torsion.gap.max()), 0.0)

    def least_backlash(self) -> float:
        """Least backlash of all teeth without torque [m]."""
        return float(np.nanmin(self._contact.rotation * self._contact.radius))

    def overlap(self) -> float:
        """Overlap of both lobes without torque [m]; negative: clearance."""
        radius = np.where(np.isnan(self._contact.rotation), np.nan, self._contact.radius)
        return float((-self.torsion.gap * np.nanmean(radius, axis=(1, 2))).max())


@lru_cache(maxsize=512)
def tooth_loads(drive: Drive) -> ToothLoads:
    """Tooth loads of a drive; cached."""
    return _loads(MeshOverTurn(drive.mesh, _turn(drive.mesh)), drive.rated_torque)


def _loads(teeth: MeshOverTurn, rated_torque: float) -> ToothLoads:
    return ToothLoads(teeth.overlap(), teeth.peak_load(0.0), teeth.peak_load(rated_torque))


def characteristics(drive: Drive, t1: float = 0.0, t2: float = 0.0, overlap: float = 0.0) -> Characteristics:
    """Characteristics of a drive; a T1 or T2 of zero [N m] becomes a share of the rated torque.

    The overlap is the most that an assembly may have [m].
    """
    t1, t2 = t1 or T1_SHARE * drive.rated_torque, t2 or T2_SHARE * drive.rated_torque
    return _characteristics(drive.mesh, drive.rated_torque, drive.cup_compliance, t1, t2, overlap)


@lru_cache(maxsize=64)  # joints of an arm are alike
def _characteristics(
    mesh: Mesh, rated_torque: float, cup_compliance: float, t1: float, t2: float, overlap: float
) -> Characteristics:
    teeth, torque = MeshOverTurn(mesh, _turn(mesh)), stiffness_steps(t1, t2)
    beta = teeth.torsion(torque).mean(axis=0) + cup_compliance * torque
    too_much, half = largest_displacement(mesh.geometry)[0], 0.5 * rated_torque
    size, limit = min(_OF_ONE, 0.5 * too_much), _eccentricity_of_overlap(mesh, overlap)
    return Characteristics(
        mesh.geometry.module,
        t1,
        t2,
        np.asarray(np.diff(torque) / np.diff(beta), dtype=np.float64),
        teeth.lost_motion(),
        teeth.least_backlash(),
        _loads(teeth, rated_torque),
        _order_2(mesh, size, half) / size,
        tuple((each, _order_2(mesh, each, half)) for each in ECCENTRICITIES if each < 0.5 * too_much),
        (limit, _order_2(mesh, limit, half)),
    )


def mean_torsion(drive: Drive, torque: Floats) -> Floats:
    """Mean torsion over a turn (n,) [rad] at torques (n,) [N m], including the cup's."""
    teeth = MeshOverTurn(drive.mesh, _turn(drive.mesh))
    return np.asarray(teeth.torsion(torque).mean(axis=0) + drive.cup_compliance * torque)


def stiffness_steps(t1: float, t2: float) -> Floats:
    """Torques (4,) between which K1, K2 and K3 are secants of the torsion [N m]."""
    return np.array([SMALLEST_SHARE * t1, t1, t2, 2.0 * t2])


def slot_shift(known: Geometry, geometry: Geometry) -> float:
    """Outward shift of a similar geometry's slots from where the module alone places them [m]."""
    deep = (known.semi_major - known.circular_spline_datum) * geometry.module / known.module
    return geometry.circular_spline_datum - (geometry.semi_major - deep)


def slot_phases(geometry: Geometry, count: int = PHASES) -> Floats:
    """Wave generator angles [rad] in a slot pitch of the circular spline."""
    return geometry.slot_pitch / count * np.arange(count, dtype=np.float64)


def _turn(mesh: Mesh) -> Floats:
    """Angles that stand for a whole turn [rad]: a centred mesh repeats after a slot pitch.

    For others a golden-section sequence, which meets every phase of the teeth evenly.
    """
    if mesh.is_centred:
        return slot_phases(mesh.geometry)
    share: Floats = 0.6180339887498949 * np.arange(_MOMENTS, dtype=np.float64) % 1.0
    return 2.0 * np.pi * share


@lru_cache(maxsize=256)
def _order_2(mesh: Mesh, eccentricity: float, torque: float) -> float:
    """Amplitude of order 2 of the wave generator in the torsion of a mesh with an eccentricity [rad]."""
    if math.isnan(eccentricity):
        return math.nan
    coarse, fine = np.arange(_ERROR_MOMENTS), slot_phases(mesh.geometry, _ERROR_PHASES)
    angle = np.add.outer(np.pi / _ERROR_MOMENTS * coarse, fine).ravel()
    eccentric = replace(mesh, eccentricity=eccentricity, runout=0.0, tilt=0.0)
    beta = MeshOverTurn(eccentric, angle).torsion(np.array([torque]))[:, 0]
    return float(2.0 * abs(np.mean(beta * np.exp(-2j * angle))))


def _eccentricity_of_overlap(mesh: Mesh, overlap: float) -> float:
    """The eccentricity that gives this overlap at the worst wave generator angle [m], by bisection.

    At the worst angle it stands across the long axis. nan if no eccentricity in the search range gives it.
    """

    def found(eccentricity: float) -> float:
        across = replace(mesh, eccentricity=0.0, runout=1j * eccentricity, tilt=0.0)
        return MeshOverTurn(across, slot_phases(mesh.geometry)).overlap()

    low, high = 0.0, 0.2 * mesh.geometry.module  # the search range of tolerances
    high = min(high, 0.99 * largest_displacement(mesh.geometry)[0])
    if not found(low) < overlap < found(high):
        return math.nan
    while high - low > _FINE_ECCENTRICITY:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if found(middle) < overlap else (low, middle)
    return low
