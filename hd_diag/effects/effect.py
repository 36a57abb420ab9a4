"""What every effect declares and can do."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.effects.signals import Signals

Values = tuple[float, ...]
Kind = Literal["kinematic", "torsion", "friction", "sensor"]
Frame = Literal["input", "output", "housing", "time", "torque"]


class Stage(IntEnum):
    """Where an effect enters, on the way from the gear to the samples."""

    NOWHERE = -1
    GEAR = 0
    SPRING = 1
    STREAM = 2


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
        Values that make sense.
    prior_scale : float
        Size that is usual, in its unit.
    meaning : str
    linear : bool
        Whether the transmission error is proportional to it. An amplitude and the direction after it count as
        linear: their cosine and sine parts are the coefficients.
    periodic : float, optional
        Period of a direction or position [rad]; ``2 pi / k`` for a k-lobed error.
    discrete : bool
        Whether only the values that a grid or scan gives make sense: not to be refined.
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


def amplitude(name: str, unit: str, high: float, prior_scale: float, meaning: str) -> Quantity:
    """Size of a harmonic, to be followed by its direction."""
    return Quantity(name, unit, 0.0, high, prior_scale, meaning)


def direction(name: str, meaning: str, order: int = 1) -> Quantity:
    """Where a harmonic is greatest: the amplitude before it times ``cos(k (angle - direction))``."""
    period = 2.0 * math.pi / order
    return Quantity(name, "rad", 0.0, period, period, meaning, periodic=period)


@dataclass(frozen=True)
class Effect(ABC):
    """A physical cause of transmission error that the model leaves out.

    Parameters
    ----------
    name : str
        Machine name.
    cause : str
        One sentence.
    kind : {"kinematic", "torsion", "friction", "sensor"}
    frame : {"input", "output", "housing", "time", "torque"}
        What it is fixed to or follows.
    needs : tuple of str
        Names of the signals that it is computed from.
    quantities : tuple of Quantity
        Linear ones first.
    confused_with : tuple of str
        Effects that short or poor records cannot tell from it.
    source : str
        Reference.
    inspect : str
        What to look at first, what it should measure, which test would confirm.
    always_confused : tuple of str
        Effects, or parameters of the model, that no record can tell from it.
    """

    name: str
    cause: str
    kind: Kind
    frame: Frame
    needs: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    confused_with: tuple[str, ...]
    source: str
    inspect: str
    always_confused: tuple[str, ...] = ()

    stage: ClassVar[Stage] = Stage.GEAR
    """Where it enters; effects of later stages see what those of earlier ones add."""

    of_teeth: ClassVar[bool] = False
    """Whether it enters through the contact: then it is part of the gear's ripple, for later stages."""

    remembers: ClassVar[bool] = False
    """Whether it depends on samples before: then it has to see all, those too that no fit uses."""

    @abstractmethod
    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Transmission error by each linear coefficient.

        Parameters
        ----------
        signals : Signals
        nonlinear : tuple of float
            Values of the nonlinear quantities.

        Returns
        -------
        ndarray, shape (n, size)
            [rad] per unit of the coefficient.
        """

    def wandering(self, signals: Signals, nonlinear: Values) -> Floats:
        """Columns by which it may wander over a record, beside its own, shape (n, k); none unless stated.

        They are fitted with it and are no part of a model that runs, for nothing foretells them.
        """
        return np.empty((signals.size, 0))

    def sensible(self, coefficients: Floats, nonlinear: Values) -> bool:
        """Whether a candidate may have these values: beyond, another cause is meant."""
        return True

    @abstractmethod
    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Whether the record's motion allows to find it; if not, the shortest extra motion that would."""

    def grid(self, signals: Signals) -> list[Values]:
        """Start values of the nonlinear quantities."""
        return [()]

    def scan(self, signals: Signals, residual: Floats) -> list[Values]:
        """Start values that fit a residual [rad], shape (n,); no more than the grid unless stated."""
        return self.grid(signals)

    def beside(self, signals: Signals, nonlinear: Values) -> list[Values]:
        """Other discrete values next to given ones: worth a look when all else is fitted."""
        return []

    def trials(self, signals: Signals) -> int:
        """Number of independent values that a grid or scan looks at, for the family-wise error."""
        return len(self.grid(signals))

    def start(self, nonlinear: Values) -> Any:
        """State before the first sample of a record."""
        return None

    def step(self, state: Any, signals: Signals, nonlinear: Values) -> tuple[Floats, Any]:
        """Columns of the next samples, and the state after them."""
        return self.columns(signals, nonlinear), state

    def response(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """Transmission error of the effect at its size [rad], shape (n,): proportional unless stated."""
        return np.asarray(self.columns(signals, nonlinear) @ coefficients)

    def secant(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """Columns that hold at this size, mean or local slopes, where it has such; else its columns."""
        return self.columns(signals, nonlinear)

    def respond(
        self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values
    ) -> tuple[Floats, Any]:
        """Transmission error of the effect at the next samples, and the state after them."""
        return self.response(signals, coefficients, nonlinear), state

    def torque_shift(self, coefficients: Floats) -> float:
        """Real less reported torque by it [N m]; none unless stated."""
        return 0.0

    def carry(self, signals: Signals, added: Floats, coefficients: Floats, nonlinear: Values) -> Floats:
        """What it makes of what earlier stages add, beside that itself; nothing unless stated.

        Parameters
        ----------
        signals : Signals
        added : ndarray, shape (n, k)
            Parts of the transmission error.
        coefficients : ndarray, shape (size,)
        nonlinear : tuple of float

        Returns
        -------
        ndarray, shape (n, k)
        """
        return np.zeros_like(added)

    @property
    def linear(self) -> tuple[Quantity, ...]:
        """Quantities behind the coefficients, one each."""
        return tuple(quantity for quantity in self.quantities if quantity.linear)

    @property
    def nonlinear(self) -> tuple[Quantity, ...]:
        """The other quantities."""
        return tuple(quantity for quantity in self.quantities if not quantity.linear)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.linear)

    @property
    def prior_scales(self) -> Floats:
        """Usual size of every coefficient, shape (size,)."""
        scales = [quantity.prior_scale for quantity in self.linear]
        for index, quantity in enumerate(self.linear):
            if quantity.periodic is not None:
                scales[index] = scales[index - 1]
        return np.array(scales)

    def to_physical(
        self, coefficients: Sequence[float] | Floats, nonlinear: Values
    ) -> dict[str, tuple[float, str]]:
        """Values as people read them.

        Parameters
        ----------
        coefficients : sequence of float, length size
        nonlinear : tuple of float

        Returns
        -------
        dict
            Name to (value, unit), in the order of the quantities.
        """
        values = dict(zip((quantity.name for quantity in self.linear), map(float, coefficients), strict=True))
        for size, turned in self._pairs():
            cosine, sine = values[size.name], values[turned.name]
            values[size.name] = math.hypot(cosine, sine)
            values[turned.name] = _direction(math.atan2(sine, cosine), turned)
        values |= zip((quantity.name for quantity in self.nonlinear), map(float, nonlinear), strict=True)
        return {quantity.name: (values[quantity.name], quantity.unit) for quantity in self.quantities}

    def from_physical(self, values: Mapping[str, float]) -> tuple[Floats, Values]:
        """Coefficients and nonlinear values from what people write.

        Raises
        ------
        ValueError
            Naming a quantity that is missing, unknown or outside its limits.
        """
        self._check(values)
        found = {quantity.name: float(values[quantity.name]) for quantity in self.quantities}
        for size, turned in self._pairs():
            phase = found[turned.name] * 2.0 * math.pi / (turned.periodic or 1.0)
            found[size.name], found[turned.name] = (
                found[size.name] * math.cos(phase),
                found[size.name] * math.sin(phase),
            )
        coefficients = np.array([found[quantity.name] for quantity in self.linear])
        return coefficients, tuple(found[quantity.name] for quantity in self.nonlinear)

    def within(self, coefficients: Sequence[float] | Floats, nonlinear: Values) -> bool:
        """Whether all quantities are inside their limits."""
        values = self.to_physical(coefficients, nonlinear)
        return all(quantity.low <= values[quantity.name][0] <= quantity.high for quantity in self.quantities)

    def standard_deviations(
        self, coefficients: Sequence[float] | Floats, nonlinear: Values, covariance: Floats
    ) -> dict[str, float]:
        """Standard deviations of the quantities by propagation (delta method).

        Parameters
        ----------
        coefficients : sequence of float, length size
        nonlinear : tuple of float
        covariance : ndarray, shape (size, size) or with the nonlinear quantities after the coefficients

        Returns
        -------
        dict
            Name to standard deviation; zero for quantities that the covariance leaves out.
        """
        center = np.concatenate((np.asarray(coefficients, dtype=np.float64), nonlinear))
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        gradient = np.zeros((len(self.quantities), spread.size))
        for index, deviation in enumerate(spread):
            step = np.zeros(center.size)
            step[index] = 1e-3 * deviation
            if deviation > 0.0:
                gradient[:, index] = self._difference(center - step, center + step) / (2.0 * step[index])
        variance = np.einsum("ij,jk,ik->i", gradient, covariance, gradient)
        return {q.name: math.sqrt(max(v, 0.0)) for q, v in zip(self.quantities, variance, strict=True)}

    def _difference(self, low: Floats, high: Floats) -> Floats:
        ends = [self.to_physical(one[: self.size], tuple(one[self.size :])) for one in (low, high)]
        change = np.array([ends[1][q.name][0] - ends[0][q.name][0] for q in self.quantities])
        for index, quantity in enumerate(self.quantities):
            if quantity.periodic is not None:
                change[index] -= quantity.periodic * round(change[index] / quantity.periodic)
        return change

    def _pairs(self) -> list[tuple[Quantity, Quantity]]:
        linear = self.linear
        return [(linear[i - 1], q) for i, q in enumerate(linear) if q.periodic is not None]

    def _check(self, values: Mapping[str, float]) -> None:
        known = {quantity.name for quantity in self.quantities}
        if wrong := sorted(known ^ set(values)):
            expected = ", ".join(quantity.name for quantity in self.quantities)
            raise ValueError(f"{self.name}: {wrong[0]} is missing or unknown; it takes {expected}")
        for quantity in self.quantities:
            value = values[quantity.name]
            inside = math.isfinite(value) if quantity.periodic else quantity.low <= value <= quantity.high
            if not inside:
                raise ValueError(
                    f"{self.name}: {quantity.name} must be from {quantity.low:g} to {quantity.high:g} "
                    f"{quantity.unit}, not {value:g}"
                )


@dataclass(frozen=True)
class StatefulEffect(Effect):
    """An effect that remembers: one sample at a time and the whole record agree."""

    remembers: ClassVar[bool] = True

    @abstractmethod
    def start(self, nonlinear: Values) -> Any:
        """State before the first sample of a run."""

    @abstractmethod
    def step(self, state: Any, signals: Signals, nonlinear: Values) -> tuple[Floats, Any]:
        """Columns of the next samples of a run, and the state after them."""

    def respond(
        self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values
    ) -> tuple[Floats, Any]:
        """See :meth:`Effect.respond`."""
        columns, state = self.step(state, signals, nonlinear)
        return np.asarray(columns @ coefficients), state

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Columns of a record, each run from its start; see :meth:`Effect.columns`."""
        parts = [self.step(self.start(nonlinear), signals.part(run), nonlinear)[0] for run in signals.runs()]
        return np.concatenate(parts) if parts else np.empty((0, self.size))


def harmonic(response: npt.NDArray[np.complex128]) -> Floats:
    """Columns of a cosine and a sine coefficient from a complex response, shape (n, 2)."""
    return np.stack((response.real, response.imag), axis=1)


def harmonic_sum(coefficients: Floats, orders: Sequence[int], angle: Floats) -> Floats:
    """``sum a_k cos k (angle - d_k)`` of cosine and sine coefficients, in the shape of the angle."""
    pairs = zip(orders, coefficients[::2], coefficients[1::2], strict=True)
    return np.asarray(sum(a * np.cos(k * angle) + b * np.sin(k * angle) for k, a, b in pairs))


def turning(phase: Floats) -> Floats:
    """``cos`` and ``sin`` of a phase [rad], shape (n, 2)."""
    return np.stack((np.cos(phase), np.sin(phase)), axis=1)


def _direction(phase: float, quantity: Quantity) -> float:
    period = quantity.periodic or 2.0 * math.pi
    found = (phase * period / (2.0 * math.pi)) % period
    return found if found < period else 0.0
