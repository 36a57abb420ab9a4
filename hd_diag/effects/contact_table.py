"""What errors of single teeth do to the transmission error: the contact's weights, tabulated.

A flank whose clearance grows by db turns the output by ``d beta / d b`` of it: its share of the torsional
stiffness if it bears load, nothing otherwise. Pitch and form errors and single damaged teeth are sums of
these shares, to first order. They are solved exactly on a grid of wave generator angles and torques; what
turns with the wave generator is taken out, so that the tables are smooth. Errors of the slots, which stand
still, can also be put into the contact at their full size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.drive import Drive
from hd_diag.effects.kept import Kept
from hd_diag.model.contact import FLANKS, Contact, contacts
from hd_diag.model.load_sharing import flank_stiffness, shares, torsion_of_flanks
from hd_diag.model.torsion import torsion_table
from hd_diag.model.torsion_map import TorsionMap, build

# Coefficients and angles along the flexspline [rad] to the teeth's displacement [m], alike after half a turn
# and in proportion to the coefficients.
Displacement = Callable[[Floats, Floats], Floats]

# Circumferential displacement of slots or of teeth, radial one of slots, clearance of all flanks.
Error = Literal["slot", "tooth", "radial", "clearance"]

Openings = tuple[float, float]
NO_OPENING: Openings = (0.0, 0.0)

TORQUES = 24
"""Torques of the grid on each side of zero, closer near zero where few pairs bear."""

PHASES = 16
"""Phases of the flexspline under the wave generator, over half a turn."""

_STEPS_PER_SLOT = 2  # the shares step where a pair comes into load; errors of some um blur the steps anyway
_IDLE = 1e-9  # share of the torque limit that stands for the limit towards zero torque from one side
_SPARSE = 4  # angles of the grid at which teeth are displaced: what is beyond the first order is smooth
_MOST_KEPT = 24 << 20  # bytes
_BEYOND = 1.2  # of the torque limit
_MEAN_TORQUES, _MEAN_ANGLES = 401, 101
_MAP_STEPS = 16  # per tooth passing: 0.005 arcsec rms
_STEP = 5e-9  # [m]; radial step of the central difference: far above rounding, far below a fillet


class ContactTable:
    """Shares of all flanks over one turn of the wave generator and torque; computed when first needed.

    Parameters
    ----------
    drive : Drive
    torque_limit : float
        Greatest magnitude of the torque [N m]; beyond it the shares at the limit are used.

    Attributes
    ----------
    steps : int
        Of the grid of angles, whose nodes are from 0 to 2 pi, both included.

    Raises
    ------
    ValueError
        If the torque limit is not positive; when shares are needed: if the teeth cannot bear it.
    """

    def __init__(self, drive: Drive, torque_limit: float) -> None:
        if not 0.0 < torque_limit < np.inf:
            raise ValueError(f"torque_limit must be positive, not {torque_limit} N m")
        self.drive = drive
        self.torque_limit = torque_limit
        self.steps = _STEPS_PER_SLOT * drive.mesh.geometry.circular_spline_teeth
        self._kept = Kept(_MOST_KEPT)

    @cached_property
    def torsion_map(self) -> TorsionMap:
        """Of the mesh without errors, for torques somewhat beyond the limit.

        Where teeth enter by their corners the torsion jumps at some angle: here it does so within a step.
        """
        found = build(self.drive.mesh, _BEYOND * self.torque_limit, steps_per_tooth=_MAP_STEPS)
        return replace(found, torque_limit=found.requested_limit)

    @cached_property
    def mean_torsion(self) -> tuple[Floats, Floats]:
        """Torques on the cup [N m], rising, and the torsion's mean over a turn there [rad]."""
        share = np.linspace(-1.0, 1.0, _MEAN_TORQUES)
        torque = _BEYOND * self.torque_limit * np.sign(share) * share**2
        turn = np.linspace(0.0, 2.0 * np.pi, _MEAN_ANGLES, endpoint=False)
        return torque, torsion_table(self.drive.mesh, turn, torque).mean(axis=0)

    @cached_property
    def contact(self) -> Contact:
        """At every angle of the grid."""
        return contacts(self.drive.mesh, self._angle)

    @cached_property
    def torque_nodes(self) -> Floats:
        """Torques on the cup of the rows [N m]; zero twice: from below and from above."""
        positive = self.torque_limit * (np.arange(TORQUES + 1) / TORQUES) ** 2
        positive[0] = _IDLE * self.torque_limit
        return np.concatenate((-positive[::-1], positive))

    @cached_property
    def torsion(self) -> Floats:
        """Beta at the torques and angles of the grid [rad], shape (torques, angles)."""
        beta = self._torsion(self.contact.rotation, self._stiffness)
        if np.isnan(beta).any():
            raise ValueError(f"the teeth cannot bear {self.torque_limit:g} N m at every wave generator angle")
        return beta

    @cached_property
    def share(self) -> Floats:
        """D beta / d b of every flank [-], negative for - flanks; shape (angles, torques, 2, pairs)."""
        return shares(self.contact.rotation, self._stiffness, self.torsion.T)

    @cached_property
    def mean_slot(self) -> Floats:
        """Of slot 0, in the mean over all slots, which an eccentric wave generator makes differ [rad/m].

        As `one_slot`, without the last angle: shape (2, torques, angles - 1).
        """
        count = self.drive.mesh.geometry.circular_spline_teeth
        row = np.arange(self.steps)[:, None] - _STEPS_PER_SLOT * self.contact.slots[:-1]
        row = np.mod(row, self.steps).ravel()
        response = (self.share[:-1] / self._radius[:-1, None] / count).transpose(2, 1, 0, 3)
        response = response.reshape(2, -1, row.size)
        return np.array([[np.bincount(row, one, self.steps) for one in flank] for flank in response])

    def harmonics(self, error: Error, orders: tuple[int, ...]) -> Complexes:
        """Responses to ``Re(A exp(i k phi))`` over ``A exp(i k theta)`` [rad/m], (torques, angles, orders).

        theta is the wave generator's angle as the slots, or the teeth, see it.
        """
        return self._kept.get((error, orders), lambda: self._harmonics(error, np.array(orders)))

    def one_slot(self, slot: int, opening: Openings = NO_OPENING) -> Floats:
        """Response to more clearance on the flanks (+, -) of one slot [rad/m]; (torques, angles, 2).

        At an opening [m] of the flanks it is the mean slope from none to that opening.
        """
        return self._kept.get(("one slot", slot, opening), lambda: self._one_slot(slot, opening))

    def displaced(self, errors: Floats) -> Floats:
        """Turn of the cup when the slots have errors of full size [rad], shape (torques, angles).

        Errors (4, Z_G) are circumferential, radial, clearance of the + and of the - flank [m].
        """
        return self._kept.get(errors.tobytes(), lambda: self._displaced(*errors))

    def teeth_beyond(self, displacement: Displacement, coefficients: tuple[float, ...]) -> Floats:
        """What errors of the flexspline's teeth do at their size beyond their first order [rad].

        Shape (PHASES, torques, angles): at phases ``pi n / PHASES`` by which the flexspline has turned under
        the wave generator.
        """
        return self._kept.get(
            (displacement, coefficients), lambda: self._teeth_beyond(displacement, np.array(coefficients))
        )

    def one_tooth(
        self, torque_row: Integers, angle_row: Integers, tooth: Integers, opening: Openings = NO_OPENING
    ) -> Floats:
        """As `one_slot`, for teeth of the flexspline [rad/m], at rows of the grid, shape (n,); (2, n)."""
        teeth, half = self.contact.teeth, self.contact.teeth.shape[1] // 2
        count = self.drive.mesh.geometry.flexspline_teeth
        first, second = (np.mod(tooth - teeth[angle_row, lobe], count) for lobe in (0, half))
        column = np.where(first < half, first, half + np.minimum(second, half - 1))
        near = (first < half) | (second < half)
        slopes = [self._slope(torque_row, angle_row, f, column, opening[f]) for f in (0, 1)]
        return np.where(near, np.stack(slopes), 0.0)

    def _one_slot(self, slot: int, opening: Openings) -> Floats:
        angle, pair = np.nonzero(self.contact.slots == slot)
        found = np.zeros((*self.torsion.shape, 2))
        for flank in (0, 1):  # a slot is at one lobe at a time: no angle comes twice
            found[:, angle, flank] = self._slope(np.s_[:], angle, flank, pair, opening[flank])
        return found

    def _slope(
        self, torque_row: Integers | slice, angle_row: Integers, flank: int, pair: Integers, opening: float
    ) -> Floats:
        """Mean response of a flank from no opening to one [rad/m].

        The pair parts where the opening has used up its overlap: there the others bear all of the load, and
        the cup turns no further.
        """
        pairs = self.share.shape[3]
        radius = self._radius.take((angle_row * 2 + flank) * pairs + pair)
        if isinstance(torque_row, slice):
            share = self.share[angle_row, torque_row, flank, pair].T
        else:  # by one index, which is several times as fast
            row = angle_row * self.torque_nodes.size + torque_row
            share = self.share.take((row * 2 + flank) * pairs + pair)
        if opening <= 0.0:
            return np.asarray(share / radius)
        overlap = FLANKS[flank, 0] * self.torsion[torque_row, angle_row] - np.nan_to_num(
            self.contact.rotation[angle_row, flank, pair], nan=np.inf
        )
        parted = np.maximum(overlap, 0.0) / np.maximum(1.0 - np.abs(share), 1e-6) * radius
        return np.asarray(share / radius * np.minimum(1.0, parted / opening))

    def _harmonics(self, error: Error, orders: Integers) -> Complexes:
        """As `harmonics`.

        A slot that moves outward opens both flanks (db) and moves their contacts, which changes how stiff
        they are (dk): ``K d beta`` is the sum of ``k db - overlap dk`` over the loaded flanks.
        """
        angle = self._tooth_angle if error == "tooth" else self._slot_angle
        turning = np.exp(1j * orders * angle[:, None, :, None])
        if error == "radial":
            opening, softening = self._radial_slopes
            fixed = np.nan_to_num(opening + self.contact.rotation * softening)
            softer = self._summed(FLANKS * np.nan_to_num(softening), turning)
            return np.asarray(self._summed(fixed, turning) - self.torsion[..., None] * softer)
        sign = {"slot": FLANKS, "tooth": -FLANKS, "clearance": np.ones((2, 1))}[error]
        return self._summed(sign / self._radius, turning)

    def _summed(self, weight: Floats, turning: Complexes) -> Complexes:
        """Shares times weights (angles, 2, pairs) of all flanks and waves (angles, 1, pairs, k), summed."""
        angles, torques = self.share.shape[:2]
        columns = (weight[..., None] * turning).reshape(angles, -1, turning.shape[-1]).view(np.float64)
        found = self.share.reshape(angles, torques, -1) @ columns
        return np.ascontiguousarray(found.view(np.complex128).transpose(1, 0, 2))

    def _displaced(self, circumferential: Floats, radial: Floats, *clearance: Floats) -> Floats:
        slots = self.contact.slots
        around = FLANKS * circumferential[slots][:, None, :]
        around = around + np.array(clearance)[:, slots].transpose(1, 0, 2)
        rotation, stiffness = self.contact.rotation + around / self._radius, self._stiffness
        if radial.any():
            opening, softening = self._radial_slopes
            outward = radial[slots][:, None, :]
            rotation = rotation + opening * outward
            stiffness = stiffness * np.exp(np.clip(np.nan_to_num(softening) * outward, -1.0, 1.0))
        return self._torsion(rotation, stiffness) - self.torsion

    def _teeth_beyond(self, displacement: Displacement, coefficients: Floats) -> Floats:
        every = slice(None, None, _SPARSE)
        rest, stiffness, share = self.contact.rotation[every], self._stiffness[every], self.share[every]
        found = []
        for phase in np.pi / PHASES * np.arange(PHASES):
            moved = displacement(coefficients, self._tooth_angle[every] + phase)
            turned = -FLANKS * moved[:, None, :] / self._radius[every]
            first = np.einsum("atfp,afp->ta", share, turned)
            found.append(self._torsion(rest + turned, stiffness) - self.torsion[:, every] - first)
        place = np.arange(self.steps + 1) / _SPARSE
        low = np.minimum(place.astype(np.int64), found[0].shape[1] - 2)
        table = np.nan_to_num(np.stack(found))
        return np.asarray(table[..., low] + (place - low) * (table[..., low + 1] - table[..., low]))

    def _torsion(self, rotation: Floats, stiffness: Floats) -> Floats:
        """Of flanks with some closing rotations and stiffnesses [rad], shape (torques, angles)."""
        return torsion_of_flanks(rotation, stiffness, self.torque_nodes).T

    @cached_property
    def _stiffness(self) -> Floats:
        return flank_stiffness(self.contact, self.drive.mesh.tooth_compliance)

    @cached_property
    def _radius(self) -> Floats:
        return np.where(np.isnan(self.contact.rotation), 1.0, self.contact.radius)

    @cached_property
    def _angle(self) -> Floats:
        return np.linspace(0.0, 2.0 * np.pi, self.steps + 1)

    @cached_property
    def _slot_angle(self) -> Floats:
        """Of the slots, seen from the wave generator [rad]; shape (angles, pairs)."""
        return self.contact.slots * self.drive.mesh.geometry.slot_pitch - self._angle[:, None]

    @cached_property
    def _tooth_angle(self) -> Floats:
        """Of the teeth along the flexspline, seen from the wave generator [rad]; shape (angles, pairs)."""
        geometry = self.drive.mesh.geometry
        turned = self._angle * (1.0 + 1.0 / geometry.reduction)
        return self.contact.teeth * geometry.tooth_pitch - turned[:, None]

    @cached_property
    def _radial_slopes(self) -> tuple[Floats, Floats]:
        """Closing rotation and logarithm of the stiffness by the radial displacement [rad/m], [1/m]."""
        mesh = self.drive.mesh
        datum = mesh.geometry.circular_spline_datum
        geometries = [replace(mesh.geometry, circular_spline_datum=datum + step) for step in (-_STEP, _STEP)]
        moved = [contacts(replace(mesh, geometry=geometry), self._angle) for geometry in geometries]
        low, high = (flank_stiffness(one, mesh.tooth_compliance) for one in moved)
        opening = (moved[1].rotation - moved[0].rotation) / (2.0 * _STEP)
        stiffness = np.where(self._stiffness > 0.0, self._stiffness, 1.0)
        return opening, (high - low) / (2.0 * _STEP * stiffness)


@lru_cache(maxsize=2)  # 50 MB each
def contact_table(drive: Drive, torque_limit: float) -> ContactTable:
    """Table of a drive up to a torque [N m], the latest kept."""
    return ContactTable(drive, torque_limit)
