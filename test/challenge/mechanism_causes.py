"""Faults as mechanisms whose laws are other ones than a catalogue of simple shapes has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from challenge import mechanics
from challenge.cause import Cause, Scene
from challenge.contact import Flaws
from challenge.design import Array, Design


@dataclass(frozen=True)
class DryFriction(Cause):
    """Torque [N m] between mesh and torque sensor against the motion: elasto-plastic, Lorentzian when slow.

    Hess and Soom, J. Tribology 112(1), 1990: the share ``stribeck`` more falls as 1/(1 + (v/v_s)²); speed
    [rad/s] and presliding [rad] of the output.
    """

    torque: float
    stribeck: float
    stribeck_speed: float
    presliding: float
    name = "coulomb_windup"
    size = "torque"

    def load(self, scene: Scene) -> Array:
        slow = 1 + self.stribeck / (1 + (scene.speed / scene.design.ratio / self.stribeck_speed) ** 2)
        return self.torque * slow * mechanics.elasto_plastic(scene.output, self.presliding, stick=0.5)


@dataclass(frozen=True)
class Grease(Cause):
    """Viscous torque [N m] at 1 rad/s of the output, thinned by shear: Carreau's law, power p when fast.

    Carreau, Trans. Soc. Rheology 16(1), 1972: c v (1 + (v/v_0)²)^((p − 1)/2).
    """

    torque: float
    power: float
    speed: float
    name = "viscous_windup"
    size = "torque"

    def load(self, scene: Scene) -> Array:
        def law(v: Array | float) -> Array | float:
            return v * (1 + (v / self.speed) ** 2) ** ((self.power - 1) / 2)

        return np.asarray(self.torque * law(scene.speed / scene.design.ratio) / law(1.0))


@dataclass(frozen=True)
class SmoothHysteresis(Cause):
    """Friction beside the spring holds the torsion back: Bouc-Wen, or a dozen slip elements.

    Half the width of the loop [rad], the torque [N m] that spends it, Bouc-Wen's exponent (0: elements).
    """

    half_width: float
    reach: float
    sharpness: float = 0.0
    name = "hysteresis"
    size = "half_width"

    def added(self, scene: Scene) -> Array:
        if self.sharpness:
            return self.half_width * mechanics.bouc_wen(scene.torque, self.reach, self.sharpness)
        reaches = self.reach * np.geomspace(0.05, 1.0, 12)
        weights = reaches**0.3 / np.sum(reaches**0.3)
        return self.half_width * mechanics.slipping_elements(scene.torque, reaches, weights)


@dataclass(frozen=True)
class SmoothHardening(Cause):
    """Spring in series, compliance [rad/(N m)] at a torque [N m]: cubic (grows) or tanh (is spent)."""

    compliance: float
    torque: float
    cubic: bool
    name = "torsional_hardening"
    size = "compliance"

    def added(self, scene: Scene) -> Array:
        x = scene.torque / self.torque
        return -self.compliance * self.torque * (x**3 if self.cubic else np.tanh(x))


@dataclass(frozen=True)
class LaggingDrift(Cause):
    """The output turns [rad/K] with a place that follows the housing's temperature with a lag [s]."""

    slope: float
    lag: float
    name = "thermal_drift"
    size = "slope"

    def added(self, scene: Scene) -> Array:
        return self.slope * (mechanics.lagging(scene.temperature, scene.time, self.lag) - 25.0)


@dataclass(frozen=True)
class UnevenSlots(Cause):
    """Cumulative pitch error of the circular spline as a machine makes it: twice around, and all others.

    ``amplitude`` [m] of the second harmonic; the others up to 8 are ``rest`` of it, falling as 1/k.
    """

    amplitude: float
    rest: float
    seed: int
    name = "circular_spline_pitch"
    size = "amplitude"

    def flaws(self, design: Design) -> Flaws:
        rng, angle = np.random.default_rng(self.seed), np.arange(design.slots) * design.slot_pitch
        size = np.array([self.rest * 2 / k if k != 2 else 1.0 for k in range(1, 9)])
        phase = rng.uniform(-np.pi, np.pi, 8)
        waves = (a * np.cos(k * angle - p) for k, a, p in zip(range(1, 9), size, phase, strict=True))
        return Flaws(slot_along=self.amplitude * sum(waves, np.zeros(design.slots)))
