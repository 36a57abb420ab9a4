"""Faults that are in no catalogue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from challenge.cause import Cause, Scene
from challenge.design import Array


@dataclass(frozen=True)
class Shape:
    """Output angle for amplitude 1 from scene and phase; order per turn of `frame`, or frequency [Hz]."""

    value: Callable[[Scene, float], Array]
    order: float | None = None
    frame: str = "input"


def _one_sided(scene: Scene, phase: float) -> Array:
    share = np.abs(scene.torque) / 50 * np.where(scene.speed > 0, 1.5, 0.5)
    return share * np.cos(2.6 * scene.motor - phase)


def _creep(scene: Scene, _: float) -> Array:
    way = np.abs(np.diff(scene.motor, prepend=scene.motor[0]))
    return np.cumsum(way * scene.torque) / 5e4


def _scratch(scene: Scene, place: float) -> Array:
    away = np.angle(np.exp(1j * (scene.output - place)))
    return np.exp(-((away / 0.06) ** 2))


def _settled(scene: Scene, phase: float) -> Array:
    places = np.random.default_rng(round(1e6 * abs(phase))).standard_normal(64)
    return places[scene.run % 64]


SHAPES: dict[str, Shape] = {
    # Wheel of a timing belt.
    "strange_order": Shape(lambda s, phase: np.cos(3.37 * s.motor - phase), 3.37),
    # Proportional to |torque|, three times as large in one direction as in the other.
    "one_sided_ripple": Shape(_one_sided, 2.6),
    # Motor that cogs under load.
    "cogging": Shape(lambda s, phase: s.torque / 40 * np.cos(23 * s.motor - phase), 23.0),
    # Belt at the output creeps with torque times travel; amplitude at 1000 rad and 50 N m.
    "belt_creep": Shape(_creep, frame="time"),
    # Scratch on the output disc: the angle is wrong within a few degrees of one place.
    "encoder_sector": Shape(_scratch, frame="output"),
    # Loose part on the input, proportional to the square of the speed.
    "unbalance": Shape(lambda s, phase: (s.speed / 60) ** 2 * np.cos(5.5 * s.motor - phase), 5.5),
    # Vibration of the floor, independent of the drive.
    "floor_vibration": Shape(lambda s, phase: np.sin(2 * np.pi * 7.3 * s.time - phase), 7.3, "time"),
    # The link bends in the same direction under either sign of torque.
    "even_torque": Shape(lambda s, phase: (s.torque / 50) ** 2, frame="torque"),
    # Clamped output bearing, only under positive torque.
    "output_order": Shape(
        lambda s, phase: norm.cdf(s.torque / 5) * np.cos(7 * s.output - phase), 7.0, "output"
    ),
    # Hub that settles at random whenever the drive rests.
    "loose_hub": Shape(_settled, frame="run"),
}


@dataclass(frozen=True)
class OutputLines(Cause, name="output_lines", known=False, sizes=("amplitude",)):
    """Lines at odd orders of the output [rad], as from the rollers of an output bearing."""

    orders: tuple[int, ...]
    amplitude: float
    phase: float

    def added(self, scene: Scene) -> Array:
        waves = (np.cos(order * (scene.output - self.phase)) for order in self.orders)
        return self.amplitude * np.asarray(sum(waves))


@dataclass(frozen=True)
class Unknown(Cause, known=False, sizes=("amplitude",)):
    """A fault by its key in `SHAPES`, with an amplitude [rad] at the output."""

    shape: str
    amplitude: float
    phase: float

    @property
    def name(self) -> str:
        return self.shape

    def added(self, scene: Scene) -> Array:
        return self.amplitude * SHAPES[self.shape].value(scene, self.phase)
