"""Load distribution: one torsion for all teeth, solved exactly by :mod:`hd_diag.model.kernel.load_sharing`.

A flank of stiffness k that closes after a rotation b bears ``k (beta - b)`` where the torsion beta exceeds b.
The derivative of the torsion by a loaded flank's b is that flank's share of the loaded stiffness. It gives
the first-order effect of pitch errors, wear and damage of single teeth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.model import kernel
from hd_diag.model.contact import FLANKS, Contact
from hd_diag.model.geometry import Geometry
from hd_diag.model.mesh import Mesh, contiguous, moments
from hd_diag.model.threads import MOMENTS, spread

_PHASES, _BEYOND = 16, 1.02  # phases of a slot pitch that sample the overlap; margin for maxima in between
_NONE = 1e-9  # share of all flanks' stiffness that is rounding error: no flank bears [-]


@dataclass(frozen=True)
class MeshState:
    """All tooth pairs at a number of moments. Flanks (+, -): counter-clockwise, clockwise.

    Attributes
    ----------
    backlash : ndarray, shape (moments, 2, Z_R)
        Circumferential, at zero torsion [m]; negative for interference, nan if the pair cannot touch.
    load : ndarray, shape (moments, 2, Z_R)
        Normal forces [N].
    pressure_angle : ndarray, shape (moments, 2, Z_R)
        [rad]; nan where the pair cannot touch.
    section_backlash, section_load : ndarray, shape (moments, sections, 2, Z_R)
        The same in each section of the width. `backlash` is the least over the sections, `pressure_angle` is
        that of the section with the least, and `load` is the sum.
    torsion : ndarray, shape (moments,)
        Rotation of the cup [rad].
    lost_motion : ndarray, shape (moments,)
        Gap at zero torque [rad].
    overlap : ndarray, shape (moments,)
        Circumferential distance by which the lobes press against each other at zero torque, at the contacts
        [m]; negative for clearance.
    built : float
        Overlap as built [m], see :func:`built_overlap`.
    """

    backlash: Floats
    load: Floats
    pressure_angle: Floats
    section_backlash: Floats
    section_load: Floats
    torsion: Floats
    lost_motion: Floats
    overlap: Floats
    built: float = 0.0

    @property
    def loaded_pairs(self) -> Integers:
        """Number of flanks that bear load, shape (moments,)."""
        return np.asarray(np.count_nonzero(self.load > 0.0, axis=(1, 2)), dtype=np.int64)

    @property
    def peak_load(self) -> Floats:
        """Largest normal force [N], shape (moments,)."""
        return np.asarray(self.load.max(axis=(1, 2)))

    @property
    def load_concentration(self) -> Floats:
        """Largest force over the mean of the loaded flanks [-], 1 where none is loaded; shape (moments,)."""
        mean = self.load.sum(axis=(1, 2)) / np.maximum(self.loaded_pairs, 1)
        return np.where(mean > 0.0, self.peak_load / np.where(mean > 0.0, mean, 1.0), 1.0)

    @property
    def minimum_backlash(self) -> Floats:
        """Least backlash over all flanks [m], shape (moments,)."""
        return np.asarray(np.nanmin(self.backlash, axis=(1, 2)))

    @property
    def interference(self) -> npt.NDArray[np.bool_]:
        """Whether the lobes press against each other more than as built, shape (moments,).

        No rotation of the cup then frees all teeth. Only a coned cup has an overlap as built.
        """
        return np.asarray(self.overlap > self.built)


def mesh_state(mesh: Mesh, wave_generator_angle: Floats, torque: Floats) -> MeshState:
    """Backlash and load of every tooth, contacts and load distribution solved together.

    Arguments are wave generator angles theta_W (moments,) [rad] and torques M on the cup (moments,) [N m].
    The torsion equals that of :func:`hd_diag.model.torsion.torsion` to the last bit.
    """
    rows = moments(mesh, wave_generator_angle, torque)
    count, geometry = rows[0].size, mesh.geometry
    teeth = np.empty((3, count, geometry.sections, 2, geometry.flexspline_teeth))
    whole = np.empty((3, count))
    spread(partial(kernel.entry.mesh_state, mesh.data, *rows, teeth, whole), count, MOMENTS)
    (backlash, load, pressure_angle), (beta, gap, radius) = teeth, whole
    apart = backlash, load
    if geometry.sections > 1:
        least = np.nan_to_num(backlash, nan=np.inf).argmin(axis=1)[:, None]
        backlash, pressure_angle = (np.take_along_axis(each, least, 1) for each in (backlash, pressure_angle))
        load = load.sum(axis=1, keepdims=True)
    whole_teeth = backlash[:, 0], load[:, 0], pressure_angle[:, 0]
    built = built_overlap(geometry)
    return MeshState(*whole_teeth, *apart, beta, np.maximum(gap, 0.0), -gap * radius, built)


def built_overlap(geometry: Geometry) -> float:
    """Overlap of the lobes that a cup's coning alone causes [m]; zero without coning."""
    return _of_coning(geometry) if geometry.cup_length and geometry.sections > 1 else 0.0


