"""Samples far off their neighbours, as after lost bits and disturbed lines."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from hd_diag.arrays import Floats, Integers, Rows
from hd_diag.diagnosis.blocks import filtered

_OUTLIER = 8.0  # robust standard deviations of the prediction error from neighbours
_OUTLIER_WINDOW = 51  # window of that deviation [samples]
_OUTLIER_PASSES = 3
_OUTLYING_TORQUE = 0.5  # least deviation over the range of torques; smaller ones hardly matter
_ROUNDING = 1e-9  # rounding of a constant torque, over the largest one


def torque_outliers(torque: Floats, bag: Integers) -> Rows:
    """Mask (n,) of torques [N m] that differ from both neighbours by much of the whole range.

    A torque that is reported less often than the angles fills several rows. Values that are not finite are
    neither outliers nor neighbours. Recording numbers (n,) ascend.
    """
    found, finite = np.zeros(torque.size, dtype=bool), np.flatnonzero(np.isfinite(torque))
    if finite.size:
        torque, bag = torque[finite], bag[finite]
        low, high = np.percentile(torque, (1.0, 99.0))
        least = max(_OUTLYING_TORQUE * (high - low), _ROUNDING * np.abs(torque).max())
        change = (np.diff(torque) != 0.0) | (np.diff(bag) != 0)
        first = np.concatenate(([0], np.flatnonzero(change) + 1))
        count = np.diff(first, append=torque.size)
        short = count <= 2.0 * np.median(count)  # a long constant torque is a pause, no outlier
        held = np.repeat(short & outliers(torque[first], bag[first], least), count)
        found[finite] = held | outliers(torque, bag, least)
    return found


def outliers(error: Floats, bag: Integers, least: float = 0.0, together: int = 1) -> Rows:
    """Mask (n,) of samples, up to `together` in a row, that differ from both neighbours by at least `least`.

    Neighbours are the samples before and after, even across a gap, as pieces between gaps may be short.
    The search is repeated without the outliers found, because others may then stand out.
    """

    def repeated(part: slice) -> Rows:
        left = np.arange(part.start, part.stop)
        for apart in (*[1] * _OUTLIER_PASSES, *range(2, together + 1)):
            left = left[~_spikes(error[left], least, apart)]
        return ~np.isin(np.arange(part.start, part.stop), left)

    found = np.zeros(error.size, dtype=bool)
    filtered(found, bag, repeated, 2 * _OUTLIER_WINDOW)
    return found


def _spikes(values: Floats, least: float, apart: int) -> Rows:
    """Mask of samples above or below both neighbours, and far (by `least`) off the cubic through four.

    Neighbours are `apart` samples away, so that a group of outliers fits between them. The cubic follows the
    gear's ripple, which a running median would cut. A flank change is a step, and exceeds only one neighbour.
    """
    if values.size < 8 * apart + 1:
        return np.zeros(values.size, dtype=bool)
    padded = np.pad(values, 2 * apart, "reflect")
    far, near, x, after, last = np.lib.stride_tricks.sliding_window_view(padded, 4 * apart + 1)[:, ::apart].T
    off = np.abs(x - (4.0 * (near + after) - far - last) / 6.0)
    before, behind = x - near, x - after
    single = ((before > 0.0) == (behind > 0.0)) & (np.minimum(np.abs(before), np.abs(behind)) > 0.5 * off)
    single &= off > least
    if not single.any():
        return np.asarray(single)
    local = median_filter(off, _OUTLIER_WINDOW, mode="nearest")
    spread = 1.4826 * np.maximum(local, np.median(off))
    return np.asarray(single & ((spread > 0.0) | (least > 0.0)) & (off > _OUTLIER * spread))
