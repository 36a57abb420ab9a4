"""The band of a torque: the frequency up to which its noise shows that waves pass the filter.

Sensor noise is white at the top of its spectrum. A low-pass filter removes it: the spectrum then falls up to
the top, or ends in the rounding of the numbers. Waves there are removed too: their absence proves nothing.

The spectrum is taken over ``s = sin(pi f dt)``. Over s, a sampled first-order filter and a moving average
fall with the square up to the highest frequency, and white noise is as flat as over f.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from scipy.optimize import nnls

from hd_diag.arrays import Floats, Integers

PASSING = 0.4
"""Share of a filter's corner frequency up to which waves count as seen: a first-order filter passes 93 %."""

_DEGREE = 5  # of the polynomial in time that removes slow parts of a stretch
_INNER = 0.8  # middle share of a stretch, where its window is open
_BESIDE = 2.5  # reach of a line and of slow parts in the spectrum [periods in a stretch]
_PER_OCTAVE = 4  # levels of the spectrum
_LEAST, _MOST = 8, 200  # least values at a level; most values that add weight
_REACH = 4  # levels on either side of a slope: two octaves in all
_TOP = 6  # levels at the top that show whether it is white
_FLAT = 0.6  # deviation of a level of white noise beyond its scatter [octaves of power]
_FALLS = -1.0  # log-log slope of a first-order filter at its corner
_STEEP = (2, 4, 8, 16)  # powers of the frequency in a filter's roll-off
_RED = (2.0, 4.0)  # powers of the frequency in the spectrum of slow parts
_FARTHEST = 3.0  # largest corner, over the frequency above which the spectrum falls
_AS_GOOD = 1.15  # largest misfit of an equivalent corner, over the least
_MOST_OCTAVES = 4.0  # largest deviation that a level counts with
_ROUNDED = 2.0  # levels below this multiple of the rounding power may be pure rounding
_VALUES = 64  # least number of values that show their rounding step


class Band(NamedTuple):
    """Frequency up to which waves are seen, and corner of the filter [Hz]; inf if there is no filter."""

    seen: float
    corner: float


class _Levels(NamedTuple):
    """Spectrum (k,): sine of the frequency, median density [N² m²/Hz], number of values in the median."""

    sine: Floats
    power: Floats
    number: Floats

    def part(self, rows: Integers | slice) -> _Levels:
        return _Levels(*(column[rows] for column in self))

    def falls(self) -> bool:
        """Whether the density falls like a filter beyond its corner; true for fewer than three levels."""
        if self.sine.size < 3:
            return True
        slope = np.polyfit(np.log2(self.sine), np.log2(self.power), 1, w=np.sqrt(self.number))[0]
        return bool(slope <= _FALLS)


def band(time: Floats, angle: Floats, torque: Floats, rows: Integers, orders: Sequence[float]) -> Band:
    """Band of a torque.

    Parameters
    ----------
    time, angle, torque : ndarray, shape (n,)
        [s]; [rad]; [N m], or any quantity proportional to torque.
    rows : ndarray of int64, shape (s, 2)
        First row of each stretch without a gap or reversal, and the row after its last.
    orders : sequence of float
        Periods per turn of the angle whose waves are no noise: their frequencies are left out.
    """
    step = float(np.median(np.concatenate([np.diff(time[a:b]) for a, b in rows.tolist()])))
    parts = [(angle[a:b], torque[a:b]) for a, b in rows.tolist()]
    levels = _levels([_periodogram(*part, step, orders) for part in parts])
    covered = levels.sine.size < _TOP  # the speed varies so much that lines cover the spectrum
    if covered:
        levels = _levels([_periodogram(*part, step, ()) for part in parts])
    rounding = 2.0 * step * _rounding(torque)
    real = levels.power > _ROUNDED * rounding
    if real.size < _TOP or (real[-_TOP:].all() and _is_white(levels.part(slice(-_TOP, None)))):
        return Band(np.inf, np.inf)
    lowest = float(levels.sine[0])
    highest = np.maximum.accumulate(levels.power[::-1])[
        ::-1
    ]  # a moving average passes some noise between its zeros
    noise = levels._replace(power=highest - rounding).part(np.flatnonzero(real))
    flat = next(
        (
            at
            for at in range(noise.sine.size - 1, -1, -1)
            if not noise.part(_near(at, noise.sine.size)).falls()
        ),
        None,
    )
    known = lowest if flat is None else float(noise.sine[flat])
    corner = min(_FARTHEST * known, _fitted_corner(noise)) if noise.sine.size else lowest
    frequency = float(np.arcsin(min(corner, 1.0)) / (np.pi * step))
    return Band(0.0 if covered or flat is None else PASSING * frequency, frequency)


