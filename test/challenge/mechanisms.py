"""Mechanisms by name: causes whose laws are other ones than a catalogue's, and how each is drawn."""

from __future__ import annotations

import numpy as np

from challenge import drive_causes as drive
from challenge import mechanism_causes as mechanism
from challenge import mesh_causes as mesh
from challenge import sensor_causes as sensor
from challenge.cause import Cause
from challenge.design import Design
from challenge.faults import FAULTS, UM, Draw, Fault
from challenge.motion import Motion
from challenge.truth import ARCSEC
from challenge.unknown_causes import OutputLines


def _phase(rng: Draw) -> float:
    return float(rng.uniform(-np.pi, np.pi))


def _sign(rng: Draw) -> float:
    return float(rng.choice([-1, 1]))


def _friction(rng: Draw, a: float, _: Motion) -> Cause:
    slow = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
    return mechanism.DryFriction(a, rng.uniform(0, 0.6), slow, rng.uniform(0.3e-3, 1e-3))


def _grease(rng: Draw, a: float, _: Motion) -> Cause:
    return mechanism.Grease(a, rng.uniform(0.7, 1.0), rng.uniform(0.05, 0.3))


def _hysteresis(rng: Draw, a: float, m: Motion) -> Cause:
    return mechanism.SmoothHysteresis(
        a * ARCSEC, m.design.strength * rng.uniform(3, 20), float(rng.choice([0, 1, 2]))
    )


def _hardening(rng: Draw, a: float, m: Motion) -> Cause:
    cubic = bool(rng.integers(2))
    torque = m.design.strength * (40.0 if cubic else rng.uniform(10, 40))
    return mechanism.SmoothHardening(_sign(rng) * a * ARCSEC, torque, cubic)


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


def _damage(rng: Draw, a: float, _: Motion) -> Cause:
    member, count = [("circular_spline", 202), ("flexspline", 200)][rng.integers(2)]
    return mesh.ToothDamage(a * UM, int(rng.integers(count)), member, rng.uniform(0, 2))


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
        lambda r, a, m: mechanism.UnevenSlots(a * UM, r.uniform(0.1, 0.5), int(r.integers(1 << 31))),
        *(0.5, 4, "um"),
    ),
    "flexspline_pitch": FAULTS["flexspline_pitch"],
    "tooth_damage": Fault(_damage, 5, 30, "um"),
    "torsional_hardening": Fault(_hardening, 0.2, 1.0, "arcsec/(N m)"),
    "hysteresis": Fault(_hysteresis, 5, 60, "arcsec"),
    "coulomb_windup": Fault(_friction, 0.5, 4, "N m"),
    "viscous_windup": Fault(_grease, 0.5, 4, "N m at 1 rad/s"),
    "input_encoder_eccentricity": Fault(_input_disc, 0.6, 30, "arcsec"),
    "encoder_interpolation": FAULTS["encoder_interpolation"],
    "stream_delay": FAULTS["stream_delay"],
    "thermal_drift": Fault(
        lambda r, a, m: mechanism.LaggingDrift(_sign(r) * a * ARCSEC, r.uniform(60, 240)), 0.5, 5, "arcsec/K"
    ),
    "torque_offset": FAULTS["torque_offset"],
    "output_encoder_interpolation": Fault(_output_lines, 1, 8, "arcsec"),
    "torque_sensor_ripple": Fault(_ripple, 1, 5, "%"),
}
# Parameters of the drive do the same: they need no name, but may have one.
OPTIONAL: dict[str, Fault] = {
    "wear_backlash": FAULTS["wear_backlash"],
    "torque_gain": Fault(lambda r, a, m: sensor.TorqueGain((1 + a / 100) ** _sign(r)), 5, 20, "%"),
}
NEED_NO_NAME = (*OPTIONAL, "motor_current")
UNNAMED: dict[str, Fault] = {"output_lines": Fault(_lines, 1, 6, "arcsec")}


def motor_current(rng: Draw, constant: float, design: Design) -> Cause:
    """Amperes that stand for torque, their constant [N m/A] known to 20 %."""
    return sensor.MotorCurrent(
        constant=constant * rng.uniform(0.8, 1.25),
        friction=design.rated * rng.uniform(0.03, 0.1),
        loaded=rng.uniform(0.03, 0.12),
        viscous=design.rated * rng.uniform(0.03, 0.12),
        inertia=design.strength * rng.uniform(0.5, 2.0),
    )
