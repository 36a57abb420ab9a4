"""A diagnosis as JSON, and as lines of text for a terminal."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import numpy as np

from hd_diag.diagnosis.action import advice
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.evidence.order_table import OrderRow
from hd_diag.diagnosis.evidence.solution import Cause, Function
from hd_diag.diagnosis.evidence.unexplained import Unexplained
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.gain import Gain, Rms
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.statements import motor_values, sentence, sentences, values_of
from hd_diag.effects.remainders import ORDERS
from hd_diag.formatting import ARCSEC, arcsec, json_ready, percent, percents, words

_NO_RMS, _NO_GAIN = Rms(*[math.nan] * 9), Gain(math.nan, math.nan, math.nan, "nothing")
_HOW_TO_FIND = (
    "counter-clockwise from where the wave generator's long axis stands at input angle zero "
    "(wave_generator_phase); an axis points to either side, so 180° more is the same"
)


def as_json(diagnosis: Diagnosis, joint: str, model: str | None = None) -> dict[str, Any]:
    """Content of `hd-diag diagnose --json`: schema ``hd_diag/diagnosis/1``; SI.

    `model` is the path of the extended model's file.
    """
    rms, gain, record = diagnosis.rms or _NO_RMS, diagnosis.gain or _NO_GAIN, diagnosis.record
    counts = {"has_torque": record.has_torque, "outliers": record.outliers, "dropped": record.dropped}
    trustworthy = diagnosis.refitted is not None and diagnosis.refitted.trustworthy
    answer, most = Answer(diagnosis), diagnosis.allowed
    usual, assembly, advised = answer.normal, answer.tolerance, advice(answer)
    effects = {effect.name for effect in diagnosis.catalogue}
    named = [finding for finding in diagnosis.findings if finding.name in effects]
    content = {
        "schema": "hd_diag/diagnosis/1",
        "joint": joint,
        "record": {**record.extent._asdict(), **counts, **record.stamps.reported},
        "findings": [finding.__dict__ for finding in diagnosis.findings],
        "nominal": {"rms": rms.nominal},
        "refit": {"rms": rms.refit, "parameters": diagnosis.parameters, "trustworthy": trustworthy},
        "causes": [*map(_finding, named), *(_cause(answer, one) for one in diagnosis.causes)],
        "hints": [_cause(answer, one) for one in diagnosis.hints],
        "unexplained": [_unexplained(line) for line in diagnosis.unexplained],
        "extended": {
            "rms": rms.extended,
            "rms_named": rms.named,
            "rms_offline": rms.offline,
            "rms_live": rms.live,
            "rms_wandering": rms.wandering,
        },
        "noise_floor": {"rms": rms.noise, "low": rms.noise_low, "high": rms.noise_high},
        "gain": {
            "rms_nominal": rms.nominal,
            "rms_refit": rms.refit,
            "rms_extended": rms.extended,
            "fraction_explained": gain.fraction,
            "low": gain.low,
            "high": gain.high,
            "held_out": gain.held_out,
        },
        "remainders": [_remainder(one) for one in diagnosis.functions if one.effect not in ORDERS],
        "misfit": {"slow": rms.slow, "gear": rms.gear},
        "testability": [test.__dict__ for test in diagnosis.testable],
        "action": advised.action,
        "advice": advised.text,
        "judgement": answer.judgement,
        "evidence": answer.evidence,
        "described": [_row(row) for row in diagnosis.order_table],
        "normal": usual
        and answer.accuracy
        and {
            "accuracy": usual.limit,
            "measured": usual.value,
            "std": usual.std,
            "turns": answer.accuracy.turns,
            "place": usual.place,
            "within": usual.within,
        },
        "tolerance": assembly
        and most
        and {
            "eccentricity": assembly.value,
            "std": assembly.std,
            "allowed": assembly.limit,
            "criterion": most.criterion,
            "place": assembly.place,
            "within": assembly.within,
        },
        "encoder_zeros": _zeros(diagnosis),
        "motor_current": motor_values(diagnosis),
        "left_out": diagnosis.left_out,
        "model": model,
        "verdict": sentence(answer),
    }
    return dict(json_ready(content))


def _row(row: OrderRow) -> dict[str, Any]:
    return {
        "order": row.order,
        "frame": row.frame,
        "amplitude": row.amplitude,
        "phase": row.phase,
        "repeats": row.repeats,
        "grows_with_torque": bool(row.nonlinear[1]),
        "might_be": row.might_be,
    }


def _remainder(one: Function) -> dict[str, Any]:
    return {
        "of": one.effect.name.removeprefix("function_of_"),
        "rms": one.rms,
        "largest": one.largest,
        "at": one.at,
        "larger_than_usual": one.is_larger,
        "in_model": one.is_described,
    }


def _cause(answer: Answer, cause: Cause) -> dict[str, Any]:
    effect, sizes = cause.effect, (cause.coefficients, cause.nonlinear)
    return {
        "name": effect.name,
        "class": cause.alike,
        "parameters": values_of(effect, *sizes, effect.standard_deviations(*sizes, cause.covariance)),
        "amplitude": cause.amplitude,
        "gain": {"value": cause.gain, "low": cause.gain_low, "high": cause.gain_high},
        "probability": cause.standing.probability,
        "usual": answer.is_usual(cause),
        "p_value": cause.standing.chance,
        "explanation": effect.cause,
        "inspect": effect.inspect,
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "name": finding.name,
        "class": [finding.name],
        "parameters": {"size": {"value": finding.value, "std": math.nan, "unit": finding.unit}},
        "amplitude": math.nan,
        "gain": dict.fromkeys(("value", "low", "high"), math.nan),
        "probability": 1.0,
        "usual": False,
        "p_value": 0.0,
        "explanation": finding.text,
        "inspect": finding.text,
    }


def _unexplained(line: Unexplained) -> dict[str, Any]:
    """A part without a period has order 0; its description precedes its torque law."""
    content = {**line.__dict__}
    if description := content.pop("description"):
        content["torque_law"] = f"{description}; {line.torque_law}"
    if where := content.pop("where"):
        content["direction_law"] = f"strongest {where}; {line.direction_law}"
    return content


def _zeros(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Encoder zeros of several recordings and their scatter [rad]; None for a single recording."""
    zeros = diagnosis.encoder_zeros
    return {"values": zeros, "scatter": float(np.std(zeros, ddof=1))} if len(zeros) > 1 else None


