"""Slow functions that no model promises: of torque, speed, place and time, and lines that change with load.

Every joint has some of each. They are part of every fit, each with a size of its own; those that predict
held-out data are part of an extended model, so that what it leaves is small. None is named as a cause.
Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Kind, Stage, Values
from hd_diag.effects.quantity import Quantity
from hd_diag.effects.signals import Signals

_SEGMENTS = 8  # of the torque, of either sign
_TURNS = (1, 2, 3)  # waves of the output's turn
_HATS = 5  # of the torque's magnitude, denser near zero, by which a line changes
# Share of a line's variance that is not the same at every torque. Waves of teeth, of even orders, halve or
# so; one per turn comes from what displaces the wave generator, unless an encoder makes it.
_CHANGES = {1: 1.0, 2: 0.25, 4: 0.25}
_KNOTS = 10  # of a drift
_SLOWEST = 5.0  # between knots of a drift, at least [s]: no wave of the gear is as slow
_SIGNS = (0.02, 0.1)  # of the top speed, within which friction changes its sign
LINES = (1, 2, 4)
"""Orders of the input's turn that any gear has: encoders and couplings; two lobes; four of both together."""

Shape = Callable[[Signals, float, float], Floats]


@dataclass(frozen=True, kw_only=True)
class Remainder(Effect):
    """A function with coefficients of standard normal prior, in units of its `size`.

    `shape` makes columns (n, count) of order one from signals and the range (`low`, `high`) that it covers;
    beyond it the function goes on as it ends. `follows` is the signal that it is a function of.
    """

    kind: Kind = "kinematic"
    stage: Stage = Stage.NOWHERE
    searched: bool = False
    standard: bool = True
    confused_with: tuple[str, ...] = ()
    inspect: str = ""
    follows: str = "torque"
    shape: Shape

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """The shape times the size; see :meth:`Effect.columns`."""
        size, low, high = nonlinear
        return size * self.shape(signals, low, high)


def _quantities(count: int, unit: str, of: str) -> tuple[Quantity, ...]:
    linear = (Quantity(f"c{k}", "-", -1e4, 1e4, 1.0, f"part {k}, over the size") for k in range(1, count + 1))
    return (
        *linear,
        Quantity("size", unit, 0.0, 1.0, 1.0, "usual size of a part", False, discrete=True),
        Quantity("low", of, -1e12, 1e12, 1.0, "least value that it was fitted to", False, discrete=True),
        Quantity("high", of, -1e12, 1e12, 1.0, "greatest value that it was fitted to", False, discrete=True),
    )


def _inside(values: Floats, low: float, high: float) -> Floats:
    """Values (n,) within a range about zero, over its greater end."""
    return np.asarray(np.clip(values, low, high) / max(-low, high, 1e-9))


def _torque(signals: Signals, low: float, high: float) -> Floats:
    """Torque within each segment: a compliance of its own there [N m], of either sign."""
    parts = []
    for sign, end in ((1.0, high), (-1.0, -low)):
        width = max(end, 0.0) / _SEGMENTS
        load = np.maximum(sign * signals.torque, 0.0)
        for k in range(_SEGMENTS):
            most = np.inf if k == _SEGMENTS - 1 and width else width
            parts.append(sign * np.clip(load - k * width, 0.0, most))
    return np.stack(parts, axis=1)


def _speed(signals: Signals, low: float, high: float) -> Floats:
    v = _inside(signals.forward_speed, low, high)
    smooth = [v, v * np.abs(v), np.abs(v), v**2]
    return np.stack([*(np.tanh(v / width) for width in _SIGNS), *smooth], axis=1)


def _place(signals: Signals, low: float, high: float) -> Floats:
    """Waves of the output's turn, and the same times the torque over its greatest."""
    load = _inside(signals.torque, low, high)
    waves = [f(k * signals.output_angle) for k in _TURNS for f in (np.cos, np.sin)]
    return np.stack([*waves, *(load * wave for wave in waves)], axis=1)


def _time(signals: Signals, low: float, high: float) -> Floats:
    """Hats about knots, whose sum is one: straight pieces between these."""
    hats = np.zeros((signals.size, _KNOTS))
    pieces = min(int((high - low) / _SLOWEST), _KNOTS - 1)
    if pieces > 0:
        at = np.clip((signals.time - low) / (high - low), 0.0, 1.0) * pieces
        knots = np.arange(pieces + 1)
        hats[:, : pieces + 1] = np.maximum(1.0 - np.abs(at[:, None] - knots), 0.0)
    return hats


def _line(order: int) -> Shape:
    """Waves with the same part at every torque, and what changes with its magnitude.

    What changes is in proportion: a gear's own wave falls with the load, a coupling's or encoder's does not.
    """
    apart, changes = np.abs(np.subtract.outer(np.arange(_HATS), np.arange(_HATS))), _CHANGES[order]
    smooth = np.linalg.cholesky(1.0 - changes + changes * (1.0 - changes) ** apart)

    def shape(signals: Signals, low: float, high: float) -> Floats:
        load = np.minimum(np.abs(signals.torque) / max(-low, high, 1e-9), 1.0)
        node = np.sqrt(load) * (_HATS - 1)
        law = np.maximum(1.0 - np.abs(node[:, None] - np.arange(_HATS)), 0.0) @ smooth
        waves = [f(order * signals.wave_generator_angle)[:, None] * law for f in (np.cos, np.sin)]
        return np.concatenate(waves, axis=1)

    return shape


TORQUE = Remainder(
    name="function_of_torque",
    cause="The torsion has another shape than the model's.",
    frame="torque",
    needs=("torque",),
    source="catalogues give straight pieces between three torques, to some ten per cent",
    quantities=_quantities(2 * _SEGMENTS, "rad/(N m)", "N m"),
    shape=_torque,
)
SPEED = Remainder(
    name="function_of_speed",
    cause="A part follows the speed and its direction.",
    frame="input",
    needs=("speed",),
    source="friction that is usual, and lags of the streams",
    quantities=_quantities(len(_SIGNS) + 4, "rad", "rad/s"),
    follows="speed",
    shape=_speed,
)
PLACE = Remainder(
    name="function_of_place",
    cause="A part belongs to the output's place.",
    frame="output",
    needs=("output_angle", "torque"),
    source="flanges and encoders that are off centre as is usual, and what a link's weight does",
    quantities=_quantities(4 * len(_TURNS), "rad", "N m"),
    follows="output_angle",
    shape=_place,
)
TIME = Remainder(
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
ORDERS = tuple(
    Remainder(
        name=f"line_{order}",
        cause=f"A wave of {order} per input turn, which changes with the torque's magnitude.",
        frame="input",
        needs=("wave_generator_angle", "torque"),
        source="couplings, encoders and lobes that are off as is usual",
        quantities=_quantities(2 * _HATS, "rad", "N m"),
        shape=_line(order),
    )
    for order in LINES
)
REMAINDERS = (TORQUE, SPEED, PLACE, TIME, *ORDERS)
"""All of them; a model file may hold each once."""
