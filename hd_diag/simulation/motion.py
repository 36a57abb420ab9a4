"""A test motion of a robot joint: runs at constant speed and torque, from rest to rest."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Times
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TORQUE

SECOND = 1_000_000_000  # [ns]
_TURN = 2.0 * math.pi


class Setpoints(NamedTuple):
    """Setpoints of a motion, each (n,): input angle [rad], input velocity [rad/s], torque [N m]."""

    input_angle: Floats
    input_velocity: Floats
    torque: Floats


@dataclass(frozen=True)
class Motion:
    """Runs at constant speed and torque from rest to rest, one for every direction, speed and torque.

    All runs have an equal share of the duration [s]. Speeds are those of the input [rad/s], positive; torques
    are those that the drive exerts on the link [N m]. All forward runs come first, so that the output travels
    far; with `both_directions` all are then repeated backwards. `ramp_share` is the part of a run in which
    speed and torque rise with minimum jerk, and likewise the part in which they fall [-]. `rest_share` is the
    part at rest and without torque before the start of a run, and likewise after its end [-].

    Raises ValueError that names an invalid value.
    """

    duration: float = 60.0
    sample_rate: float = 500.0
    speeds: tuple[float, ...] = (1.0 * _TURN, 2.0 * _TURN, 4.0 * _TURN)
    torques: tuple[float, ...] = (-40.0, -14.0, 14.0, 40.0)
    both_directions: bool = True
    ramp_share: float = 0.1
    rest_share: float = 0.05

    def __post_init__(self) -> None:
        for name, value, unit in (("duration", self.duration, "s"), ("sample_rate", self.sample_rate, "Hz")):
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, not {value} {unit}")
        if not self.speeds or not all(0.0 < speed < math.inf for speed in self.speeds):
            raise ValueError(f"speeds must be positive and finite, not {list(self.speeds)} rad/s")
        if not self.torques or not all(math.isfinite(torque) for torque in self.torques):
            raise ValueError(f"torques must be finite, not {list(self.torques)} N m")
        if not (self.ramp_share > 0.0 and 0.0 <= self.rest_share <= 0.5 - self.ramp_share):
            raise ValueError(
                f"ramp_share must be positive and rest_share not negative, both together at most 0.5, not "
                f"{self.ramp_share} and {self.rest_share}"
            )
        if self.sample_rate > SECOND:
            raise ValueError(f"sample_rate must be at most {SECOND:g} Hz, for stamps are in ns")
        if self.duration * max(self.speeds) > LARGEST_ANGLE:
            raise ValueError(f"the input turns by more than {LARGEST_ANGLE:g} rad: lower speeds or duration")
        if max(map(abs, self.torques)) > LARGEST_TORQUE:
            raise ValueError(f"torques must be at most {LARGEST_TORQUE:g} N m, not {list(self.torques)}")
        if self.samples < 1:
            raise ValueError(f"{self.duration} s at {self.sample_rate} Hz hold no sample")

    def under(self, share: float) -> Motion:
        """The same motion with a share of its torques."""
        return replace(self, torques=tuple(share * torque for torque in self.torques))

    @property
    def samples(self) -> int:
        """Number of samples."""
        return round(self.duration * self.sample_rate)

    @property
    def runs(self) -> list[tuple[float, float]]:
        """Velocity of the input [rad/s] and torque [N m] of every run."""
        forward = list(itertools.product(self.speeds, self.torques))
        return forward + [(-speed, torque) for speed, torque in forward if self.both_directions]

    def stamps(self, start: int, first: int, last: int) -> Times:
        """Times of the samples from `first` to before `last` [ns]; `start` is the time of sample 0."""
        count = np.arange(first, min(last, self.samples))
        elapsed: Times = np.rint(count * (SECOND / self.sample_rate)).astype(np.int64)
        return start + elapsed

    def at(self, time: Floats) -> Setpoints:
        """Setpoints at times since the motion's start (n,) [s]; the joint is at rest before and after it."""
        velocity, torque = np.array(self.runs).T
        length = self.duration / velocity.size
        travelled = (1.0 - 2.0 * self.rest_share - self.ramp_share) * length * velocity
        before = np.concatenate(([0.0], np.cumsum(travelled)))[:-1]
        run = np.clip(np.floor(time / length), 0, velocity.size - 1).astype(np.int64)
        ramp = self.ramp_share * length
        since = time - run * length - self.rest_share * length
        until = (1.0 - 2.0 * self.rest_share) * length - since
        share = _smooth_step(since / ramp) * _smooth_step(until / ramp)
        moving = ramp * (_step_integral(since / ramp) - _step_integral(1.0 - until / ramp))
        return Setpoints(before[run] + velocity[run] * moving, velocity[run] * share, torque[run] * share)


def _smooth_step(x: Floats) -> Floats:
    """Minimum-jerk rise from 0 at x = 0 to 1 at x = 1; Flash and Hogan (1985)."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - x * (15.0 - 6.0 * x))


def _step_integral(x: Floats) -> Floats:
    """Integral of `_smooth_step` from minus infinity to x."""
    rising = np.clip(x, 0.0, 1.0)
    return rising**4 * (2.5 - rising * (3.0 - rising)) + np.maximum(x - 1.0, 0.0)
