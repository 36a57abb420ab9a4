"""Motion and load of a record: runs between rests, as functions of continuous time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from challenge.design import SIZE_25, Array, Design

REST = 0.15  # [s] at rest at the beginning and the end of a run
RAMP = 0.6  # [s] from rest to full speed
SPEEDS = (1.3, 3.1, 6.2, 9.7, 14.3, 19.1)  # [1/s], turns of the input
BOTH_WAYS = (*SPEEDS, *(-v for v in SPEEDS))
RATE = 500.0  # [Hz]


@dataclass(frozen=True)
class Run:
    """One run: signed speed [turns/s]; torque [N m] = level + swing sin + nested sin, ramped."""

    speed: float
    level: float = 0.0
    swing: float = 0.0
    period: float = 3.0
    nested: float = 0.0
    duration: float = 10.0
    ramp: float = RAMP

    def _moving(self, t: Array) -> Array:
        return np.clip(t - REST, 0, self.duration - 2 * REST)

    def envelope(self, t: Array) -> Array:
        """Share 0..1 of full speed and load, with raised-cosine ramps."""
        t = self._moving(t)
        end = self.duration - 2 * REST
        return np.sin(np.pi / 2 * np.clip(np.minimum(t, end - t) / self.ramp, 0, 1)) ** 2

    def way(self, t: Array) -> Array:
        """Angle [rad] since the run's start, the integral of the speed."""
        t, ramp = self._moving(t), self.ramp
        end = self.duration - 2 * REST

        def risen(x: Array) -> Array:
            x = np.clip(x, 0, ramp)
            return x / 2 - ramp / (2 * np.pi) * np.sin(np.pi * x / ramp)

        even = np.clip(t - ramp, 0, end - 2 * ramp)
        seconds = risen(t) + even + risen(np.array(ramp)) - risen(end - t)
        return 2 * np.pi * self.speed * np.where(t < end - ramp, risen(t) + even, seconds)

    def torque(self, t: Array) -> Array:
        """Torque that the drive exerts on the link [N m]."""
        phase = 2 * np.pi * self._moving(t) / self.period
        return self.envelope(t) * (
            self.level + self.swing * np.sin(phase) + self.nested * np.sin(5.3 * phase + 0.7)
        )


@dataclass(frozen=True)
class Motion:
    """Runs one after the other; the input angle continues from run to run."""

    runs: tuple[Run, ...]
    start_angle: float = 0.0
    design: ClassVar[Design] = SIZE_25

    @property
    def starts(self) -> Array:
        """Start of every run and end of the last one [s]."""
        return np.r_[0, np.cumsum([run.duration for run in self.runs])]

    def times(self, rate: float = RATE) -> Array:
        """Evenly spaced moments [s]."""
        return np.arange(round(self.starts[-1] * rate)) / rate

    def run_of(self, t: Array) -> Array:
        """Index of the run at each moment."""
        return np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.runs) - 1)

    def _each(self, t: Array, what: str) -> Array:
        index, out = self.run_of(t), np.empty(len(t))
        for i, run in enumerate(self.runs):
            mine = index == i
            out[mine] = getattr(run, what)(t[mine] - self.starts[i])
        return out

    def angle(self, t: Array) -> Array:
        """Angle of the motor [rad]."""
        travelled = [float(run.way(np.array(run.duration))) for run in self.runs]
        return self.start_angle + np.r_[0, np.cumsum(travelled)][self.run_of(t)] + self._each(t, "way")

    def speed(self, t: Array) -> Array:
        """Speed of the motor [rad/s]."""
        full = np.array([2 * np.pi * run.speed for run in self.runs])
        return full[self.run_of(t)] * self._each(t, "envelope")

    def torque(self, t: Array) -> Array:
        """Torque that the drive exerts on the link [N m]."""
        return self._each(t, "torque")


def _loads(rng: np.random.Generator, count: int) -> list[dict[str, float]]:
    """Loads that cover the range: steady levels of both signs, large and small swings, nested reversals."""
    loads: list[dict[str, float]] = []
    for i in range(count):
        sign, period = 1.0 if i % 2 else -1.0, rng.uniform(2.2, 7.0)
        kinds = (
            {"level": sign * rng.uniform(15, 75), "swing": 8.0},
            {"swing": sign * rng.uniform(50, 72)},
            {"swing": sign * rng.uniform(40, 60), "nested": 15.0},
            {"swing": sign * 8.0},
        )
        loads.append({**kinds[(0, 1, 2, 1, 0, 3, 1, 2, 0, 1, 1, 0)[i % 12]], "period": period})
    return [loads[i] for i in rng.permutation(count)]


def _assembled(rng: np.random.Generator, speeds: Sequence[float], duration: float = 10.0) -> Motion:
    loads = _loads(rng, len(speeds))
    runs = tuple(Run(v, **load, duration=duration) for v, load in zip(speeds, loads, strict=True))
    return Motion(runs)


def standard(rng: np.random.Generator) -> Motion:
    """Twelve runs of 10 s: six speeds, each in both directions."""
    return _assembled(rng, rng.permutation(BOTH_WAYS).tolist())


def short(rng: np.random.Generator) -> Motion:
    """Two runs of 2 s under one load, one in each direction."""
    v = rng.uniform(0.8, 2.0)
    return Motion((Run(v, swing=50, period=1.6, duration=2.0), Run(-v, swing=50, period=1.6, duration=2.0)))


def one_direction(rng: np.random.Generator) -> Motion:
    """Twelve runs at six speeds, all in one direction."""
    sign = rng.choice([-1, 1])
    return _assembled(rng, [sign * v for v in rng.permutation([*SPEEDS, *SPEEDS]).tolist()])


def one_speed(rng: np.random.Generator) -> Motion:
    """Twelve runs at one speed in both directions."""
    v = float(rng.choice(SPEEDS[1:4]))
    return _assembled(rng, rng.permutation([v, -v] * 6).tolist())


def unloaded(rng: np.random.Generator) -> Motion:
    """Runs at the standard speeds without torque."""
    return Motion(tuple(Run(v) for v in rng.permutation(BOTH_WAYS).tolist()))


def constant_torque(rng: np.random.Generator) -> Motion:
    """Runs at the standard speeds under one torque (except for the ramps)."""
    level = rng.choice([-1, 1]) * rng.uniform(20, 60)
    return Motion(tuple(Run(v, level=level) for v in rng.permutation(BOTH_WAYS).tolist()))
