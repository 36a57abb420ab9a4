"""Samples far off their neighbours, as lost bits and disturbed lines make them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.blocks import filtered
from hd_diag.diagnosis.noise import bounds, numbered

Rows = npt.NDArray[np.bool_]

_OUTLIER = 8.0  # robust standard deviations of what neighbours do not predict
_OUTLIER_WINDOW = 51  # over which that deviation is taken [samples]
_OUTLIER_PASSES = 3
_OUTLYING_TORQUE = 0.5  # of the range of torques, without which a sample is no outlier: it hardly matters
_ROUNDING = 1e-9  # of the largest torque, within which it is constant


def torque_outliers(torque: Floats, bag: Integers) -> Rows:
    """Torques far off both their neighbours, by much of the range of all, shape (n,).

    A torque that is reported less often than the angles stands in several rows.

    Parameters
    ----------
    torque : ndarray, shape (n,)
        [N m]; what is not finite is no outlier, and no neighbour.
    bag : ndarray of int64, shape (n,)
        Number of the recording, ascending.
    """
    found, finite = np.zeros(torque.size, dtype=bool), np.flatnonzero(np.isfinite(torque))
    if finite.size:
        torque, bag = torque[finite], bag[finite]
        low, high = np.percentile(torque, (1.0, 99.0))
        least = max(_OUTLYING_TORQUE * (high - low), _ROUNDING * np.abs(torque).max())
        number = numbered((np.diff(torque) != 0.0) | (np.diff(bag) != 0))
        _, first, count = np.unique(number, return_index=True, return_counts=True)
        short = count <= 2.0 * np.median(count)  # a pause without torque is none
        held = (short & outliers(torque[first], bag[first], least))[number]
        found[finite] = held | outliers(torque, bag, least)
    return found


def outliers(error: Floats, bag: Integers, least: float = 0.0) -> Rows:
    """Single samples far off both their neighbours; without them, others beside them may stand out.

    Neighbours are those recorded before and after, even across a gap: between gaps there may be few samples.
    """
    found = np.zeros(error.size, dtype=bool)
    for begin, end in bounds(bag):
        filtered(found, begin, end, lambda rows: _repeated(error[rows], least), 2 * _OUTLIER_WINDOW)
    return found


def _repeated(error: Floats, least: float) -> Rows:
    found = np.zeros(error.size, dtype=bool)
    rows = np.arange(error.size)
    for _ in range(_OUTLIER_PASSES):
        off = _spikes(error[rows], least)
        found[rows[off]] = True
        rows = rows[~off]
    return found


def _spikes(values: Floats, least: float) -> Rows:
    """Samples beyond both neighbours, and by far, more than `least`, off the cubic through four of them.

    The cubic follows the gear's ripple, which a running median would cut; flanks that change are a step,
    beyond one neighbour only.
    """
    if values.size < 9:
        return np.zeros(values.size, dtype=bool)
    far, near, x, after, last = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, "reflect"), 5).T
    off = np.abs(x - (4.0 * (near + after) - far - last) / 6.0)
    before, behind = x - near, x - after
    single = ((before > 0.0) == (behind > 0.0)) & (np.minimum(np.abs(before), np.abs(behind)) > 0.5 * off)
    single &= off > least
    if not single.any():
        return np.asarray(single)
    local = median_filter(off, _OUTLIER_WINDOW, mode="nearest")
    spread = 1.4826 * np.maximum(local, np.median(off))
    return np.asarray(single & ((spread > 0.0) | (least > 0.0)) & (off > _OUTLIER * spread))
