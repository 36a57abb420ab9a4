"""Faults as geometry or mechanics; names and units of the catalogue of causes, and what it does not know.

A cause says where it enters by the methods it overrides; :mod:`challenge.records` asks for them in the order
of cause and consequence. Sizes are SI. ``size`` names the field that scales the cause.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from reference import polyline
from scipy.stats import norm

from challenge import encoders, mechanics
from challenge.clearances import SLOT_PITCH, SLOTS, TEETH, TOOTH_PITCH, Array
from challenge.contact import Flaws
from challenge.truth import RATIO

RING_RADIUS = polyline.ring_radius()  # [m], of the undeformed neutral circle
PITCH_POINT = 0.6193e-3  # [m] above the neutral layer, t + hf of the paper's Table 1


@dataclass(frozen=True)
class Scene:
    """What really happens, arrays (n,): time [s], motor angle [rad], speed [rad/s], torque, temperature, run.

    ``output`` is the ideal output angle; ``shaft`` the angle that reaches the wave generator's hub [rad].
    """

    time: Array
    motor: Array
    speed: Array
    torque: Array
    temperature: Array
    run: Array

    @property
    def output(self) -> Array:
        """Output angle of an ideal gear [rad]."""
        return self.motor / RATIO


@dataclass(frozen=True)
class Cause:
    """A fault; what it does not override stays as it is."""

    name: ClassVar[str] = ""
    size: ClassVar[str] = ""
    known: ClassVar[bool] = True

    def flaws(self) -> Flaws | None:
        """Departures of teeth and slots."""
        return None

    def shaft(self, angle: Array) -> Array:
        """Angle of the wave generator's hub [rad] from the motor's."""
        return angle

    def added(self, scene: Scene) -> Array | float:
        """Angle of the output [rad] beside kinematics and mesh."""
        return 0.0

    def carried(self, scene: Scene, ripple: Array) -> Array | float:
        """Angle of the output [rad] that the gear's ripple excites beside itself."""
        return 0.0

    def input_reading(self, angle: Array) -> Array:
        """Reported input angle [rad]."""
        return angle

    def output_reading(self, angle: Array) -> Array:
        """Reported output angle [rad]."""
        return angle

    def torque_reading(self, torque: Array) -> Array:
        """Reported torque [N m]."""
        return torque

    @property
    def delay(self) -> float:
        """Age of the output's samples [s]."""
        return 0.0

    def scaled(self, factor: float) -> Cause:
        """The same fault, larger or smaller."""
        return dataclasses.replace(self, **{self.size: getattr(self, self.size) * factor})

    def as_dict(self) -> dict[str, float]:
        """Sizes by name [SI]."""
        return dataclasses.asdict(self)


# Geometry of the mesh ---


@dataclass(frozen=True)
class CircularSplinePitch(Cause):
    """Slots displaced along the circumference [m], ``order`` waves around (cumulative pitch error)."""

    amplitude: float
    phase: float
    order: int = 2
    name = "circular_spline_pitch"
    size = "amplitude"

    def flaws(self) -> Flaws:
        angle = np.arange(SLOTS) * SLOT_PITCH
        return Flaws(slot_along=self.amplitude * np.cos(self.order * angle - self.phase))


@dataclass(frozen=True)
class FlexsplinePitch(Cause):
    """Teeth displaced along the circumference [m], ``order`` waves around, measured at the pitch circle."""

    amplitude: float
    phase: float
    order: int = 2
    name = "flexspline_pitch"
    size = "amplitude"

    def flaws(self) -> Flaws:
        angle = np.arange(TEETH) * TOOTH_PITCH
        neutral = RING_RADIUS / (RING_RADIUS + PITCH_POINT) * self.amplitude
        return Flaws(tooth_along=neutral * np.cos(self.order * angle - self.phase))