@lru_cache(maxsize=16)
def _of_coning(geometry: Geometry) -> float:
    rows = moments(Mesh(geometry), geometry.slot_pitch / _PHASES * np.arange(_PHASES, dtype=np.float64))
    teeth = np.empty((3, _PHASES, geometry.sections, 2, geometry.flexspline_teeth))
    _, gap, radius = whole = np.empty((3, _PHASES))
    kernel.entry.mesh_state(Mesh(geometry).data, *rows, teeth, whole, 0, _PHASES)
    return max(_BEYOND * float((-gap * radius).max()), 0.0)


def flank_stiffness(contact: Contact, tooth_compliance: float) -> Floats:
    """Torsional stiffness ``k = (r cos alpha)^2 / (K1 + K2)`` of each flank (moments, 2, columns) [N m/rad].

    It includes the section's share of the width and is zero where the flanks cannot touch.
    """
    arm = contact.radius * np.cos(contact.pressure_angle)
    return np.where(np.isfinite(contact.rotation), contact.weight * (arm * arm / tooth_compliance), 0.0)


def torsion_of_flanks(rotation: Floats, stiffness: Floats, torque: Floats) -> Floats:
    """Torsion (moments, torques) [rad] of flanks that begin to bear at given rotations.

    Rotations b [rad] and stiffness k [N m/rad] have the shape (moments, 2, teeth); b is not finite where a
    flank cannot touch. Torques M (torques,) must rise [N m]. In a true gap the torsion is the gap's middle.
    It is nan if no flank can bear the torque.
    """
    found: Floats = kernel.entry.torsion_of_flanks(*map(contiguous, (rotation, stiffness, torque)))
    return found


class FlankTorsion:
    """As :func:`torsion_of_flanks` for torques in any order, without compiled code, so that starts are fast.

    Flanks are sorted by the torsion at which they begin (+) or cease (-) to bear. Between two such torsions
    ``M = K beta - Q`` holds, with sums K and Q over the bearing flanks.
    """

    def __init__(self, rotation: Floats, stiffness: Floats) -> None:
        count, touching = rotation.shape[0], np.isfinite(rotation)
        start = np.where(touching, FLANKS * rotation, np.nan).reshape(count, -1)
        gain = np.where(touching, FLANKS * stiffness, 0.0).reshape(count, -1)
        order = np.argsort(start, axis=1)  # nan is last
        start, gain = (np.take_along_axis(each, order, axis=1) for each in (start, gain))

        def summed(change: Floats) -> Floats:
            """Sums over the flanks that bear, before each start and after the last."""
            lowest = -np.where(gain < 0.0, change, 0.0).sum(axis=1)
            return np.cumsum(np.column_stack((lowest, change)), axis=1)

        self._stiffness, self._moment = summed(gain), summed(np.nan_to_num(gain * start))
        self._begin = self._stiffness[:, 1:] * start - self._moment[:, 1:]
        self._stiffness[self._stiffness <= _NONE * np.abs(gain).sum(axis=1, keepdims=True)] = np.nan
        ends = np.fmin.reduce(rotation, axis=2, initial=np.inf)  # ends of the free range
        self.gap = ends[:, 0] + ends[:, 1]
        self._middle = np.where(np.isfinite(self.gap), 0.5 * (ends[:, 0] - ends[:, 1]), np.nan)

    def __call__(self, torque: Floats) -> Floats:
        """Torsion (moments, torques) at torques (torques,)."""
        piece = np.stack([np.searchsorted(begin, torque) for begin in self._begin])
        bearing, rest = (np.take_along_axis(each, piece, axis=1) for each in (self._stiffness, self._moment))
        idle = (torque == 0.0) & (self.gap > 0.0)[:, None]
        return np.where(idle, self._middle[:, None], (torque + rest) / bearing)
