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
_WINDOWS = 0.01 * 1.35 ** np.arange(20)  # to choose from [s]
_NARROWER = (3.0, 9.0, 27.0, 81.0)  # by which a window is cut
_BENT = 5.0  # times the variance of noise that shows a bend
_STILL = 4.0  # times the variance of smoothed noise, up to which smoothed values count as constant
_ZERO = 16.0  # times the variance of a mean, up to which it counts as zero
_JUDGED = 100_000  # samples by which a window is chosen


def smooth(values: Floats, segment: Integers, step: float, width: float | Floats) -> Floats:
    """Values smoothed by a local quadratic, applied twice.

    Applied once it leaves noise at high frequencies, which whitening would amplify.

    Parameters
    ----------
    values : ndarray, shape (n,) or (n, k)
    segment : ndarray of int64, shape (n,)
        Number of the stretch without a gap that a sample belongs to, ascending.
    step : float
        Between samples [s].
    width : float, or ndarray, shape (n,)
        Of the window [s], of all values or each.
    """
    result = np.empty_like(values)
    for one in np.unique(width).tolist():
        own = np.broadcast_to(width == one, segment.shape)
        around = np.isin(segment, segment[own])
        local = partial(_twice, step=step, width=one)
        result[own] = _by_segment(values[around], segment[around], local, step, 2.0 * one)[own[around]]
    return result


def best_width(values: Floats, segment: Integers, step: float) -> float:
    """Window [s] by which neighbours predict each value best; arguments as of :func:`smooth`.

    Notes
    -----
    Generalised cross-validation: Golub, Heath, Wahba, Technometrics 21 (1979).
    """
    part = values[judged(segment)]
    scores = [float(np.mean(_prediction_errors(part, step, width))) for width in _WINDOWS]
    return float(_WINDOWS[int(np.argmin(scores))])


def usual_prediction_error(values: Floats, segment: Integers, step: float) -> float:
    """Median square by which values differ from what neighbours in the best window predict."""
    part = values[judged(segment)]
    return float(np.median(_prediction_errors(part, step, best_width(values, segment, step))))


def judged(segment: Integers) -> slice:
    """Rows by which a window is chosen: the middle of the longest segment."""
    begin, end = max(bounds(segment), key=lambda edges: edges[1] - edges[0])
    middle = (begin + end) // 2
    return slice(max(begin, middle - _JUDGED // 2), min(end, middle + _JUDGED // 2))


def best_widths(values: Floats, segment: Integers, step: float) -> Floats:
    """Window of every value [s], shape (n,): the best for all, or a narrower one where that would bend them.

    A robot that rests, creeps and hurries has no window for all: where a narrower one differs from it by more
    than noise, that one holds (Lepski, Theory Probab. Appl. 35, 1991). Arguments as of :func:`smooth`.
    """
    best = best_width(values, segment, step)
    found, broad = np.full(values.size, best), smooth(values, segment, step, best)
    rows = _window(values.size, step, best)
    for narrower in (best / one for one in _NARROWER):
        if _window(values.size, step, narrower) <= _ORDER + 1:
            break
        fine = smooth(values, segment, step, narrower)
        broad -= fine  # in place: of an hour each array takes 30 MB
        differs = uniform_filter1d(np.square(broad, out=broad), rows, output=broad)
        bent = (differs > _BENT * float(np.median(differs))) & (found == found.min())
        if not bent.any():
            break
        found[bent], broad = narrower, fine
    return found


def settled(values: Floats, smoothed: Floats, step: float, width: float) -> Floats:
    """The smoothed values (n,); their mean, or zero, where they vary no more than smoothed noise does.

    Whether a torque is zero decides which teeth carry in a gap: noise must not decide it. Step and width [s]
    are those that :func:`smooth` was given.
    """
    noise = float(np.var(values - smoothed))
    if np.var(smoothed) > _STILL * noise * _passed(values.size, step, width):
        return smoothed
    mean = float(np.mean(values))
    return np.full(values.size, mean if mean**2 > _ZERO * noise / values.size else 0.0)


def deviation(values: Floats, smoothed: Floats, step: float, width: Floats) -> Floats:
    """Standard deviation of each smoothed value by the noise left in it; arguments as of :func:`settled`."""
    windows, number = np.unique(width, return_inverse=True)
    passed = np.array([_passed(values.size, step, one) for one in windows.tolist()])
    return np.asarray(float(np.std(values - smoothed)) * np.sqrt(passed)[number])


def _passed(size: int, step: float, width: float) -> float:
    """Share of the variance of white noise that is left by smoothing."""
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
    """Savitzky-Golay filter of (n,) or (n, k); at either end one quadratic of half a window's rows.

    Or its derivative [1/row].
    """
    from hd_diag.diagnosis import kernel  # late: it imports numba

    (shape, weights), half, size = _quadratic(window, derivative), window // 2, values.shape[0]
    taps = _middle(window, derivative)[::-1]
    before = -window % 3  # taps, and rows, of zero
    wide = np.concatenate((np.zeros((before, values[0].size)), values.reshape(size, -1)))
    result = np.empty_like(values)
    found = kernel.filtered(wide, np.append(taps, np.zeros(before)), np.array([0, size + before]))
    result[half : size - half] = found[before + window - 1 :].reshape(-1, *values.shape[1:])
    result[:half] = shape[:half] @ (weights @ values[:window])
    result[size - half :] = shape[-half:] @ (weights @ values[-window:])
    return result


@lru_cache(maxsize=64)  # the windows to choose from, and narrower ones, of two rates
def _quadratic(window: int, derivative: int = 0) -> tuple[Floats, Floats]:
    """Powers in a window of rows, or their derivatives (window, 3), and what fits them (3, window)."""
    place, half = np.arange(window) - window // 2, max(window // 2, 1)
    powers = np.vander(place / half, _ORDER + 1)
    slopes = np.stack((2.0 * place / half, np.ones(window), np.zeros(window)), axis=1) / half
    return (slopes if derivative else powers), np.asarray(np.linalg.pinv(powers), np.float64)


def _middle(window: int, derivative: int = 0) -> Floats:
    """Weights (window,) of the rows about the middle one."""
    shape, weights = _quadratic(window, derivative)
    return np.asarray(shape[window // 2] @ weights)


def _prediction_errors(values: Floats, step: float, width: float) -> Floats:
    """Squares by which values differ from what their neighbours predict."""
    window = _window(values.size, step, width)
    if window <= _ORDER + 1:
        return np.full(values.size, np.inf)
    own = float(np.sum(_middle(window) ** 2))  # weight of a value in its own estimate
    return np.asarray((values - _twice(values, step, width)) ** 2 / (1.0 - own) ** 2)


def _window(size: int, step: float, width: float) -> int:
    """Odd number of samples, no more than there are."""
    wanted = int(width / step) | 1
    largest = size if size % 2 else size - 1
    return min(max(wanted, _ORDER + 2 | 1), largest)


def _by_segment(
    values: Floats, segment: Integers, function: Callable[[Floats], Floats], step: float, width: float
) -> Floats:
    """Values after a filter of a width [s] along every segment."""
    result = np.empty_like(values)
    filtered(result, segment, lambda rows: function(values[rows]), _window(segment.size, step, width))
    return result
