"""One row of the table: a joint of a bag, diagnosed by the functions that ``hd-diag diagnose`` uses."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hd_diag import __version__
from hd_diag.bag import BagError
from hd_diag.config.catalogue import load
from hd_diag.config.configuration import JointConfig
from hd_diag.config.parameters import Value
from hd_diag.diagnosis.action import advice
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.evidence.solution import Cause
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.ripple.ripple import ripple
from hd_diag.diagnosis.ripple.verdict import sentence as ripple_sentence
from hd_diag.diagnosis.screening import screened
from hd_diag.diagnosis.verdict import as_json
from hd_diag.effects import CATALOGUE
from hd_diag.formatting import json_ready
from hd_diag.records.joint_record import read_bags, read_motion
from hd_diag.replay.versions import running
from hd_diag.report.cards import cards
from hd_diag.report.facts import JointReport, of_diagnosis, of_motion, sources
from hd_diag.tolerance.study import with_allowed

SCHEMA = "hd_diag/fleet/1"

PAGE = "page"
"""Key of a page: its HTML in a result of `judge`, its path in a row of the table."""

Row = dict[str, Any]
"""Values by the names of `hd_diag.fleet.table.COLUMNS`; missing values are unknown. `start` is in nanoseconds
since 1970."""

_CONTENT = "5"  # version of the rows: journal results of another one are computed again

FITTED = {
    "eccentricity.magnitude": ("eccentricity{}_m", "m", "eccentricity, refitted"),
    "eccentricity.direction": (
        "eccentricity_direction{}_rad",
        "rad",
        "its direction in the housing, modulo pi",
    ),
    "runout.magnitude": ("runout{}_m", "m", "part that turns with the wave generator, refitted"),
    "runout.direction": ("runout_direction{}_rad", "rad", "its direction"),
    "tilt.magnitude": ("tilt{}_rad", "rad", "tilt of the wave generator, refitted where there are sections"),
    "tilt.direction": ("tilt_direction{}_rad", "rad", "its direction in the housing"),
    "circular_spline_datum": ("circular_spline_datum{}_m", "m", "datum radius, refitted"),
    "tooth_compliance": ("tooth_compliance{}_m_per_N", "m/N", "K1 + K2 of a tooth pair, refitted"),
    "cup_compliance": ("cup_compliance{}_rad_per_Nm", "rad/(N m)", "compliance of the cup, refitted"),
}
"""Columns of fitted parameters and, with ``_std`` for the braces, of their deviations; unit; meaning."""


@dataclass(frozen=True)
class Task:
    """One joint of one bag, to be diagnosed by a process that can read the bag; `drawn` asks for a page.

    `flat` are the joint's parameters by their full names.
    """

    bag: str
    joint: JointConfig
    flat: Mapping[str, Value]
    digest: str
    config_digest: str
    messages: int
    drawn: bool = False

    @property
    def key(self) -> str:
        """Hash of the inputs of the result: bag contents, joint, its parameters, version, added effects."""
        added = (effect.name for effect in load() if effect not in CATALOGUE)
        parts = (SCHEMA, _CONTENT, __version__, self.digest, self.joint.name, self.config_digest, *added)
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def judge(task: Task) -> Row:
    """Columns that depend only on bag contents, joint and version: a diagnosis, or an ``error``.

    `PAGE` is added if a page is to be drawn and there is something to draw.
    """
    versions = {f"{name}_version": version for name, version in running().items()}
    fixed = {"joint": task.joint.name, "config_sha256": task.config_digest, **versions}
    try:
        configured = task.joint.configured
        record = screened(read_bags([task.bag], task.joint), configured)
        found = diagnose(record, configured, np.random.default_rng(0), catalogue=load())
        found = with_allowed(found, task.flat, task.joint.name)
    except BagError as error:
        return {**fixed, "error": error.cause}
    except RecordError as error:
        return {**fixed, **_not_judged(task, str(error).replace(task.bag, "the bag"))}
    row = {**fixed, **judged(found, task.joint.name)}
    if task.drawn:
        row[PAGE] = _page(task, of_diagnosis(found, task.joint, task.flat, np.random.default_rng(0)))
    return row


def _page(task: Task, report: JointReport) -> str:
    from hd_diag.report.page import page  # imported late: matplotlib takes its time

    return page([report], sources([Path(task.bag)]))


def _not_judged(task: Task, reason: str) -> Row:
    """Columns of a joint whose angles cannot be judged: the torque's ripple, or an ``error``."""
    motion = found = None
    with contextlib.suppress(RecordError):
        motion = read_motion([task.bag], task.joint)
        if motion is not None:
            columns = motion.time, motion.input_angle, motion.torque, motion.bag
            found = ripple(*columns, task.joint.configured.kinematics)
    if motion is None:
        return {"error": reason}
    row: Row = {"error": reason}
    if found:
        row = {
            "duration_s": float(motion.time[-1] - motion.time[0]),
            "samples": motion.time.size,
            "runs": found.runs,
            "input_turns": found.turns,
            "ripple_orders": [line.order for line in found.lines],
            "ripple_reverses": [line.reverses for line in found.lines],
            "ripple_found": [line.found for line in found.lines],
            "ripple_amplitudes_Nm": [line.amplitude for line in found.lines],
            "ripple_stds_Nm": [line.std for line in found.lines],
            "verdict": ripple_sentence(found),
        }
    row |= {name: motion.stamps.reported[name] for name in ("refused", "last_refusal")}
    if task.drawn:
        row[PAGE] = _page(task, of_motion(motion, task.joint, task.flat, reason, found))
    return row


