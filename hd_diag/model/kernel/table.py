"""Interpolation in a torsion map: the operations of ``torsion_map`` in their order, equal to the last bit."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hd_diag.model.kernel import inline, part

Floats = npt.NDArray[np.float64]

_TURN = 2.0 * math.pi
_BELOW_ZERO = -5e-324  # the float before zero


@part
def interpolated(breakpoints: Floats, values: Floats, turn: float, torque: float) -> float:
    """Torsion between two rows of the table."""
    steps = breakpoints.shape[0] - 1
    place = _mod_turn(turn) * (steps / _TURN)
    if math.isnan(place):
        return math.nan
    row = min(int(place), steps - 1)
    low = _at(breakpoints[row], values[row], torque)
    high = _at(breakpoints[row + 1], values[row + 1], torque)
    return low + (place - row) * (high - low)


@inline
def _mod_turn(turn: float) -> float:
    rest = math.fmod(turn, _TURN)
    return rest + (_TURN if rest < 0.0 else 0.0)


@part
def _at(breakpoints: Floats, values: Floats, torque: float) -> float:
    """Torsion of one row; the middle of a true gap."""
    beta = _from(breakpoints, values, torque, _last_not_above(breakpoints, torque))
    if torque == 0.0:
        beta = 0.5 * (beta + _from(breakpoints, values, torque, _last_not_above(breakpoints, _BELOW_ZERO)))
    return beta


@inline
def _from(breakpoints: Floats, values: Floats, torque: float, column: int) -> float:
    start, beta = breakpoints[column], values[column]
    slope = (values[column + 1] - beta) / (breakpoints[column + 1] - start)
    return beta + slope * (torque - start)


@inline
def _last_not_above(breakpoints: Floats, value: float) -> int:
    """Column of the last entry <= value that lies below the limit, or the first one."""
    low, high = 0, breakpoints.size - 1
    limit = breakpoints[high]
    while high - low > 1:
        half = (low + high) >> 1
        ahead = breakpoints[half] <= value and breakpoints[half] < limit
        low, high = (half, high) if ahead else (low, half)
    return low
