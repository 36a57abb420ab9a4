"""A study as JSON, schema ``hd_diag/tolerance/1``, and what its assemblies yield in words."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from hd_diag.formatting import json_ready
from hd_diag.tolerance.assembly import ANGLES, FACTORS, WITHIN
from hd_diag.tolerance.criteria import CRITERIA, NAMES
from hd_diag.tolerance.limit import (
    FINE_STEPS,
    RESOLUTION,
    ROOT_TOLERANCE,
    STEPS,
    EccentricityLimit,
    input_angle,
)
from hd_diag.tolerance.sensitivity import Indices
from hd_diag.tolerance.study import Question, Study, Yield


def document(joint: str, found: Study) -> dict[str, Any]:
    """What `hd-diag tolerance --json` writes; SI units, null where a limit is not reached."""
    question, first, allowed = found.question, found.interference, found.allowed
    content = {
        "schema": "hd_diag/tolerance/1",
        "joint": joint,
        "torques": question.torque,
        "largest_eccentricity": question.largest,
        "resolution": {
            "eccentricity_step": question.largest / STEPS,
            "eccentricity_step_of_jumps": question.largest / STEPS / FINE_STEPS,
            "eccentricity_root": ROOT_TOLERANCE,
            "angle_from_long_axis": RESOLUTION[0],
            "wave_generator_angle": RESOLUTION[1] * question.drive.mesh.geometry.slot_pitch,
        },
        "interference": {
            "across_long_axis": {"eccentricity": first.across, "clearance": first.clearance},
            "any_direction": _limit(found, first.any_direction),
            "all_teeth": _limit(found, first.all_teeth),
        },
        "limits": [
            {"torque": torque, "criteria": {limit.criterion: _limit(found, limit) for limit in row}}
            for torque, row in zip(question.torque, found.limits, strict=True)
        ],
        "allowed": allowed and {"eccentricity": allowed.eccentricity, "criterion": allowed.criterion},
        "assemblies": found.assemblies and _assemblies(question, found.assemblies),
        "sensitivity": found.sensitivity and _sensitivity(question, found.sensitivity),
        "units": {
            "eccentricity": "m",
            "direction": "rad, in the housing",
            "angle": "rad",
            "torque": "N m",
            **{criterion.name: criterion.unit for criterion in CRITERIA},
        },
    }
    return dict(json_ready(content))


def yielded(question: Question, drawn: Yield) -> str:
    """What assemblies yield, in one sentence: so few may be drawn that it is not known."""
    share, t = f"{100 * question.target:g} % of the assemblies are", drawn.together
    if math.isfinite(drawn.at_target):
        place = f"{share} within all limits up to a tolerance of {drawn.at_target * 1e6:.2f} µm"
        configured = f"{drawn.configured * 1e6:.2f} µm configured"
        return f"{place} ({100 * WITHIN:g} % of eccentricities are within it; {configured})."
    if t.high[0] < question.target:
        return f"{share} not within all limits even without eccentricity."
    found, low, high = (f"{100 * each[0]:.1f}" for each in (t.share, t.low, t.high))
    few = f"{question.samples} assemblies do not tell: {found} % are ({low} to {high} %)"
    return f"Whether {share} within all limits without eccentricity, {few}; draw more (--samples)."


def _limit(found: Study, limit: EccentricityLimit) -> dict[str, Any]:
    return {
        "limit": limit.limit,
        "reached": limit.reached,
        "eccentricity": limit.eccentricity,
        "value_without": limit.without,
        "worst": {
            **asdict(limit.worst),
            "direction_deg": math.degrees(limit.worst.direction),
            "input_angle": input_angle(found.question.drive, limit.worst.wave_generator_angle),
        },
        "curve": {"eccentricity": limit.scanned[0], "value": limit.scanned[1]},
    }


def _assemblies(question: Question, drawn: Yield) -> dict[str, Any]:
    return {
        "samples": question.samples,
        "seed": question.seed,
        "angles_per_turn": ANGLES,
        "tolerances": drawn.tolerances,
        "configured_tolerance": drawn.configured,
        "target": question.target,
        "tolerance_at_target": drawn.at_target,
        "yield": dict(zip(("all", *NAMES), map(asdict, (drawn.together, *drawn.each)), strict=True)),
        "spreads": {name: asdict(spread) for name, spread in question.spreads.items()},
    }


def _sensitivity(question: Question, found: Indices) -> dict[str, Any]:
    return {
        "samples": question.sensitivity_samples,
        "criteria": {
            criterion: {
                factor: {
                    order: {name: values[k, i] for name, values in vars(estimate).items()}
                    for order, estimate in vars(found).items()
                }
                for i, factor in enumerate(FACTORS)
            }
            for k, criterion in enumerate(NAMES)
        },
    }
