"""Faults of encoders, streams and torque sensors."""

from __future__ import annotations

from dataclasses import dataclass

from challenge import encoders
from challenge.cause import Cause
from challenge.clearances import Array


@dataclass(frozen=True)
class OutputRunout(Cause):
    """The output flange's centre circles by an offset, as a fraction of the arm that reads its angle."""

    offset: float
    direction: float
    name = "output_runout"
    size = "offset"

    def output_reading(self, angle: Array) -> Array:
        return encoders.swung_arm(angle, self.offset, self.direction)


@dataclass(frozen=True)
class OutputEncoderEccentricity(Cause):
    """The output encoder's disc is off the shaft, as a fraction of the head's radius."""

    offset: float
    direction: float
    name = "output_encoder_eccentricity"
    size = "offset"

    def output_reading(self, angle: Array) -> Array:
        return encoders.off_centre(angle, self.offset, self.direction)


@dataclass(frozen=True)
class InputEncoderEccentricity(Cause):
    """The input encoder's disc is off the shaft, as a fraction of the head's radius."""

    offset: float
    direction: float
    name = "input_encoder_eccentricity"
    size = "offset"

    def input_reading(self, angle: Array) -> Array:
        return encoders.off_centre(angle, self.offset, self.direction)


@dataclass(frozen=True)
class EncoderInterpolation(Cause):
    """Quadrature signals of the input encoder with an offset (fraction), ``lines`` periods a turn."""

    offset: float
    phase: float
    lines: int
    name = "encoder_interpolation"
    size = "offset"

    def input_reading(self, angle: Array) -> Array:
        return encoders.quadrature(angle, self.lines, self.offset, self.phase)


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
