"""Faults of shafts, bearings, springs and friction, as mechanics."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from challenge import mechanics
from challenge.cause import Cause, Scene
from challenge.design import Array
from challenge.truth import ARCSEC

COMPLIANCE = 4 * ARCSEC  # [rad/(N m)], mean of teeth and cup


@dataclass(frozen=True)
class CouplingMisalignment(Cause):
    """Universal joint between motor and wave generator, bent [rad], with play on reversal [rad]."""

    bend: float
    direction: float
    play: float = 0.0
    name = "coupling_misalignment"
    size = "bend"

    def shaft(self, angle: Array) -> Array:
        driven = mechanics.universal_joint(angle, self.bend, self.direction)
        return mechanics.play(driven, self.play) if self.play else driven


@dataclass(frozen=True)
class BearingPassage(Cause):
    """One thick ball (``part`` "cage"), or a dent in a race ("outer", "inner"), of a bearing that slips.

    ``amplitude`` [rad] at the output; the cage turns ``cage`` times a turn of the wave generator, and creeps
    by a random walk of ``slip`` [rad] over the record.
    """

    amplitude: float
    phase: float
    cage: float
    part: str = "cage"
    balls: int = 23
    slip: float = 0.1
    seed: int = 0
    name = "bearing_passage"
    size = "amplitude"

    @property
    def order(self) -> float:
        """Passages per turn of the wave generator."""
        return {"cage": self.cage, "outer": self.balls * self.cage, "inner": self.balls * (1 - self.cage)}[
            self.part
        ]

    def added(self, scene: Scene) -> Array:
        way = np.r_[0, np.cumsum(np.abs(np.diff(scene.motor)))]
        knots = np.linspace(0, max(way[-1], 1e-9), 40)
        steps = np.random.default_rng(self.seed).standard_normal(40)
        creep = np.interp(way, knots, self.slip / np.sqrt(40) * np.cumsum(steps))
        times = {"cage": 1, "outer": self.balls, "inner": -self.balls}[self.part]
        angle = self.order * scene.motor + times * creep
        return self.amplitude * np.cos(angle - self.phase)


@dataclass(frozen=True)
class TorsionalHardening(Cause):
    """Spring in series whose compliance [rad/(N m)] changes at two knees [N m]."""

    first: float
    second: float = 0.0
    knee_1: float = 14.0
    knee_2: float = 48.0
    name = "torsional_hardening"
    size = "first"

    def added(self, scene: Scene) -> Array:
        return -mechanics.spring(scene.torque, (self.knee_1, self.knee_2), (self.first, self.second))

    def scaled(self, factor: float) -> Cause:
        return dataclasses.replace(self, first=self.first * factor, second=self.second * factor)


@dataclass(frozen=True)
class Hysteresis(Cause):
    """Slip elements beside a spring: half the width of the loop [rad], the torques [N m] that spend them.

    ``sense`` = 1: the elements hold the torsion back, as friction must; −1: the torque sensor lags by them,
    so that the torsion seems to run ahead. The spring alone belongs to the drive, the difference is added.
    """

    half_width: float
    torques: tuple[float, ...] = (8.0,)
    sense: float = 1.0
    name = "hysteresis"
    size = "half_width"

    def added(self, scene: Scene) -> Array:
        out = np.zeros_like(scene.torque)
        for torque in self.torques:
            slip = 0.5 * torque
            stiffness = slip * len(self.torques) / self.half_width
            element = (stiffness * slip / (torque - slip), slip)
            out += scene.torque / stiffness - mechanics.slip_spring(scene.torque, stiffness, (element,))
        return self.sense * out


@dataclass(frozen=True)
class CoulombWindup(Cause):
    """A seal's dry friction winds up the output [rad], more so when slow (Stribeck share, speed [rad/s]).

    It acts as the torque that does so at the drive's mean compliance.
    """

    amplitude: float
    stribeck: float = 0.0
    stribeck_speed: float = 10.0
    name = "coulomb_windup"
    size = "amplitude"

    def load(self, scene: Scene) -> Array:
        bristle = mechanics.rubbing(scene.motor, scene.time, presliding=2e-3, relaxation=0.02)
        slow = 1 + self.stribeck * np.exp(-((scene.speed / self.stribeck_speed) ** 2))
        return self.amplitude / COMPLIANCE * slow * bristle


@dataclass(frozen=True)
class ViscousWindup(Cause):
    """Grease winds up the output, in proportion to the input's speed [rad per rad/s]."""

    slope: float
    name = "viscous_windup"
    size = "slope"

    def load(self, scene: Scene) -> Array:
        return self.slope / COMPLIANCE * scene.speed


@dataclass(frozen=True)
class ThermalDrift(Cause):
    """The output turns with the housing's temperature [rad/K] above 25 °C."""

    slope: float
    name = "thermal_drift"
    size = "slope"

    def added(self, scene: Scene) -> Array:
        return self.slope * (scene.temperature - 25.0)


@dataclass(frozen=True)
class Resonance(Cause):
    """The link's inertia behind a spring, driven by the gear's ripple and one of its own [rad]."""

    frequency: float
    damping: float
    amplitude: float
    order: int
    phase: float
    name = "resonance"
    size = "amplitude"

    def carried(self, scene: Scene, ripple: Array) -> Array:
        driven = ripple + self.amplitude * np.cos(self.order * scene.motor - self.phase)
        step = float(np.median(np.diff(scene.time)))
        return mechanics.beyond_spring(driven, step, self.frequency, self.damping) - ripple