@dataclass(frozen=True)
class CircularSplineForm(Cause):
    """Ring out of round, ``order`` lobes of a radial amplitude [m].

    ``bent`` = 1: squeezed in its seat, the circumference keeps its length and slots move along it, too;
    0: cut out of round, slots move only outwards and inwards.
    """

    amplitude: float
    phase: float
    order: int = 4
    bent: float = 1.0
    name = "circular_spline_form"
    size = "amplitude"

    def flaws(self) -> Flaws:
        wave = self.order * np.arange(SLOTS) * SLOT_PITCH - self.phase
        along = -self.bent * self.amplitude / self.order * np.sin(wave)
        return Flaws(slot_out=self.amplitude * np.cos(wave), slot_along=along)


@dataclass(frozen=True)
class ToothDamage(Cause):
    """One tooth (``member`` "flexspline") or slot ("circular_spline") worn by a depth [m] or softer."""

    depth: float
    index: int
    member: str = "circular_spline"
    softness: float = 0.0
    name = "tooth_damage"
    size = "depth"

    def flaws(self) -> Flaws:
        kind, count = ("slot", SLOTS) if self.member == "circular_spline" else ("tooth", TEETH)
        here = np.arange(count) == self.index
        return Flaws(
            **{f"{kind}_wear": np.tile(self.depth * here, (2, 1)), f"{kind}_softness": self.softness * here}
        )


@dataclass(frozen=True)
class WearBacklash(Cause):
    """All flanks of the flexspline thinned by a thickness [m]."""

    thickness: float
    name = "wear_backlash"
    size = "thickness"

    def flaws(self) -> Flaws:
        return Flaws(tooth_wear=np.full((2, TEETH), self.thickness))


@dataclass(frozen=True)
class ToothSkip(Cause):
    """The flexspline jumps by a whole tooth at a moment [s], the way the load pulls (sign)."""

    time: float
    sign: float
    name = "tooth_skip"
    size = "sign"

    def added(self, scene: Scene) -> Array:
        return self.sign * TOOTH_PITCH * (scene.time >= self.time)


# Drive train ---


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
    """A seal's dry friction winds up the output [rad], more so when slow (Stribeck share, speed [rad/s])."""

    amplitude: float
    stribeck: float = 0.0
    stribeck_speed: float = 10.0
    name = "coulomb_windup"
    size = "amplitude"

    def added(self, scene: Scene) -> Array:
        bristle = mechanics.rubbing(scene.motor, scene.time, presliding=2e-3, relaxation=0.02)
        slow = 1 + self.stribeck * np.exp(-((scene.speed / self.stribeck_speed) ** 2))
        return -self.amplitude * slow * bristle


@dataclass(frozen=True)
class ViscousWindup(Cause):
    """Grease winds up the output, in proportion to the input's speed [rad per rad/s]."""

    slope: float
    name = "viscous_windup"
    size = "slope"

    def added(self, scene: Scene) -> Array:
        return -self.slope * scene.speed


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


# Sensors ---


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


# In no catalogue ---


@dataclass(frozen=True)
class Unknown(Cause):
    """A fault that no catalogue has, of an amplitude [rad] at the output."""

    amplitude: float
    phase: float = 0.0
    size = "amplitude"
    known = False
    order: ClassVar[float | None] = None  # per turn of ``frame``, where it has one
    frame: ClassVar[str] = "input"


@dataclass(frozen=True)
class StrangeOrder(Unknown):
    """3.37 waves per turn of the input: a timing belt's wheel."""

    name = "strange_order"
    order = 3.37

    def added(self, scene: Scene) -> Array:
        return self.amplitude * np.cos(3.37 * scene.motor - self.phase)


@dataclass(frozen=True)
class OneSidedRipple(Unknown):
    """2.6 waves a turn, in proportion to the torque's size, three times as large one way as the other."""

    name = "one_sided_ripple"
    order = 2.6

    def added(self, scene: Scene) -> Array:
        share = np.abs(scene.torque) / 50 * np.where(scene.speed > 0, 1.5, 0.5)
        return self.amplitude * share * np.cos(2.6 * scene.motor - self.phase)


