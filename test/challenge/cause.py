"""Base class of faults: the places where a fault can act, and the scene that it gets. Sizes are SI."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from challenge.contact import Flaws
from challenge.design import SIZE_25, Array, Design


@dataclass(frozen=True)
class Scene:
    """True motion, arrays (n,): time [s], motor angle [rad], motor speed, torque, temperature, run index."""

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
    """A fault with its catalogue name; methods that a subclass does not override change nothing.

    ``sizes`` names the fields that :meth:`scaled` multiplies, by default the first field. A diagnosis may,
    but need not, give a name from ``may_be``.
    """

    name: ClassVar[str] = ""
    sizes: ClassVar[tuple[str, ...]] = ()
    known: ClassVar[bool] = True
    may_be: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, name: str = "", sizes: tuple[str, ...] = (), known: bool = True) -> None:
        cls.name, cls.sizes, cls.known = name or cls.name, sizes, known

    def flaws(self, design: Design) -> Flaws | None:
        """Departures of teeth and slots."""
        return None

    def shaft(self, angle: Array) -> Array:
        """Angle of the wave generator's hub [rad] at a motor angle [rad]."""
        return angle

    def added(self, scene: Scene) -> Array | float:
        """Angle [rad] added to the output angle of kinematics and mesh."""
        return 0.0

    def carried(self, scene: Scene, ripple: Array) -> Array | float:
        """Angle [rad] added to the output because the gear's ripple excites it, without the ripple itself."""
        return 0.0

    def load(self, scene: Scene) -> Array | float:
        """Torque [N m] on the mesh in addition to the link's."""
        return 0.0

    def input_reading(self, angle: Array) -> Array:
        """Reported input angle [rad] for an input angle."""
        return angle

    def output_reading(self, angle: Array) -> Array:
        """Reported output angle [rad] for an output angle."""
        return angle

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        """Reported torque [N m]; ``torque`` already contains the causes before this one."""
        return torque

    @property
    def delay(self) -> float:
        """Age of the output's samples [s]."""
        return 0.0

    def scaled(self, factor: float) -> Cause:
        """The same fault, larger or smaller."""
        sizes = self.sizes or (dataclasses.fields(self)[0].name,)
        return dataclasses.replace(self, **{size: getattr(self, size) * factor for size in sizes})

    def as_dict(self) -> dict[str, float]:
        """Sizes by name [SI]."""
        return {name: value for name, value in vars(self).items() if name != "shape"}
