"""A diagnosis in words and in JSON."""

from __future__ import annotations

import math
from typing import Any

from hd_diag.diagnosis.diagnosis import Diagnosis, Gain, Rms
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.search.causes import Cause
from hd_diag.diagnosis.search.unexplained import Unexplained
from hd_diag.formatting import ARCSEC, arcsec, direction, json_ready, si, words

_SIGMAS = 3.0  # a parameter this many standard deviations off its configured value is worth a word
_NO_RMS, _NO_GAIN = Rms(*[math.nan] * 8), Gain(math.nan, math.nan, math.nan, "nothing")
_PER = {"input": "per input turn", "output": "per output turn", "time": "Hz"}


def as_json(diagnosis: Diagnosis, joint: str, model: str | None = None) -> dict[str, Any]:
    """What `hd-diag diagnose --json` writes.

    Parameters
    ----------
    diagnosis : Diagnosis
    joint : str
    model : str, optional
        Where the extended model was written.

    Returns
    -------
    dict
        Schema ``hd_diag/diagnosis/1``; SI.
    """
    rms, gain, record = diagnosis.rms or _NO_RMS, diagnosis.gain or _NO_GAIN, diagnosis.record
    counts = {"has_torque": record.has_torque, "outliers": record.outliers, "dropped": record.dropped}
    trustworthy = diagnosis.refitted is not None and diagnosis.refitted.trustworthy
    content = {
        "schema": "hd_diag/diagnosis/1",
        "joint": joint,
        "record": {**record.extent._asdict(), **counts},
        "findings": [finding.__dict__ for finding in diagnosis.findings],
        "nominal": {"rms": rms.nominal},
        "refit": {"rms": rms.refit, "parameters": diagnosis.parameters, "trustworthy": trustworthy},
        "causes": [*map(_finding, diagnosis.findings), *map(_cause, diagnosis.causes)],
        "unexplained": [_unexplained(line) for line in diagnosis.unexplained],
        "extended": {"rms": rms.extended, "rms_offline": rms.offline, "rms_live": rms.live},
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
        "testability": [test.__dict__ for test in diagnosis.testable],
        "model": model,
        "verdict": sentence(diagnosis),
    }
    return dict(json_ready(content))


def _cause(cause: Cause) -> dict[str, Any]:
    effect = cause.effect
    values = effect.to_physical(cause.coefficients, cause.nonlinear)
    spread = effect.standard_deviations(cause.coefficients, cause.nonlinear, cause.covariance)
    return {
        "name": effect.name,
        "class": cause.alike,
        "parameters": {
            name: {"value": value, "std": spread.get(name, math.nan), "unit": unit}
            for name, (value, unit) in values.items()
        },
        "amplitude": cause.amplitude,
        "gain": {"value": cause.gain, "low": cause.gain_low, "high": cause.gain_high},
        "p_value": cause.p_value,
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
        "p_value": 0.0,
        "explanation": finding.text,
        "inspect": finding.text,
    }


def _unexplained(line: Unexplained) -> dict[str, Any]:
    """What has no period is order 0, its law what it looks like."""
    content = {**line.__dict__}
    if description := content.pop("description"):
        content["torque_law"] = f"{description}; {line.torque_law}"
    if where := content.pop("where"):
        content["direction_law"] = f"strongest {where}; {line.direction_law}"
    return content


def sentence(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence."""
    fatal = [finding for finding in diagnosis.findings if finding.fatal]
    if fatal:
        return f"First of all: {fatal[0].text}."
    parts = [*(finding.text for finding in diagnosis.findings), _eccentricity(diagnosis)]
    if diagnosis.causes:
        parts.append("beside that: " + "; ".join(map(_cause_in_words, diagnosis.causes)))
    elif not diagnosis.unexplained:
        parts.append("no other cause is needed")
    else:
        parts.append("none of the known causes explains the rest")
    if diagnosis.unexplained:
        parts.append("unexplained: " + ", ".join(map(_line_in_words, diagnosis.unexplained)))
    rms, record = diagnosis.rms, diagnosis.record
    if rms is not None and diagnosis.causes and not rms.extended < rms.refit:
        parts.append(
            "but data that nothing was fitted to is predicted no better with it than by the model's "
            f"parameters alone ({rms.extended / ARCSEC:.2f} against {arcsec(rms.refit)}): take it for a "
            "hint, and record more"
        )
    if record.size < record.extent.samples:
        samples = f"{record.size} of {record.extent.samples} samples"
        parts.append(f"fitted to {samples}, in stretches all over the record")
    return "; ".join(parts) + "."


def _eccentricity(diagnosis: Diagnosis) -> str:
    """What the fit of the model's own parameters says, in words."""
    if diagnosis.refitted is None:
        return "the model's parameters could not be fitted"
    if not diagnosis.refitted.trustworthy:
        return "the model's parameters are ambiguous: several sets fit about as well"
    size, turn = (diagnosis.parameters[f"eccentricity.{part}"] for part in ("magnitude", "direction"))
    configured = f"{size['configured'] * 1e6:.1f} µm"
    if abs(size["value"] - size["configured"]) < _SIGMAS * size["std"]:
        return f"the eccentricity is as configured ({configured})"
    towards = direction(turn["value"], turn["std"], math.pi).replace("modulo", "mod")
    return f"the eccentricity is {si(size['value'], size['std'], 'm')} at {towards}, not {configured}"


def _cause_in_words(cause: Cause) -> str:
    name = words(cause.effect.name)
    if len(cause.alike) > 1:
        name = f"{' or '.join(map(words, cause.alike))} (this record cannot tell which)"
    return f"{name}, {arcsec(cause.amplitude)} rms"


def _line_in_words(line: Unexplained) -> str:
    if line.description:
        return f"a part that {line.description} ({arcsec(line.amplitude)})"
    where = f" {line.where}" if line.where else ""
    return f"{line.order:.2f} {_PER[line.frame]}{where}, {arcsec(line.amplitude)}"


def summary(diagnosis: Diagnosis) -> list[str]:
    """The diagnosis in lines for a terminal."""
    lines = [sentence(diagnosis)]
    rms, gain = diagnosis.rms, diagnosis.gain
    if rms and gain:
        lines.append(
            f"held-out residual ({gain.held_out}): nominal {rms.nominal / ARCSEC:.2f}, "
            f"refit {rms.refit / ARCSEC:.2f}, extended {rms.extended / ARCSEC:.2f}, "
            f"noise {arcsec(rms.noise)} rms; explained {100 * gain.fraction:.1f} % "
            f"({100 * gain.low:.1f} to {100 * gain.high:.1f} %)"
        )
    lines += [f"inspect: {cause.effect.inspect}" for cause in diagnosis.causes]
    untested = [test for test in diagnosis.testable if not test.testable]
    return lines + [f"not testable here: {words(test.name)}: {test.reason}" for test in untested]
