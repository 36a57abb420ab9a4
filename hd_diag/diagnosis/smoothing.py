"""Smoothed columns of a record, and their rates: Savitzky–Golay filters, segment by segment."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from scipy.ndimage import uniform_filter1d

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.blocks import filtered
from hd_diag.diagnosis.noise import bounds

_ORDER = 2
_WINDOWS = 0.01 * 1.35 ** np.arange(20)  # candidate windows [s]
_NARROWER = (3.0, 9.0, 27.0, 81.0)  # divisors of the best window
_BENT = 5.0  # squared difference over its median above which the wider window distorts
_STILL = 4.0  # variance of constant values after smoothing, over that of smoothed noise
_ZERO = 16.0  # square of a mean that counts as zero, over its variance
_JUDGED = 100_000  # samples that choose a window


def smooth(values: Floats, segment: Integers, step: float, width: float | Floats) -> Floats:
    """Values smoothed by a local quadratic, applied twice.

    Applied once, it would pass noise at high frequencies, which whitening amplifies.

    Parameters
    ----------
    values : ndarray, shape (n,) or (n, k)
    segment : ndarray of int64, shape (n,)
        Number of the gap-free stretch of each sample, ascending.
    step : float
        Time between samples [s].
    width : float, or ndarray, shape (n,)
        Window [s], one for all values or one for each.
    """
    result = np.empty_like(values)
    for one in np.unique(width).tolist():
        own = np.broadcast_to(width == one, segment.shape)
        around = np.isin(segment, segment[own])
        local = partial(_twice, step=step, width=one)
        result[own] = _by_segment(values[around], segment[around], local, step, 2.0 * one)[own[around]]
    return result


def best_width(values: Floats, segment: Integers, step: float) -> float:
    """Window [s] in which neighbours predict each value best; arguments as of :func:`smooth`.

    Notes
    -----
    Generalised cross-validation: Golub, Heath, Wahba, Technometrics 21 (1979).
    """
    part = values[judged(segment)]
    scores = [float(np.mean(_prediction_errors(part, step, width))) for width in _WINDOWS]
    return float(_WINDOWS[int(np.argmin(scores))])


def usual_prediction_error(values: Floats, segment: Integers, step: float) -> float:
    """Median square of the prediction errors with the best window."""
    part = values[judged(segment)]
    return float(np.median(_prediction_errors(part, step, best_width(values, segment, step))))


def judged(segment: Integers) -> slice:
    """Rows that choose a window: the middle of the longest segment."""
    begin, end = max(bounds(segment), key=lambda edges: edges[1] - edges[0])
    middle = (begin + end) // 2
    return slice(max(begin, middle - _JUDGED // 2), min(end, middle + _JUDGED // 2))


def best_widths(values: Floats, segment: Integers, step: float) -> Floats:
    """Window of every value [s], shape (n,): the best one for all, or a narrower one where that distorts.

    No single window suits a robot that rests, creeps and hurries. Where a narrower window gives a result that
    differs by more than noise, it is used (Lepski, Theory Probab. Appl. 35, 1991). Arguments as of
    :func:`smooth`.
    """
    best = best_width(values, segment, step)
    found, broad = np.full(values.size, best), smooth(values, segment, step, best)
    rows = _window(values.size, step, best)
    for narrower in (best / one for one in _NARROWER):
        if _window(values.size, step, narrower) <= _ORDER + 1:
            break
        fine = smooth(values, segment, step, narrower)
        broad -= fine  # in place, as an hour takes 30 MB per array
        differs = uniform_filter1d(np.square(broad, out=broad), rows, output=broad)
        bent = (differs > _BENT * float(np.median(differs))) & (found == found.min())
        if not bent.any():
            break
        found[bent], broad = narrower, fine
    return found


def settled(values: Floats, smoothed: Floats, step: float, width: float) -> Floats:
    """The smoothed values (n,), or their mean or zero if they vary no more than smoothed noise.

    Whether the torque is zero decides which teeth carry load in a gap, so noise must not decide it. Step and
    width [s] are those given to :func:`smooth`.
    """
    noise = float(np.var(values - smoothed))
    if np.var(smoothed) > _STILL * noise * _passed(values.size, step, width):
        return smoothed
    mean = float(np.mean(values))
    return np.full(values.size, mean if mean**2 > _ZERO * noise / values.size else 0.0)


def deviation(values: Floats, smoothed: Floats, step: float, width: Floats) -> Floats:
    """Standard deviation of each smoothed value by its noise (n,); arguments as of :func:`settled`."""
    windows, number = np.unique(width, return_inverse=True)
    passed = np.array([_passed(values.size, step, one) for one in windows.tolist()])
    return np.asarray(float(np.std(values - smoothed)) * np.sqrt(passed)[number])


def _passed(size: int, step: float, width: float) -> float:
    """Share of the variance of white noise that smoothing passes."""
    taps = _middle(_window(size, step, width))
    return float(np.sum(np.convolve(taps, taps) ** 2))


def rate(values: Floats, segment: Integers, step: float, width: float) -> Floats:
    """Rate of change by a local quadratic [1/s]; arguments as of :func:`smooth`."""

    def local(part: Floats) -> Floats:
        window = _window(part.size, step, width)
        if window < 3:
            return np.gradient(part, step) if part.size > 1 else np.zeros_like(part)
        return _filtered(part, window, 1) / step

    return _by_segment(values, segment, local, step, width)


def _twice(values: Floats, step: float, width: float) -> Floats:
    window = _window(values.shape[0], step, width)
    if window <= _ORDER + 1:
        return values
    return _filtered(_filtered(values, window), window)


def _filtered(values: Floats, window: int, derivative: int = 0) -> Floats:
    """Savitzky-Golay filter of (n,) or (n, k), or its derivative [1/row].

    At each end, one quadratic over a window gives half a window of rows.
    """
    from hd_diag.diagnosis import kernel  # late: it imports numba

    (shape, weights), half, size = _quadratic(window, derivative), window // 2, values.shape[0]
    taps = _middle(window, derivative)[::-1]
    before = -window % 3  # zeros that make the taps a multiple of three
    wide = np.concatenate((np.zeros((before, values[0].size)), values.reshape(size, -1)))
    result = np.empty_like(values)
    found = kernel.filtered(wide, np.append(taps, np.zeros(before)), np.array([0, size + before]))
    result[half : size - half] = found[before + window - 1 :].reshape(-1, *values.shape[1:])
    result[:half] = shape[:half] @ (weights @ values[:window])
    result[size - half :] = shape[-half:] @ (weights @ values[-window:])
    return result


@lru_cache(maxsize=64)  # candidate windows and narrower ones for two rates
def _quadratic(window: int, derivative: int = 0) -> tuple[Floats, Floats]:
    """Powers over a window of rows, or their derivatives (window, 3), and the pseudo-inverse (3, window)."""
    place, half = np.arange(window) - window // 2, max(window // 2, 1)
    powers = np.vander(place / half, _ORDER + 1)
    slopes = np.stack((2.0 * place / half, np.ones(window), np.zeros(window)), axis=1) / half
    return (slopes if derivative else powers), np.asarray(np.linalg.pinv(powers), np.float64)


def _middle(window: int, derivative: int = 0) -> Floats:
    """Filter weights (window,) for the middle row."""
    shape, weights = _quadratic(window, derivative)
    return np.asarray(shape[window // 2] @ weights)


def _prediction_errors(values: Floats, step: float, width: float) -> Floats:
    """Squared differences (n,) between values (n,) and their predictions from neighbours."""
    window = _window(values.size, step, width)
    if window <= _ORDER + 1:
        return np.full(values.size, np.inf)
    own = float(np.sum(_middle(window) ** 2))  # weight of a value in its own estimate
    return np.asarray((values - _twice(values, step, width)) ** 2 / (1.0 - own) ** 2)


def _window(size: int, step: float, width: float) -> int:
    """Window length in samples: odd, at most `size`."""
    wanted = int(width / step) | 1
    largest = size if size % 2 else size - 1
    return min(max(wanted, _ORDER + 2 | 1), largest)


def _by_segment(
    values: Floats, segment: Integers, function: Callable[[Floats], Floats], step: float, width: float
) -> Floats:
    """Values after a filter `function` with a `width` [s], segment by segment."""
    result = np.empty_like(values)
    filtered(result, segment, lambda rows: function(values[rows]), _window(segment.size, step, width))
    return result
