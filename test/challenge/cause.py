"""What a fault is: where it can act, and what it sees of the drive. Sizes are SI."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from challenge.contact import Flaws
from challenge.design import SIZE_25, Array, Design


@dataclass(frozen=True)
class Scene:
    """True state, arrays (n,): time [s], motor angle [rad], its speed, torque, temperature, run."""

    time: Array
    motor: Array
    speed: Array
    torque: Array
    temperature: Array
    run: Array
    design: Design = SIZE_25

    @property
    def acceleration(self) -> Array:
        """Acceleration of the motor [rad/s²]."""
        return np.gradient(self.speed, self.time)

    @property
    def output(self) -> Array:
        """Output angle of an ideal gear [rad]."""
        return self.motor / self.design.ratio


@dataclass(frozen=True)
class Cause:
    """A fault, by its name in a catalogue. Methods that it does not override change nothing.

    The first field is its size, or the fields that ``sizes`` names. ``may_be`` holds catalogue names that a
    diagnosis may give the fault, though it need not name any.
    """

    name: ClassVar[str] = ""
    sizes: ClassVar[tuple[str, ...]] = ()
    known: ClassVar[bool] = True
    may_be: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, name: str = "", sizes: tuple[str, ...] = (), known: bool = True) -> None:
        cls.name, cls.sizes, cls.known = name or cls.name, sizes, known

    def flaws(self, design: Design) -> Flaws | None:
        """Deviations of teeth and slots."""
        return None

    def shaft(self, angle: Array) -> Array:
        """Angle of the wave generator's hub [rad] for an angle of the motor [rad]."""
        return angle

    def added(self, scene: Scene) -> Array | float:
        """Angle of the output [rad] in addition to kinematics and mesh."""
        return 0.0

    def carried(self, scene: Scene, ripple: Array) -> Array | float:
        """Additional angle of the output [rad] that the gear's ripple excites."""
        return 0.0

    def load(self, scene: Scene) -> Array | float:
        """Torque [N m] on the mesh in addition to the link's."""
        return 0.0

    def input_reading(self, angle: Array) -> Array:
        """Reported input angle [rad]."""
        return angle

    def output_reading(self, angle: Array) -> Array:
        """Reported output angle [rad]."""
        return angle

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        """Reported torque [N m] for the torque that earlier sensors report."""
        return torque

    @property
    def delay(self) -> float:
        """Age of the output's samples [s]."""
        return 0.0

    def scaled(self, factor: float) -> Cause:
        """The same fault with its sizes multiplied by a factor."""
        sizes = self.sizes or (dataclasses.fields(self)[0].name,)
        return dataclasses.replace(self, **{size: getattr(self, size) * factor for size in sizes})

    def as_dict(self) -> dict[str, float]:
        """Fields by name [SI]."""
        return {name: value for name, value in vars(self).items() if name != "shape"}