@dataclass(frozen=True)
class Cogging(Unknown):
    """23 waves per turn in proportion to the torque: a motor that cogs under load."""

    name = "cogging"
    order = 23.0

    def added(self, scene: Scene) -> Array:
        return self.amplitude * scene.torque / 40 * np.cos(23 * scene.motor - self.phase)


@dataclass(frozen=True)
class BeltCreep(Unknown):
    """A belt at the output creeps with torque times way; amplitude per 1000 rad of the input at 50 N m."""

    name = "belt_creep"
    frame = "time"

    def added(self, scene: Scene) -> Array:
        way = np.abs(np.diff(scene.motor, prepend=scene.motor[0]))
        return self.amplitude * np.cumsum(way * scene.torque) / 5e4


@dataclass(frozen=True)
class EncoderSector(Unknown):
    """A scratch on the output disc: the angle is wrong within some degrees of one place."""

    width: float = 0.06
    name = "encoder_sector"
    frame = "output"

    def added(self, scene: Scene) -> Array:
        away = np.angle(np.exp(1j * (scene.output - self.phase)))
        return self.amplitude * np.exp(-((away / self.width) ** 2))


@dataclass(frozen=True)
class OutputDeadBand(Unknown):
    """A loose output encoder coupling: within a dead band the reading stays, either way."""

    name = "output_dead_band"
    frame = "output"

    def output_reading(self, angle: Array) -> Array:
        return mechanics.play(angle, 2 * self.amplitude)


@dataclass(frozen=True)
class FloorVibration(Unknown):
    """7.3 Hz from the floor, whatever the drive does."""

    name = "floor_vibration"
    frame = "time"
    frequency: ClassVar[float] = 7.3

    def added(self, scene: Scene) -> Array:
        return self.amplitude * np.sin(2 * np.pi * 7.3 * scene.time - self.phase)


@dataclass(frozen=True)
class EvenTorque(Unknown):
    """The link bends alike under either torque: a square law."""

    name = "even_torque"
    frame = "torque"

    def added(self, scene: Scene) -> Array:
        return self.amplitude * (scene.torque / 50) ** 2


@dataclass(frozen=True)
class OutputOrder(Unknown):
    """Seven waves per turn of the output, only under positive torque: a clamped output bearing."""

    name = "output_order"
    frame = "output"
    order = 7.0

    def added(self, scene: Scene) -> Array:
        return self.amplitude * norm.cdf(scene.torque / 5) * np.cos(7 * scene.output - self.phase)


@dataclass(frozen=True)
class LooseHub(Unknown):
    """A hub that settles anew, by chance, whenever the drive rests."""

    name = "loose_hub"
    frame = "run"

    def added(self, scene: Scene) -> Array:
        place = np.random.default_rng(round(1e6 * abs(self.phase))).standard_normal(64)
        return self.amplitude * place[scene.run % 64]


CATALOGUE: tuple[type[Cause], ...] = (
    OutputRunout,
    OutputEncoderEccentricity,
    CircularSplineForm,
    CouplingMisalignment,
    BearingPassage,
    CircularSplinePitch,
    FlexsplinePitch,
    ToothDamage,
    WearBacklash,
    TorsionalHardening,
    Hysteresis,
    CoulombWindup,
    ViscousWindup,
    InputEncoderEccentricity,
    EncoderInterpolation,
    StreamDelay,
    ThermalDrift,
    RatioError,
    ToothSkip,
    Resonance,
    TorqueOffset,
)
UNKNOWN: tuple[type[Unknown], ...] = (
    StrangeOrder,
    OneSidedRipple,
    Cogging,
    BeltCreep,
    EncoderSector,
    OutputDeadBand,
    FloorVibration,
    EvenTorque,
    OutputOrder,
    LooseHub,
)