def judged(found: Diagnosis, joint: str) -> Row:
    """Columns of a diagnosis: the content of `hd-diag diagnose --json`, flat, with amplitudes' deviations."""
    report = as_json(found, joint)
    record, gain, noise, refit = (report[part] for part in ("record", "gain", "noise_floor", "refit"))
    stds = [amplitude_std(found.found.fit, cause) for cause in found.causes] if found.found else []
    causes, lines = report["causes"], report["unexplained"]
    tested = [test for test in report["testability"] if test["testable"]]
    normal, tolerance = report["normal"] or {}, report["tolerance"] or {}
    answer = Answer(found)
    advised = advice(answer)
    row = {
        "light": advised.light,
        "advice": advised.text,
        "judgement": report["judgement"],
        "accuracy_rad": found.configured.accuracy,
        "error_rad": normal.get("measured"),
        "error_std_rad": normal.get("std"),
        "eccentricity_allowed_m": tolerance.get("allowed"),
        "eccentricity_criterion": tolerance.get("criterion"),
        "inspect": [f"{card.title}: {card.inspect}" for card in cards(answer) if card.inspect],
        "duration_s": record["duration"],
        **{name: record[name] for name in ("samples", "runs", "input_turns", "refused", "last_refusal")},
        "trustworthy": refit["trustworthy"],
        "causes": [cause["name"] for cause in causes],
        "cause_classes": [cause["class"] for cause in causes],
        "cause_amplitudes_rad": [cause["amplitude"] for cause in causes],
        "cause_amplitude_stds_rad": json_ready([math.nan] * (len(causes) - len(stds)) + stds),
        "tested": [test["name"] for test in tested],
        "tested_least_rad": [test["least_size"] for test in tested],
        **{f"{name}_rad": gain[name] for name in ("rms_nominal", "rms_refit", "rms_extended")},
        "noise_floor_rad": noise["rms"],
        "fraction_explained": gain["fraction_explained"],
        **{f"noise_floor_{end}_rad": noise[end] for end in ("low", "high")},
        **{f"fraction_explained_{end}": gain[end] for end in ("low", "high")},
        "unexplained_orders": [line["order"] for line in lines],
        "unexplained_frames": [line["frame"] for line in lines],
        "unexplained_amplitudes_rad": [line["amplitude"] for line in lines],
        "findings": [finding["text"] for finding in report["findings"]],
        "verdict": report["verdict"],
    }
    for name, (column, *_) in FITTED.items():
        if name in refit["parameters"]:
            fitted = refit["parameters"][name]
            row |= {column.format(""): fitted["value"], column.format("_std"): fitted["std"]}
    if causes:
        first, of_first = causes[0], causes[0]["gain"]
        row |= {"cause": first["name"], "cause_amplitude_rad": first["amplitude"]}
        row |= {"cause_gain": of_first["value"], "cause_p_value": first["p_value"]}
        row |= {"cause_gain_low": of_first["low"], "cause_gain_high": of_first["high"]}
    return row


def amplitude_std(fit: LinearisedFit, cause: Cause) -> float:
    """Standard deviation of a cause's amplitude, from that of its coefficients [rad rms].

    With columns X about their mean and coefficients c of covariance C, the amplitude is a = |X c| / sqrt(n),
    its gradient g = X' X c / (n a), its variance g' C g, to first order in C. Nonlinear values are fixed.
    """
    own = slice(cause.coefficients.size)  # without wander columns: a cause keeps no coefficients of them
    columns = fit.columns(cause.effect, cause.nonlinear)[:, own]
    part = columns @ cause.coefficients
    if not (amplitude := float(np.std(part))) > 0.0:
        return math.nan
    gradient = columns.T @ (part - part.mean()) / (part.size * amplitude)
    return float(np.sqrt(max(float(gradient @ cause.covariance[own, own] @ gradient), 0.0)))


def readable(value: Any) -> Any:
    r"""A value with valid Unicode only: bytes of a file name that are no text become ``\udcXX``."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    return [readable(item) for item in value] if isinstance(value, list) else value
