"""Remainders: slow functions of torque, speed, place and time that the model lacks, and lines of the input.

Every joint shows some of each. Every fit contains them, each with its own prior size. Those that predict
held-out data become part of the extended model, so that its residual is small. None is named as a cause.
Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Kind, Stage, Stepped, Values
from hd_diag.effects.quantity import Quantity, turning
from hd_diag.effects.recursions import slip
from hd_diag.effects.signals import Signals

_SEGMENTS = 8  # torque segments for either sign
_REACHES = (0.02, 0.06, 0.2, 0.6)  # torque at which a relaxed element slips, over the torque's range
_TURNS = (1, 2, 3)  # orders of the output's turn
_HATS = 5  # nodes of the torque's magnitude, denser near zero, for the change of a line
# Share of a line's prior variance that changes with torque. Even orders come from the teeth and about halve
# under load. Order 1 comes from a displaced wave generator, unless an encoder causes it.
_CHANGES = {1: 1.0, 2: 0.25, 4: 0.25}
_TURNED = 0.2  # change of phase [rad] with the torque's sign, because other flanks bear
_ODD = 2  # laws that are odd in the torque: proportional, and square root
_KNOTS = 10  # knots of a drift
_SLOWEST = 5.0  # least time between knots of a drift [s]: no wave of the gear is as slow
_SPEEDS = np.array([0.01, 0.03, 0.1, 0.3, 1.0])  # nodes over the top speed; below, friction changes its sign
_OWN = 0.1  # share of the prior variance that is independent at each node of the speed
_LOADED = 2  # speed laws that also grow with the load: the constant and the proportional one
_SPEED_LAWS = np.linalg.cholesky(
    1.0 - _OWN + np.multiply.outer(_SPEEDS, _SPEEDS) + _OWN * np.eye(_SPEEDS.size)
)
LINES = (1, 2, 4)
"""Orders of the input's turn in any gear: 1 of encoders and couplings, 2 of the lobes, 4 of both together."""

# Last torque [N m], None before the first sample; state z of each element, -1 to 1.
LoopState = tuple[float | None, tuple[float, ...]]

Shape = Callable[[Signals, float, float], Floats]


@dataclass(frozen=True, kw_only=True)
class Remainder(Effect):
    """A function whose coefficients have a standard normal prior, in units of its `size`.

    `low` and `high` are the range that it was fitted to. `follows` is the signal that it is a function of.
    """

    kind: Kind = "kinematic"
    stage: Stage = Stage.REPORTED
    searched: bool = False
    standard: bool = True
    confused_with: tuple[str, ...] = ()
    inspect: str = ""
    follows: str = "torque"


@dataclass(frozen=True, kw_only=True)
class Law(Remainder):
    """A remainder without memory.

    `shape` makes columns (n, count) of order one from signals and the range. Beyond the range the outer
    torque segments continue linearly; all other laws stay constant.
    """

    shape: Shape

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """The shape times the size; see :meth:`Effect.columns`."""
        size, low, high = nonlinear
        return size * self.shape(signals, low, high)


@dataclass(frozen=True, kw_only=True)
class Line(Law):
    """Waves with `order` periods per turn of the input."""

    order: int


@dataclass(frozen=True, kw_only=True)
class Loop(Remainder):
    """Hysteresis of dry friction: elements that slip one after the other (Prandtl and Ishlinskii)."""

    remembers: bool = True

    def start(self, nonlinear: Values) -> LoopState:
        """No torque yet; all elements are relaxed."""
        return None, (0.0,) * len(_REACHES)

    def advance(self, state: LoopState, signals: Signals, nonlinear: Values) -> Stepped:
        """Move the elements by the changes of torque; see :meth:`Effect.advance`."""
        torque, (size, low, high) = signals.torque, nonlinear
        if not torque.size:
            return np.empty((0, len(_REACHES))), state
        change = np.diff(torque, prepend=torque[0] if state[0] is None else state[0])
        change /= max(high - low, 1e-9)
        every = [slip(z, change / reach) for z, reach in zip(state[1], _REACHES, strict=True)]
        return size * np.stack(every, axis=1), (float(torque[-1]), tuple(float(z[-1]) for z in every))


