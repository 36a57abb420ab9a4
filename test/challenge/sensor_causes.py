"""Faults of encoders, streams and torque sensors, and what discs off their shaft make of an angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from challenge.cause import Cause
from challenge.clearances import Array


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
    """Something off the shaft that it should be on, by an offset as a fraction of the reading's radius."""

    offset: float
    direction: float
    size = "offset"


class OutputRunout(Offset):
    """The output flange's centre circles; the radius is the arm that reads its angle."""

    name = "output_runout"

    def output_reading(self, angle: Array) -> Array:
        return swung_arm(angle, self.offset, self.direction)


class OutputEncoderEccentricity(Offset):
    """The output encoder's disc is off the shaft; the radius is that of its head."""

    name = "output_encoder_eccentricity"

    def output_reading(self, angle: Array) -> Array:
        return off_centre(angle, self.offset, self.direction)


class InputEncoderEccentricity(Offset):
    """The input encoder's disc is off the shaft; the radius is that of its head."""

    name = "input_encoder_eccentricity"

    def input_reading(self, angle: Array) -> Array:
        return off_centre(angle, self.offset, self.direction)


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

    def torque_reading(self, torque: Array) -> Array:
        return torque - self.torque
