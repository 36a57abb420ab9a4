"""Faults by name, and how each is drawn from its amplitude range in the field."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from challenge import drive_causes as drive
from challenge import mesh_causes as mesh
from challenge import page
from challenge import sensor_causes as sensor
from challenge.cause import Cause
from challenge.design import Design
from challenge.motion import Motion
from challenge.truth import ARCSEC
from challenge.unknown_causes import OutputLines, Unknown

Build = Callable[[np.random.Generator, float, Motion], Cause]
Draw = np.random.Generator

UM = 1e-6  # [m]
FULL_SPEED = 120.0  # [rad/s], of the input
TIMES_LEAST = 3.0


@dataclass(frozen=True)
class Fault:
    """How a cause is drawn: builder, amplitude range in the field with unit, and least findable amplitude."""

    build: Build
    low: float
    high: float
    unit: str
    least: float = 0.0  # from bench/findable.py, on a standard record


def _phase(rng: Draw) -> float:
    return float(rng.uniform(-np.pi, np.pi))


def _sign(rng: Draw) -> float:
    return float(rng.choice([-1, 1]))


def _bearing(rng: Draw, a: float, _: Motion) -> Cause:
    part = str(rng.choice(["cage", "outer", "inner"]))
    cage = rng.uniform(0.41, 0.47)
    return drive.BearingPassage(a * ARCSEC, _phase(rng), cage, part, seed=int(rng.integers(1 << 31)))


def _coupling(rng: Draw, a: float, m: Motion) -> Cause:
    bend = np.sqrt(4 * m.design.ratio * a * ARCSEC)
    return drive.CouplingMisalignment(
        bend, _phase(rng), 2 * m.design.ratio * rng.uniform(0, 0.3) * a * ARCSEC
    )


def _damage(rng: Draw, a: float, _: Motion) -> Cause:
    member, count = [("circular_spline", 202), ("flexspline", 200)][rng.integers(2)]
    return mesh.ToothDamage(a * UM, int(rng.integers(count)), member)


def _hardening(rng: Draw, a: float, _: Motion) -> Cause:
    sign = rng.choice([-1, 1])
    return drive.TorsionalHardening(sign * a * ARCSEC, sign * rng.uniform(0, 0.5) * a * ARCSEC)


def _form(rng: Draw, a: float, _: Motion) -> Cause:
    return mesh.CircularSplineForm(a * UM, _phase(rng), int(rng.choice([4, 6])), float(rng.integers(2)))


def _hysteresis(rng: Draw, a: float, _: Motion) -> Cause:
    torques = tuple(sorted(rng.uniform(2, 20, rng.integers(1, 4)).tolist()))
    return drive.Hysteresis(a * ARCSEC, torques, float(rng.choice([-1, 1])))


def _skip(rng: Draw, _a: float, motion: Motion) -> Cause:
    time = motion.times()
    torque = motion.torque(time)
    worst = int(np.argmax(np.abs(torque)))
    return mesh.ToothSkip(float(time[worst]), -float(np.sign(torque[worst])))


def _resonance(rng: Draw, a: float, _: Motion) -> Cause:
    order = int(rng.choice([1, 2]))
    return drive.Resonance(
        order * rng.uniform(5, 16), rng.uniform(0.04, 0.12), a * ARCSEC, order, _phase(rng)
    )


def _interpolation(rng: Draw, a: float, m: Motion) -> Cause:
    lines = int(rng.choice([8, 12, 16, 20, 24, 32]))
    return sensor.EncoderInterpolation(lines * m.design.ratio * a * ARCSEC, _phase(rng), lines)


def _order(rng: Draw) -> int:
    return int(rng.choice([2, 2, 2, 4]))


def _unknown(name: str) -> Build:
    return lambda rng, a, motion: Unknown(name, a * ARCSEC, _phase(rng))


def _sector(rng: Draw, a: float, motion: Motion) -> Cause:
    time = motion.times()
    place = motion.angle(rng.choice(time, 1))[0] / motion.design.ratio  # a place that the output reaches
    return Unknown("encoder_sector", a * ARCSEC, float(place))


# Ramps, steps and resonances (excited by the gear's ripple) have no least size: their range is enough.
FAULTS: dict[str, Fault] = {
    "output_runout": Fault(lambda r, a, m: sensor.OutputRunout(a * ARCSEC, _phase(r)), 2, 40, "arcsec", 0.98),
    "output_encoder_eccentricity": Fault(
        lambda r, a, m: sensor.OutputEncoderEccentricity(a * ARCSEC, _phase(r)), 2, 60, "arcsec", 0.95
    ),
    "circular_spline_form": Fault(_form, 1, 8, "um", 0.5),
    "coupling_misalignment": Fault(_coupling, 0.5, 2, "arcsec", 0.36),
    "bearing_passage": Fault(_bearing, 0.3, 4, "arcsec", 0.35),
    "circular_spline_pitch": Fault(
        lambda r, a, m: mesh.CircularSplinePitch(a * UM, _phase(r), _order(r)), 0.3, 4, "um", 0.11
    ),
    "flexspline_pitch": Fault(
        lambda r, a, m: mesh.FlexsplinePitch(a * UM, _phase(r), _order(r)), 0.3, 4, "um", 0.11
    ),
    "tooth_damage": Fault(_damage, 5, 30, "um", 5),
    "wear_backlash": Fault(lambda r, a, m: mesh.WearBacklash(a * UM), 0.5, 4, "um", 0.78),
    "torsional_hardening": Fault(_hardening, 0.1, 0.8, "arcsec/(N m)", 0.19),
    "hysteresis": Fault(_hysteresis, 5, 60, "arcsec", 0.9),
    "coulomb_windup": Fault(
        lambda r, a, m: drive.CoulombWindup(a * ARCSEC, r.choice([0, 0.4])), 1, 15, "arcsec", 0.65
    ),
    "viscous_windup": Fault(
        lambda r, a, m: drive.ViscousWindup(a * ARCSEC / FULL_SPEED), 1, 15, "arcsec at 120 rad/s", 1.3
    ),
    "input_encoder_eccentricity": Fault(
        lambda r, a, m: sensor.InputEncoderEccentricity(m.design.ratio * a * ARCSEC, _phase(r)),
        0.4,
        30,
        "arcsec",
        0.38,
    ),
    "encoder_interpolation": Fault(_interpolation, 0.3, 5, "arcsec", 0.35),
    "stream_delay": Fault(lambda r, a, m: sensor.StreamDelay(a * 1e-6), 5, 10_000, "us", 5.3),
    "thermal_drift": Fault(
        lambda r, a, m: drive.ThermalDrift(_sign(r) * a * ARCSEC), 0.1, 3, "arcsec/K", 0.33
    ),
    "ratio_error": Fault(lambda r, a, m: sensor.RatioError(_sign(r) * a), 1e-4, 0.05, "-"),
    "tooth_skip": Fault(_skip, 1, 1, "teeth"),
    "resonance": Fault(_resonance, 0.5, 4, "arcsec"),
    "torque_offset": Fault(lambda r, a, m: sensor.TorqueOffset(_sign(r) * a), 0.3, 3, "N m", 0.19),
}
UNKNOWN: dict[str, Fault] = {
    "strange_order": Fault(_unknown("strange_order"), 1, 4, "arcsec", 0.36),
    "one_sided_ripple": Fault(_unknown("one_sided_ripple"), 1, 4, "arcsec", 0.37),
    "cogging": Fault(_unknown("cogging"), 1, 4, "arcsec", 0.34),
    "belt_creep": Fault(_unknown("belt_creep"), 8, 30, "arcsec per 1000 rad at 50 N m", 2.6),
    "encoder_sector": Fault(_sector, 16, 50, "arcsec", 5.2),
    "unbalance": Fault(_unknown("unbalance"), 1.5, 5, "arcsec at 60 rad/s", 0.2),
    "floor_vibration": Fault(_unknown("floor_vibration"), 1, 4, "arcsec", 0.35),
    "even_torque": Fault(_unknown("even_torque"), 3, 15, "arcsec at 50 N m", 1),
    "output_order": Fault(_unknown("output_order"), 4, 15, "arcsec", 1.3),
    "loose_hub": Fault(_unknown("loose_hub"), 3, 15, "arcsec", 0.82),
}

# wear_backlash is left out: a parameter of the drive has the same effect.
NAMED = tuple(name for name in FAULTS if name != "wear_backlash")
# Ramp (ratio_error) and step (tooth_skip) are found before any fit.
COMBINED = tuple(name for name in NAMED if name not in ("ratio_error", "tooth_skip"))


# The same mechanisms by other laws ---


def _friction(rng: Draw, a: float, _: Motion) -> Cause:
    slow = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
    return drive.DryFriction(a, rng.uniform(0, 0.6), slow, rng.uniform(0.3e-3, 1e-3))


def _grease(rng: Draw, a: float, _: Motion) -> Cause:
    return drive.Grease(a, rng.uniform(0.7, 1.0), rng.uniform(0.05, 0.3))


def _smooth_hysteresis(rng: Draw, a: float, m: Motion) -> Cause:
    return drive.SmoothHysteresis(
        a * ARCSEC, m.design.strength * rng.uniform(3, 20), float(rng.choice([0, 1, 2]))
    )


def _smooth_hardening(rng: Draw, a: float, m: Motion) -> Cause:
    cubic = bool(rng.integers(2))
    torque = m.design.strength * (40.0 if cubic else rng.uniform(10, 40))
    return drive.SmoothHardening(_sign(rng) * a * ARCSEC, torque, cubic)


def _cage(rng: Draw, a: float, _: Motion) -> Cause:
    part = str(rng.choice(["cage", "cage", "outer", "inner"]))
    slip = rng.uniform(0.5, 2.0) if part == "cage" else 0.1
    seed = int(rng.integers(1 << 31))
    return drive.BearingPassage(a * ARCSEC, _phase(rng), rng.uniform(0.41, 0.47), part, slip=slip, seed=seed)


def _input_disc(rng: Draw, a: float, m: Motion) -> Cause:
    offset = m.design.ratio * a * ARCSEC
    return sensor.InputEncoderEccentricity(offset, _phase(rng), rng.uniform(0.1, 0.4), _phase(rng))


def _output_disc(rng: Draw, a: float, _: Motion) -> Cause:
    return sensor.OutputEncoderEccentricity(a * ARCSEC, _phase(rng), rng.uniform(0.1, 0.4), _phase(rng))


def _output_lines(rng: Draw, a: float, _: Motion) -> Cause:
    lines = int(rng.choice([64, 72, 128, 180, 256]))
    offset = lines * a * ARCSEC
    return sensor.OutputEncoderInterpolation(offset, _phase(rng), lines, 2 * rng.uniform(0.2, 1) * offset)


def _ripple(rng: Draw, a: float, m: Motion) -> Cause:
    phases = tuple(_phase(rng) for _ in range(4))
    constant, once, fourfold = rng.uniform(0.02, 0.1), rng.uniform(0, 0.3), rng.uniform(0, 0.3)
    return sensor.TorqueSensorRipple(a / 100, m.design.strength * constant * a, phases, once, fourfold)  # type: ignore[arg-type]


def _soft_damage(rng: Draw, a: float, motion: Motion) -> Cause:
    return dataclasses.replace(_damage(rng, a, motion), softness=rng.uniform(0, 2))


def _lines(rng: Draw, a: float, _: Motion) -> Cause:
    orders = tuple(sorted(2 * int(n) + 1 for n in rng.choice(np.arange(8, 60), 3, replace=False)))
    return OutputLines(orders, a * ARCSEC, _phase(rng))


MECHANISMS: dict[str, Fault] = {
    "output_runout": FAULTS["output_runout"],
    "output_encoder_eccentricity": Fault(_output_disc, 4, 60, "arcsec"),
    "circular_spline_form": FAULTS["circular_spline_form"],
    "coupling_misalignment": FAULTS["coupling_misalignment"],
    "bearing_passage": Fault(_cage, 1, 5, "arcsec"),
    "circular_spline_pitch": Fault(
        lambda r, a, m: mesh.UnevenSlots(a * UM, r.uniform(0.1, 0.5), int(r.integers(1 << 31))),
        *(0.5, 4, "um"),
    ),
    "flexspline_pitch": FAULTS["flexspline_pitch"],
    "tooth_damage": Fault(_soft_damage, 5, 30, "um"),
    "torsional_hardening": Fault(_smooth_hardening, 0.2, 1.0, "arcsec/(N m)"),
    "hysteresis": Fault(_smooth_hysteresis, 5, 60, "arcsec"),
    "coulomb_windup": Fault(_friction, 0.5, 4, "N m"),
    "viscous_windup": Fault(_grease, 0.5, 4, "N m at 1 rad/s"),
    "input_encoder_eccentricity": Fault(_input_disc, 0.6, 30, "arcsec"),
    "encoder_interpolation": FAULTS["encoder_interpolation"],
    "stream_delay": FAULTS["stream_delay"],
    "thermal_drift": Fault(
        lambda r, a, m: drive.LaggingDrift(_sign(r) * a * ARCSEC, r.uniform(60, 240)), 0.5, 5, "arcsec/K"
    ),
    "torque_offset": FAULTS["torque_offset"],
    "output_encoder_interpolation": Fault(_output_lines, 1, 8, "arcsec"),
    "torque_sensor_ripple": Fault(_ripple, 1, 5, "%"),
}
# Parameters of the drive have the same effect: these may be named but need not be.
OPTIONAL: dict[str, Fault] = {
    "wear_backlash": FAULTS["wear_backlash"],
    "torque_gain": Fault(lambda r, a, m: sensor.TorqueGain((1 + a / 100) ** _sign(r)), 5, 20, "%"),
}
# The torsion's shape is reported, but not as a cause.
NEED_NO_NAME = (*OPTIONAL, "torsional_hardening", "motor_current")
UNNAMED: dict[str, Fault] = {"output_lines": Fault(_lines, 1, 6, "arcsec")}


def motor_current(rng: Draw, constant: float, design: Design) -> Cause:
    """Current reported as torque; its constant [N m/A] is known to 20 %."""
    return sensor.MotorCurrent(
        constant=constant * rng.uniform(0.8, 1.25),
        friction=design.rated * rng.uniform(0.03, 0.1),
        loaded=rng.uniform(0.03, 0.12),
        viscous=design.rated * rng.uniform(0.03, 0.12),
        inertia=design.strength * rng.uniform(0.5, 2.0),
    )


def draw(rng: Draw, name: str, motion: Motion) -> Cause:
    """Cause of a name, at least three times as large as the least findable on a standard record."""
    return sized(rng, FAULTS.get(name) or UNKNOWN[name], motion)[0]


def sized(rng: Draw, fault: Fault, motion: Motion) -> tuple[Cause, float]:
    """Cause of a kind, and the factor by which it can grow within the range of the field."""
    scale = motion.design.scale(fault.unit)
    low = scale * max(fault.low, TIMES_LEAST * fault.least)
    high = max(low * 1.0001, scale * fault.high)
    # Log-uniform: small faults are more frequent in the field than large ones.
    amplitude = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return fault.build(rng, amplitude, motion), high / amplitude


# Joints from a catalogue page, without teeth ---


def _wave(kind: type[page.Wave]) -> Build:
    def build(rng: Draw, a: float, m: Motion) -> Cause:
        law = str(rng.choice(["reciprocal", "exponential", "straight"]))
        order = int(rng.choice([1, 2, 2, 2, 4])) if kind is page.Wave else 2
        return kind(a * ARCSEC, order, _phase(rng), law, m.design.rated * rng.uniform(0.2, 0.8))

    return build


def _loop(kind: type[page.Loop]) -> Build:
    return lambda rng, a, m: kind(a * ARCSEC, m.design.rated * rng.uniform(0.05, 0.3))


def _page_loop(rng: Draw, a: float, m: Motion) -> Cause:
    if rng.random() < 0.5:
        return page.LargeLoop(a * ARCSEC, m.design.rated * rng.uniform(0.05, 0.3))
    return drive.SmoothHysteresis(a * ARCSEC, m.design.rated * rng.uniform(0.05, 0.3), 1.0)


PAGE_USUAL: dict[str, Fault] = {
    "usual_wave": Fault(_wave(page.Wave), 0.5, 2, "arcsec"),
    "usual_loop": Fault(_loop(page.Loop), 2, 5, "arcsec"),
    "usual_output_wave": Fault(
        lambda r, a, m: page.OutputWave(a * ARCSEC, int(r.integers(1, 4)), _phase(r)), 0.3, 3, "arcsec"
    ),
    "usual_drift": Fault(
        lambda r, a, m: page.SlowDrift(a * ARCSEC, int(r.integers(1 << 31))), 0.2, 2, "arcsec"
    ),
}
# Two to ten times the size in a new gear.
PAGE: dict[str, Fault] = {
    "hysteresis": Fault(_page_loop, 20, 40, "arcsec"),
    "input_wave": Fault(_wave(page.LargeWave), 15, 30, "arcsec"),
    "output_runout": Fault(lambda r, a, m: page.LargeOutputWave(a * ARCSEC, 1, _phase(r)), 25, 50, "arcsec"),
    "coulomb_windup": Fault(
        lambda r, a, m: drive.DryFriction(a * m.design.rated, r.uniform(0, 0.6), 0.03, 5e-4), 0.04, 0.08, "-"
    ),
    "input_encoder_eccentricity": Fault(_input_disc, 10, 30, "arcsec"),
    "stream_delay": Fault(lambda r, a, m: sensor.StreamDelay(a * 1e-3), 1, 2.5, "ms"),
}
