"""Amplitude of a residual over orders of an angle, and its lines: sums over bins, then an FFT.

One spectrum and one finder of lines for all that looks for orders nobody has named: causes, the residual of a
record, the torque of a joint with one angle, the report. Apart from it stand the orders that a running joint
follows (`monitor.residual_orders`: four known ones, in bounded memory) and the band of a torque
(`diagnosis.ripple.band`: a density over frequency, from which lines are taken out).
"""

from __future__ import annotations

import math

import numpy as np

from hd_diag.arrays import Floats, Integers

_OVERSAMPLING = 4  # orders per resolvable one: a line between two of them loses 5 % at most
_MOST_BINS = 2**23
_FASTEST = 0.98  # of the samples that are slower than what a weight counts
_BINS_PER_PERIOD = 8  # of the highest order


def spectrum(angle: Floats, residual: Floats, highest: float) -> tuple[Floats, Floats]:
    """Orders up to the highest, closer than the record resolves, and the magnitude of the Fourier sum [rad].

    The angle [rad] (n,) is continuous over the turns and may run back and forth; both results are (k,).
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
    """Strength of the integer orders 0 to highest [rad], shape (highest + 1,)."""
    bins = 2 ** math.ceil(math.log2(_BINS_PER_PERIOD * highest))
    place = np.floor(np.mod(angle, 2.0 * math.pi) * (bins / (2.0 * math.pi))) % bins
    return _strength(angle, residual, place, bins, bins)[: highest + 1]


def _strength(angle: Floats, residual: Floats, place: Floats, bins: int, length: int) -> Floats:
    """Magnitudes of the Fourier transform of so many bins, filled with zeros to a length [rad]."""
    sums = np.bincount(place.astype(np.int64), travelled(angle) * (residual - residual.mean()), bins)
    return np.asarray(np.abs(np.fft.rfft(sums, length)) * (2.0 / angle.size))


def travelled(angle: Floats) -> Floats:
    """Weights of samples (n,), in proportion to the angle that each covers, 1 in the mean."""
    way = np.abs(np.gradient(angle)) if angle.size > 1 else np.zeros(angle.size)
    if not way.any():
        return np.ones(angle.size)
    most = float(np.quantile(way, _FASTEST)) or float(way.max())  # nearly all may rest
    way = np.minimum(way, most)  # where rows are left out it is no sample's own
    return np.asarray(way / way.mean())


def peaks(strength: Floats, beside: int) -> Integers:
    """Indices of values above zero that none of so many on either side exceeds, the strongest first."""
    from scipy.ndimage import maximum_filter1d  # late: a node that diagnoses nothing does without

    most = maximum_filter1d(strength, 2 * beside + 1, mode="constant")
    found = np.flatnonzero((strength >= most) & (strength > 0.0))
    return np.asarray(found[np.argsort(strength[found])[::-1]])


def prominence(strength: Floats, beside: int) -> Floats:
    """Strength (k,) over what is usual there: medians of parts with so many values on either side."""
    width = min(2 * beside + 1, strength.size)
    count = strength.size // width
    usual = np.median(strength[: count * width].reshape(count, width), axis=1)
    middle = width * (np.arange(count) + 0.5) - 0.5
    return np.asarray(strength / np.maximum(np.interp(np.arange(strength.size), middle, usual), 1e-300))


def top(order: Floats, strength: Floats, index: int) -> float:
    """Order at which a parabola through the logarithms of a peak and the values beside it is greatest."""
    if order.size < 3:
        return float(order[index])
    at = min(max(index, 1), order.size - 2)
    low, middle, high = np.log(np.maximum(strength[at - 1 : at + 2], 1e-300)).tolist()
    bend = low - 2.0 * middle + high
    away = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
    return float(order[at] + min(max(away, -1.0), 1.0) * (order[1] - order[0]))


def line_width(angle: Floats, leak: float) -> float:
    """Distance from a line of the spectrum within which its side lobes are above a share of it [order].

    For samples that are spread evenly it is about one over the turns; more where a record dwells in parts of
    its way. The angle [rad] (n,) is continuous over the turns; the leak is that share.
    """
    place = (angle - np.min(angle)) / (2.0 * math.pi)
    turns = max(1.0, _OVERSAMPLING * float(place.max()) / _MOST_BINS)  # of a bin
    count = np.bincount(np.floor(place / turns).astype(np.int64), travelled(angle))
    length = 2 ** math.ceil(math.log2(_OVERSAMPLING * max(count.size, 2)))
    window = np.abs(np.fft.rfft(count, length)) / angle.size
    last = int(np.flatnonzero(window > leak)[-1])
    return float((last + 1) / (length * turns))
