"""Faults of encoders, streams and torque sensors, and the readings of eccentric discs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from challenge.cause import Cause, Scene
from challenge.design import Array


def off_centre(angle: Array, eccentricity: float, direction: float) -> Array:
    """Reading [rad] of one head over an eccentric disc; eccentricity as a fraction of the head's radius.

    The head reads the disc's angle at its own place, the direction of the line from the disc's centre to it.
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
    """Something eccentric to its shaft, by an offset as a fraction of the reading's radius.

    ``second`` is the second harmonic relative to the first (a tilted or oval disc has one, too).
    """

    offset: float
    direction: float
    second: float = 0.0
    second_phase: float = 0.0

    def _off_centre(self, angle: Array) -> Array:
        second = self.offset * self.second * np.cos(2 * angle - self.second_phase)
        return off_centre(angle, self.offset, self.direction) + second


class OutputRunout(Offset, name="output_runout"):
    """The output flange's centre circles; the offset is relative to the lever arm of the angle reading."""

    def output_reading(self, angle: Array) -> Array:
        return angle + np.arcsin(self.offset * np.sin(angle - self.direction))


class OutputEncoderEccentricity(Offset, name="output_encoder_eccentricity"):
    """The output encoder's disc is off its shaft; the offset is relative to the head's radius."""

    def output_reading(self, angle: Array) -> Array:
        return self._off_centre(angle)


class InputEncoderEccentricity(Offset, name="input_encoder_eccentricity"):
    """The input encoder's disc is off its shaft; the offset is relative to the head's radius."""

    def input_reading(self, angle: Array) -> Array:
        return self._off_centre(angle)


@dataclass(frozen=True)
class EncoderInterpolation(Cause, name="encoder_interpolation"):
    """Quadrature signals of the input encoder with an offset (fraction), ``lines`` periods per turn."""

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
    """The output angle is older than its stamp by ``age`` [s]."""

    age: float

    @property
    def delay(self) -> float:
        return self.age


@dataclass(frozen=True)
class RatioError(Cause, name="ratio_error"):
    """The reported input is too large by a fraction: ratio 100 (1 + fraction), or an undeclared belt."""

    fraction: float

    def input_reading(self, angle: Array) -> Array:
        return angle * (1 + self.fraction)


@dataclass(frozen=True)
class TorqueOffset(Cause, name="torque_offset"):
    """The reported torque is smaller than the true torque by this offset [N m]."""

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
    """Current reported as torque: it includes motor inertia, friction of the wave generator and the load.

    ``constant`` [N m/A] at the output. ``friction`` [N m], ``loaded``: friction as a share of the load,
    ``viscous`` [N m] at 1 rad/s of the output, to the power 0.8. Motor inertia seen at the output [kg m²].
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
    """Strain gauges on the flexspline sense the wave generator: a share of the torque, and a constant [N m].

    Two waves per turn, the share also with 1 and 4 (``once`` and ``fourfold`` relative to 2). Taghirad,
    Belanger, IEEE Trans. Robotics and Automation 15(1), 1999, found 2 and its multiples.
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