def _quantities(count: int, unit: str, of: str) -> tuple[Quantity, ...]:
    linear = (Quantity(f"c{k}", "-", -1e4, 1e4, 1.0, f"part {k}, over the size") for k in range(1, count + 1))
    return (
        *linear,
        Quantity("size", unit, 0.0, 1.0, 1.0, "usual size of a part", False, discrete=True),
        Quantity("low", of, -1e12, 1e12, 1.0, "least value that it was fitted to", False, discrete=True),
        Quantity("high", of, -1e12, 1e12, 1.0, "greatest value that it was fitted to", False, discrete=True),
    )


def _inside(values: Floats, low: float, high: float) -> Floats:
    """Values (n,) clipped to a range about zero, over its end of greater magnitude [-]."""
    return np.asarray(np.clip(values, low, high) / max(-low, high, 1e-9))


def _hats(place: Floats, count: int) -> Floats:
    """Hat functions about nodes 0 to count - 1: linear interpolation weights at places (n,), (n, count)."""
    shares: Floats = np.maximum(1.0 - np.abs(place[:, None] - np.arange(count)), 0.0)
    return shares


def _torque(signals: Signals, low: float, high: float) -> Floats:
    """Torque within each segment of either sign [N m], (n, count): each coefficient is a compliance."""
    parts = []
    for sign, end in ((1.0, high), (-1.0, -low)):
        width = max(end, 0.0) / _SEGMENTS
        load = np.maximum(sign * signals.torque, 0.0)
        for k in range(_SEGMENTS):
            most = np.inf if k == _SEGMENTS - 1 and width else width
            parts.append(sign * np.clip(load - k * width, 0.0, most))
    return np.stack(parts, axis=1)


def _speed(signals: Signals, low: float, high: float) -> Floats:
    """Speed laws from constant to proportional: first odd in the direction of motion, then even.

    Then odd laws that grow with the load, as the friction of loaded teeth does.
    """
    speed = _inside(signals.forward_speed, low, high)
    size = np.maximum(np.abs(speed), 1e-9)
    node = np.interp(np.log(size), np.log(_SPEEDS), np.arange(_SPEEDS.size))
    law = _hats(node, _SPEEDS.size) @ _SPEED_LAWS
    law *= np.minimum(np.abs(speed) / _SPEEDS[0], 1.0)[:, None]
    way, load = np.sign(speed)[:, None], np.clip(signals.torque / signals.rated_torque, -1.0, 1.0)[:, None]
    loads = [load, np.abs(load), np.sqrt(np.abs(load))]
    return np.concatenate((way * law, law, *(way * law[:, :_LOADED] * each for each in loads)), axis=1)


def _place(signals: Signals, low: float, high: float) -> Floats:
    """Waves of the output's turn, and the same waves times the torque over its greatest magnitude."""
    load = _inside(signals.torque, low, high)
    waves = [f(k * signals.output_angle) for k in _TURNS for f in (np.cos, np.sin)]
    return np.stack([*waves, *(load * wave for wave in waves)], axis=1)


def _time(signals: Signals, low: float, high: float) -> Floats:
    """Hat functions of the time about the knots, with sum one; zero in too short a record."""
    hats = np.zeros((signals.size, _KNOTS))
    pieces = min(int((high - low) / _SLOWEST), _KNOTS - 1)
    if pieces > 0:
        at = np.clip((signals.time - low) / (high - low), 0.0, 1.0) * pieces
        hats[:, : pieces + 1] = _hats(at, pieces + 1)
    return hats


