"""Motion of a robot's joint: point to point with rests, loaded by gravity, payload and inertia."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from challenge.design import SIZE_25, Array, Design
from challenge.motion import RATE

FASTEST, SLOWEST, STEEPEST = 1.5, 0.05, 6.0  # [rad/s], [rad/s], [rad/s²] of the output
LONGEST = 15.0  # [s], longest move
HEAVIEST = 0.92  # share of the rated torque


def _quintic(u: Array) -> tuple[Array, Array, Array]:
    """Travel 0..1 over time 0..1, with its first and second derivative."""
    way = u**3 * (10 + u * (6 * u - 15))
    return way, 30 * (u * (1 - u)) ** 2, 60 * u * (1 - u) * (1 - 2 * u)


def _trapezoid(u: Array, ramp: float = 0.25) -> tuple[Array, Array, Array]:
    """Travel at constant speed between ramps (``ramp``: their share of the time) with rounded corners."""
    top, turn = 1 / (1 - ramp), np.pi / ramp

    def risen(x: Array) -> Array:
        return top * (x - np.sin(turn * x) / turn) / 2

    edge = np.minimum(u, 1 - u)
    short = np.where(edge < ramp, risen(np.minimum(edge, ramp)), top * (edge - ramp / 2))
    speed = np.where(edge < ramp, top * (1 - np.cos(turn * edge)) / 2, top)
    rise = np.where(edge < ramp, top * turn * np.sin(turn * edge) / 2, 0.0)
    return np.where(u < 0.5, short, 1 - short), speed, np.where(u < 0.5, rise, -rise)


PROFILES = {"quintic": (_quintic, 1.875, 5.774), "trapezoid": (_trapezoid, 1 / 0.75, np.pi / 0.25 / 0.75 / 2)}


@dataclass(frozen=True)
class Arm:
    """Load of the joint: gravity [N m], its share that varies with position, inertia [kg m²]."""

    gravity: float
    share: float
    upright: float  # [rad], angle of full gravity torque
    inertia: float
    payload: float  # [N m], carried on every other move

    def torque(self, angle: Array, acceleration: Array, loaded: Array) -> Array:
        """Torque that the drive exerts on the link [N m]."""
        lever = 1 - self.share + self.share * np.cos(angle - self.upright)
        held = self.gravity + self.payload * loaded
        return held * lever + self.inertia * (1 + 0.2 * loaded) * acceleration


@dataclass(frozen=True)
class Moves:
    """Moves between poses: begin [s], duration [s], poses (m + 1,) of the output [rad]."""

    begin: tuple[float, ...]
    length: tuple[float, ...]
    poses: tuple[float, ...]
    profile: str
    arm: Arm
    duration: float
    design: Design = SIZE_25

    def times(self, rate: float = RATE) -> Array:
        """Evenly spaced moments [s]."""
        return np.arange(round(self.duration * rate)) / rate

    def run_of(self, t: Array) -> NDArray[np.intp]:
        """Index of the move at each moment; a rest belongs to the move before it."""
        return np.clip(np.searchsorted(self.begin, t, side="right") - 1, 0, len(self.begin) - 1)

    def _course(self, t: Array) -> tuple[Array, Array, Array]:
        """Output angle [rad], speed [rad/s] and acceleration [rad/s²]."""
        move = self.run_of(t)
        begin, length, poses = (np.array(v) for v in (self.begin, self.length, self.poses))
        way, length = np.diff(poses)[move], length[move]
        u = np.clip((t - begin[move]) / length, 0, 1)
        s, speed, acceleration = PROFILES[self.profile][0](u)
        return poses[move] + way * s, way * speed / length, way * acceleration / length**2

    def angle(self, t: Array) -> Array:
        """Angle of the motor [rad]."""
        return self.design.ratio * self._course(t)[0]

    def speed(self, t: Array) -> Array:
        """Speed of the motor [rad/s]."""
        return self.design.ratio * self._course(t)[1]

    def torque(self, t: Array) -> Array:
        """Torque that the drive exerts on the link [N m]; the payload changes during rests."""
        angle, _, acceleration = self._course(t)
        move = self.run_of(t)
        end = (np.array(self.begin) + np.array(self.length))[move]
        change = np.clip((t - end) / 0.15, 0, 1)
        loaded = np.where(move % 2, 1 - change, change)
        return self.arm.torque(angle, acceleration, loaded)


def _arm(rng: np.random.Generator, middle: float, strength: float) -> Arm:
    heavy = rng.random() < 0.75
    return Arm(
        gravity=strength * rng.choice([-1, 1]) * (rng.uniform(15, 60) if heavy else rng.uniform(0, 3)),
        share=float(rng.choice([1.0, 0.5])),
        upright=middle + rng.choice([rng.uniform(-0.5, 0.5), rng.uniform(-np.pi, np.pi)]),
        inertia=strength * float(np.exp(rng.uniform(np.log(0.3), np.log(4)))),
        payload=strength * float(rng.choice([0.0, rng.uniform(2, 15)])),
    )


def point_to_point(rng: np.random.Generator, duration: float = 120.0, design: Design = SIZE_25) -> Moves:
    """Moves among five poses in a range of 0.5 to 0.9 output turns, with rests of 0.2 to 0.8 s."""
    reach = np.pi * rng.uniform(0.5, 0.9)
    middle = rng.uniform(-0.5, 0.5)
    places = middle + np.array([-reach, reach, *rng.uniform(-reach, reach, 3)])
    profile = str(rng.choice(list(PROFILES)))
    _, peak, steepest = PROFILES[profile]
    usual = np.exp(rng.uniform(np.log(0.15), np.log(FASTEST)))
    now, at, begin, length, poses = 0.3, 0, [], [], [places[0]]
    while now < duration:
        # Begin with a move from end to end, so that every record covers the range.
        at = 1 if not begin else int(rng.choice([i for i in range(5) if i != at]))
        way = abs(places[at] - poses[-1])
        speed = max(usual * rng.uniform(0.4, 1.0), SLOWEST)
        takes = max(
            min(peak * way / speed, LONGEST), peak * way / FASTEST, np.sqrt(steepest * way / STEEPEST)
        )
        begin.append(now)
        length.append(max(takes, 0.3))
        poses.append(places[at])
        now += length[-1] + rng.uniform(0.2, 0.8)
    arm = _arm(rng, middle, design.strength)
    moves = Moves(tuple(begin), tuple(length), tuple(poses), profile, arm, duration, design)
    return _bearable(moves)


def _bearable(moves: Moves) -> Moves:
    """The same motion with an arm light enough for the drive."""
    most = float(np.abs(moves.torque(moves.times(50.0))).max())
    factor = min(1.0, HEAVIEST * moves.design.rated / most)
    a = moves.arm
    arm = Arm(a.gravity * factor, a.share, a.upright, a.inertia * factor, a.payload * factor)
    return dataclasses.replace(moves, arm=arm)


def there(rng: np.random.Generator, design: Design) -> Moves:
    """One to six moves in one direction over part of an output turn, 2 to 95 s, as after a homing error."""
    return _between(rng, design, [1.0] * int(rng.integers(1, 7)))


def there_and_back(rng: np.random.Generator, design: Design) -> Moves:
    """Two to eight moves there and back over the same part of an output turn, each at its own speed."""
    return _between(rng, design, [1.0, -1.0] * int(rng.integers(1, 5)))


def _between(rng: np.random.Generator, design: Design, ways: Sequence[float]) -> Moves:
    whole = 2 * np.pi * rng.uniform(0.15, 0.95)
    way = whole / max(np.ptp(np.r_[0.0, np.cumsum(ways)]), 1.0)
    start = rng.uniform(-np.pi, np.pi)
    poses = start + way * np.r_[0.0, np.cumsum(ways)]
    profile = str(rng.choice(list(PROFILES)))
    _, peak, steepest = PROFILES[profile]
    now, begin, length = 0.3, [], []
    for _ in ways:
        speed = np.exp(rng.uniform(np.log(SLOWEST), np.log(FASTEST)))
        begin.append(now)
        length.append(float(max(min(peak * way / speed, LONGEST), np.sqrt(steepest * way / STEEPEST))))
        now += length[-1] + rng.uniform(0.2, 0.8)
    arm = _arm(rng, start + 0.5 * whole, design.strength)
    return _bearable(Moves(tuple(begin), tuple(length), tuple(poses), profile, arm, now, design))
