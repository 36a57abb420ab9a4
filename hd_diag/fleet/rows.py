"""One row of the table: a joint of a bag, judged by the functions that ``hd-diag diagnose`` uses."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hd_diag import __version__
from hd_diag.bag import BagError
from hd_diag.bag.joint_record import read_bags
from hd_diag.config.configuration import JOINT_PARAMETERS, Config, JointConfig
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.fit.linearised_fit import Workbench
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.screening import screened
from hd_diag.diagnosis.search.causes import Cause
from hd_diag.diagnosis.verdict import as_json
from hd_diag.fleet.survey import Survey
from hd_diag.formatting import json_ready
from hd_diag.replay.versions import running

SCHEMA = "hd_diag/fleet/1"

Row = dict[str, Any]
"""Values by the names of `COLUMNS`; what is not there is unknown. `start` is in nanoseconds since 1970."""


@dataclass(frozen=True)
class Column:
    """A column: name with the unit in it, Parquet type, unit, what it says."""

    name: str
    kind: str
    unit: str
    about: str


def _measured(name: str, unit: str, about: str) -> tuple[Column, Column]:
    """A fitted number and its standard deviation; `name` has a place for what goes before the unit."""
    return (
        Column(name.format(""), "double", unit, about),
        Column(name.format("_std"), "double", unit, f"its standard deviation: {about}"),
    )


COLUMNS: tuple[Column, ...] = (
    Column("bag", "string", "", "the bag, as it was given"),
    Column("robot", "string", "", "which robot, by --robot"),
    Column("joint", "string", "", "name in the configuration; null where a bag has no usable joint"),
    Column("start", "time", "UTC", "first log time of the bag, to the microsecond"),
    Column("duration_s", "double", "s", "time covered by the runs"),
    Column("samples", "int64", "1", "samples judged"),
    Column("runs", "int64", "1", "runs in the bag"),
    Column("input_turns", "double", "1", "turns of the input, both directions counted"),
    *_measured("eccentricity{}_m", "m", "eccentricity, refitted"),
    *_measured("eccentricity_direction{}_rad", "rad", "its direction in the housing, modulo pi"),
    *_measured("runout{}_m", "m", "part that turns with the wave generator, refitted"),
    *_measured("runout_direction{}_rad", "rad", "its direction"),
    *_measured("circular_spline_datum{}_m", "m", "datum radius, refitted"),
    *_measured("tooth_compliance{}_m_per_N", "m/N", "K1 + K2 of a tooth pair, refitted"),
    *_measured("cup_compliance{}_rad_per_Nm", "rad/(N m)", "compliance of the cup, refitted"),
    Column("trustworthy", "bool", "", "whether one set of refitted parameters is clearly the best"),
    Column("causes", "strings", "", "causes found, most explaining first"),
    Column("cause_classes", "stringss", "", "names that the record cannot tell from each cause"),
    Column("cause_amplitudes_rad", "doubles", "rad rms at the output", "of each cause"),
    Column("cause_amplitude_stds_rad", "doubles", "rad rms at the output", "their standard deviations"),
    Column("cause", "string", "", "the first cause"),
    Column("cause_amplitude_rad", "double", "rad rms at the output", "of the first cause"),
    Column("cause_gain", "double", "1", "share of the held-out deviance that the first cause explains"),
    Column("cause_gain_low", "double", "1", "lower end of its interval"),
    Column("cause_gain_high", "double", "1", "upper end of its interval"),
    Column("cause_p_value", "double", "1", "corrected for all candidates"),
    Column("tested", "strings", "", "causes that the record could have shown"),
    Column(
        "tested_least_rad", "doubles", "rad rms at the output", "least size of each found with 99 % chance"
    ),
    Column("rms_nominal_rad", "double", "rad", "held-out residual, simulation as configured"),
    Column("rms_refit_rad", "double", "rad", "held-out residual, parameters refitted"),
    Column("rms_extended_rad", "double", "rad", "held-out residual, with the causes found"),
    Column("noise_floor_rad", "double", "rad", "rms of the noise"),
    Column("noise_floor_low_rad", "double", "rad", "lower end of its 95 % interval"),
    Column("noise_floor_high_rad", "double", "rad", "upper end of its 95 % interval"),
    Column("fraction_explained", "double", "1", "of the nominal mean square, by the extended model"),
    Column("fraction_explained_low", "double", "1", "lower end of its 95 % interval"),
    Column("fraction_explained_high", "double", "1", "upper end of its 95 % interval"),
    Column(
        "unexplained_orders", "doubles", "1/turn or Hz by the frame", "lines that no known cause explains"
    ),
    Column("unexplained_frames", "strings", "", "input, output (orders per turn) or time (Hz) of each"),
    Column("unexplained_amplitudes_rad", "doubles", "rad", "amplitude of each"),
    Column("findings", "strings", "", "what comes before the model: ratio, skipped teeth, ramps"),
    Column("verdict", "string", "", "one sentence"),
    Column("error", "string", "", "why it could not be judged; null where it was"),
    Column("problems", "strings", "", "what is unfinished about the bag's files"),
    Column("bag_sha256", "string", "", "of the bag's contents"),
    Column("config_sha256", "string", "", "of the joint's parameters that a diagnosis uses"),
    Column("hd_diag_version", "string", "", "of the worker that judged"),
    Column("python_version", "string", "", "the same"),
    Column("numpy_version", "string", "", "the same"),
    Column("scipy_version", "string", "", "the same"),
    Column("numba_version", "string", "", "the same; null where numba was not used"),
)
"""Columns of the Parquet file, in order."""

_FITTED = {
    "eccentricity.magnitude": "eccentricity{}_m",
    "eccentricity.direction": "eccentricity_direction{}_rad",
    "runout.magnitude": "runout{}_m",
    "runout.direction": "runout_direction{}_rad",
    "circular_spline_datum": "circular_spline_datum{}_m",
    "tooth_compliance": "tooth_compliance{}_m_per_N",
    "cup_compliance": "cup_compliance{}_rad_per_Nm",
}


@dataclass(frozen=True)
class Task:
    """One joint of one bag, to be judged where the bag can be read."""

    bag: str
    joint: JointConfig
    digest: str
    config_digest: str
    messages: int

    @property
    def key(self) -> str:
        """What the result depends on: contents of the bag, parameters of the joint, version of hd_diag."""
        parts = (SCHEMA, __version__, self.digest, self.joint.name, self.config_digest)
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def tasks(looked: Survey, config: Config, joints: tuple[JointConfig, ...]) -> list[Task]:
    """The joints of a bag that are to be judged: those of which it holds an angle.

    Parameters
    ----------
    looked : Survey
    config : Config
    joints : tuple of JointConfig
        Of that configuration.

    Returns
    -------
    list of Task
    """
    return [
        Task(looked.path, joint, looked.digest, config_digest(config, joint), looked.messages)
        for joint in joints
        if looked.names & {joint.input_joint, joint.output_joint}
    ]


def config_digest(config: Config, joint: JointConfig) -> str:
    """SHA-256 of the parameters of a joint that a diagnosis uses: limits and an extended model are none."""
    names = (p.name for p in JOINT_PARAMETERS if not p.name.startswith("limits.") and p.name != "model_file")
    own = {name: config.flat[f"{joint.name}.{name}"] for name in names}
    return hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()


def judge(task: Task) -> Row:
    """Diagnose one joint of one bag.

    Parameters
    ----------
    task : Task

    Returns
    -------
    dict
        The part of a row that the bag's contents, the joint and the version settle; with ``error`` where the
        record cannot be judged.
    """
    versions = {f"{name}_version": version for name, version in running().items()}
    fixed = {"joint": task.joint.name, "config_sha256": task.config_digest, **versions}
    try:
        configured = task.joint.configured
        found = diagnose(screened(read_bags([task.bag], task.joint), configured), configured)
    except BagError as error:
        return {**fixed, "error": error.cause}
    except RecordError as error:
        return {**fixed, "error": str(error).replace(task.bag, "the bag")}
    return {**fixed, **judged(found, task.joint.name)}


def judged(found: Diagnosis, joint: str) -> Row:
    """Columns of a diagnosis: those of `hd-diag diagnose --json`, flat, and deviations of the amplitudes.

    Parameters
    ----------
    found : Diagnosis
    joint : str

    Returns
    -------
    dict
    """
    told = as_json(found, joint)
    record, gain, noise = told["record"], told["gain"], told["noise_floor"]
    tested = [test for test in told["testability"] if test["testable"]]
    return {
        "duration_s": record["duration"],
        "samples": record["samples"],
        "runs": record["runs"],
        "input_turns": record["input_turns"],
        **_fitted(told["refit"]["parameters"]),
        "trustworthy": told["refit"]["trustworthy"],
        **_causes(told["causes"]),
        "cause_amplitude_stds_rad": [None] * len(found.findings) + _amplitude_stds(found),
        "tested": [test["name"] for test in tested],
        "tested_least_rad": [test["least_size"] for test in tested],
        "rms_nominal_rad": gain["rms_nominal"],
        "rms_refit_rad": gain["rms_refit"],
        "rms_extended_rad": gain["rms_extended"],
        "noise_floor_rad": noise["rms"],
        "noise_floor_low_rad": noise["low"],
        "noise_floor_high_rad": noise["high"],
        "fraction_explained": gain["fraction_explained"],
        "fraction_explained_low": gain["low"],
        "fraction_explained_high": gain["high"],
        "unexplained_orders": [line["order"] for line in told["unexplained"]],
        "unexplained_frames": [line["frame"] for line in told["unexplained"]],
        "unexplained_amplitudes_rad": [line["amplitude"] for line in told["unexplained"]],
        "findings": [finding["text"] for finding in told["findings"]],
        "verdict": told["verdict"],
    }


def _fitted(parameters: Mapping[str, Mapping[str, Any]]) -> Row:
    row = {}
    for name, column in _FITTED.items():
        if name in parameters:
            row[column.format("")] = parameters[name]["value"]
            row[column.format("_std")] = parameters[name]["std"]
    return row


def _causes(causes: list[dict[str, Any]]) -> Row:
    row: Row = {
        "causes": [cause["name"] for cause in causes],
        "cause_classes": [cause["class"] for cause in causes],
        "cause_amplitudes_rad": [cause["amplitude"] for cause in causes],
    }
    if causes:
        first = causes[0]
        row |= {"cause": first["name"], "cause_amplitude_rad": first["amplitude"]}
        row |= {"cause_gain": first["gain"]["value"], "cause_p_value": first["p_value"]}
        row |= {"cause_gain_low": first["gain"]["low"], "cause_gain_high": first["gain"]["high"]}
    return row


def _amplitude_stds(found: Diagnosis) -> list[float | None]:
    bench = found.found.bench if found.found is not None else None
    return [json_ready(amplitude_std(bench, cause)) if bench else None for cause in found.causes]


def amplitude_std(bench: Workbench, cause: Cause) -> float:
    """Standard deviation of a cause's amplitude by that of its coefficients [rad rms].

    Notes
    -----
    With columns X about their mean and coefficients c of covariance C, the amplitude is a = |X c| / sqrt(n),
    its gradient g = X' X c / (n a), its variance g' C g: the first order in C. Nonlinear values are held.
    """
    own = slice(cause.coefficients.size)  # before the columns that wander, of which a cause keeps no numbers
    columns = bench.columns(cause.effect, cause.nonlinear)[:, own]
    part = columns @ cause.coefficients
    if not (amplitude := float(np.std(part))) > 0.0:
        return math.nan
    gradient = columns.T @ (part - part.mean()) / (part.size * amplitude)
    return float(np.sqrt(max(float(gradient @ cause.covariance[own, own] @ gradient), 0.0)))
