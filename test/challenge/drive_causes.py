"""Faults of shafts, bearings, springs and friction, as mechanics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from challenge import mechanics
from challenge.cause import Cause, Scene
from challenge.design import Array
from challenge.truth import ARCSEC

COMPLIANCE = 4 * ARCSEC  # [rad/(N m)], mean compliance of teeth and cup


@dataclass(frozen=True)
class CouplingMisalignment(Cause, name="coupling_misalignment"):
    """Universal joint between motor and wave generator, bent [rad], with play on reversal [rad]."""

    bend: float
    direction: float
    play: float = 0.0

    def shaft(self, angle: Array) -> Array:
        driven = mechanics.universal_joint(angle, self.bend, self.direction)
        return mechanics.play(driven, self.play) if self.play else driven


@dataclass(frozen=True)
class BearingPassage(Cause, name="bearing_passage"):
    """A thick ball (``part`` "cage") or a dented race ("outer", "inner") of a bearing that slips.

    ``amplitude`` [rad] applies at the output. The cage turns ``cage`` times per turn of the wave generator.
    Its creep is a random walk of ``slip`` [rad] over the record.
    """

    amplitude: float
    phase: float
    cage: float
    part: str = "cage"
    balls: int = 23
    slip: float = 0.1
    seed: int = 0

    def added(self, scene: Scene) -> Array:
        way = np.r_[0, np.cumsum(np.abs(np.diff(scene.motor)))]
        knots = np.linspace(0, max(way[-1], 1e-9), 40)
        steps = np.random.default_rng(self.seed).standard_normal(40)
        creep = np.interp(way, knots, self.slip / np.sqrt(40) * np.cumsum(steps))
        # Passages per turn of the wave generator, and per turn of the cage's creep.
        order, times = {
            "cage": (self.cage, 1),
            "outer": (self.balls * self.cage, self.balls),
            "inner": (self.balls * (1 - self.cage), -self.balls),
        }[self.part]
        return self.amplitude * np.cos(order * scene.motor + times * creep - self.phase)


@dataclass(frozen=True)
class TorsionalHardening(Cause, name="torsional_hardening", sizes=("first", "second")):
    """Spring in series whose compliance [rad/(N m)] changes at two knees [N m]."""

    first: float
    second: float = 0.0
    knee_1: float = 14.0
    knee_2: float = 48.0

    def added(self, scene: Scene) -> Array:
        return -mechanics.spring(scene.torque, (self.knee_1, self.knee_2), (self.first, self.second))


@dataclass(frozen=True)
class Hysteresis(Cause, name="hysteresis"):
    """Slip elements in parallel with a spring: half the loop's width [rad], torques at which they slip [N m].

    With ``sense`` = 1 the elements hold the torsion back, as friction must. With −1 the torque sensor lags by
    them, so that the torsion seems to lead. The drive has the spring alone; the difference is added.
    """

    half_width: float
    torques: tuple[float, ...] = (8.0,)
    sense: float = 1.0

    def added(self, scene: Scene) -> Array:
        out = np.zeros_like(scene.torque)
        for torque in self.torques:
            slip = 0.5 * torque
            stiffness = slip * len(self.torques) / self.half_width
            element = (stiffness * slip / (torque - slip), slip)
            out += scene.torque / stiffness - mechanics.slip_spring(scene.torque, stiffness, (element,))
        return self.sense * out


@dataclass(frozen=True)
class CoulombWindup(Cause, name="coulomb_windup"):
    """A seal's dry friction winds up the output [rad], more at low speed (Stribeck share, speed [rad/s]).

    The friction torque is `amplitude` over the drive's mean compliance.
    """

    amplitude: float
    stribeck: float = 0.0
    stribeck_speed: float = 10.0

    def load(self, scene: Scene) -> Array:
        bristle = mechanics.rubbing(scene.motor, scene.time, presliding=2e-3, relaxation=0.02)
        slow = 1 + self.stribeck * np.exp(-((scene.speed / self.stribeck_speed) ** 2))
        return self.amplitude / COMPLIANCE * slow * bristle


@dataclass(frozen=True)
class ViscousWindup(Cause, name="viscous_windup"):
    """Grease winds up the output in proportion to the input's speed [rad per rad/s]."""

    slope: float

    def load(self, scene: Scene) -> Array:
        return self.slope / COMPLIANCE * scene.speed


