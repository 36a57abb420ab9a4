"""Noise of the output angle, and disturbances by the recording. Generators are passed in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from challenge.design import Array
from challenge.truth import ARCSEC

DRIFTING, POLE, WHITE = 2.5 * ARCSEC, 0.97, 2.0 * ARCSEC  # rms [rad], AR(1) coefficient, rms [rad]
TORQUE_NOISE = 0.15  # [N m]


def _first_order(innovations: Array) -> Array:
    """AR(1) noise with coefficient POLE and the rms of its innovations."""
    scale = np.sqrt(1 - POLE**2)
    return lfilter([scale], [1, -POLE], innovations)


def autoregressive(rng: np.random.Generator, n: int) -> Array:
    """AR(1) plus white noise, normal [rad]."""
    slow = _first_order(rng.standard_normal(n + 500))[500:]  # settled
    return DRIFTING * slow + WHITE * rng.standard_normal(n)


def pink(rng: np.random.Generator, n: int) -> Array:
    """Noise with power 1/f above 0.05 Hz (at 500 Hz) and the rms of the AR(1), plus white noise [rad]."""
    frequency = np.fft.rfftfreq(n)
    spectrum = np.fft.rfft(rng.standard_normal(n)) / np.sqrt(np.maximum(frequency, 1e-4))
    spectrum[0] = 0
    coloured = np.fft.irfft(spectrum, n)
    return DRIFTING * coloured / coloured.std() + WHITE * rng.standard_normal(n)


def heavy(rng: np.random.Generator, n: int) -> Array:
    """AR(1) plus white noise, the latter with Student t of three degrees of freedom [rad]."""
    white = rng.standard_t(3, n) / np.sqrt(3)
    return DRIFTING * _first_order(rng.standard_normal(n + 500))[500:] + WHITE * white


FAMILIES: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "autoregressive": autoregressive,
    "pink": pink,
    "heavy": heavy,
}


def kept(rng: np.random.Generator, n: int, share: float, burst: float = 20.0) -> Array:
    """Mask (n,) of the samples that survive dropouts; bursts of mean length [samples] lose about a share."""
    lost = np.zeros(n, dtype=bool)
    for start in rng.integers(0, n, size=round(share * n / burst)):
        lost[start : start + rng.geometric(1 / burst)] = True
    return ~lost


def outliers(rng: np.random.Generator, n: int, share: float) -> Array:
    """Errors (n,) [rad]: a share of the samples is off by 50 to 2000 arcsec with either sign."""
    struck = rng.random(n) < share
    return struck * rng.choice([-1, 1], n) * np.exp(rng.uniform(np.log(50), np.log(2000), n)) * ARCSEC


def jittered(rng: np.random.Generator, time: Array, spread: float = 0.3e-3) -> Array:
    """True sampling moments [s]: uneven but in order."""
    step = np.median(np.diff(time))
    return time + np.clip(spread * rng.standard_normal(len(time)), -0.4 * step, 0.4 * step)


def counted(angle: Array, bits: int) -> Array:
    """Angles [rad] rounded to an encoder's 2**bits counts per turn; unchanged for 0 bits."""
    step = 2 * np.pi / 2**bits
    return step * np.rint(angle / step) if bits else angle
