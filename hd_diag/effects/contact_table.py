"""Response of the transmission error to errors of single teeth, tabulated over angle and torque.

If the clearance of a flank grows by db, the output turns by ``d beta / d b`` times db. This derivative is the
flank's share of the torsional stiffness if it bears load, and zero otherwise. To first order, pitch errors,
form errors and single damaged teeth are sums of these shares. The shares are solved exactly on a grid of wave
generator angles and torques. The phase that turns with the wave generator is removed, so that the tables are
smooth. Errors of the slots, which stand still, can also be solved at full size.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Literal

import numpy as np

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.drive import Drive
from hd_diag.effects.array_cache import ArrayCache
from hd_diag.model.contact import FLANKS, Contact, contacts
from hd_diag.model.load_sharing import flank_stiffness, torsion_of_flanks
from hd_diag.model.torsion import torsion, torsion_table
from hd_diag.model.torsion_map import TorsionMap, build

# Circumferential displacement of slots or of teeth, radial displacement of slots, clearance of all flanks.
Error = Literal["slot", "tooth", "radial", "clearance"]

Openings = tuple[float, float]
Neighbours = tuple[tuple[Integers, Floats], tuple[Integers, Floats]]
NO_OPENING: Openings = (0.0, 0.0)

TORQUES = 24
"""Torques of the grid on each side of zero, closer near zero where few pairs bear."""

MAP_STEPS = 8
"""Steps per tooth passing of a torsion map along a record: 0.005 arcsec rms."""

PHASES = 16
"""Phases of the flexspline under the wave generator, over half a turn."""

# The shares jump where a pair comes into load; errors of some um blur the jumps. Sections make them smaller:
# at ratio 50 an error of 14.4 arcsec is off by 0.15 with five sections, by 0.31 with one and two steps.
_STEPS_PER_SLOT, _IN_SECTIONS = 2, 1
_IDLE = 1e-9  # share of the torque limit that represents zero torque, approached from one side
_SPARSE = 4  # grid steps between angles with displaced teeth: the part beyond first order is smooth
_MOST_KEPT = 24 << 20  # bytes
_BEYOND = 1.2  # range of the first torsion map and of the mean torsion, over the torque limit
_FAR_BEYOND = (3.6, 11.0)  # ranges of wider maps, for torque that causes add to the measured torque
_MEAN_TORQUES, _MEAN_ANGLES = 401, 101
_FEW_SLOTS = 16  # slots around the gear that represent all


class ContactTable:
    """Shares of all flanks over one turn of the wave generator and over torque, computed when needed.

    Parameters
    ----------
    drive : Drive
    torque_limit : float
        Greatest magnitude of the torque [N m]; beyond it the shares at the limit are used.

    Attributes
    ----------
    steps, per_slot : int
        Steps of the grid of angles from 0 to 2 pi, both included, in all and per slot.

    Raises
    ------
    ValueError
        If the torque limit is not positive. When shares are computed, if the teeth cannot bear it.
    """

    def __init__(self, drive: Drive, torque_limit: float) -> None:
        if not 0.0 < torque_limit < np.inf:
            raise ValueError(f"torque_limit must be positive, not {torque_limit} N m")
        self.drive = drive
        self.torque_limit = torque_limit
        geometry = drive.mesh.geometry
        self.per_slot = _IN_SECTIONS if geometry.sections > 1 else _STEPS_PER_SLOT
        self.steps = self.per_slot * geometry.circular_spline_teeth
        self._kept = ArrayCache(_MOST_KEPT)
        self._maps: dict[float, TorsionMap | None] = {}

    def torsion_under(self, wave_generator_angle: Floats, cup_torque: Floats) -> Floats:
        """Torsion without tooth errors (n,) [rad], by the narrowest map that covers each torque (n,) [N m].

        Torques beyond all maps, or in a range that the teeth cannot bear, are solved exactly.
        """
        beta, size = np.full(cup_torque.size, np.nan), np.abs(cup_torque) / self.torque_limit
        for reach in (_BEYOND, *_FAR_BEYOND):
            rows = np.flatnonzero(np.isnan(beta) & (size <= reach))
            if rows.size and (table := self._torsion_map(reach)) is not None:
                beta[rows] = table(wave_generator_angle[rows], cup_torque[rows])
        rows = np.flatnonzero(np.isnan(beta))
        beta[rows] = torsion(self.drive.mesh, wave_generator_angle[rows], cup_torque[rows])
        return beta

    def _torsion_map(self, reach: float) -> TorsionMap | None:
        """Torsion map up to `reach` torque limits; None if the teeth cannot bear that.

        The torsion may jump where teeth enter by their corners. Such a jump spreads over one step of the map.
        """
        if reach not in self._maps:
            try:
                found = build(self.drive.mesh, reach * self.torque_limit, steps_per_tooth=MAP_STEPS)
                self._maps[reach] = replace(found, torque_limit=found.requested_limit)
            except ValueError:
                self._maps[reach] = None
        return self._maps[reach]

    @cached_property
    def mean_torsion(self) -> tuple[Floats, Floats]:
        """Rising torques on the cup [N m], and the mean torsion over a turn at each [rad]."""
        share = np.linspace(-1.0, 1.0, _MEAN_TORQUES)
        torque = _BEYOND * self.torque_limit * np.sign(share) * share**2
        turn = np.linspace(0.0, 2.0 * np.pi, _MEAN_ANGLES, endpoint=False)
        return torque, torsion_table(self.drive.mesh, turn, torque).mean(axis=0)

    @cached_property
    def contact(self) -> Contact:
        """Contact at every angle of the grid."""
        return contacts(self.drive.mesh, self._angle, compiled=True)

    @cached_property
    def torque_nodes(self) -> Floats:
        """Torques on the cup of the rows [N m]; zero occurs twice, approached from below and above."""
        positive = self.torque_limit * (np.arange(TORQUES + 1) / TORQUES) ** 2
        positive[0] = _IDLE * self.torque_limit
        return np.concatenate((-positive[::-1], positive))

    @cached_property
    def torsion(self) -> Floats:
        """Torsion beta at the torques and angles of the grid [rad], shape (torques, angles)."""
        beta = self._torsion(self.contact.rotation, self._stiffness)
        if np.isnan(beta).any():
            raise ValueError(f"the teeth cannot bear {self.torque_limit:g} N m at every wave generator angle")
        return beta

    @cached_property
    def mean_slot(self) -> Floats:
        """Mean response of slots around the gear, each turned to slot 0 [rad/m].

        An eccentricity makes slots differ. As `one_slot` without the last angle: (2, torques, angles - 1).
        """
        count = self.drive.mesh.geometry.circular_spline_teeth
        slots = np.linspace(0, count, _FEW_SLOTS, endpoint=False).astype(np.int64)
        turned = [np.roll(self.one_slot(s)[:, :-1], -self.per_slot * s, axis=1) for s in slots.tolist()]
        return np.asarray(np.mean(turned, axis=0).transpose(2, 0, 1))

    def harmonics(self, error: Error, orders: tuple[int, ...]) -> Complexes:
        """Responses to ``Re(A exp(i k phi))`` over ``A exp(i k theta)`` [rad/m], (torques, angles, orders).

        theta is the wave generator's angle seen from the slots, or from the teeth if these have the error.
        """
        return self._kept.get((error, orders), lambda: self._harmonics(error, np.array(orders)))

    def one_slot(self, slot: int, opening: Openings = NO_OPENING) -> Floats:
        """Response to more clearance on the flanks (+, -) of one slot [rad/m]; (torques, angles, 2).

        `opening` is the clearance added to the flanks [m]; the response is the mean slope from zero to it.
        """
        return self._kept.get(("one slot", slot, opening), lambda: self._one_slot(slot, opening))

    def displaced(self, errors: Floats) -> Floats:
        """Rotation of the cup by slot errors at full size [rad], shape (torques, angles).

        Errors (4, Z_G) are circumferential, radial, clearance of the + flank and of the - flank [m].
        """
        return self._kept.get(errors.tobytes(), lambda: self._displaced(*errors))

    def teeth_beyond(self, orders: tuple[int, ...], coefficients: tuple[float, ...]) -> Floats:
        """Torsion by errors of the flexspline's teeth at full size, less the first order [rad].

        The errors are waves with even numbers of periods around, each with a cosine and a sine coefficient
        [m]. Shape (PHASES, torques, angles): at phases ``pi n / PHASES`` of the flexspline's turn under
        the wave generator.
        """
        return self._kept.get(
            (orders, coefficients), lambda: self._teeth_beyond(orders, np.array(coefficients))
        )

    def one_tooth(
        self, torque_rows: Neighbours, angle_rows: Neighbours, tooth: Integers, opening: Openings = NO_OPENING
    ) -> Floats:
        """As `one_slot`, for teeth (n,) of the flexspline, interpolated between rows of the grid; (2, n)."""
        teeth, half = self.contact.teeth, self.contact.teeth.shape[1] // 2
        count, found = self.drive.mesh.geometry.flexspline_teeth, np.zeros((2, tooth.size))
        for angle_row, angle_share in angle_rows:
            first, second = (np.mod(tooth - teeth[:, lobe].take(angle_row), count) for lobe in (0, half))
            near = np.flatnonzero(
                (first < self._pairs) | (second < self._pairs)
            )  # only teeth at a lobe respond
            column = np.where(first[near] < self._pairs, first[near], half + second[near])
            angle, share = angle_row[near], angle_share[near]
            for torque_row, torque_share in torque_rows:
                torque, part = torque_row[near], share * torque_share[near]
                for flank, at in product((0, 1), range(0, half, self._pairs)):
                    slope = self._slope(torque, angle, flank, column + at, opening[flank])
                    found[flank, near] += part * slope
        return found

    def _one_slot(self, slot: int, opening: Openings) -> Floats:
        angle, pair = np.nonzero(self.contact.slots == slot)
        found, there = np.zeros((*self.torsion.shape, 2)), np.s_[:, angle]
        for flank in (0, 1):  # a slot meets one lobe at a time, in every section
            slope = self._slope(np.s_[:], angle, flank, pair, opening[flank])
            np.add.at(found[..., flank], there, slope)  # type: ignore[arg-type]
        return found

    def _slope(
        self, torque_row: Integers | slice, angle_row: Integers, flank: int, pair: Integers, opening: float
    ) -> Floats:
        """Mean response of a flank from zero opening to `opening` [rad/m].

        The pair parts when the opening exceeds its overlap. Beyond that the other pairs bear all of the load,
        and the cup turns no further.
        """
        rotation, stiffness, radius = self._rotation, self._stiffness, self._radius
        at = (angle_row * 2 + flank) * rotation.shape[2] + pair  # one flat index is several times as fast
        if isinstance(torque_row, slice):
            torsion, bearing = self.torsion[torque_row, angle_row], self._bearing[torque_row, angle_row]
        else:
            node = torque_row * (self.steps + 1) + angle_row
            torsion, bearing = self.torsion.take(node), self._bearing.take(node)
        overlap = np.maximum(FLANKS[flank, 0] * torsion - rotation.take(at), 0.0)
        share = np.where(overlap > 0.0, FLANKS[flank, 0] * stiffness.take(at), 0.0) / bearing
        slope = np.asarray(share / radius.take(at))
        if opening <= 0.0:
            return slope
        parted = overlap / np.maximum(1.0 - np.abs(share), 1e-6) * radius.take(at)
        return np.asarray(slope * np.minimum(1.0, parted / opening))

    def _harmonics(self, error: Error, orders: Integers) -> Complexes:
        """As `harmonics`, not cached.

        A slot that moves outward opens both flanks (db) and moves their contacts, which changes their
        stiffness (dk): ``K d beta`` is the sum of ``k db - overlap dk`` over the loaded flanks.
        """
        angle = self._tooth_angle if error == "tooth" else self._slot_angle
        if error == "radial":
            softening = np.nan_to_num(self.contact.softening)
            fixed = FLANKS * np.nan_to_num(self.contact.opening + self.contact.rotation * softening)
            softer = self._summed(softening, angle, orders)
            return np.asarray(self._summed(fixed, angle, orders) - self.torsion[..., None] * softer)
        sign = {"slot": np.ones((2, 1)), "tooth": -np.ones((2, 1)), "clearance": FLANKS}[error]
        return self._summed(sign / self._radius, angle, orders)

    def _summed(self, weight: Floats, angle: Floats, orders: Integers) -> Complexes:
        """Sum over all flanks of share, weight (angles, 2, pairs) and wave; (torques, angles, k)."""
        found = np.empty((*self.torsion.shape, orders.size), dtype=np.complex128)
        for index, turned in enumerate(orders[:, None, None, None] * angle[:, None, :]):
            found[..., index].real = self._borne(weight * np.cos(turned))
            found[..., index].imag = self._borne(weight * np.sin(turned))
        return np.asarray(found / self._bearing[..., None])

    def _borne(self, weight: Floats) -> Floats:
        """Stiffness times weight (angles, 2, pairs), summed over the flanks that bear; (torques, angles)."""
        cells, nodes = self._begin
        sums = np.bincount(cells, (self._stiffness * weight).ravel(), 2 * nodes * self._angle.size)
        rising, falling = sums.reshape(2, nodes, -1).cumsum(axis=1)
        return np.asarray(rising[:-1] + falling[-2::-1])

    @cached_property
    def _begin(self) -> tuple[Integers, int]:
        """First torque node at which each flank bears load, as the torque rises (+) or falls (-).

        Flat indices into an array (side, node, angle), flank after flank, and the number of nodes. The last
        node is for flanks that never bear.
        """
        nodes, angles = self.torque_nodes.size + 1, self._angle.size
        turned = [side * self.torsion[..., None] for side in (1.0, -1.0)]
        idle = [np.count_nonzero(beta <= self._rotation[:, f], axis=0) for f, beta in enumerate(turned)]
        cells = (np.arange(2)[:, None] * nodes + np.stack(idle, axis=1)) * angles
        return (cells + np.arange(angles)[:, None, None]).ravel(), nodes

    @cached_property
    def _bearing(self) -> Floats:
        """Total stiffness of the flanks that bear [N m/rad], (torques, angles)."""
        return self._borne(np.ones(self._stiffness.shape))

    def _displaced(self, circumferential: Floats, radial: Floats, *clearance: Floats) -> Floats:
        slots = self.contact.slots
        around = FLANKS * circumferential[slots][:, None, :]
        around = around + np.array(clearance)[:, slots].transpose(1, 0, 2)
        rotation, stiffness = self.contact.rotation + around / self._radius, self._stiffness
        if radial.any():
            outward = radial[slots][:, None, :]
            rotation = rotation + self.contact.opening * outward
            softer = np.nan_to_num(self.contact.softening) * outward
            stiffness = stiffness * np.exp(np.clip(softer, -1.0, 1.0))
        return self._torsion(rotation, stiffness) - self.torsion

    def _teeth_beyond(self, orders: tuple[int, ...], coefficients: Floats) -> Floats:
        every, found = slice(None, None, _SPARSE), []
        rest, stiffness, radius = self.contact.rotation[every], self._stiffness[every], self._radius[every]
        whole = coefficients[::2] - 1j * coefficients[1::2]  # a cos + b sin is Re (a - i b) exp
        waves = np.exp(1j * np.multiply.outer(self._tooth_angle[every], orders)) * whole
        response = self.harmonics("tooth", orders)[:, every] * whole
        for turn in np.exp(1j * np.multiply.outer(np.pi / PHASES * np.arange(PHASES), orders)):
            opened = (waves @ turn).real[:, None, :] / radius
            first = self.torsion[:, every] + (response @ turn).real
            found.append(self._torsion(rest - FLANKS * opened, stiffness) - first)
        place = np.arange(self.steps + 1) / _SPARSE
        low = np.minimum(place.astype(np.int64), found[0].shape[1] - 2)
        table = np.nan_to_num(np.stack(found))
        return np.asarray(table[..., low] + (place - low) * (table[..., low + 1] - table[..., low]))

    def _torsion(self, rotation: Floats, stiffness: Floats) -> Floats:
        """Torsion of flanks with given closing rotations and stiffnesses [rad], (torques, angles)."""
        return torsion_of_flanks(rotation, stiffness, self.torque_nodes).T

    @property
    def _pairs(self) -> int:
        """Number of columns per lobe and section."""
        return int(self.contact.teeth.shape[1]) // (2 * self.drive.mesh.geometry.sections)

    @cached_property
    def _stiffness(self) -> Floats:
        return flank_stiffness(self.contact, self.drive.mesh.tooth_compliance)

    @cached_property
    def _rotation(self) -> Floats:
        """Closing rotation of each flank [rad]; infinite where a flank cannot touch."""
        return np.nan_to_num(self.contact.rotation, nan=np.inf)

    @cached_property
    def _radius(self) -> Floats:
        return np.where(np.isnan(self.contact.rotation), 1.0, self.contact.radius)

    @cached_property
    def _angle(self) -> Floats:
        return np.linspace(0.0, 2.0 * np.pi, self.steps + 1)

    @cached_property
    def _slot_angle(self) -> Floats:
        """Angles of the slots, seen from the wave generator [rad]; shape (angles, pairs)."""
        return self.contact.slots * self.drive.mesh.geometry.slot_pitch - self._angle[:, None]

    @cached_property
    def _tooth_angle(self) -> Floats:
        """Angles of the teeth along the flexspline, from the wave generator [rad]; (angles, pairs)."""
        geometry = self.drive.mesh.geometry
        turned = self._angle * (1.0 + 1.0 / geometry.reduction)
        return self.contact.teeth * geometry.tooth_pitch - turned[:, None]


@lru_cache(maxsize=2)  # 20 MB each
def contact_table(drive: Drive, torque_limit: float) -> ContactTable:
    """Table of a drive up to a torque [N m]; the two latest are cached."""
    return ContactTable(drive, torque_limit)
