"""What errors of single teeth do to the transmission error: the contact's weights, tabulated.

A flank whose clearance grows by db turns the output by ``d beta / d b`` of it: its share of the torsional
stiffness if it bears load, nothing otherwise. Pitch and form errors and single damaged teeth are sums of
these shares, to first order. They are solved exactly on a grid of wave generator angles and torques;
what turns with the wave generator is taken out before a sample is interpolated: the tables are smooth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from hd_diag.drive import Drive
from hd_diag.model import load_sharing
from hd_diag.model.clearance import Contact

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Integers = npt.NDArray[np.int64]
Neighbours = tuple[tuple[Integers, Floats], tuple[Integers, Floats]]
Rows = slice | npt.NDArray[np.bool_] | Integers

_STEPS_PER_SLOT = 2  # the shares step where a pair comes into load; errors of some um blur the steps anyway
_TORQUES = 12  # nodes on each side of zero, closer near zero where few pairs bear
_LEAST_LIMIT = 0.125  # of the rated torque; a table of an idle record still has a width
_IDLE = 1e-9  # share of the torque limit that stands for the limit towards zero torque from one side
_STEP = 5e-9  # [m]; radial step of the central difference: far above rounding, far below a fillet
_FLANKS = np.array([1.0, -1.0])[:, None]


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
        self.contact = drive.mesh.contacts(np.linspace(0.0, 2.0 * np.pi, self.steps + 1))
        self._stiffness = load_sharing.flank_stiffness(self.contact, drive.mesh.tooth_compliance)
        self.torsion = self._torsion()
        self.share = np.stack([self._shares(beta) for beta in self.torsion])
        self._tables: dict[tuple[str, int], Complexes] = {}

    def slot_harmonic(self, order: int) -> Complexes:
        """Response to ``c = Re(A exp(i k phi))`` over ``A exp(i k theta_W)`` [rad/m]; (torques, angles)."""
        return self._harmonic(
            "slot", order, lambda: self._slot_angle, lambda: np.abs(self.share) / self._radius
        )

    def tooth_harmonic(self, order: int) -> Complexes:
        """The same for the flexspline's teeth, over ``A exp(i k theta_F)``, theta_F = theta_W (1 + 1/N)."""
        return self._harmonic(
            "tooth", order, lambda: self._tooth_angle, lambda: -np.abs(self.share) / self._radius
        )

    def radial_harmonic(self, order: int) -> Complexes:
        """The same for a radial displacement of the slots, over ``A exp(i k theta_W)`` [rad/m]."""
        return self._harmonic("radial", order, lambda: self._slot_angle, lambda: self._radial_share)

    def clearance(self) -> Complexes:
        """Response to more circumferential clearance on all flanks [rad/m], shape (torques, angles)."""
        return self._harmonic("clearance", 0, lambda: self._slot_angle, lambda: self.share / self._radius)

    def one_slot(self, slot: int) -> Complexes:
        """Response to more clearance on the flanks (+, -) of one slot [rad/m]; (2, torques, angles)."""
        key = ("one slot", slot % self.drive.mesh.geometry.circular_spline_teeth)
        if key not in self._tables:
            own = self.contact.slots == key[1]
            masked = np.where(own[:, None, :], 1.0 / self._radius, 0.0)
            self._tables[key] = np.einsum("tafp,afp->fta", self.share, masked).astype(np.complex128)
        return self._tables[key]

    def mean_slot(self) -> Floats:
        """Of slot 0, in the mean over all slots; an eccentric wave generator makes them differ.

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

    def one_tooth(self, torque_row: Integers, angle_row: Integers, tooth: Integers) -> Floats:
        """The same for teeth of the flexspline [rad/m], at rows of the grid, shape (n,); (2, n)."""
        teeth, half = self.contact.teeth, self.contact.teeth.shape[1] // 2
        count = self.drive.mesh.geometry.flexspline_teeth
        first, second = (np.mod(tooth - teeth[angle_row, lobe], count) for lobe in (0, half))
        column = np.where(first < half, first, half + np.minimum(second, half - 1))
        near = (first < half) | (second < half)
        found = self.share[torque_row, angle_row, :, column] / self._radius[angle_row, :, column]
        return np.where(near, found.T, 0.0)

    @cached_property
    def torque_nodes(self) -> Floats:
        """Torques on the cup of the rows [N m]."""
        positive = self.torque_limit * (np.arange(_TORQUES + 1) / _TORQUES) ** 2
        positive[0] = _IDLE * self.torque_limit
        return np.concatenate((-positive[::-1], positive))

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
    def _radial_share(self) -> Floats:
        """Response to each slot's own radial displacement [rad/m], shape (torques, angles, 2, pairs).

        A slot that moves outward opens both flanks (db) and moves their contacts, which changes how stiff
        they are (dk): ``K d beta`` is the sum of ``k db - overlap dk`` over the loaded flanks.
        """
        moved = [self._moved(sign * _STEP) for sign in (-1.0, 1.0)]
        stiffness = [load_sharing.flank_stiffness(one, self.drive.mesh.tooth_compliance) for one in moved]
        opening = (moved[1].rotation - moved[0].rotation) / (2.0 * _STEP)
        softer = (
            (stiffness[1] - stiffness[0]) / (2.0 * _STEP) / np.where(self._stiffness > 0, self._stiffness, 1)
        )
        overlap = _FLANKS * self.torsion[:, :, None, None] - self.contact.rotation
        return np.nan_to_num(self.share * (opening - overlap * softer))

    def _moved(self, outward: float) -> Contact:
        geometry = self.drive.mesh.geometry
        datum = geometry.circular_spline_datum + outward
        mesh = replace(self.drive.mesh, geometry=replace(geometry, circular_spline_datum=datum))
        return mesh.contacts(self._angle)

    def _torsion(self) -> Floats:
        curve = load_sharing.torque_curve(self.contact.rotation, self._stiffness)
        beta = load_sharing.torsion(curve, self.torque_nodes)
        if np.isnan(beta).any():
            raise ValueError(f"the teeth cannot bear {self.torque_limit:g} N m at every wave generator angle")
        return beta.T

    def _shares(self, beta: Floats) -> Floats:
        loaded = _FLANKS * beta[:, None, None] > self.contact.rotation
        bearing = np.where(loaded, self._stiffness, 0.0)
        total = bearing.sum(axis=(1, 2), keepdims=True)
        return np.asarray(_FLANKS * bearing / np.where(total > 0.0, total, np.inf))

    def _harmonic(
        self, name: str, order: int, angle: Callable[[], Floats], response: Callable[[], Floats]
    ) -> Complexes:
        key = (name, order)
        if key not in self._tables:
            turning = np.exp(1j * order * angle())
            self._tables[key] = np.einsum("tafp,ap->ta", response(), turning, optimize=True)
        return self._tables[key]


@lru_cache(maxsize=4)
def contact_table(drive: Drive, torque_limit: float) -> ContactTable:
    """Table of a drive up to a torque [N m], built once."""
    return ContactTable(drive, torque_limit)


@dataclass(frozen=True, eq=False)
class ContactWeights:
    """Response of the transmission error to errors of teeth, at samples.

    Parameters
    ----------
    drive : Drive
    wave_generator_angle : ndarray, shape (n,)
        theta_W [rad], continuous over the turns: which teeth are at the lobes follows from their number.
    torque : ndarray, shape (n,)
        On the link [N m].
    torque_limit : float, optional
        Up to which the contact is solved [N m], beyond it the response stays. Left out, the record's own; a
        later evaluation is the same only with the same limit.

    Notes
    -----
    A displacement ``a cos(k (phi - d)) = Re(a exp(-i k d) exp(i k phi))`` gives the error
    ``Re(a exp(-i k d) H) = a cos(k d) Re H + a sin(k d) Im H`` with H the harmonic's response.
    """

    drive: Drive
    wave_generator_angle: Floats
    torque: Floats
    torque_limit: float = 0.0

    def __post_init__(self) -> None:
        if self.torque_limit <= 0.0:
            greatest = float(np.max(np.abs(self.torque), initial=0.0))
            limit = max(greatest, _LEAST_LIMIT * self.drive.rated_torque)
            object.__setattr__(self, "torque_limit", limit)

    @property
    def table(self) -> ContactTable:
        """What is interpolated; built when first needed."""
        return contact_table(self.drive, self.torque_limit)

    def part(self, rows: Rows) -> ContactWeights:
        """Weights at some of the samples."""
        return ContactWeights(
            self.drive, self.wave_generator_angle[rows], self.torque[rows], self.torque_limit
        )

    def slot_harmonic(self, order: int) -> Complexes:
        """Response H to a circumferential displacement of the slots.

        Parameters
        ----------
        order : int
            k, periods around the circular spline.

        Returns
        -------
        ndarray of complex, shape (n,)
            Of TE to ``c = Re(A exp(i k phi))``, counter-clockwise at slot angle phi: Re(A H); H in [rad/m].
        """
        return self._sign * self._interpolate(self.table.slot_harmonic(order)) * self._turning(order, 1.0)

    def tooth_harmonic(self, order: int) -> Complexes:
        """Response H to a circumferential displacement of the flexspline's teeth [rad/m], shape (n,).

        The angle is that of the tooth along the flexspline, tooth 0 at zero.
        """
        turns = 1.0 + 1.0 / self.drive.mesh.geometry.reduction
        return self._sign * self._interpolate(self.table.tooth_harmonic(order)) * self._turning(order, turns)

    def radial_harmonic(self, order: int) -> Complexes:
        """Response H to a radial displacement of the slots, outward [rad/m], shape (n,)."""
        return self._sign * self._interpolate(self.table.radial_harmonic(order)) * self._turning(order, 1.0)

    def clearance(self) -> Floats:
        """Response to more circumferential clearance on both flanks of all pairs [rad/m], shape (n,)."""
        return self._sign * self._interpolate(self.table.clearance()).real

    def one_slot(self, position: float) -> Floats:
        """Response to more clearance on the flanks (+, -) of the slot nearest an angle.

        Parameters
        ----------
        position : float
            Angle of the slot's axis in the circular spline [rad].

        Returns
        -------
        ndarray, shape (n, 2)
            [rad/m]; wear of both flanks is the sum, a displaced slot the difference.
        """
        slot = round(position / self.drive.mesh.geometry.slot_pitch)
        flanks = self.table.one_slot(slot)
        return self._sign * np.stack([self._interpolate(flank).real for flank in flanks], axis=1)

    def one_tooth(self, position: float) -> Floats:
        """Response to more clearance on the flanks (+, -) of the tooth nearest an angle of the flexspline.

        Parameters
        ----------
        position : float
            Angle of the tooth along the flexspline, tooth 0 at zero [rad].

        Returns
        -------
        ndarray, shape (n, 2)
            [rad/m]
        """
        geometry = self.drive.mesh.geometry
        turn = np.floor(self.wave_generator_angle / (2.0 * np.pi)).astype(np.int64)
        ahead = geometry.circular_spline_teeth - geometry.flexspline_teeth
        tooth = np.mod(round(position / geometry.tooth_pitch) - ahead * turn, geometry.flexspline_teeth)
        result = np.zeros((2, self.torque.size))
        for torque_row, torque_share in self.torque_rows:
            for angle_row, angle_share in self.angle_rows:
                result += torque_share * angle_share * self.table.one_tooth(torque_row, angle_row, tooth)
        return self._sign * result.T

    @property
    def _sign(self) -> float:
        return -self.drive.kinematics.torque_sign

    def _turning(self, order: int, turns: float) -> Complexes:
        return np.asarray(np.exp(1j * order * turns * self.wave_generator_angle))

    @cached_property
    def angle_rows(self) -> Neighbours:
        """Rows of the table on both sides of every angle, and their shares; each of shape (n,)."""
        steps = self.table.steps
        place = np.mod(self.wave_generator_angle, 2.0 * np.pi) * (steps / (2.0 * np.pi))
        return _neighbours(place, steps)

    @cached_property
    def torque_rows(self) -> Neighbours:
        """Rows of the table on both sides of every torque, and their shares; each of shape (n,)."""
        cup = self.drive.kinematics.cup_torque(self.torque)
        place = np.sqrt(np.minimum(np.abs(cup) / self.table.torque_limit, 1.0)) * _TORQUES
        (low, low_share), (high, high_share) = _neighbours(place, _TORQUES)
        low, high = (np.where(cup < 0.0, _TORQUES - row, _TORQUES + 1 + row) for row in (low, high))
        idle = cup == 0.0  # the middle of a gap: the mean of both sides
        return (
            (np.where(idle, _TORQUES, low), np.where(idle, 0.5, low_share)),
            (np.where(idle, _TORQUES + 1, high), np.where(idle, 0.5, high_share)),
        )

    def _interpolate(self, table: Complexes) -> Complexes:
        result = np.zeros(self.torque.shape, dtype=np.complex128)
        for torque_row, torque_share in self.torque_rows:
            for angle_row, angle_share in self.angle_rows:
                result += torque_share * angle_share * table[torque_row, angle_row]
        return result


def _neighbours(place: Floats, last: int) -> Neighbours:
    row = np.clip(np.floor(place), 0, last - 1).astype(np.int64)
    share = place - row
    return (row, 1.0 - share), (row + 1, share)
