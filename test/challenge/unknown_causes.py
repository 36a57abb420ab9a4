"""Faults that no catalogue has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.stats import norm

from challenge.cause import Cause, Scene
from challenge.clearances import Array


@dataclass(frozen=True)
class Unknown(Cause):
    """A fault that no catalogue has, of an amplitude [rad] at the output."""

    amplitude: float
    phase: float = 0.0
    size = "amplitude"
    known = False
    order: ClassVar[float | None] = None  # per turn of ``frame``, where it has one
    frame: ClassVar[str] = "input"


@dataclass(frozen=True)
class StrangeOrder(Unknown):
    """3.37 waves per turn of the input: a timing belt's wheel."""

    name = "strange_order"
    order = 3.37

    def added(self, scene: Scene) -> Array:
        return self.amplitude * np.cos(3.37 * scene.motor - self.phase)


@dataclass(frozen=True)
class OneSidedRipple(Unknown):
    """2.6 waves a turn, in proportion to the torque's size, three times as large one way as the other."""

    name = "one_sided_ripple"
    order = 2.6

    def added(self, scene: Scene) -> Array:
        share = np.abs(scene.torque) / 50 * np.where(scene.speed > 0, 1.5, 0.5)
        return self.amplitude * share * np.cos(2.6 * scene.motor - self.phase)


@dataclass(frozen=True)
class Cogging(Unknown):
    """23 waves per turn in proportion to the torque: a motor that cogs under load."""

    name = "cogging"
    order = 23.0

    def added(self, scene: Scene) -> Array:
        return self.amplitude * scene.torque / 40 * np.cos(23 * scene.motor - self.phase)


@dataclass(frozen=True)
class BeltCreep(Unknown):
    """A belt at the output creeps with torque times way; amplitude per 1000 rad of the input at 50 N m."""

    name = "belt_creep"
    frame = "time"

    def added(self, scene: Scene) -> Array:
        way = np.abs(np.diff(scene.motor, prepend=scene.motor[0]))
        return self.amplitude * np.cumsum(way * scene.torque) / 5e4


@dataclass(frozen=True)
class EncoderSector(Unknown):
    """A scratch on the output disc: the angle is wrong within some degrees of one place."""

    width: float = 0.06
    name = "encoder_sector"
    frame = "output"

    def added(self, scene: Scene) -> Array:
        away = np.angle(np.exp(1j * (scene.output - self.phase)))
        return self.amplitude * np.exp(-((away / self.width) ** 2))


@dataclass(frozen=True)
class Unbalance(Unknown):
    """5.5 waves a turn that grow with the square of the speed: something loose on the input."""

    name = "unbalance"
    order = 5.5

    def added(self, scene: Scene) -> Array:
        return self.amplitude * (scene.speed / 60) ** 2 * np.cos(5.5 * scene.motor - self.phase)


@dataclass(frozen=True)
class FloorVibration(Unknown):
    """7.3 Hz from the floor, whatever the drive does."""

    name = "floor_vibration"
    frame = "time"
    frequency: ClassVar[float] = 7.3

    def added(self, scene: Scene) -> Array:
        return self.amplitude * np.sin(2 * np.pi * 7.3 * scene.time - self.phase)


@dataclass(frozen=True)
class EvenTorque(Unknown):
    """The link bends alike under either torque: a square law."""

    name = "even_torque"
    frame = "torque"

    def added(self, scene: Scene) -> Array:
        return self.amplitude * (scene.torque / 50) ** 2


@dataclass(frozen=True)
class OutputOrder(Unknown):
    """Seven waves per turn of the output, only under positive torque: a clamped output bearing."""

    name = "output_order"
    frame = "output"
    order = 7.0

    def added(self, scene: Scene) -> Array:
        return self.amplitude * norm.cdf(scene.torque / 5) * np.cos(7 * scene.output - self.phase)


@dataclass(frozen=True)
class LooseHub(Unknown):
    """A hub that settles anew, by chance, whenever the drive rests."""

    name = "loose_hub"
    frame = "run"

    def added(self, scene: Scene) -> Array:
        place = np.random.default_rng(round(1e6 * abs(self.phase))).standard_normal(64)
        return self.amplitude * place[scene.run % 64]
