"""A study as JSON: schema ``hd_diag/tolerance/1``."""

from __future__ import annotations

import math
from typing import Any

from hd_diag.formatting import json_ready
from hd_diag.tolerance.assembly import ANGLES, FACTORS
from hd_diag.tolerance.criteria import CRITERIA
from hd_diag.tolerance.limit import (
    FINE_STEPS,
    RESOLUTION,
    ROOT_TOLERANCE,
    STEPS,
    EccentricityLimit,
    input_angle,
)
from hd_diag.tolerance.study import Study


def document(joint: str, found: Study) -> dict[str, Any]:
    """What `hd-diag tolerance --json` writes.

    Parameters
    ----------
    joint : str
    found : Study

    Returns
    -------
    dict
        Schema ``hd_diag/tolerance/1``; SI units; null where a limit is not reached.
    """
    question = found.question
    allowed = found.allowed
    content = {
        "schema": "hd_diag/tolerance/1",
        "joint": joint,
        "torques": question.torque.tolist(),
        "largest_eccentricity": question.largest,
        "resolution": {
            "eccentricity_step": question.largest / STEPS,
            "eccentricity_step_of_jumps": question.largest / STEPS / FINE_STEPS,
            "eccentricity_root": ROOT_TOLERANCE,
            "angle_from_long_axis": RESOLUTION[0],
            "wave_generator_angle": RESOLUTION[1] * question.drive.mesh.geometry.slot_pitch,
        },
        "interference": _interference(found),
        "limits": [
            {"torque": torque, "criteria": {limit.criterion: _limit(found, limit) for limit in row}}
            for torque, row in zip(question.torque.tolist(), found.limits, strict=True)
        ],
        "allowed": allowed and {"eccentricity": allowed.eccentricity, "criterion": allowed.criterion},
        "assemblies": _assemblies(found),
        "sensitivity": _sensitivity(found),
        "units": {
            "eccentricity": "m",
            "direction": "rad, in the housing",
            "angle": "rad",
            "torque": "N m",
            **{criterion.name: criterion.unit for criterion in CRITERIA},
        },
    }
    return dict(json_ready(content))


def _interference(found: Study) -> dict[str, Any]:
    first = found.interference
    return {
        "across_long_axis": {"eccentricity": first.across, "clearance": first.clearance},
        "any_direction": _limit(found, first.any_direction),
        "all_teeth": _limit(found, first.all_teeth),
    }


def _limit(found: Study, limit: EccentricityLimit) -> dict[str, Any]:
    worst, scanned = limit.worst, limit.scanned
    return {
        "limit": limit.limit,
        "reached": limit.reached,
        "eccentricity": limit.eccentricity,
        "value_without": limit.without,
        "worst": {
            "value": worst.value,
            "direction": worst.direction,
            "direction_deg": math.degrees(worst.direction),
            "wave_generator_angle": worst.wave_generator_angle,
            "input_angle": input_angle(found.question.drive, worst.wave_generator_angle),
        },
        "curve": {"eccentricity": scanned[0].tolist(), "value": scanned[1].tolist()},
    }


def _assemblies(found: Study) -> dict[str, Any] | None:
    if found.assemblies is None:
        return None
    drawn = found.assemblies
    shares = {"all": drawn.together} | dict(zip((c.name for c in CRITERIA), drawn.each, strict=True))
    return {
        "samples": found.question.samples,
        "seed": found.question.seed,
        "angles_per_turn": ANGLES,
        "tolerances": drawn.tolerances.tolist(),
        "configured_tolerance": drawn.configured,
        "target": found.question.target,
        "tolerance_at_target": drawn.at_target,
        "yield": {
            name: {"share": s.share.tolist(), "low": s.low.tolist(), "high": s.high.tolist()}
            for name, s in shares.items()
        },
        "spreads": {
            name: {"distribution": spread.distribution, "size": spread.size}
            for name, spread in found.question.spreads.items()
        },
    }


def _sensitivity(found: Study) -> dict[str, Any] | None:
    s = found.sensitivity
    if s is None:
        return None
    orders = {"first": (s.first, s.first_low, s.first_high), "total": (s.total, s.total_low, s.total_high)}
    return {
        "samples": found.question.sensitivity_samples,
        "criteria": {
            criterion.name: {
                factor: {
                    order: dict(zip(("value", "low", "high"), (a[k, i] for a in arrays), strict=True))
                    for order, arrays in orders.items()
                }
                for i, factor in enumerate(FACTORS)
            }
            for k, criterion in enumerate(CRITERIA)
        },
    }
