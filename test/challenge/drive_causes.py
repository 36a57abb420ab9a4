"""Faults of shafts, bearings, springs and friction, as mechanics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from challenge import mechanics
from challenge.cause import Cause, Scene
from challenge.design import Array
from challenge.truth import ARCSEC

COMPLIANCE = 4 * ARCSEC  # [rad/(N m)], mean of teeth and cup


@dataclass(frozen=True)
class CouplingMisalignment(Cause, name="coupling_misalignment"):
    """Universal joint between motor and wave generator: bend [rad] and play on reversal [rad]."""

    bend: float
    direction: float
    play: float = 0.0

    def shaft(self, angle: Array) -> Array:
        driven = mechanics.universal_joint(angle, self.bend, self.direction)
        return mechanics.play(driven, self.play) if self.play else driven


@dataclass(frozen=True)
class BearingPassage(Cause, name="bearing_passage"):
    """Thick ball (``part`` "cage") or dent in a race ("outer", "inner") of a bearing that slips.

    ``amplitude`` [rad] at the output. Per turn of the wave generator the cage makes ``cage`` turns; it also
    creeps by a random walk of ``slip`` [rad] over the record.
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
        # Passages per turn of the wave generator, and per turn of cage creep.
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
    """Slip elements parallel to a spring: half width of the loop [rad], torques [N m] at which they slip.

    ``sense`` = 1: the elements oppose the torsion, as friction does. −1: the torque sensor lags, so that the
    torsion seems to lead. The spring alone belongs to the drive; the difference from it is added.
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
    """Dry friction of a seal winds up the output [rad], more at low speed (Stribeck share, speed [rad/s]).

    It acts as the torque that causes this windup at the drive's mean compliance.
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
    """Link inertia behind a spring, excited by the gear's ripple and by a wave of its own [rad]."""

    frequency: float
    damping: float
    amplitude: float
    order: int
    phase: float

    def carried(self, scene: Scene, ripple: Array) -> Array:
        driven = ripple + self.amplitude * np.cos(self.order * scene.motor - self.phase)
        step = float(np.median(np.diff(scene.time)))
        return mechanics.beyond_spring(driven, step, self.frequency, self.damping) - ripple


# The same mechanisms by other laws than the simple shapes of a catalogue ---


@dataclass(frozen=True)
class DryFriction(Cause, name="coulomb_windup"):
    """Torque [N m] between mesh and torque sensor against the motion: elasto-plastic friction.

    Hess and Soom, J. Tribology 112(1), 1990: at low speed friction is larger by the share ``stribeck``, which
    falls as 1/(1 + (v/v_s)²). Speed [rad/s] and presliding [rad] are those of the output.
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
    """Viscous torque [N m] at 1 rad/s of the output with shear thinning: Carreau's law, fast limit v^p.

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
    """Friction parallel to the spring opposes the torsion: Bouc-Wen, or a dozen slip elements.

    Half width of the loop [rad], torque [N m] over which it builds up, Bouc-Wen's exponent (0: elements).
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
    """Spring in series with torsion c T_0 (T/T_0)³ (cubic) or c T_0 tanh(T/T_0); c [rad/(N m)], T_0 [N m]."""

    compliance: float
    torque: float
    cubic: bool

    def added(self, scene: Scene) -> Array:
        x = scene.torque / self.torque
        return -self.compliance * self.torque * (x**3 if self.cubic else np.tanh(x))


@dataclass(frozen=True)
class LaggingDrift(Cause, name="thermal_drift"):
    """The output turns [rad/K] with a place whose temperature follows the housing's with a lag [s]."""

    slope: float
    lag: float

    def added(self, scene: Scene) -> Array:
        return self.slope * (mechanics.lagging(scene.temperature, scene.time, self.lag) - 25.0)
