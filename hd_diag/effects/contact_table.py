"""What errors of single teeth do to the transmission error: the contact's weights, tabulated.

A flank whose clearance grows by db turns the output by ``d beta / d b`` of it: its share of the torsional
stiffness if it bears load, nothing otherwise. Pitch and form errors and single damaged teeth are sums of
these shares, to first order. They are solved exactly on a grid of wave generator angles and torques; what
turns with the wave generator is taken out, so that the tables are smooth. Errors of the slots, which stand
still, can also be put into the contact at their full size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.drive import Drive
from hd_diag.model.contact import Contact, contacts
from hd_diag.model.load_sharing import FLANKS, flank_stiffness, shares, torsion_of_flanks
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion_table
from hd_diag.model.torsion_map import TorsionMap, build

Displacement = Callable[[Floats, Floats], Floats]
Openings = tuple[float, float]
NO_OPENING: Openings = (0.0, 0.0)

TORQUES = 24
"""Torques of the grid on each side of zero, closer near zero where few pairs bear."""

_STEPS_PER_SLOT = 2  # the shares step where a pair comes into load; errors of some um blur the steps anyway
_IDLE = 1e-9  # share of the torque limit that stands for the limit towards zero torque from one side
_SLOTS_KEPT = 16
_BEYOND_KEPT = 4  # 2.6 MB each
_SPARSE = 4  # angles of the grid at which teeth are displaced: what is beyond the first order is smooth

PHASES = 16
"""Phases of the flexspline under the wave generator, over half a turn."""

_BEYOND = 1.2  # of the torque limit
_MEAN_TORQUES, _MEAN_ANGLES = 401, 101
_MAP_STEPS = 16  # per tooth passing: 0.005 arcsec rms
_STEP = 5e-9  # [m]; radial step of the central difference: far above rounding, far below a fillet


@dataclass(frozen=True, eq=False)
class SlotErrors:
    """Errors of the circular spline's slots.

    Parameters
    ----------
    circumferential : ndarray, shape (Z_G,)
        Displacement, counter-clockwise [m].
    radial : ndarray, shape (Z_G,)
        Displacement, outward [m].
    clearance : ndarray, shape (2, Z_G)
        Circumferential clearance added to the flanks (+, -) [m].
    """

    circumferential: Floats
    radial: Floats
    clearance: Floats

    @property
    def key(self) -> bytes:
        """What they are told apart by."""
        return b"".join(one.tobytes() for one in (self.circumferential, self.radial, self.clearance))


class ContactTable:
    """Shares of all flanks over one turn of the wave generator and torque.

    Parameters
    ----------
    drive : Drive
    torque_limit : float
        Greatest magnitude of the torque [N m]; beyond it the shares at the limit are used.

    Attributes
    ----------
    contact : Contact
        At every angle of the grid, 0 to 2 pi, both included.
    torsion : ndarray, shape (torques, angles)
        beta [rad], at torques of the cup from -limit to limit; zero torque twice: from below and from above.
    share : ndarray, shape (torques, angles, 2, pairs)
        d beta / d b of every flank [-], negative for - flanks.

    Raises
    ------
    ValueError
        If the torque limit is not positive, or the teeth cannot bear it.
    """

    def __init__(self, drive: Drive, torque_limit: float) -> None:
        if not 0.0 < torque_limit < np.inf:
            raise ValueError(f"torque_limit must be positive, not {torque_limit} N m")
        geometry = drive.mesh.geometry
        self.drive = drive
        self.torque_limit = torque_limit
        self.steps = _STEPS_PER_SLOT * geometry.circular_spline_teeth
        self.contact = contacts(drive.mesh, np.linspace(0.0, 2.0 * np.pi, self.steps + 1))
        self._stiffness = flank_stiffness(self.contact, drive.mesh.tooth_compliance)
        self.torsion = self._torsion()
        self.share = np.stack([shares(self.contact.rotation, self._stiffness, beta) for beta in self.torsion])
        self._tables: dict[tuple[str, int], Complexes] = {}
        self._responses: dict[str, Floats] = {}
        self._slots: dict[tuple[int, Openings], Complexes] = {}
        self._displaced: dict[bytes, Floats] = {}
        self._beyond: dict[tuple[float, ...], Floats] = {}

    def slot_harmonic(self, order: int) -> Complexes:
        """Response to ``c = Re(A exp(i k phi))`` over ``A exp(i k theta_W)`` [rad/m]; (torques, angles)."""
        return self._harmonic(
            "slot", order, lambda: self._slot_angle, lambda: self._summed(FLANKS / self._radius)
        )

    def tooth_harmonic(self, order: int) -> Complexes:
        """The same for the flexspline's teeth, over ``A exp(i k theta_F)``, theta_F = theta_W (1 + 1/N)."""
        return self._harmonic(
            "tooth", order, lambda: self._tooth_angle, lambda: self._summed(-FLANKS / self._radius)
        )

    def radial_harmonic(self, order: int) -> Complexes:
        """The same for a radial displacement of the slots, over ``A exp(i k theta_W)`` [rad/m]."""
        return self._harmonic("radial", order, lambda: self._slot_angle, self._radial_share)

    def clearance(self) -> Complexes:
        """Response to more circumferential clearance on all flanks [rad/m], shape (torques, angles)."""
        return self._harmonic(
            "clearance", 0, lambda: self._slot_angle, lambda: self._summed(1.0 / self._radius)
        )

    def one_slot(self, slot: int, opening: Openings = NO_OPENING) -> Complexes:
        """Response to more clearance on the flanks (+, -) of one slot [rad/m]; (2, torques, angles).

        At an opening [m] of the flanks it is the mean slope from none to that opening.
        """
        slot %= self.drive.mesh.geometry.circular_spline_teeth
        key = (slot, opening)
        if key not in self._slots:
            if len(self._slots) >= _SLOTS_KEPT:
                self._slots.clear()
            angle, pair = np.nonzero(self.contact.slots == slot)
            found = np.zeros((2, *self.torsion.shape))
            for flank in (0, 1):  # a slot is at one lobe at a time: no angle comes twice
                found[flank][:, angle] = self._slope(np.s_[:], angle, flank, pair, opening[flank])
            self._slots[key] = found.astype(np.complex128)
        return self._slots[key]

    def displaced(self, errors: SlotErrors) -> Floats:
        """How the cup turns when the slots have errors of full size [rad], shape (torques, angles)."""
        if errors.key not in self._displaced:
            if len(self._displaced) >= _SLOTS_KEPT:
                self._displaced.clear()
            self._displaced[errors.key] = self._displacement(errors)
        return self._displaced[errors.key]

    def teeth_beyond(self, displacement: Displacement, coefficients: tuple[float, ...]) -> Floats:
        """What errors of the flexspline's teeth do at their size beyond their first order.

        Parameters
        ----------
        displacement : callable
            Coefficients and angles along the flexspline [rad] to the teeth's displacement [m], alike after
            half a turn.
        coefficients : tuple of float

        Returns
        -------
        ndarray, shape (PHASES, torques, angles)
            [rad], at phases ``pi n / PHASES`` by which the flexspline has turned under the wave generator.
        """
        if coefficients not in self._beyond:
            if len(self._beyond) >= _BEYOND_KEPT:
                self._beyond.clear()
            self._beyond[coefficients] = self._teeth_beyond(displacement, np.array(coefficients))
        return self._beyond[coefficients]

    def mean_slot(self) -> Floats:
        """Of slot 0, in the mean over all slots; an eccentric wave generator makes them differ."""
        return self._mean_slot

    @cached_property
    def _mean_slot(self) -> Floats:
        """See :meth:`mean_slot`.

        Returns
        -------
        ndarray, shape (2, torques, angles - 1)
            As :meth:`one_slot`, without the last angle [rad/m].
        """
        count = self.drive.mesh.geometry.circular_spline_teeth
        row = np.arange(self.steps)[:, None] - _STEPS_PER_SLOT * self.contact.slots[:-1]
        row = np.mod(row, self.steps).ravel()
        response = (self.share[:, :-1] / self._radius[:-1] / count).transpose(2, 0, 1, 3)
        response = response.reshape(2, -1, row.size)
        return np.array([[np.bincount(row, one, self.steps) for one in flank] for flank in response])

    def one_tooth(
        self, torque_row: Integers, angle_row: Integers, tooth: Integers, opening: Openings = NO_OPENING
    ) -> Floats:
        """The same for teeth of the flexspline [rad/m], at rows of the grid, shape (n,); (2, n)."""
        teeth, half = self.contact.teeth, self.contact.teeth.shape[1] // 2
        count = self.drive.mesh.geometry.flexspline_teeth
        first, second = (np.mod(tooth - teeth[angle_row, lobe], count) for lobe in (0, half))
        column = np.where(first < half, first, half + np.minimum(second, half - 1))
        near = (first < half) | (second < half)
        slopes = [self._slope(torque_row, angle_row, f, column, opening[f]) for f in (0, 1)]
        return np.where(near, np.stack(slopes), 0.0)

    def _slope(
        self,
        torque_row: Integers | slice,
        angle_row: Integers,
        flank: int,
        pair: Integers,
        opening: float,
    ) -> Floats:
        """Mean response of a flank from no opening to one [rad/m].

        The pair parts where the opening has used up its overlap: there the others bear all of the load, and
        the cup turns no further.
        """
        place = (angle_row * 2 + flank) * self.share.shape[3] + pair
        radius = self._radius.take(place)
        if isinstance(torque_row, slice):
            share = self.share[torque_row, angle_row, flank, pair]
        else:  # by one index, which is several times as fast
            share = self.share.take(torque_row * self._radius.size + place)
        if opening <= 0.0:
            return np.asarray(share / radius)
        overlap = FLANKS[flank, 0] * self.torsion[torque_row, angle_row] - np.nan_to_num(
            self.contact.rotation[angle_row, flank, pair], nan=np.inf
        )
        parted = np.maximum(overlap, 0.0) / np.maximum(1.0 - np.abs(share), 1e-6) * radius
        return np.asarray(share / radius * np.minimum(1.0, parted / opening))

    @cached_property
    def torque_nodes(self) -> Floats:
        """Torques on the cup of the rows [N m]."""
        positive = self.torque_limit * (np.arange(TORQUES + 1) / TORQUES) ** 2
        positive[0] = _IDLE * self.torque_limit
        return np.concatenate((-positive[::-1], positive))

    @cached_property
    def torsion_map(self) -> TorsionMap:
        """Of the mesh without errors, for torques somewhat beyond the limit."""
        return contact_map(self.drive.mesh, self.torque_limit)

    @cached_property
    def mean_torsion(self) -> tuple[Floats, Floats]:
        """Torques on the cup [N m], rising, and the torsion's mean over a turn there [rad]."""
        return mean_torsion(self.drive.mesh, self.torque_limit)

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

    def _radial_share(self) -> Floats:
        """Response to each slot's own radial displacement [rad/m], shape (torques, angles, pairs).

        A slot that moves outward opens both flanks (db) and moves their contacts, which changes how stiff
        they are (dk): ``K d beta`` is the sum of ``k db - overlap dk`` over the loaded flanks.
        """
        opening, softening = self._radial_slopes
        fixed = np.nan_to_num(opening + self.contact.rotation * softening)
        with_torsion = self._summed(FLANKS * np.nan_to_num(softening))
        return self._summed(fixed) - self.torsion[:, :, None] * with_torsion

    def _summed(self, weight: Floats) -> Floats:
        """Shares times a weight of every flank, shape (angles, 2, pairs), summed over both flanks."""
        plus, minus = (self.share[:, :, flank] * weight[:, flank] for flank in (0, 1))
        return np.asarray(plus + minus)

    @cached_property
    def _radial_slopes(self) -> tuple[Floats, Floats]:
        """Closing rotation and logarithm of the stiffness by the radial displacement [rad/m], [1/m]."""
        moved = [self._moved(sign * _STEP) for sign in (-1.0, 1.0)]
        low, high = (flank_stiffness(one, self.drive.mesh.tooth_compliance) for one in moved)
        opening = (moved[1].rotation - moved[0].rotation) / (2.0 * _STEP)
        stiffness = np.where(self._stiffness > 0.0, self._stiffness, 1.0)
        return opening, (high - low) / (2.0 * _STEP * stiffness)

    def _displacement(self, errors: SlotErrors) -> Floats:
        slots = self.contact.slots
        around = FLANKS * errors.circumferential[slots][:, None, :]
        around = around + errors.clearance[:, slots].transpose(1, 0, 2)
        rotation, stiffness = self.contact.rotation + around / self._radius, self._stiffness
        if errors.radial.any():
            opening, softening = self._radial_slopes
            outward = errors.radial[slots][:, None, :]
            rotation = rotation + opening * outward
            stiffness = stiffness * np.exp(np.clip(np.nan_to_num(softening) * outward, -1.0, 1.0))
        return np.asarray(torsion_of_flanks(rotation, stiffness, self.torque_nodes).T - self.torsion)

    def _teeth_beyond(self, displacement: Displacement, coefficients: Floats) -> Floats:
        every = slice(None, None, _SPARSE)
        rest, stiffness, share = self.contact.rotation[every], self._stiffness[every], self.share[:, every]
        found = []
        for phase in np.pi / PHASES * np.arange(PHASES):
            moved = displacement(coefficients, self._tooth_angle[every] + phase)
            turned = -FLANKS * moved[:, None, :] / self._radius[every]
            first = np.einsum("tafp,afp->ta", share, turned)
            beta = torsion_of_flanks(rest + turned, stiffness, self.torque_nodes)
            found.append(beta.T - self.torsion[:, every] - first)
        place = np.arange(self.steps + 1) / _SPARSE
        low = np.minimum(place.astype(np.int64), found[0].shape[1] - 2)
        table = np.nan_to_num(np.stack(found))
        return np.asarray(table[..., low] + (place - low) * (table[..., low + 1] - table[..., low]))

    def _moved(self, outward: float) -> Contact:
        geometry = self.drive.mesh.geometry
        datum = geometry.circular_spline_datum + outward
        mesh = replace(self.drive.mesh, geometry=replace(geometry, circular_spline_datum=datum))
        return contacts(mesh, self._angle)

    def _torsion(self) -> Floats:
        beta = torsion_of_flanks(self.contact.rotation, self._stiffness, self.torque_nodes)
        if np.isnan(beta).any():
            raise ValueError(f"the teeth cannot bear {self.torque_limit:g} N m at every wave generator angle")
        return beta.T

    def _harmonic(
        self, name: str, order: int, angle: Callable[[], Floats], response: Callable[[], Floats]
    ) -> Complexes:
        key = (name, order)
        if key not in self._tables:
            if name not in self._responses:
                self._responses[name] = np.ascontiguousarray(response().transpose(1, 0, 2))
            turning: Complexes = np.exp(1j * order * angle())
            found = self._responses[name] @ np.stack((turning.real, turning.imag), axis=2)
            self._tables[key] = (found[..., 0] + 1j * found[..., 1]).T
        return self._tables[key]


@lru_cache(maxsize=3)  # 9 MB each
def contact_map(mesh: Mesh, torque_limit: float) -> TorsionMap:
    """Torsion of a mesh for torques somewhat beyond a limit [N m], built once."""
    return build(mesh, _BEYOND * torque_limit, steps_per_tooth=_MAP_STEPS)


@lru_cache(maxsize=4)
def mean_torsion(mesh: Mesh, torque_limit: float) -> tuple[Floats, Floats]:
    """Torques on the cup to somewhat beyond a limit [N m], rising, and the torsion's mean over a turn."""
    share = np.linspace(-1.0, 1.0, _MEAN_TORQUES)
    torque = _BEYOND * torque_limit * np.sign(share) * share**2
    turn = np.linspace(0.0, 2.0 * np.pi, _MEAN_ANGLES, endpoint=False)
    return torque, torsion_table(mesh, turn, torque).mean(axis=0)


@lru_cache(maxsize=2)  # 40 MB each
def contact_table(drive: Drive, torque_limit: float) -> ContactTable:
    """Table of a drive up to a torque [N m], built once."""
    return ContactTable(drive, torque_limit)
