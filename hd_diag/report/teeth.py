"""Backlash and load of every tooth over a turn of the input, and at a record's own moments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.drive import Drive, mesh_state

_ANGLES = 180  # over a turn of the input
_DIRECTIONS = 120  # around the gear
_MOMENTS = 720  # of the record
_STRONG = 99.0  # percentile of a record's torque for which the map is drawn
_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class TeethOverTurn:
    """Teeth over a turn of the input at one torque.

    Attributes
    ----------
    torque : float
        On the link [N m].
    input_angle : ndarray, shape (angles,)
        As reported, over one turn [rad].
    backlash : ndarray, shape (angles, Z_R)
        Lesser of both flanks [m], nan where a pair cannot touch.
    load : ndarray, shape (angles, Z_R)
        Sum of both flanks [N].
    visited : ndarray of bool, shape (angles,)
        Whether the record was there.
    moment : int
        Index of the angle with the greatest force on a tooth.
    tooth_direction : ndarray, shape (Z_R,)
        Where the teeth stand then, in the housing [rad].
    direction, least_backlash, greatest_load : ndarray, shape (directions,)
        Around the housing [rad], over the whole turn [m], [N].
    long_axis, eccentricity : float
        Direction of the wave generator's long axis at that moment, and of its displacement [rad].
    displacement : float
        Size of that displacement [m].
    """

    torque: float
    input_angle: Floats
    backlash: Floats
    load: Floats
    visited: npt.NDArray[np.bool_]
    moment: int
    tooth_direction: Floats
    direction: Floats
    least_backlash: Floats
    greatest_load: Floats
    long_axis: float
    eccentricity: float
    displacement: float


class Extremes(NamedTuple):
    """Of a record's moments: least backlash [m], greatest force [N], loaded flanks, overlap [m]."""

    moments: int
    least_backlash: float
    greatest_load: float
    fewest_pairs: int
    most_pairs: int
    overlap: float


def strongest_torque(torque: Floats) -> float:
    """The torque that a record hardly exceeds, in its stronger direction [N m]."""
    low, high = (float(np.percentile(torque, q)) for q in (100.0 - _STRONG, _STRONG))
    return high if high >= -low else low


def teeth_over_turn(drive: Drive, input_angle: Floats, torque: float) -> TeethOverTurn:
    """Teeth over a turn.

    Parameters
    ----------
    drive : Drive
    input_angle : ndarray, shape (n,)
        Where the record was [rad].
    torque : float
        On the link [N m].
    """
    frame, geometry = drive.frame, drive.mesh.geometry
    angle = _TURN * (np.arange(_ANGLES) + 0.5) / _ANGLES
    state = mesh_state(drive, angle, frame.cup_torque(np.full(_ANGLES, torque)))
    backlash, load = np.fmin(state.backlash[:, 0], state.backlash[:, 1]), state.load.sum(axis=1)
    turned, teeth = frame.wave_generator_angle(angle), geometry.flexspline_teeth
    # Where the teeth stand in the housing, shape (angles, teeth) [rad]; their bending is left out.
    cup = -turned[:, None] * ((geometry.circular_spline_teeth - teeth) / teeth)
    place = np.mod(cup + _TURN * np.arange(teeth) / teeth, _TURN)
    at = int(np.argmax(load.max(axis=1)))
    displacement = complex(drive.mesh.displacement(turned[at : at + 1])[0])
    return TeethOverTurn(
        torque,
        angle,
        backlash,
        load,
        np.bincount(_sector(input_angle, _ANGLES), minlength=_ANGLES) > 0,
        at,
        place[at],
        *_around(place, backlash, load),
        float(np.mod(turned[at], _TURN)),
        float(np.angle(displacement)),
        abs(displacement),
    )


def _sector(angle: Floats, sectors: int) -> npt.NDArray[np.int64]:
    """In which of the equal parts of a turn an angle [rad] lies."""
    return (np.mod(angle, _TURN) / _TURN * sectors).astype(np.int64) % sectors


def _around(place: Floats, backlash: Floats, load: Floats) -> tuple[Floats, Floats, Floats]:
    """Direction in the housing, least backlash and greatest load there over a turn."""
    sector = _sector(place, _DIRECTIONS)
    least, greatest = np.full(_DIRECTIONS, np.inf), np.zeros(_DIRECTIONS)
    known = np.isfinite(backlash)
    np.minimum.at(least, sector[known], backlash[known])
    np.maximum.at(greatest, sector.ravel(), load.ravel())
    least[~np.isfinite(least)] = np.nan
    return _TURN * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS, least, greatest


def extremes(drive: Drive, input_angle: Floats, torque: Floats) -> Extremes:
    """What the record's own angles and torques did to the teeth.

    Parameters
    ----------
    drive : Drive
    input_angle, torque : ndarray, shape (n,)
        As reported [rad], on the link [N m]; of many, moments at equal distances are looked at.
    """
    rows = np.unique(np.linspace(0, input_angle.size - 1, _MOMENTS).astype(np.int64))
    state = mesh_state(drive, input_angle[rows], drive.frame.cup_torque(torque[rows]))
    return Extremes(
        rows.size,
        float(np.nanmin(state.minimum_backlash)),
        float(np.max(state.peak_load)),
        int(state.loaded_pairs.min()),
        int(state.loaded_pairs.max()),
        float(np.nanmax(state.overlap)),
    )
