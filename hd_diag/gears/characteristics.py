"""What a drive is, in the numbers of its catalogue page and of its assembly: what a user can compare."""

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
"""Least torque over T1 at which K1 is measured [-]: below it the gap is taken up."""

ECCENTRICITIES = (5e-6, 10e-6, 20e-6)
"""At which the error of an eccentricity is shown [m]: it is far from linear."""

_OF_ONE = 10e-6  # at which the error per eccentricity is taken [m]

PHASES = 16
"""Wave generator angles in a slot pitch, where each is like the others."""

_MOMENTS = 128  # of a turn
_FINE_ECCENTRICITY = 0.02e-6  # resolution of the eccentricity of an overlap [m]
# Over half a turn, which is a period of the error, and over a slot pitch at each: orders of teeth cancel.
_ERROR_MOMENTS, _ERROR_PHASES = 8, 3


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
    loads : ToothLoads
    error_per_eccentricity : float
        Amplitude of order 2 of the wave generator at half the rated torque, over an eccentricity of 10 µm
        [rad/m].
    errors : tuple of (float, float)
        That amplitude [rad] at some eccentricities [m].
    limit : (float, float)
        The eccentricity at which the lobes overlap as much as an assembly may have [m], and its amplitude
        [rad]; nan: they do so without, or not below the eccentricity that is too much.
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
    """The teeth of a mesh at some wave generator angles [rad], as far as a whole turn is judged by them.

    Its `torsion` gives rotations of the cup (moments, torques) [rad] at torques (torques,) [N m].
    """

    def __init__(self, mesh: Mesh, angle: Floats) -> None:
        # Whether both lobes are the same, and one stands for both.
        is_same = mesh.is_centred and mesh.geometry.flexspline_teeth % 2 == 0
        self._lobes, self._sections = 2 - is_same, mesh.geometry.sections
        self._compliance, self._contact = mesh.tooth_compliance, contacts(mesh, angle, lobes=self._lobes)
        self._stiffness = flank_stiffness(self._contact, mesh.tooth_compliance)
        self.torsion = FlankTorsion(self._contact.rotation, (1.0 + is_same) * self._stiffness)

    def peak_load(self, torque: float) -> float:
        """Largest force on a flank [N]; nan: the torque cannot be borne."""
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
        """Of all teeth without torque [m]."""
        return float(np.nanmin(self._contact.rotation * self._contact.radius))

    def overlap(self) -> float:
        """Overlap of both lobes without torque [m]; negative: clearance."""
        radius = np.where(np.isnan(self._contact.rotation), np.nan, self._contact.radius)
        return float((-self.torsion.gap * np.nanmean(radius, axis=(1, 2))).max())


@lru_cache(maxsize=512)
def tooth_loads(drive: Drive) -> ToothLoads:
    """What the teeth of a drive bear."""
    return _loads(MeshOverTurn(drive.mesh, _turn(drive.mesh)), drive.rated_torque)


def _loads(teeth: MeshOverTurn, rated_torque: float) -> ToothLoads:
    return ToothLoads(teeth.overlap(), teeth.peak_load(0.0), teeth.peak_load(rated_torque))


def characteristics(drive: Drive, t1: float = 0.0, t2: float = 0.0, overlap: float = 0.0) -> Characteristics:
    """Characteristics of a drive; T1 and T2 [N m] are shares of the rated torque where they are zero.

    The overlap is what an assembly may have [m].
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
    """Torsion (n,) [rad] at torques (n,) [N m] over a turn, cup included."""
    teeth = MeshOverTurn(drive.mesh, _turn(drive.mesh))
    return np.asarray(teeth.torsion(torque).mean(axis=0) + drive.cup_compliance * torque)


def stiffness_steps(t1: float, t2: float) -> Floats:
    """Torques (4,) between which K1, K2 and K3 are secants of the torsion [N m]."""
    return np.array([SMALLEST_SHARE * t1, t1, t2, 2.0 * t2])


def slot_shift(known: Geometry, geometry: Geometry) -> float:
    """By how much a similar geometry's slots lie further out than the module alone has them [m]."""
    deep = (known.semi_major - known.circular_spline_datum) * geometry.module / known.module
    return geometry.circular_spline_datum - (geometry.semi_major - deep)


def slot_phases(geometry: Geometry, count: int = PHASES) -> Floats:
    """Wave generator angles [rad] in a slot pitch of the circular spline."""
    return geometry.slot_pitch / count * np.arange(count, dtype=np.float64)


def _turn(mesh: Mesh) -> Floats:
    """Angles that show all of a turn [rad]: a centred mesh is the same again after a slot pitch.

    Of others by golden section, which meets every phase of the teeth evenly.
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
    """The eccentricity that gives this overlap at the worst wave generator angle [m].

    That is where it stands across the long axis; by bisection.
    """

    def found(eccentricity: float) -> float:
        across = replace(mesh, eccentricity=0.0, runout=1j * eccentricity, tilt=0.0)
        return MeshOverTurn(across, slot_phases(mesh.geometry)).overlap()

    low, high = 0.0, 0.2 * mesh.geometry.module  # as far as tolerances look
    high = min(high, 0.99 * largest_displacement(mesh.geometry)[0])
    if not found(low) < overlap < found(high):
        return math.nan
    while high - low > _FINE_ECCENTRICITY:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if found(middle) < overlap else (low, middle)
    return low