def _line(order: int) -> Shape:
    """Waves whose amplitude may change with the torque's magnitude and, a little, with its sign.

    A gear's own wave falls up to the rated torque, a coupling's or encoder's does not. A record of less
    torque allows less change, in proportion. The sign decides which flanks bear.
    """
    apart, changes = np.abs(np.subtract.outer(np.arange(_HATS), np.arange(_HATS))), _CHANGES[order]
    smooth = np.linalg.cholesky(1.0 - changes + changes * (1.0 - changes) ** apart)

    def shape(signals: Signals, low: float, high: float) -> Floats:
        greatest = max(-low, high)
        load = np.minimum(np.abs(signals.torque), greatest) / max(greatest, signals.rated_torque)
        even = _hats(np.sqrt(load) * (_HATS - 1), _HATS) @ smooth
        odd = _TURNED * np.sign(signals.torque)[:, None] * np.stack((load, np.sqrt(load)), axis=1)
        law = np.concatenate((even, odd), axis=1)
        waves = [f(order * signals.input_angle)[:, None] * law for f in (np.cos, np.sin)]
        return np.concatenate(waves, axis=1)

    return shape


TORQUE = Law(
    name="function_of_torque",
    cause="The torsion has another shape than the model's.",
    frame="torque",
    needs=("torque",),
    source="catalogues give straight pieces between three torques, to some ten per cent",
    quantities=_quantities(2 * _SEGMENTS, "rad/(N m)", "N m"),
    shape=_torque,
)
LOOP = Loop(
    name="function_of_history",
    cause="The torsion depends on where the torque came from.",
    frame="torque",
    needs=("torque", "run"),
    source="friction in the teeth and the cup: loops of half an arcminute are usual",
    quantities=_quantities(len(_REACHES), "rad", "N m"),
)
SPEED = Law(
    name="function_of_speed",
    cause="A part follows the speed and its direction.",
    frame="input",
    needs=("speed", "torque"),
    source="friction that is usual, and lags of the streams",
    quantities=_quantities(2 * _SPEEDS.size + 3 * _LOADED, "rad", "rad/s"),
    follows="speed",
    shape=_speed,
)
PLACE = Law(
    name="function_of_place",
    cause="A part belongs to the output's place.",
    frame="output",
    needs=("output_angle", "torque"),
    source="flanges and encoders that are off centre as is usual, and what a link's weight does",
    quantities=_quantities(4 * len(_TURNS), "rad", "N m"),
    follows="output_angle",
    shape=_place,
)
TIME = Law(
    name="function_of_time",
    cause="A part drifts with time.",
    frame="time",
    needs=("time",),
    source="zeros wander with warmth that nobody measures",
    quantities=_quantities(_KNOTS, "rad", "s"),
    lasting=False,
    follows="time",
    shape=_time,
)
EVEN = Line(
    name="even_line_2",
    cause="A wave of 2 per input turn, alike under any torque.",
    frame="input",
    needs=("output_angle",),
    source="gears whose teeth are preloaded, encoders and couplings: none of them can be told from another",
    quantities=_quantities(2, "rad", "N m"),
    shape=lambda signals, low, high: turning(2.0 * signals.input_angle),
    order=2,
)


def _changing(order: int) -> Line:
    return Line(
        name=f"line_{order}",
        cause=f"A wave of {order} per input turn, which changes with the torque's magnitude.",
        frame="input",
        needs=("output_angle", "torque"),
        source="couplings, encoders and lobes that are off as is usual",
        quantities=_quantities(2 * (_HATS + _ODD), "rad", "N m"),
        shape=_line(order),
        order=order,
    )


# The even line before the changing one of its order: if it suffices, the next line keeps its usual size.
ORDERS = (_changing(1), EVEN, _changing(2), _changing(4))
REMAINDERS = (TORQUE, LOOP, SPEED, PLACE, TIME, *ORDERS)
"""All remainders; a model file may hold each once."""
