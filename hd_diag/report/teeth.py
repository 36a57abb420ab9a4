"""Backlash and load of every tooth over a turn of the input, and at a record's own moments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.drive import Drive, mesh_state
from hd_diag.formatting import rounded

_ANGLES = 180  # over a turn of the input
_DIRECTIONS = 120  # around the gear
_MOMENTS = 720  # of the record
_STRONG = 99.0  # percentile of a record's torque for which the map is drawn
_TURN = 2.0 * np.pi
_FREE = 2.0 / 15.0  # backlash over module above which a tooth counts as free: 40 um at 0.3 mm


class Extremes(NamedTuple):
    """Extremes in a record's moments: least backlash [m], greatest force [N], loaded flanks, overlap [m]."""

    moments: int
    least_backlash: float
    greatest_load: float
    fewest_pairs: int
    most_pairs: int
    overlap: float


@dataclass(frozen=True)
class TeethOverTurn:
    """Teeth over a turn of the input at one torque [N m].

    `input_angle` [rad] has shape (angles,). `backlash`, the lesser of both flanks [m], and `load`, their sum
    [N], have shape (angles, Z_R); `visited` marks the angles in the record. `moment` is the index of the
    angle with the greatest force on a tooth. At that moment the teeth, the long axis and the wave generator's
    `displacement` [m] have the given directions in the housing [rad]. `least_backlash` [m] and
    `greatest_load` [N] of the whole turn are given over `direction`, shape (directions,). `extremes` are
    those of the record's own moments. A tooth with a backlash of `free` [m] or more is far from any load.
    """

    torque: float
    input_angle: Floats
    backlash: Floats
    load: Floats
    visited: npt.NDArray[np.bool_]
    moment: int
    tooth_direction: Floats
    long_axis: float
    eccentricity: float
    displacement: float
    direction: Floats
    least_backlash: Floats
    greatest_load: Floats
    extremes: Extremes
    free: float


def strongest_torque(torque: Floats) -> float:
    """The torque that a record hardly exceeds, in its stronger direction [N m]."""
    low, high = (float(np.percentile(torque, q)) for q in (100.0 - _STRONG, _STRONG))
    return high if high >= -low else low


def teeth_over_turn(drive: Drive, input_angle: Floats, torque: Floats) -> TeethOverTurn:
    """Teeth under the strongest of a record's torques [N m]; angles as reported [rad], shape (n,) both."""
    from scipy.stats import binned_statistic  # imported late: it takes half a second

    frame, geometry, strong = drive.frame, drive.mesh.geometry, strongest_torque(torque)
    angle = _TURN * (np.arange(_ANGLES) + 0.5) / _ANGLES
    state = mesh_state(drive, angle, frame.cup_torque(np.full(_ANGLES, strong)))
    backlash, load = np.fmin(state.backlash[:, 0], state.backlash[:, 1]), state.load.sum(axis=1)
    turned, teeth = frame.wave_generator_angle(angle), geometry.flexspline_teeth
    # Directions of the teeth in the housing, shape (angles, teeth) [rad], without their bending.
    cup = -turned[:, None] * ((geometry.circular_spline_teeth - teeth) / teeth)
    place = np.mod(cup + _TURN * np.arange(teeth) / teeth, _TURN)
    at = int(np.argmax(load.max(axis=1)))
    displacement = complex(drive.mesh.displacement(turned[at : at + 1])[0])
    known, around = np.isfinite(backlash), {"bins": _DIRECTIONS, "range": (0.0, _TURN)}
    return TeethOverTurn(
        strong,
        angle,
        backlash,
        load,
        np.histogram(np.mod(input_angle, _TURN), _ANGLES, (0.0, _TURN))[0] > 0,
        at,
        place[at],
        float(np.mod(turned[at], _TURN)),
        float(np.angle(displacement)),
        abs(displacement),
        _TURN * (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS,
        binned_statistic(place[known], backlash[known], "min", **around).statistic,
        np.nan_to_num(binned_statistic(place.ravel(), load.ravel(), "max", **around).statistic),
        _extremes(drive, input_angle, torque),
        rounded(_FREE * geometry.module, 1),
    )


def _extremes(drive: Drive, input_angle: Floats, torque: Floats) -> Extremes:
    """Extremes at the record's own angles and torques, for at most `_MOMENTS` evenly spaced moments."""
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
