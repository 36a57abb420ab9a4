"""Base class of the effects: what each declares as data and what it computes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.excitation import Check, Verdict
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals

Values = tuple[float, ...]
Kind = Literal["kinematic", "torsion", "friction", "sensor"]
Frame = Literal["input", "output", "housing", "time", "torque"]

# Values of an effect at n samples, and its state after the last one.
Stepped = tuple[Floats, Any]

_OF_TEETH, _FREE = 3.0, 1e3  # prior deviation over the usual size: of errors of teeth, of all others
_KNOTS = 12  # knots of the piecewise linear amplitude and phase of an effect that wanders


class Stage(IntEnum):
    """Where an effect enters the chain from the torque through gear and spring to the samples.

    ``REPORTED`` is a function of the reported signals, which no stage carries.
    """

    REPORTED = -1
    TORQUE = 0
    GEAR = 1
    SPRING = 2
    STREAM = 3


class Starts(NamedTuple):
    """Start values of the nonlinear quantities, and the number of independent values that were compared."""

    points: list[Values]
    trials: int

    @staticmethod
    def grid(points: Iterable[Values]) -> Starts:
        """Start points that each count as one trial."""
        every = list(points)
        return Starts(every, len(every))


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A physical cause of transmission error that the model leaves out.

    An effect without memory implements `columns`, one that depends on earlier samples `advance`. If it is not
    proportional to its coefficients, it implements `step` as well. Everything else that a fit needs is data.

    Parameters
    ----------
    name : str
        Machine name.
    cause : str
        One sentence.
    kind : {"kinematic", "torsion", "friction", "sensor"}
    frame : {"input", "output", "housing", "time", "torque"}
        What the effect is fixed to or follows.
    needs : tuple of str
        Names of the signals that the effect is computed from. If it uses neither the prediction nor the
        contact (`of_teeth`), its columns stay cached when the model's parameters change.
    quantities : tuple of Quantity
        Linear ones first.
    confused_with : tuple of str
        Effects that short or poor records cannot distinguish from it.
    source : str
        Reference.
    inspect : str
        What to look at first, what to measure there, which test would confirm.
    always_confused : tuple of str
        Effects, or parameters of the model, that no record can distinguish from it.
    formula : str
        What it adds to the transmission error; if empty, the docstring of its class is taken.
    excitation : tuple of callable
        Checks of :mod:`hd_diag.effects.excitation`. The effect is testable if the motion passes them all.
    grid : tuple of tuple of float
        Start values of the nonlinear quantities, used if the record gives no better ones.
    stage : Stage
        Where it enters. Effects of later stages see what earlier ones add.
    of_teeth : bool
        Whether it acts through the tooth contact. Later stages then see it as part of the gear's ripple.
    remembers : bool
        Whether it depends on earlier samples. It is then computed on all rows, also on those not fitted.
    proportional : bool
        Whether `step` returns the columns times the coefficients.
    own_slopes : bool
        Whether its columns change with its size; see `slopes`.
    wanders_by : str
        Name of the discrete quantity that, at 1, lets amplitude and phase wander over the record; or "".
    broadband : bool
        Whether it has no spectral line of its own. The noise is then estimated with its columns in the fit.
    searched : bool
        Whether it is searched for in the residual. Others are found before the fit, belong to every fit, or
        are added after the search.
    given : bool
        Whether every fit contains it if the torque comes from motor current. Its prior is then centred on
        zero with its usual sizes, and it is never named as a cause.
    lasting : bool
        Whether an extended model may contain it. False for what happened once in a record.
    standard : bool
        Whether its coefficients have a standard normal prior; see
        :mod:`hd_diag.effects.remainders`.
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
    formula: str = ""
    excitation: tuple[Check, ...] = ()
    grid: tuple[Values, ...] = ((),)
    stage: Stage = Stage.GEAR
    of_teeth: bool = False
    remembers: bool = False
    proportional: bool = True
    own_slopes: bool = False
    wanders_by: str = ""
    broadband: bool = False
    searched: bool = True
    given: bool = False
    lasting: bool = True
    standard: bool = False

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Derivatives of the transmission error by the coefficients at small size [rad per unit], (n, size).

        `nonlinear` holds the values of the nonlinear quantities. Every run begins from its start state.
        """
        if not self.remembers:
            raise NotImplementedError
        return by_run(signals, lambda run: self.advance(self.start(nonlinear), run, nonlinear)[0])

    def start(self, nonlinear: Values) -> Any:
        """State before the first sample of a run."""
        return None

    def advance(self, state: Any, signals: Signals, nonlinear: Values) -> Stepped:
        """Columns at the next samples of a run, shape (n, size), and the state after them."""
        return self.columns(signals, nonlinear), state

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Transmission error at the next samples of a run [rad], shape (n,), and the state after them."""
        columns, state = self.advance(state, signals, nonlinear)
        return np.asarray(columns @ coefficients), state

    def slopes(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """Columns at given coefficients, for effects whose columns change with size (`own_slopes`)."""
        return self.columns(signals, nonlinear)

    def shown(self, signals: Signals, columns: Floats, nonlinear: Values) -> Floats:
        """Columns (n, k) with zeros where samples are too far apart to resolve a wave.

        There the wave is aliased and could imitate anything slow. Unchanged unless overridden.
        """
        return columns

    def carry(self, signals: Signals, added: Floats, coefficients: Floats, nonlinear: Values) -> Floats:
        """Change that the effect makes to the parts that earlier stages add; zero unless overridden.

        `added` holds parts of the transmission error [rad], shape (n, k), and so does the result.
        """
        return np.zeros_like(added)

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Start values of the nonlinear quantities: a grid, or values that fit a residual (n,) [rad]."""
        return Starts.grid(self.grid)

    def testable(self, signals: Signals) -> Verdict:
        """Whether the record's motion can show the effect; if not, the shortest extra motion that would."""
        verdicts = (check(signals) for check in self.excitation)
        return next((verdict for verdict in verdicts if not verdict[0]), (True, ""))

    def response(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """Transmission error of the effect at full size along a record [rad], shape (n,)."""
        if self.proportional:
            return np.asarray(self.columns(signals, nonlinear) @ coefficients)
        if not self.remembers:
            return self.step(None, signals, coefficients, nonlinear)[0]
        return by_run(signals, lambda run: self.step(self.start(nonlinear), run, coefficients, nonlinear)[0])

    def wandering(self, signals: Signals, nonlinear: Values) -> Floats:
        """Additional columns (n, k) that let amplitude and phase wander over a record; k may be 0.

        They are fitted with the effect. A running model omits them, because nothing predicts them.
        """
        if not self.wanders(nonlinear) or signals.size < 2:
            return np.empty((signals.size, 0))
        angle = signals.wave_generator_angle
        way = np.cumsum(np.abs(np.diff(angle, prepend=angle[0])))
        place, hats = way * (_KNOTS / max(float(way[-1]), 1e-300)), np.zeros((signals.size, _KNOTS))
        edges = np.searchsorted(place, np.arange(_KNOTS + 2))
        for knot, (before, after) in enumerate(zip(edges, edges[2:], strict=False)):
            hats[before:after, knot] = 1.0 - np.abs(place[before:after] - knot - 1.0)
        hats -= hats.mean(axis=0)
        own = self.columns(signals, nonlinear)
        return np.asarray((hats[:, :, None] * own[:, None, :]).reshape(signals.size, -1))

    def wanders(self, nonlinear: Values) -> bool:
        """Whether the effect wanders over a record at these values."""
        names = [quantity.name for quantity in self.nonlinear]
        return bool(self.wanders_by and nonlinear[names.index(self.wanders_by)])

    def sensible(self, coefficients: Floats, nonlinear: Values) -> bool:
        """Whether all strict limits hold; a candidate outside them imitates another cause."""
        strict = [quantity for quantity in self.quantities if quantity.strict]
        values = self.to_physical(coefficients, nonlinear) if strict else {}
        return all(quantity.allows(values[quantity.name][0]) for quantity in strict)

    @property
    def linear(self) -> tuple[Quantity, ...]:
        """Linear quantities, one for each coefficient."""
        return tuple(quantity for quantity in self.quantities if quantity.linear)

    @property
    def nonlinear(self) -> tuple[Quantity, ...]:
        """Nonlinear quantities."""
        return tuple(quantity for quantity in self.quantities if not quantity.linear)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.linear)

    @property
    def usual(self) -> Floats:
        """Usual size of every coefficient, shape (size,)."""
        linear = self.linear
        sizes = [linear[i - 1] if q.periodic is not None else q for i, q in enumerate(linear)]
        return np.array([q.prior_scale**q.power for q in sizes])

    @property
    def reach(self) -> Floats:
        """Prior standard deviation of every coefficient in a fit, shape (size,).

        Most are very wide. They only bound coefficients whose columns are zero in nearly all rows.
        """
        return self.usual * (1.0 if self.given else _OF_TEETH if self.of_teeth else _FREE)

    def to_physical(
        self, coefficients: Sequence[float] | Floats, nonlinear: Values
    ) -> dict[str, tuple[float, str]]:
        """Physical values: name to (value, unit), in the order of the quantities."""
        values = dict(zip((quantity.name for quantity in self.linear), map(float, coefficients), strict=True))
        for size, turned in self._pairs():
            cosine, sine = values[size.name], values[turned.name]
            values[size.name] = math.hypot(cosine, sine) ** (1.0 / size.power)
            period = turned.periodic or 2.0 * math.pi
            place = (math.atan2(sine, cosine) * period / (2.0 * math.pi)) % period
            values[turned.name] = place if place < period else 0.0
        values |= zip((quantity.name for quantity in self.nonlinear), map(float, nonlinear), strict=True)
        return {quantity.name: (values[quantity.name], quantity.unit) for quantity in self.quantities}

    def from_physical(self, values: Mapping[str, float]) -> tuple[Floats, Values]:
        """Coefficients and nonlinear values from physical values by name.

        Raises
        ------
        ValueError
            If a quantity is missing, unknown or outside its limits; the message names it.
        """
        names = [quantity.name for quantity in self.quantities]
        if wrong := sorted(set(names) ^ set(values)):
            raise ValueError(f"{self.name}: {wrong[0]} is missing or unknown; it takes {', '.join(names)}")
        for quantity in self.quantities:
            value = values[quantity.name]
            if not (math.isfinite(value) if quantity.periodic else quantity.allows(value)):
                raise ValueError(
                    f"{self.name}: {quantity.name} must be from {quantity.low:g} to {quantity.high:g} "
                    f"{quantity.unit}, not {value:g}"
                )
        found = {quantity.name: float(values[quantity.name]) for quantity in self.quantities}
        for size, turned in self._pairs():
            phase = found[turned.name] * 2.0 * math.pi / (turned.periodic or 1.0)
            whole = found[size.name] ** size.power
            found[size.name], found[turned.name] = whole * math.cos(phase), whole * math.sin(phase)
        coefficients = np.array([found[quantity.name] for quantity in self.linear])
        return coefficients, tuple(found[quantity.name] for quantity in self.nonlinear)

    def standard_deviations(
        self, coefficients: Sequence[float] | Floats, nonlinear: Values, covariance: Floats
    ) -> dict[str, float]:
        """Standard deviations of the quantities by name, by propagation (delta method).

        The covariance is that of the coefficients, or of the coefficients followed by the nonlinear
        quantities. Quantities that it leaves out get the deviation zero.
        """
        known = covariance.shape[0]
        gradient = np.eye(len(self.quantities), known)
        for index, turned in enumerate(self.linear):
            if turned.periodic is None:
                continue
            pair, size = slice(index - 1, index + 1), self.linear[index - 1]
            cosine, sine = map(float, coefficients[pair])
            whole = max(math.hypot(cosine, sine), 1e-300)
            along, across = np.array([cosine, sine]) / whole, np.array([-sine, cosine]) / whole
            gradient[index - 1, pair] = along * whole ** (1.0 / size.power - 1.0) / size.power
            gradient[index, pair] = across / whole * (turned.periodic / (2.0 * math.pi))
        variance = np.einsum("ij,jk,ik->i", gradient, covariance, gradient)
        return {q.name: math.sqrt(max(v, 0.0)) for q, v in zip(self.quantities, variance, strict=True)}

    def _pairs(self) -> list[tuple[Quantity, Quantity]]:
        """Every amplitude with its direction."""
        linear = self.linear
        return [(linear[i - 1], q) for i, q in enumerate(linear) if q.periodic is not None]


def by_run(signals: Signals, evaluate: Callable[[Signals], Floats]) -> Floats:
    """Values of a whole record, every run evaluated from its own start."""
    runs = signals.runs() or [slice(0, 0)]
    return np.concatenate([evaluate(signals.part(run)) for run in runs])


def seen_at(
    stage: Stage, signals: Signals, parts: Sequence[tuple[Effect, Floats]], rate: Callable[[Floats], Floats]
) -> Signals:
    """Signals as effects of a stage see them: tooth errors for the spring, all earlier effects for a stream.

    `signals` has the base model's own prediction; `parts` are effects with what each adds (n,) [rad]. Effects
    of the same and later stages are ignored. `rate` is the time derivative of values at the samples.
    """
    before = [(effect, part) for effect, part in parts if Stage.GEAR <= effect.stage < stage]
    if stage == Stage.SPRING:
        teeth = [part for effect, part in before if effect.of_teeth]
        return replace(signals, tooth_ripple=np.sum(teeth, axis=0)) if teeth else signals
    if not before:
        return signals
    total: Floats = signals.predicted + np.sum([part for _, part in before], axis=0)
    return replace(signals, predicted=total, predicted_rate=rate(total))
