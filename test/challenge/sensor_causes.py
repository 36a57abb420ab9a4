"""Faults of encoders, streams and torque sensors, and what discs off their shaft make of an angle."""

from __future__ import annotations

import dataclasses
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
    return np.asarray(angle - line, dtype=np.float64)


def quadrature(angle: Array, lines: int, offset: float, phase: float, gain: float = 0.0) -> Array:
    """Reading [rad] from sine and cosine tracks with offsets and unequal gains (fractions of a track)."""
    electrical = lines * angle
    c = (1 + gain) * np.cos(electrical) + offset * np.cos(phase)
    s = np.sin(electrical) + offset * np.sin(phase)
    return np.asarray(angle + np.angle((c + 1j * s) * np.exp(-1j * electrical)) / lines, dtype=np.float64)


def swung_arm(angle: Array, offset: float, direction: float) -> Array:
    """Angle [rad] of an arm whose pivot circles with the shaft by an offset, as a fraction of its length."""
    return np.asarray(angle + np.arcsin(offset * np.sin(angle - direction)), dtype=np.float64)


@dataclass(frozen=True)
class Offset(Cause):
    """Something off the shaft that it should be on, by an offset as a fraction of the reading's radius.

    ``second`` is a second harmonic (of a disc that is tilted or oval, too) as a share of the first.
    """

    offset: float
    direction: float
    second: float = 0.0
    second_phase: float = 0.0
    size = "offset"

    def _doubled(self, angle: Array) -> Array:
        return self.offset * self.second * np.cos(2 * angle - self.second_phase)


class OutputRunout(Offset):
    """The output flange's centre circles; the radius is the arm that reads its angle."""

    name = "output_runout"

    def output_reading(self, angle: Array) -> Array:
        return swung_arm(angle, self.offset, self.direction)


class OutputEncoderEccentricity(Offset):
    """The output encoder's disc is off the shaft; the radius is that of its head."""

    name = "output_encoder_eccentricity"

    def output_reading(self, angle: Array) -> Array:
        return off_centre(angle, self.offset, self.direction) + self._doubled(angle)


class InputEncoderEccentricity(Offset):
    """The input encoder's disc is off the shaft; the radius is that of its head."""

    name = "input_encoder_eccentricity"

    def input_reading(self, angle: Array) -> Array:
        return off_centre(angle, self.offset, self.direction) + self._doubled(angle)


@dataclass(frozen=True)
class EncoderInterpolation(Cause):
    """Quadrature signals of the input encoder with an offset (fraction), ``lines`` periods a turn."""

    offset: float
    phase: float
    lines: int
    name = "encoder_interpolation"
    size = "offset"

    def input_reading(self, angle: Array) -> Array:
        return quadrature(angle, self.lines, self.offset, self.phase)


@dataclass(frozen=True)
class OutputEncoderInterpolation(Cause):
    """Quadrature signals of the output encoder with an offset and unequal gains (fractions of a track)."""

    offset: float
    phase: float
    lines: int
    gain: float = 0.0
    name = "output_encoder_interpolation"
    size = "offset"

    def output_reading(self, angle: Array) -> Array:
        return quadrature(angle, self.lines, self.offset, self.phase, self.gain)

    def scaled(self, factor: float) -> Cause:
        return dataclasses.replace(self, offset=self.offset * factor, gain=self.gain * factor)


@dataclass(frozen=True)
class StreamDelay(Cause):
    """The output angle is older than its stamp [s]."""

    age: float
    name = "stream_delay"
    size = "age"

    @property
    def delay(self) -> float:
        return self.age


@dataclass(frozen=True)
class RatioError(Cause):
    """The reported input counts a fraction too much: ratio 100 (1 + fraction), or a belt not declared."""

    fraction: float
    name = "ratio_error"
    size = "fraction"

    def input_reading(self, angle: Array) -> Array:
        return angle * (1 + self.fraction)


@dataclass(frozen=True)
class TorqueOffset(Cause):
    """The true torque is the reported plus this [N m]."""

    torque: float
    name = "torque_offset"
    size = "torque"

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        return torque - self.torque


@dataclass(frozen=True)
class TorqueGain(Cause):
    """The torque sensor reports the true torque times a factor."""

    gain: float
    name = "torque_gain"
    size = "gain"

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        return torque * self.gain


@dataclass(frozen=True)
class MotorCurrent(Cause):
    """Amperes for torque: the motor moves itself, the wave generator's friction and the load that reaches it.

    ``constant`` [N m/A] at the output; friction [N m], and as a share of the load; viscous [N m] at 1 rad/s
    of the output, to the power 0.8; inertia of the motor seen from the output [kg m²].
    """

    constant: float
    friction: float
    loaded: float
    viscous: float
    inertia: float
    name = "motor_current"
    size = "friction"

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        speed, ratio = scene.speed / scene.design.ratio, scene.design.ratio
        rubbing = (self.friction + self.loaded * np.abs(scene.torque)) * np.tanh(speed / 5e-3)
        drag = self.viscous * np.abs(speed) ** 0.8 * np.sign(speed)
        needed = scene.torque + rubbing + drag + self.inertia * scene.acceleration / ratio
        return np.asarray(needed / self.constant)


@dataclass(frozen=True)
class TorqueSensorRipple(Cause):
    """Strain gauges on the flexspline read the wave generator: a share of the torque, and a part [N m].

    Twice a turn, and less at 1 and 4 (shares of that at 2); Taghirad, Belanger, IEEE Trans. Robotics and
    Automation 15(1), 1999, found 2 and its multiples.
    """

    share: float
    constant: float
    phases: tuple[float, float, float, float]
    once: float = 0.0
    fourfold: float = 0.0
    name = "torque_sensor_ripple"
    size = "share"

    def torque_reading(self, torque: Array, scene: Scene) -> Array:
        wave = np.cos(2 * scene.motor - self.phases[0])
        wave = wave + self.once * np.cos(scene.motor - self.phases[1])
        wave = wave + self.fourfold * np.cos(4 * scene.motor - self.phases[2])
        return torque * (1 + self.share * wave) + self.constant * np.cos(2 * scene.motor - self.phases[3])

    def scaled(self, factor: float) -> Cause:
        return dataclasses.replace(self, share=self.share * factor, constant=self.constant * factor)
