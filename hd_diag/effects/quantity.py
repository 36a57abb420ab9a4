"""Quantities of an effect: name, unit and limits; and the columns of harmonics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Complexes, Floats


@dataclass(frozen=True)
class Quantity:
    """One physical number of an effect.

    Parameters
    ----------
    name : str
        The field's term.
    unit : str
        SI; "-" for a pure number.
    low, high : float
        Plausible range. Lengths, torques and compliances are those of a gear of size 25, ratio 100 and
        56 N m; `hd_diag.effects.scaling` converts them to another gear.
    prior_scale : float
        Usual size for the same gear, in its unit.
    meaning : str
    linear : bool
        Whether the transmission error is proportional to it. An amplitude and the direction after it count as
        linear: their cosine and sine parts are the coefficients.
    periodic : float, optional
        Period of a direction or position [rad]; ``2 pi / k`` for a k-lobed error.
    discrete : bool
        Whether only the values of the effect's start points are allowed. A fit does not refine it.
    power : int
        The coefficient is the quantity to this power: 2 where the error grows with its square.
    strict : bool
        Whether a candidate with a value outside the limits is rejected, because it imitates another cause.
    shape : bool
        Whether it only shapes a curve. Reports show the curve, not the number.
    least, most : float
        Narrower limits for fits. Beyond them the effect looks like another one.
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
        """Least and greatest value that a fit may give it."""
        return max(self.low, self.least), min(self.high, self.most)

    def allows(self, value: float) -> bool:
        """Whether the value is inside the limits."""
        return self.low <= value <= self.high


def amplitude(name: str, unit: str, high: float, prior_scale: float, meaning: str) -> Quantity:
    """Amplitude of a harmonic; its direction must be the next quantity."""
    return Quantity(name, unit, 0.0, high, prior_scale, meaning)


def direction(name: str, meaning: str, order: int = 1) -> Quantity:
    """Angle at which a harmonic is greatest: the wave is ``amplitude cos(k (angle - direction))``."""
    period = 2.0 * math.pi / order
    return Quantity(name, "rad", 0.0, period, period, meaning, periodic=period)


def choice(name: str, meaning: str, values: tuple[float, ...]) -> Quantity:
    """A quantity that takes one of the given values, in rising order."""
    return Quantity(name, "-", values[0], values[-1], 1.0, meaning, linear=False, discrete=True)


def switch(name: str, meaning: str) -> Quantity:
    """A choice between two forms of an effect, 0 or 1."""
    return choice(name, meaning, (0.0, 1.0))


def lobes(
    name: str, orders: Sequence[int], size_meaning: str, direction_meaning: str
) -> tuple[Quantity, ...]:
    """Amplitude [m] and direction of tooth errors for each order, the number of periods around the gear.

    Names end with the order, which also replaces ``{}`` in the amplitude's meaning.
    """
    return tuple(
        quantity
        for k in orders
        for quantity in (
            # Cumulative errors decrease with the order: a random walk as its reciprocal.
            amplitude(f"{name}_{k}", "m", 5e-5, 2e-6 * min(1.0, 2.0 / k), size_meaning.format(k)),
            direction(f"{name}_direction_{k}", direction_meaning, k),
        )
    )


def turning(phase: Floats) -> Floats:
    """``cos`` and ``sin`` of a phase [rad], shape (n, 2)."""
    return np.stack((np.cos(phase), np.sin(phase)), axis=1)


def harmonics(responses: Complexes) -> Floats:
    """Columns (n, 2 k) of cosine and sine coefficients, from complex responses (n, k)."""
    return np.ascontiguousarray(responses).view(np.float64)


def harmonic_sum(coefficients: Floats, orders: Sequence[int], angle: Floats) -> Floats:
    """``sum a_k cos k (angle - d_k)`` from cosine and sine coefficients, in the shape of the angle."""
    pairs = zip(orders, coefficients[::2], coefficients[1::2], strict=True)
    return np.asarray(sum(a * np.cos(k * angle) + b * np.sin(k * angle) for k, a, b in pairs))
