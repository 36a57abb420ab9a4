"""Extended models that tests share: a refitted drive with stateful and other effects, and its file."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from live import config

from hd_diag.config.configuration import Config
from hd_diag.config.configured_drive import drive_from
from hd_diag.config.model_file import document, drive_parameters
from hd_diag.config.parameters import of_joint
from hd_diag.effects import CATALOGUE
from hd_diag.extended_model import ExtendedModel, Range, Ranges, Term

EFFECTS = {effect.name: effect for effect in CATALOGUE}
REFIT = {
    "circular_spline_datum": 29.88e-3,
    "eccentricity.magnitude": 9e-6,
    "eccentricity.direction": 0.7,
    "runout.magnitude": 2e-6,
    "tooth_compliance": 0.93e-6,
    "cup_compliance": 3e-6,
}
PITCH = (3e-7, 1e-6, 3e-7, 2e-7, 1e-7, 1e-7, 1e-7, 1e-7)  # [m], of one to eight periods around the gear
VALUES = {
    name: dict(zip((quantity.name for quantity in EFFECTS[name].quantities), values, strict=True))
    for name, values in {
        "hysteresis": (5e-5, 3e-5, 2.0, 1.5, 9.0, 1.5),
        "stream_delay": (3e-4,),
        "resonance": (4e-5, 1.0, 0.5, 2.0, 60.0, 0.04),
        "circular_spline_pitch": [x for k, size in enumerate(PITCH, 1) for x in (size, 0.4 / k)],
        "viscous_windup": (1.2, 0.9),
        "thermal_drift": (5e-6, 20.0),
        "coulomb_windup": (1.0, 0.2, 0.0, 0.5, 4.0),
        "torque_offset": (1.5,),
    }.items()
}
STATEFUL = ("hysteresis", "stream_delay", "resonance", "coulomb_windup", "thermal_drift")
RANGES = Ranges(Range(-40.0, 45.0), Range(-90.0, 90.0), Range(20.0, 40.0))
OFFSET = 2e-4  # [rad]


def term(name: str, values: dict[str, float] | None = None) -> Term:
    effect = EFFECTS[name]
    coefficients, nonlinear = effect.from_physical(values or VALUES[name])
    return Term(effect, tuple(coefficients.tolist()), nonlinear)


def own(joint: str = "joint_1", given: Config | None = None) -> dict[str, Any]:
    """Parameters of a joint by their names without the joint."""
    return of_joint((given or config(joint)).flat, joint)


def model(*names: str, **refit: float) -> ExtendedModel:
    """A refitted drive with effects of the usual size."""
    drive = drive_from({**own(), **REFIT, **refit})
    return ExtendedModel(drive, tuple(map(term, names)), OFFSET, RANGES)


def content(*names: str) -> dict[str, Any]:
    made = model(*names)
    effects = [({}, (name,)) for name in names]
    evidence = {"bags": [], "samples": 1}
    return document("joint_1", own(), made, {"cup_compliance": 1e-7}, effects, evidence, "0")


def write_model(path: Path, *names: str) -> Path:
    path.write_text(json.dumps(content(*names)))
    return path


def base_names() -> list[str]:
    return list(drive_parameters(own()))


def motion(count: int, seed: int = 3) -> tuple[np.ndarray, ...]:
    """Time [s], input angle [rad], torque [N m], temperature [degC] of an uneven motion; each (n,)."""
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.5e-3, 4e-3, count))
    angle = 30.0 * np.sin(1.7 * time) + 0.02 * np.sin(40.0 * time)
    torque = 35.0 * np.sin(3.1 * time) + random.normal(0.0, 0.3, count)
    return time, angle, torque, 25.0 + time