@dataclass(frozen=True)
class ThermalDrift(Cause, name="thermal_drift"):
    """The output turns with the housing's temperature above 25 °C [rad/K]."""

    slope: float

    def added(self, scene: Scene) -> Array:
        return self.slope * (scene.temperature - 25.0)


@dataclass(frozen=True)
class Resonance(Cause, name="resonance", sizes=("amplitude",)):
    """The link's inertia on a spring, driven by the gear's ripple and an additional ripple [rad]."""

    frequency: float
    damping: float
    amplitude: float
    order: int
    phase: float

    def carried(self, scene: Scene, ripple: Array) -> Array:
        driven = ripple + self.amplitude * np.cos(self.order * scene.motor - self.phase)
        step = float(np.median(np.diff(scene.time)))
        return mechanics.beyond_spring(driven, step, self.frequency, self.damping) - ripple


# The same mechanisms by laws that a catalogue of simple shapes lacks ---


@dataclass(frozen=True)
class DryFriction(Cause, name="coulomb_windup"):
    """Elasto-plastic friction torque [N m] between mesh and torque sensor; a Lorentzian rise at low speed.

    Hess and Soom, J. Tribology 112(1), 1990: the additional share ``stribeck`` falls as 1/(1 + (v/v_s)²).
    Speed [rad/s] and presliding [rad] refer to the output.
    """

    torque: float
    stribeck: float
    stribeck_speed: float
    presliding: float

    def load(self, scene: Scene) -> Array:
        slow = 1 + self.stribeck / (1 + (scene.speed / scene.design.ratio / self.stribeck_speed) ** 2)
        return self.torque * slow * mechanics.elasto_plastic(scene.output, self.presliding, stick=0.5)


@dataclass(frozen=True)
class Grease(Cause, name="viscous_windup"):
    """Viscous torque [N m] at 1 rad/s of the output, thinned by shear: Carreau's law, power p at high speed.

    Carreau, Trans. Soc. Rheology 16(1), 1972: c v (1 + (v/v_0)²)^((p − 1)/2).
    """

    torque: float
    power: float
    speed: float

    def load(self, scene: Scene) -> Array:
        def law(v: Array | float) -> Array | float:
            return v * (1 + (v / self.speed) ** 2) ** ((self.power - 1) / 2)

        return self.torque * law(scene.speed / scene.design.ratio) / law(1.0)


@dataclass(frozen=True)
class SmoothHysteresis(Cause, name="hysteresis"):
    """Friction in parallel with the spring holds the torsion back: Bouc-Wen, or a dozen slip elements.

    Fields: half the loop's width [rad], torque for the full loop [N m], Bouc-Wen's exponent (0: elements).
    """

    half_width: float
    reach: float
    sharpness: float = 0.0

    def added(self, scene: Scene) -> Array:
        if self.sharpness:
            return self.half_width * mechanics.bouc_wen(scene.torque, self.reach, self.sharpness)
        reaches = self.reach * np.geomspace(0.05, 1.0, 12)
        weights = reaches**0.3 / np.sum(reaches**0.3)
        return self.half_width * mechanics.slipping_elements(scene.torque, reaches, weights)


@dataclass(frozen=True)
class SmoothHardening(Cause, name="torsional_hardening"):
    """Spring in series, with a compliance [rad/(N m)] and a torque scale [N m]: cubic or tanh (saturates)."""

    compliance: float
    torque: float
    cubic: bool

    def added(self, scene: Scene) -> Array:
        x = scene.torque / self.torque
        return -self.compliance * self.torque * (x**3 if self.cubic else np.tanh(x))


@dataclass(frozen=True)
class LaggingDrift(Cause, name="thermal_drift"):
    """The output turns [rad/K] with a part whose temperature lags behind the housing's [s]."""

    slope: float
    lag: float

    def added(self, scene: Scene) -> Array:
        return self.slope * (mechanics.lagging(scene.temperature, scene.time, self.lag) - 25.0)
