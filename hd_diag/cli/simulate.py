"""``hd-diag simulate``: a bag of a simulated joint."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag.bag import BagError
from hd_diag.cli.joints import chosen_joints, configured
from hd_diag.cli.lines import tell
from hd_diag.cli.progress import interrupted, working
from hd_diag.cli.targets import Problem, write_json
from hd_diag.cli.verbs.bags import SHORT
from hd_diag.config.configuration import Config, ConfigError, resolve
from hd_diag.config.parameter_file import parse_value
from hd_diag.config.parameters import of_joint
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.simulation import Motion, Noise, SimulatedJoint, write_bag
from hd_diag.simulation.motion import SECOND

_TURN = 2.0 * math.pi
_MOTION = Motion()

_RATED = 56.0  # rated torque of the drive for which a motion's default torques are meant [N m]


def simulate(
    out: Path, config_file: str | None, names: tuple[str, ...], json_file: str | None, **given: Any
) -> None:
    """Run ``hd-diag simulate``."""
    kept = out.exists()
    try:
        config = _true_configuration(config_file, names, given)
        speeds = tuple(_TURN * speed for speed in given["speed"])
        both_ways, levels = not given["one_way"], given["torque_level"] or _MOTION.torques
        motion = Motion(given["duration"], given["rate"], speeds, levels, both_ways)
        joints = _joints(config, names, given)
        if not 0.0 <= given["start_time"] < 2.0**31:
            raise ValueError(f"--start-time must be a Unix time within 32 bits, not {given['start_time']} s")
        if given["start_time"] + motion.duration >= 2.0**31:
            raise ValueError(
                f"duration must end within 32 bits of Unix time, not after {motion.duration:g} s"
            )
        start = round(given["start_time"] * SECOND)
        with working() as part:
            mapping = part("preparing the model")
            samples = write_bag(
                out,
                config,
                motion,
                np.random.default_rng(given["seed"]),
                joints,
                start=start,
                with_temperature=given["temperature"],
                overwrite=given["overwrite"],
                mapped=lambda fraction: mapping(fraction, 1.0),
                progress=part("simulate", "samples"),
            )
    except KeyboardInterrupt as error:
        interrupted(error, out, kept)
    except BagError:
        raise
    except ValueError as error:
        raise Problem(str(error)) from error
    truth = {
        "schema": "hd_diag/simulation/1",
        "bag": str(out),
        "samples": samples,
        "duration": motion.duration,
        "sample_rate": motion.sample_rate,
        "start": start,
        "seed": given["seed"],
        "joints": {
            name: {
                "parameters": of_joint(config.flat, name),
                "offset": joint.offset,
                "noise": dataclasses.asdict(joint.noise),
            }
            for name, joint in joints.items()
        },
    }
    if write_json(json_file, truth):
        tell(f"{out}: {samples} samples, {motion.duration:g} s, joints {', '.join(joints)}")


def _true_configuration(file: str | None, names: tuple[str, ...], given: dict[str, Any]) -> Config:
    """Configuration of the simulated joints, from a file and changed by the options."""
    flat: dict[str, Any] = {"joints": list(names) or ["joint_1"]}
    if file:
        config = configured(file)
        chosen_joints(config, names)
        flat = dict(config.given)
    for joint in names or flat["joints"]:
        for option, (parameter, unit, _) in SHORT.items():
            if given[option] is not None:
                flat[f"{joint}.{parameter}"] = given[option] * unit
    return resolve(flat | dict(map(_assignment, given["assignments"])))


def _assignment(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"--set {text}: expected PARAMETER=VALUE")
    try:
        return name.strip(), parse_value(value)
    except ConfigError as error:
        raise ConfigError(f"--set {name}: {error}") from error


def _joints(config: Config, names: tuple[str, ...], given: dict[str, Any]) -> dict[str, SimulatedJoint]:
    angles = ("angle_noise_arcsec", "angle_drift_arcsec", "offset_arcsec")
    white, drift, offset = (given[name] * ARCSEC for name in angles)
    noise = Noise(white=white, drift=drift, torque=given["torque_noise"])
    found = {}
    for joint in chosen_joints(config, names):
        share = 1.0 if given["torque_level"] else joint.drive.rated_torque / _RATED
        found[joint.name] = SimulatedJoint(joint.drive, noise, offset, torque_share=share)
    return found
