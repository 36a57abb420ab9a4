"""Amplitude of a residual over orders of an angle, and its lines: sums over bins, then an FFT.

Every search for unknown orders uses this spectrum and this finder of lines: causes, the residual of a record,
the torque of a joint with one angle, the report. Two others are separate: the orders that a running joint
follows (`monitor.residual_orders`: four known orders, in bounded memory), and the band of a torque
(`diagnosis.ripple.band`: a density over frequency, with lines removed).
"""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Floats, Integers

_OVERSAMPLING = 4  # points per resolvable order: a line between two points loses 5 % at most
_MOST_BINS = 2**23
_FASTEST = 0.98  # quantile of the travel per sample at which weights are capped
_BINS_PER_PERIOD = 8  # bins per period of the highest order


def spectrum(angle: Floats, residual: Floats, highest: float) -> tuple[Floats, Floats]:
    """Orders up to the highest, closer than the record resolves, and the amplitude at each [rad], (k,) each.

    The angle [rad] (n,) is continuous over the turns and may run back and forth.
    """
    first, span = float(np.min(angle)), max(float(np.ptp(angle)), 2.0 * math.pi)
    per_turn = min(_BINS_PER_PERIOD * highest, _MOST_BINS / (_OVERSAMPLING * span / (2.0 * math.pi)))
    width = 2.0 * math.pi / per_turn
    bins = int(span / width) + 1
    length = 2 ** math.ceil(math.log2(_OVERSAMPLING * bins))
    order = np.arange(length // 2 + 1) * (2.0 * math.pi / (length * width))
    kept = order <= highest
    return order[kept], _strength(angle, residual, (angle - first) / width, bins, length)[kept]


def integer_orders(angle: Floats, residual: Floats, highest: int) -> Floats:
    """Amplitudes of the integer orders 0 to highest [rad], shape (highest + 1,)."""
    bins = 2 ** math.ceil(math.log2(_BINS_PER_PERIOD * highest))
    place = np.floor(np.mod(angle, 2.0 * math.pi) * (bins / (2.0 * math.pi))) % bins
    return _strength(angle, residual, place, bins, bins)[: highest + 1]


def _strength(angle: Floats, residual: Floats, place: Floats, bins: int, length: int) -> Floats:
    """Amplitudes by the Fourier transform of the binned residual, zero-padded to a length [rad]."""
    sums = np.bincount(place.astype(np.int64), travelled(angle) * (residual - residual.mean()), bins)
    return np.asarray(np.abs(np.fft.rfft(sums, length)) * (2.0 / angle.size))


def travelled(angle: Floats) -> Floats:
    """Weights of samples (n,), proportional to the angle that each covers, with mean 1."""
    way = np.abs(np.gradient(angle)) if angle.size > 1 else np.zeros(angle.size)
    if not way.any():
        return np.ones(angle.size)
    most = float(np.quantile(way, _FASTEST)) or float(way.max())  # zero if nearly all samples rest
    way = np.minimum(way, most)  # a step across left-out rows belongs to no sample
    return np.asarray(way / way.mean())


def peaks(strength: Floats, beside: int) -> Integers:
    """Indices of positive local maxima among `beside` values on either side, the strongest first."""
    from scipy.ndimage import maximum_filter1d  # late: a node without diagnoses does not need it

    most = maximum_filter1d(strength, 2 * beside + 1, mode="constant")
    found = np.flatnonzero((strength >= most) & (strength > 0.0))
    return np.asarray(found[np.argsort(strength[found])[::-1]])


def prominence(strength: Floats, beside: int) -> Floats:
    """Strength (k,) over its local level: interpolated medians of blocks of ``2 beside + 1`` values."""
    width = min(2 * beside + 1, strength.size)
    count = strength.size // width
    usual = np.median(strength[: count * width].reshape(count, width), axis=1)
    middle = width * (np.arange(count) + 0.5) - 0.5
    return np.asarray(strength / np.maximum(np.interp(np.arange(strength.size), middle, usual), 1e-300))


def top(order: Floats, strength: Floats, index: int) -> float:
    """Order at the vertex of a parabola through the logarithms of a peak and of its two neighbours."""
    if order.size < 3:
        return float(order[index])
    at = min(max(index, 1), order.size - 2)
    low, middle, high = np.log(np.maximum(strength[at - 1 : at + 2], 1e-300)).tolist()
    bend = low - 2.0 * middle + high
    away = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
    return float(order[at] + min(max(away, -1.0), 1.0) * (order[1] - order[0]))


def line_width(angle: Floats, leak: float) -> float:
    """Distance from a line of the spectrum within which its side lobes exceed a share of it [order].

    It is about one over the turns for evenly spread samples, and more if a record dwells in parts of its way.
    The angle [rad] (n,) is continuous over the turns; `leak` is the share.
    """
    place = (angle - np.min(angle)) / (2.0 * math.pi)
    turns = max(1.0, _OVERSAMPLING * float(place.max()) / _MOST_BINS)  # turns per bin
    count = np.bincount(np.floor(place / turns).astype(np.int64), travelled(angle))
    length = 2 ** math.ceil(math.log2(_OVERSAMPLING * max(count.size, 2)))
    window = np.abs(np.fft.rfft(count, length)) / angle.size
    last = int(np.flatnonzero(window > leak)[-1])
    return float((last + 1) / (length * turns))
