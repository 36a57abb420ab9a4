"""Response of the transmission error to errors of teeth, at the samples of a record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.drive import Drive
from hd_diag.effects.contact_table import (
    NO_OPENING,
    PHASES,
    TORQUES,
    ContactTable,
    Error,
    Neighbours,
    Openings,
    contact_table,
)

Values = TypeVar("Values", Floats, Complexes)
Rows = slice | npt.NDArray[np.bool_] | Integers

_ROUNDED = 1e-7  # step of coefficients at which tooth errors are solved at full size [m]
_LEAST_LIMIT = 0.125  # least torque limit over the rated torque: an idle record needs a table too


@dataclass(frozen=True, eq=False)
class ContactWeights:
    """Response of the transmission error to errors of teeth, at samples.

    Parameters
    ----------
    table : ContactTable
        Table to interpolate. Beyond its torque limit the response stays constant.
    wave_generator_angle : ndarray, shape (n,)
        theta_W [rad], continuous over the turns: the number of turns decides which teeth are at the lobes.
    torque : ndarray, shape (n,)
        On the link [N m].
    torsion : ndarray, shape (n,), optional
        Torsion of the mesh if it is already known [rad].

    Notes
    -----
    A displacement ``a cos(k (phi - d)) = Re(a exp(-i k d) exp(i k phi))`` gives the error
    ``Re(a exp(-i k d) H) = a cos(k d) Re H + a sin(k d) Im H`` with H the harmonic's response.
    """

    table: ContactTable
    wave_generator_angle: Floats
    torque: Floats
    torsion: Floats | None = None

    @property
    def drive(self) -> Drive:
        """Drive of the table."""
        return self.table.drive

    def part(self, rows: Rows) -> ContactWeights:
        """Weights at selected samples; known torsion and ripple are kept."""
        known = None if self.torsion is None else self.torsion[rows]
        found = ContactWeights(self.table, self.wave_generator_angle[rows], self.torque[rows], known)
        if "ripple" in self.__dict__:
            found.__dict__["ripple"] = self.ripple[rows]
        return found

    def harmonics(self, error: Error, orders: tuple[int, ...]) -> Complexes:
        """Responses H [rad/m] to displacements ``Re(A exp(i k phi))`` with k periods around, (n, orders).

        TE is ``Re(A H)``. The error displaces slots ("slot") or teeth ("tooth") counter-clockwise, or slots
        outward ("radial"). phi is the angle of the slot, or of the tooth along the flexspline, where tooth 0
        is at zero.
        """
        responses = self._interpolate(self.table.harmonics(error, orders))
        return self._sign * responses * self._turned(error, orders)

    def even_harmonics(self, orders: tuple[int, ...]) -> Complexes:
        """Responses [rad/m] to tooth errors if a preload makes all teeth bear at any torque, (n, orders).

        The flexspline lags by the displacement of its teeth over the radius.
        """
        return -self._sign / self.drive.mesh.geometry.curve.radius * self._turned("tooth", orders)

    def _turned(self, error: Error, orders: tuple[int, ...]) -> Complexes:
        """``exp(i k phi)`` (n, orders); phi is the wave generator's angle in the displaced member."""
        angle = self.flexspline_angle if error == "tooth" else self.wave_generator_angle
        turned: Complexes = np.power.outer(np.exp(1j * angle), orders)
        return turned

    @property
    def flexspline_angle(self) -> Floats:
        """theta_F = theta_W (1 + 1/N), the wave generator seen from the flexspline [rad], shape (n,)."""
        return np.asarray(self.wave_generator_angle * (1.0 + 1.0 / self.drive.mesh.geometry.reduction))

    def clearance(self) -> Floats:
        """Response to added circumferential clearance on both flanks of all pairs [rad/m], shape (n,)."""
        return self._sign * self._interpolate(self.table.harmonics("clearance", (0,)).real)[:, 0]

    def one_slot(self, position: float, opening: Openings = NO_OPENING) -> Floats:
        """Response to more clearance on the flanks (+, -) of the slot nearest an angle [rad/m], shape (n, 2).

        Wear of both flanks is the sum of the columns, a displaced slot their difference. The response is the
        mean slope from zero to the `opening` of the flanks [m]; it falls once the pair has parted. `position`
        is the angle of the slot's axis in the circular spline [rad].
        """
        geometry = self.drive.mesh.geometry
        slot = round(position / geometry.slot_pitch) % geometry.circular_spline_teeth
        return self._sign * self._interpolate(self.table.one_slot(slot, opening))

    def one_tooth(self, position: float, opening: Openings = NO_OPENING) -> Floats:
        """As `one_slot`, for the tooth nearest an angle along the flexspline [rad/m], shape (n, 2)."""
        geometry = self.drive.mesh.geometry
        turn = np.floor(self.wave_generator_angle / (2.0 * np.pi)).astype(np.int64)
        ahead = geometry.circular_spline_teeth - geometry.flexspline_teeth
        tooth = np.mod(round(position / geometry.tooth_pitch) - ahead * turn, geometry.flexspline_teeth)
        return self._sign * self.table.one_tooth(self.torque_rows, self.angle_rows, tooth, opening).T

    def one_by_share(self, share: Floats) -> Floats:
        """As `one_slot`, for a pair with a given share (n,) of the load instead of the contact's, (n, 2)."""
        cup_torque = self.drive.frame.cup_torque(self.torque)
        flanks = np.stack((cup_torque > 0.0, -1.0 * (cup_torque < 0.0)), axis=1)
        return np.asarray(self._sign / self.drive.mesh.geometry.curve.radius * share[:, None] * flanks)

    def under_more_torque(self, torque: Floats) -> Floats:
        """Change of TE [rad] by additional torque (n,) [N m] on the link, the cup's compliance included."""
        change = self._torsion(self.torque + torque) - self._own_torsion()
        return self.drive.frame.transmission_error(change, torque)

    @cached_property
    def ripple(self) -> Floats:
        """The model's TE less its mean over a turn of the wave generator [rad], shape (n,)."""
        cup_torque = self.drive.frame.cup_torque(self.torque)
        return self._sign * (self._own_torsion() - np.interp(cup_torque, *self.table.mean_torsion))

    def displaced(
        self,
        circumferential: Floats | float = 0.0,
        radial: Floats | float = 0.0,
        clearance: Floats | float = 0.0,
    ) -> Floats:
        """Change of TE [rad] by slot errors at full size, with pairs that come into or out of load.

        Displacements of slots counter-clockwise and outward, and circumferential clearance added to the
        flanks (+, -) [m]: scalars for all slots, or (Z_G,), (Z_G,) and (2, Z_G).
        """
        errors = np.empty((4, self.drive.mesh.geometry.circular_spline_teeth))
        errors[0], errors[1], errors[2:] = circumferential, radial, clearance
        change = self.table.displaced(errors)
        return self._sign * self._interpolate(change[..., None])[:, 0]

    def teeth_beyond(self, orders: tuple[int, ...], coefficients: Floats) -> Floats:
        """Change of TE [rad] by errors of the flexspline's teeth at full size, less the first order.

        The errors are waves of `orders` periods around, with cosine and sine coefficients (2 k,) [m]. They
        are solved at coefficients rounded to `_ROUNDED` and scaled with the square of the size.
        """
        size = float(np.linalg.norm(coefficients))
        rounded = _ROUNDED * np.rint(coefficients / _ROUNDED)
        solved = float(np.linalg.norm(rounded))
        if not solved:
            return np.zeros(self.torque.size)
        table = self.table.teeth_beyond(orders, tuple(rounded.tolist()))
        table = self._sign * (size / solved) ** 2 * table
        turned = np.mod(self.flexspline_angle, np.pi)
        (low, low_share), (high, high_share) = _neighbours(turned * (PHASES / np.pi), PHASES)
        result = np.zeros(self.torque.size)
        for torque_row, angle_row, share in self._cells():
            first = table[low, torque_row, angle_row]
            second = table[np.mod(high, PHASES), torque_row, angle_row]
            result += share * (low_share * first + high_share * second)
        return result

    @property
    def slot_angles(self) -> Floats:
        """Angles of all slots in the circular spline [rad], shape (Z_G,)."""
        geometry = self.drive.mesh.geometry
        return geometry.slot_pitch * np.arange(geometry.circular_spline_teeth, dtype=np.float64)

    @cached_property
    def angle_rows(self) -> Neighbours:
        """Rows of the table on both sides of every angle, and their weights; each of shape (n,)."""
        steps = self.table.steps
        place = np.mod(self.wave_generator_angle, 2.0 * np.pi) * (steps / (2.0 * np.pi))
        return _neighbours(place, steps)

    @cached_property
    def torque_rows(self) -> Neighbours:
        """Rows of the table on both sides of every torque, and their weights; each of shape (n,)."""
        cup = self.drive.frame.cup_torque(self.torque)
        place = np.sqrt(np.minimum(np.abs(cup) / self.table.torque_limit, 1.0)) * TORQUES
        (low, low_share), (high, high_share) = _neighbours(place, TORQUES)
        low, high = (np.where(cup < 0.0, TORQUES - row, TORQUES + 1 + row) for row in (low, high))
        idle = cup == 0.0  # in the middle of the gap: the mean of both limits
        return (
            (np.where(idle, TORQUES, low), np.where(idle, 0.5, low_share)),
            (np.where(idle, TORQUES + 1, high), np.where(idle, 0.5, high_share)),
        )

    def _cells(self) -> Iterator[tuple[Integers, Integers, Floats]]:
        """Torque row, angle row and weight of each of the four nodes around every sample."""
        for torque_row, torque_share in self.torque_rows:
            for angle_row, angle_share in self.angle_rows:
                yield torque_row, angle_row, torque_share * angle_share

    @cached_property
    def _nodes(self) -> list[tuple[Integers, Floats]]:
        """As `_cells`, with one flat index for both rows."""
        count = self.table.steps + 1
        return [(torque_row * count + row, share[:, None]) for torque_row, row, share in self._cells()]

    @property
    def _sign(self) -> float:
        return -self.drive.frame.torque_sign

    def _own_torsion(self) -> Floats:
        return self._torsion(self.torque) if self.torsion is None else self.torsion

    def _torsion(self, torque: Floats) -> Floats:
        """Torsion of the mesh at a torque on the link [rad]."""
        return self.table.torsion_under(self.wave_generator_angle, self.drive.frame.cup_torque(torque))

    def _interpolate(self, table: Values) -> Values:
        """Values at the samples (n, k), from a table (torques, angles, k)."""
        flat = table.reshape(-1, table.shape[-1])
        found = np.zeros((self.torque.size, flat.shape[1]), flat.dtype)
        for node, share in self._nodes:
            part = flat.take(node, axis=0)
            part *= share
            found += part
        return found


def contact_weights(
    drive: Drive,
    wave_generator_angle: Floats,
    torque: Floats,
    torsion: Floats | None = None,
    least: float = 0.0,
) -> ContactWeights:
    """Weights of a drive at samples; the table covers the greatest torque, and at least `least` [N m]."""
    limit = max(greatest_torque(drive, torque), least)
    return ContactWeights(contact_table(drive, limit), wave_generator_angle, torque, torsion)


def greatest_torque(drive: Drive, torque: Floats) -> float:
    """Torque limit for a record's contact table [N m], from its torque, shape (n,)."""
    return max(float(np.max(np.abs(torque), initial=0.0)), _LEAST_LIMIT * drive.rated_torque)


def _neighbours(place: Floats, last: int) -> Neighbours:
    row = np.clip(np.floor(place), 0, last - 1).astype(np.int64)
    share = place - row
    return (row, 1.0 - share), (row + 1, share)