def _near(at: int, size: int) -> slice:
    """Levels around the one at index `at`; at the top of the spectrum, the same number below it."""
    begin = max(min(at, size - 1 - _REACH) - _REACH, 0)
    return slice(begin, at + _REACH + 1)


def _is_white(top: _Levels) -> bool:
    """Whether the levels are equal within their scatter, and do not fall."""
    octaves = np.log2(np.maximum(top.power, 1e-300))
    allowed = _FLAT + 3.0 / (np.log(2.0) * np.sqrt(top.number))
    return bool((np.abs(octaves - np.median(octaves)) <= allowed).all()) and not top.falls()


def _fitted_corner(noise: _Levels) -> float:
    """Sine of the lowest filter corner that fits the levels, as white noise plus slow parts, about best."""
    weight = np.sqrt(np.minimum(noise.number, _MOST))
    corners = 2.0 ** np.arange(np.log2(noise.sine[0]), 0.01, 1.0 / _PER_OCTAVE)
    misfit = []
    for corner in corners:
        passed = [1.0 / (1.0 + (noise.sine / corner) ** steep) / noise.power for steep in _STEEP]
        misfit.append(
            min(
                _misfit(np.stack([(noise.sine / corner) ** -red * one, one], axis=1), weight)
                for one in passed
                for red in _RED
            )
        )
    return float(corners[np.flatnonzero(np.array(misfit) <= _AS_GOOD * min(misfit))[0]])


def _misfit(parts: Floats, weight: Floats) -> float:
    """Weighted sum of deviations from one [octaves], for the best non-negative sum of `parts` (k, 2)."""
    scale = parts.max(axis=0)
    found = parts @ (nnls(weight[:, None] * parts / scale, weight)[0] / scale)
    return float(np.sum(weight * np.abs(np.log2(np.maximum(found, 2.0**-_MOST_OCTAVES)))))


def _levels(spectra: Sequence[tuple[Floats, Floats]]) -> _Levels:
    """Levels of the stretches' spectra: medians, which suppress lines."""
    sine, power = (np.concatenate(parts) for parts in zip(*spectra, strict=True))
    number = np.ceil(_PER_OCTAVE * np.log2(sine)).astype(np.int64)
    numbers, counts = np.unique(number, return_counts=True)
    kept = numbers[counts >= _LEAST]
    median = np.array([np.median(power[number == one]) / np.log(2.0) for one in kept])
    return _Levels(2.0 ** ((kept - 0.5) / _PER_OCTAVE), median, counts[counts >= _LEAST].astype(np.float64))


def _periodogram(
    angle: Floats, torque: Floats, step: float, orders: Sequence[float]
) -> tuple[Floats, Floats]:
    """Sines of the frequencies of a stretch, and its density there, with a squared Hann window."""
    place = np.linspace(-1.0, 1.0, torque.size)
    basis = legendre.legvander(place, _DEGREE)
    slow, smooth = (basis @ np.linalg.lstsq(basis, one, rcond=None)[0] for one in (torque, angle))
    taper = np.cos(0.5 * np.pi * place) ** 4
    power = 2.0 * step * np.abs(np.fft.rfft(taper * (torque - slow))) ** 2 / np.sum(taper**2)
    number = np.arange(power.size)
    turns = np.abs(np.diff(smooth))[np.abs(place[1:]) < _INNER] * torque.size / (2.0 * np.pi)
    kept = number >= _BESIDE
    for order in orders:
        kept &= (number < order * turns.min() - _BESIDE) | (number > order * turns.max() + _BESIDE)
    return np.sin(np.pi * number[kept] / torque.size), power[kept]


def _rounding(torque: Floats) -> float:
    """Rounding variance of a torque [N² m²], from the step of its numbers between each two powers of two."""
    binade, total = np.frexp(torque)[1], 0.0
    for one in np.unique(binade):
        own = torque[binade == one]
        steps = np.diff(np.unique(own))
        if own.size >= _VALUES and steps.size:
            total += own.size * float(np.min(steps)) ** 2 / 12.0
    return total / torque.size
