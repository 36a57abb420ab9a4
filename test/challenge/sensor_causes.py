"""Faults of encoders, streams and torque sensors, and what discs off their shaft make of an angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from challenge.cause import Cause, Scene
from challenge.design import Array


def off_centre(angle: Array, eccentricity: float, direction: float) -> Array:
    """Reading [rad] of one head over a disc whose centre is off the shaft, a fraction of the head's radius.

    The head sees the disc's angle at its own place: that of the line from the disc's centre to the head.
    """
    centre = angle + direction
    line = np.arctan2(-eccentricity * np.sin(centre), 1 - eccentricity * np.cos(centre))
    return angle - line


def quadrature(angle: Array, lines: int, offset: float, phase: float, gain: float = 0.0) -> Array:
    """Reading [rad] from sine and cosine tracks with offsets and unequal gains (fractions of a track)."""
    electrical = lines * angle
    c = (1 + gain) * np.cos(electrical) + offset * np.cos(phase)
    s = np.sin(electrical) + offset * np.sin(phase)
    return angle + np.angle((c + 1j * s) * np.exp(-1j * electrical)) / lines


@dataclass(frozen=True)
class Offset(Cause):
    """Something off the shaft that it should be on, by an offset as a fraction of the reading's radius.

    ``second`` is a second harmonic (of a disc that is tilted or oval, too) as a share of the first.
    """

    offset: float
    direction: float
    second: float = 0.0
    second_phase: float = 0.0

    def _off_centre(self, angle: Array) -> Array:
        second = self.offset * self.second * np.cos(2 * angle - self.second_phase)
        return off_centre(angle, self.offset, self.direction) + second


class OutputRunout(Offset, name="output_runout"):
    """The output flange's centre circles; the radius is the arm that reads its angle."""

    def output_reading(self, angle: Array) -> Array:
        return angle + np.arcsin(self.offset * np.sin(angle - self.direction))


class OutputEncoderEccentricity(Offset, name="output_encoder_eccentricity"):
    """The output encoder's disc is off the shaft; the radius is that of its head."""

    def output_reading(self, angle: Array) -> Array:
        return self._off_centre(angle)


class InputEncoderEccentricity(Offset, name="input_encoder_eccentricity"):
    """The input encoder's disc is off the shaft; the radius is that of its head."""

    def input_reading(self, angle: Array) -> Array:
        return self._off_centre(angle)


@dataclass(frozen=True)
class EncoderInterpolation(Cause, name="encoder_interpolation"):
    """Quadrature signals of the input encoder with an offset (fraction), ``lines`` periods a turn."""

    offset: float
    phase: float
    lines: int

    def input_reading(self, angle: Array) -> Array:
        return quadrature(angle, self.lines, self.offset, self.phase)


@dataclass(frozen=True)
class OutputEncoderInterpolation(Cause, name="output_encoder_interpolation", sizes=("offset", "gain")):
    """Quadrature signals of the output encoder with an offset and unequal gains (fractions of a track)."""

    offset: float
    phase: float
    lines: int
    gain: float = 0.0

    def output_reading(self, angle: Array) -> Array:
        return quadrature(angle, self.lines, self.offset, self.phase, self.gain)


@dataclass(frozen=True)
class StreamDelay(Cause, name="stream_delay"):
    """The output angle is older than its stamp [s]."""

    age: float

    @property
    def delay(self) -> float:
        return self.age


@dataclass(frozen=True)
class RatioError(Cause, name="ratio_error"):
    """The reported input counts a fraction too much: ratio 100 (1 + fraction), or a belt not declared."""

    fraction: float

    def input_reading(self, angle: Array) -> Array:
        return angle * (1 + self.fraction)


@dataclass(frozen=True)
class TorqueOffset(Cause, name="torque_offset"):
    """The true torque is the reported plus this [N m]."""

    torque: float

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        return torque - self.torque


@dataclass(frozen=True)
class TorqueGain(Cause, name="torque_gain"):
    """The torque sensor reports the true torque times a factor."""

    gain: float

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        return torque * self.gain


@dataclass(frozen=True)
class MotorCurrent(Cause, name="motor_current", sizes=("friction",)):
    """Amperes for torque: the motor moves itself, the wave generator's friction and the load that reaches it.

    ``constant`` [N m/A] at the output; friction [N m], and as a share of the load; viscous [N m] at 1 rad/s
    of the output, to the power 0.8; inertia of the motor seen from the output [kg m²].
    """

    constant: float
    friction: float
    loaded: float
    viscous: float
    inertia: float

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        speed, ratio = scene.speed / scene.design.ratio, scene.design.ratio
        rubbing = (self.friction + self.loaded * np.abs(scene.torque)) * np.tanh(speed / 5e-3)
        drag = self.viscous * np.abs(speed) ** 0.8 * np.sign(speed)
        needed = scene.torque + rubbing + drag + self.inertia * scene.acceleration / ratio
        return needed / self.constant


@dataclass(frozen=True)
class TorqueSensorRipple(Cause, name="torque_sensor_ripple", sizes=("share", "constant")):
    """Strain gauges on the flexspline read the wave generator: a share of the torque, and a part [N m].

    Twice a turn, and less at 1 and 4 (shares of that at 2); Taghirad, Belanger, IEEE Trans. Robotics and
    Automation 15(1), 1999, found 2 and its multiples.
    """

    share: float
    constant: float
    phases: tuple[float, float, float, float]
    once: float = 0.0
    fourfold: float = 0.0

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        wave = np.cos(2 * scene.motor - self.phases[0])
        wave = wave + self.once * np.cos(scene.motor - self.phases[1])
        wave = wave + self.fourfold * np.cos(4 * scene.motor - self.phases[2])
        return torque * (1 + self.share * wave) + self.constant * np.cos(2 * scene.motor - self.phases[3])
