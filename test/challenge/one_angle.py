"""Joints that report one angle and a torque of gravity, inertia, friction and noise; ripple hides in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from challenge.design import Array
from challenge.moves import point_to_point
from challenge.noise import counted, jittered

RATE = 500.0  # [Hz]
COUNT = 0.01  # resolution of a reported torque [N m]
RING = 12.0  # frequency of the arm's own vibration [Hz]


@dataclass(frozen=True)
class Line:
    """``size cos(order angle - phase)`` [N m] over the output; times the speed's sign if it reverses."""

    order: float
    size: float
    phase: float
    reverses: bool = False


@dataclass(frozen=True)
class OneAngle:
    """Reported signals, (n,) each: time [s], output angle [rad], its speed [rad/s], torque [N m]."""

    time: Array
    angle: Array
    speed: Array
    torque: Array


def friction(rng: np.random.Generator, speed: Array) -> Array:
    """Coulomb, Stribeck and viscous friction in a motor current [N m], smooth within 1 mrad/s of zero."""
    coulomb, stuck, viscous = rng.uniform(1, 4), rng.uniform(0, 1.5), rng.uniform(1, 6)
    settling = rng.uniform(0.01, 0.05)  # [rad/s]
    dry = (coulomb + stuck * np.exp(-((speed / settling) ** 2))) * np.tanh(speed / 1e-3)
    return dry + viscous * np.sign(speed) * np.abs(speed) ** rng.uniform(0.7, 1)


def noise(rng: np.random.Generator, n: int) -> Array:
    """White noise, slow noise (pole 0.97) and the arm's vibration excited by noise [N m]."""
    slow = lfilter([np.sqrt(1 - 0.97**2)], [1, -0.97], rng.standard_normal(n))
    turn, damping = 2 * np.pi * RING / RATE, 0.97
    ring = lfilter([1], [1, -2 * damping * np.cos(turn), damping**2], rng.standard_normal(n))
    return 0.15 * rng.standard_normal(n) + 0.25 * slow + 0.1 * ring / ring.std()


def record(seed: int, lines: Sequence[Line] = (), duration: float = 60.0, stream: int = 0) -> OneAngle:
    """A record of a joint; the streams of one seed are recordings of the same joint with other motion."""
    joint, rng = np.random.default_rng(seed), np.random.default_rng((seed, stream))
    moves = point_to_point(rng, duration)
    even = moves.times(RATE)
    time = jittered(rng, even)
    ratio = moves.design.ratio
    angle, speed = moves.angle(time) / ratio, moves.speed(time) / ratio
    torque = moves.torque(time) + friction(joint, speed) + noise(rng, time.size)
    for line in lines:
        sign = np.tanh(speed / 1e-3) if line.reverses else 1.0
        torque += sign * line.size * np.cos(line.order * angle - line.phase)
    drives = np.asarray(counted(angle, 19), dtype=np.float64)
    told = speed + 1e-3 * rng.standard_normal(time.size)
    return OneAngle(even, drives, told, COUNT * np.rint(torque / COUNT))
