"""``hd-diag simulate``: a bag of a simulated joint."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import click
import numpy as np

from hd_diag.cli.options import CONFIG, JOINTS, Problem, chosen_joints, json_option, tell, verb, write_json
from hd_diag.cli.progress import interrupted, working
from hd_diag.config.configuration import Config, ConfigError, load, resolve
from hd_diag.config.parameter_file import parse_value
from hd_diag.config.parameters import JOINT_PARAMETERS
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.simulation import START, Motion, Noise, SimulatedJoint, write_bag

_TURN = 2.0 * math.pi
_SECOND = 1_000_000_000  # [ns]
_MOTION = Motion()

# Short options for the values most asked for: parameter, and its unit in the option's unit.
_SHORT = {
    "eccentricity_um": ("eccentricity.magnitude", 1e-6),
    "direction_deg": ("eccentricity.direction", math.pi / 180.0),
    "runout_um": ("runout.magnitude", 1e-6),
    "runout_direction_deg": ("runout.direction", math.pi / 180.0),
    "datum_mm": ("circular_spline_datum", 1e-3),
}


@verb("simulate --out joint.mcap --eccentricity-um 18")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="*.mcap or a rosbag2 folder.")
@CONFIG
@JOINTS
@click.option("--duration", default=_MOTION.duration, show_default=True, help="Length of the record [s].")
@click.option("--rate", default=_MOTION.sample_rate, show_default=True, help="Samples per second [Hz].")
@click.option(
    "--speed",
    "speeds",
    type=float,
    multiple=True,
    default=tuple(speed / _TURN for speed in _MOTION.speeds),
    show_default=True,
    help="Speed of the input [rev/s]; repeatable.",
)
@click.option(
    "--torque-level",
    "torques",
    type=float,
    multiple=True,
    default=_MOTION.torques,
    show_default=True,
    help="Torque on the link [N m]; repeatable.",
)
@click.option("--one-way", is_flag=True, help="Turn forwards only.")
@click.option("--eccentricity-um", type=float, help="Eccentricity, fixed in the housing [µm].")
@click.option("--direction-deg", type=float, help="Its direction [degrees].")
@click.option("--runout-um", type=float, help="Runout, which turns with the wave generator [µm].")
@click.option("--runout-direction-deg", type=float, help="Its direction at input angle 0 [degrees].")
@click.option("--datum-mm", type=float, help="Datum radius of the circular spline's slots [mm].")
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="PARAMETER=VALUE",
    help="Any parameter, such as joint_1.cup_compliance=2e-6; repeatable.",
)
@click.option(
    "--offset-arcsec", default=0.0, show_default=True, help="Zero error of the output encoder [arcsec]."
)
@click.option(
    "--angle-noise-arcsec",
    default=0.0,
    show_default=True,
    help="White noise of the output angle [arcsec rms].",
)
@click.option(
    "--angle-drift-arcsec",
    default=0.0,
    show_default=True,
    help="Correlated noise of the output angle [arcsec rms].",
)
@click.option("--torque-noise", default=0.0, show_default=True, help="White noise of the torque [N m rms].")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0), help="Seed of the noise.")
@click.option("--start-time", default=START / _SECOND, show_default=True, help="First stamp, Unix time [s].")
@click.option("--temperature", is_flag=True, help="Write /<joint>/temperature at 1 Hz too.")
@click.option("--overwrite", is_flag=True, help="Replace a bag that exists.")
@json_option("the true values")
def simulate(
    out: Path, config_file: str | None, names: tuple[str, ...], json_file: str | None, **options: Any
) -> None:
    """Write a bag of a simulated joint.

    The joint is that of --config with what the options change; it moves both ways at every speed under every
    torque. What an option does not give stands in the configuration. Ctrl-C leaves a valid file and ends with
    code 130; a bag that --overwrite replaces stays until the new one is whole.
    """
    kept = out.exists()
    try:
        config = _true_configuration(config_file, names, options)
        motion = Motion(
            options["duration"],
            options["rate"],
            tuple(_TURN * speed for speed in options["speeds"]),
            options["torques"],
            not options["one_way"],
        )
        joints = _joints(config, names, options)
        start = _start(options["start_time"])
        with working() as part:
            mapping = part("map", "%")
            samples = write_bag(
                out,
                config,
                motion,
                np.random.default_rng(options["seed"]),
                joints,
                start=start,
                with_temperature=options["temperature"],
                overwrite=options["overwrite"],
                mapped=lambda fraction: mapping(100.0 * fraction, 100.0),
                progress=part("simulate", "samples"),
            )
    except KeyboardInterrupt:
        interrupted(out, kept)
    except ValueError as error:
        raise Problem(str(error)) from error
    if json_file:
        truth = {
            "schema": "hd_diag/simulation/1",
            "bag": str(out),
            "samples": samples,
            "duration": motion.duration,
            "sample_rate": motion.sample_rate,
            "start": start,
            "seed": options["seed"],
            "joints": {name: _truth_of(config, name, joint) for name, joint in joints.items()},
        }
        write_json(json_file, truth)
    if json_file != "-":
        tell(f"{out}: {samples} samples, {motion.duration:g} s, joints {', '.join(joints)}")


def _true_configuration(file: str | None, names: tuple[str, ...], options: dict[str, Any]) -> Config:
    """Configuration of the simulated joints: a file's, changed by the options."""
    flat: dict[str, Any] = {"joints": list(names) or ["joint_1"]}
    if file:
        config = load(file)
        chosen_joints(config, names)
        flat = dict(config.flat)
    for joint in names or flat["joints"]:
        for option, (parameter, unit) in _SHORT.items():
            if options[option] is not None:
                flat[f"{joint}.{parameter}"] = options[option] * unit
    return resolve(flat | dict(map(_assignment, options["assignments"])))


def _assignment(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"--set {text}: expected PARAMETER=VALUE")
    try:
        return name.strip(), parse_value(value)
    except ConfigError as error:
        raise ConfigError(f"--set {name}: {error}") from error


def _joints(config: Config, names: tuple[str, ...], options: dict[str, Any]) -> dict[str, SimulatedJoint]:
    noise = Noise(
        white=options["angle_noise_arcsec"] * ARCSEC,
        drift=options["angle_drift_arcsec"] * ARCSEC,
        torque=options["torque_noise"],
    )
    offset = options["offset_arcsec"] * ARCSEC
    return {joint.name: SimulatedJoint(joint.drive, noise, offset) for joint in chosen_joints(config, names)}


def _start(seconds: float) -> int:
    if not 0.0 <= seconds < 2.0**31:
        raise ValueError(f"--start-time must be a Unix time within 32 bits, not {seconds} s")
    return round(seconds * _SECOND)


def _truth_of(config: Config, name: str, joint: SimulatedJoint) -> dict[str, Any]:
    """What a reader needs to know the truth, in SI units."""
    parameters = {entry.name: config.flat[f"{name}.{entry.name}"] for entry in JOINT_PARAMETERS}
    return {"parameters": parameters, "offset": joint.offset, "noise": dataclasses.asdict(joint.noise)}
