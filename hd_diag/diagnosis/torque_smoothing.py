"""The torque as a regressor: smoothed, but with the waves that a sensor feels as the lobes pass."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import special

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.smoothing import best_widths, judged, settled, smooth, usual_prediction_error
from hd_diag.effects.torque_sensor_ripple import ORDERS

_FIRST = 0.2  # first window of the search for waves [s]
_ALIKE = 0.01  # least singular value over the greatest; frames coincide over a short travel
_CHANCE = 1e-6  # largest p value of waves
_BETTER = 0.99  # largest ratio of prediction errors with and without waves; jumps are no waves
_ROUNDS = 6  # alternating updates of window and waves
_PASSES = 2  # waves scale with the torque: first with its ripple, then without


class SmoothedTorque(NamedTuple):
    """Smoothed torque [N m] and window [s], (n,) each, and whether waves of the input's turn are kept."""

    torque: Floats
    window: Floats
    with_waves: bool


def smoothed_torque(
    reported: Floats, angle: Floats, ratio: float, segment: Integers, step: float
) -> SmoothedTorque:
    """Torque without its noise.

    A ripple of the lobes would force a narrow window, and a wide window would damp the ripple. Its waves are
    therefore fitted and kept: of constant size and proportional to the torque, over the input's turn as seen
    from the housing or either member.

    Parameters
    ----------
    reported : ndarray, shape (n,)
        [N m]
    angle : ndarray, shape (n,)
        Input angle [rad].
    ratio : float
        Input angle over output angle [-].
    segment : ndarray of int64, shape (n,)
        Number of the gap-free stretch of each sample, ascending.
    step : float
        Time between samples [s].
    """
    some = judged(segment)
    sizes = _sizes(reported[some], angle[some], ratio, segment[some], step)
    if sizes is not None:
        even = smooth(reported, segment, step, _FIRST)
        most = float(np.std(reported - even))
        for _ in range(_PASSES):
            ripple = _ripple(sizes, angle, even, ratio)
            window = best_widths(reported - ripple, segment, step)
            even = smooth(reported - ripple, segment, step, window)
        if np.std(reported - ripple - even) <= most:  # otherwise the waves are local to the judged rows
            return SmoothedTorque(even + ripple, window, True)
    window = best_widths(reported, segment, step)
    smoothed = smooth(reported, segment, step, window)
    return SmoothedTorque(settled(reported, smoothed, step, float(window.max())), window, False)


def _sizes(reported: Floats, angle: Floats, ratio: float, segment: Integers, step: float) -> Floats | None:
    """Sizes of the waves (k,), found with the best window; None if they may be noise or jumps."""
    window, ripple, known = np.full(reported.size, _FIRST), np.zeros(reported.size), None
    for _ in range(_ROUNDS):
        even = smooth(reported - ripple, segment, step, window)
        quick = np.stack([w - smooth(w, segment, step, window) for w in _waves(angle, even, ratio)], axis=1)
        rest = reported - smooth(reported, segment, step, window)
        sizes, rank = _fitted(quick, rest)
        left, freedom = float(np.sum((rest - quick @ sizes) ** 2)), rest.size - rank
        if not 0 < rank < freedom:
            break
        fisher = (float(rest @ rest) - left) / rank / max(left / freedom, 1e-300)
        if special.fdtrc(rank, freedom, fisher) > _CHANCE:
            break
        known, ripple = sizes, _ripple(sizes, angle, even, ratio)
        last, window = window, best_widths(reported - ripple, segment, step)
        if np.array_equal(window, last):
            break
    if known is None:
        return None
    before, after = (usual_prediction_error(one, segment, step) for one in (reported, reported - ripple))
    return known if after < _BETTER * before * (1.0 - known.size / reported.size) ** 2 else None


def _fitted(columns: Floats, values: Floats) -> tuple[Floats, int]:
    """Least-squares coefficients (k,) of columns (n, k), and their rank, from the normal equations.

    A singular value decomposition of the columns, as in `numpy.linalg.lstsq`, takes ten times as long.
    Singular values above :data:`_ALIKE` lose no accuracy by squaring.
    """
    norm = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    even = columns / norm
    squares, directions = np.linalg.eigh(even.T @ even)
    apart = squares > _ALIKE**2 * squares[-1]
    along = directions[:, apart]
    sizes = along @ ((along.T @ (even.T @ values)) / squares[apart])
    return sizes / norm, int(np.count_nonzero(apart))


def _ripple(sizes: Floats, angle: Floats, torque: Floats, ratio: float) -> Floats:
    """Sum of the waves with their sizes [N m], shape (n,)."""
    total = np.zeros(torque.size)
    for size, wave in zip(sizes, _waves(angle, torque, ratio), strict=True):
        total += size * wave
    return total


def _waves(angle: Floats, torque: Floats, ratio: float) -> Iterator[Floats]:
    """Waves (n,) of the input's turn seen from the housing and both members, each also times the torque."""
    for order, side in product(ORDERS, (-1.0, 0.0, 1.0)):
        phase = order * (1.0 + side / abs(ratio)) * angle
        for wave in (np.cos(phase), np.sin(phase)):
            yield wave
            yield wave * torque
