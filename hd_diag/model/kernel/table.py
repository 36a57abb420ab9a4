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
def interpolated(
    breakpoints: Floats, values: Floats, turn: float, torque: float, below_end: float, column: int
) -> tuple[float, int]:
    """Torsion between two rows of the table, and the column in which it was found.

    ``below_end`` is the float before the last breakpoint; ``column`` is where to look first.
    """
    steps = breakpoints.shape[0] - 1
    place = _within_turn(turn) * (steps / _TURN)
    if math.isnan(place):
        return math.nan, column
    row, value = min(int(place), steps - 1), min(torque, below_end)
    column = _last_not_above(breakpoints[row], value, column)
    low = _at(breakpoints[row], values[row], torque, column)
    column = _last_not_above(breakpoints[row + 1], value, column)
    high = _at(breakpoints[row + 1], values[row + 1], torque, column)
    return low + (place - row) * (high - low), column


@inline
def _within_turn(turn: float) -> float:
    rest: float = np.fmod(turn, _TURN)
    return rest + (_TURN if rest < 0.0 else 0.0)


@inline
def _at(breakpoints: Floats, values: Floats, torque: float, column: int) -> float:
    """Torsion of one row; the middle of a true gap."""
    beta = _from(breakpoints, values, torque, column)
    if torque == 0.0:
        beta = 0.5 * (
            beta + _from(breakpoints, values, torque, _last_not_above(breakpoints, _BELOW_ZERO, column))
        )
    return beta


@inline
def _from(breakpoints: Floats, values: Floats, torque: float, column: int) -> float:
    start, beta = breakpoints[column], values[column]
    slope = (values[column + 1] - beta) / (breakpoints[column + 1] - start)
    result: float = beta + slope * (torque - start)
    return result


@inline
def _last_not_above(breakpoints: Floats, value: float, column: int) -> int:
    """Column of the last entry <= value, at most the last but one.

    Looked for from another one's column: torques and breakpoints move little from one to the next.
    """
    while column > 0 and breakpoints[column] > value:
        column -= 1
    while column < breakpoints.size - 2 and breakpoints[column + 1] <= value:
        column += 1
    return column
