"""Numbers of an effect as people read them: name, unit, limits; and the columns of harmonics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Complexes, Floats


@dataclass(frozen=True)
class Quantity:
    """One number of an effect, as it is given to people.

    Parameters
    ----------
    name : str
        The field's term.
    unit : str
        SI; "-" for a pure number.
    low, high : float
        Values that make sense; lengths, torques and compliances are those of a gear of size 25, ratio 100 and
        56 N m, and those of another gear follow (`hd_diag.effects.scaling`).
    prior_scale : float
        Size that is usual, in its unit, of the same gear.
    meaning : str
    linear : bool
        Whether the transmission error is proportional to it. An amplitude and the direction after it count as
        linear: their cosine and sine parts are the coefficients.
    periodic : float, optional
        Period of a direction or position [rad]; ``2 pi / k`` for a k-lobed error.
    discrete : bool
        Whether only the values that the effect's start points have make sense: not to be refined.
    power : int
        Power of it that the coefficient is: 2 where the error grows with its square.
    strict : bool
        Whether a candidate with a value outside the limits is rejected: another cause is meant.
    shape : bool
        Whether it only bends a curve: people get the curve, not the number.
    least, most : float
        How far a fit goes within the limits: beyond, the effect looks like another one.
    """

    name: str
    unit: str
    low: float
    high: float
    prior_scale: float
    meaning: str
    linear: bool = True
    periodic: float | None = None
    discrete: bool = False
    power: int = 1
    strict: bool = False
    shape: bool = False
    least: float = -math.inf
    most: float = math.inf

    @property
    def fitted(self) -> tuple[float, float]:
        """Least and greatest value that a fit gives it."""
        return max(self.low, self.least), min(self.high, self.most)

    def allows(self, value: float) -> bool:
        """Whether the value is inside the limits."""
        return self.low <= value <= self.high


def amplitude(name: str, unit: str, high: float, prior_scale: float, meaning: str) -> Quantity:
    """Size of a harmonic, to be followed by its direction."""
    return Quantity(name, unit, 0.0, high, prior_scale, meaning)


def direction(name: str, meaning: str, order: int = 1) -> Quantity:
    """Where a harmonic is greatest: the amplitude before it times ``cos(k (angle - direction))``."""
    period = 2.0 * math.pi / order
    return Quantity(name, "rad", 0.0, period, period, meaning, periodic=period)


def choice(name: str, meaning: str, values: tuple[float, ...]) -> Quantity:
    """One of some numbers, rising."""
    return Quantity(name, "-", values[0], values[-1], 1.0, meaning, linear=False, discrete=True)


def switch(name: str, meaning: str) -> Quantity:
    """Which of two forms an effect has, 0 or 1."""
    return choice(name, meaning, (0.0, 1.0))


def lobes(
    name: str, orders: Sequence[int], size_meaning: str, direction_meaning: str
) -> tuple[Quantity, ...]:
    """Amplitude [m] and direction of errors of the teeth with some numbers of periods around.

    Names end with the order; ``{}`` in the amplitude's meaning stands for it.
    """
    return tuple(
        quantity
        for k in orders
        for quantity in (
            # Errors that add up around fall with the order (a random walk: as its reciprocal).
            amplitude(f"{name}_{k}", "m", 5e-5, 2e-6 * min(1.0, 2.0 / k), size_meaning.format(k)),
            direction(f"{name}_direction_{k}", direction_meaning, k),
        )
    )


def turning(phase: Floats) -> Floats:
    """``cos`` and ``sin`` of a phase [rad], shape (n, 2)."""
    return np.stack((np.cos(phase), np.sin(phase)), axis=1)


def harmonics(responses: Complexes) -> Floats:
    """Columns of a cosine and a sine coefficient for every complex response (n, k), shape (n, 2 k)."""
    return np.ascontiguousarray(responses).view(np.float64)


def harmonic_sum(coefficients: Floats, orders: Sequence[int], angle: Floats) -> Floats:
    """``sum a_k cos k (angle - d_k)`` of cosine and sine coefficients, in the shape of the angle."""
    pairs = zip(orders, coefficients[::2], coefficients[1::2], strict=True)
    return np.asarray(sum(a * np.cos(k * angle) + b * np.sin(k * angle) for k, a, b in pairs))