def summary(diagnosis: Diagnosis) -> list[str]:
    """The diagnosis as lines of text for a terminal."""
    answer = Answer(diagnosis)
    lines = [advice(answer).text, *sentences(answer)]
    rms, gain = diagnosis.rms, diagnosis.gain
    if rms and gain:
        lines.append(
            f"held-out residual ({gain.held_out}): nominal {rms.nominal / ARCSEC:.2f}, "
            f"refit {rms.refit / ARCSEC:.2f}, extended {rms.extended / ARCSEC:.2f}, "
            f"noise {arcsec(rms.noise)} rms; explained {percent(gain.fraction)} "
            f"({percents(gain.low, gain.high)})"
        )
    if zeros := _zeros(diagnosis):
        lines.append(
            f"encoders' zero: one for each of {len(zeros['values'])} recordings; they scatter by "
            f"{arcsec(zeros['scatter'])} (standard deviation), which is no cause"
        )
    if any(change.name == "eccentricity" for change in answer.changes):
        lines.append(f"direction: {_HOW_TO_FIND}")
    lines += [f"inspect: {cause.effect.inspect}" for cause in diagnosis.causes if not answer.is_usual(cause)]
    untested = defaultdict[str, list[str]](list)
    for test in diagnosis.untestable:
        untested[test.reason].append(words(test.name))
    return lines + [f"not testable here: {', '.join(names)}: {why}" for why, names in untested.items()]
