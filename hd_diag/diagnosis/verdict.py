"""A diagnosis in words and in JSON."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hd_diag import __version__
from hd_diag.config.model_file import document
from hd_diag.config.parameters import Value
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.search.causes import Cause
from hd_diag.diagnosis.search.detectability import Testability
from hd_diag.diagnosis.search.unexplained import Line
from hd_diag.formatting import direction, json_ready, si
from hd_diag.model.torsion_map import ARCSEC

_SIGMAS = 3.0  # a parameter this many standard deviations off its configured value is worth a word


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
    rms, gain, record = diagnosis.rms, diagnosis.gain, diagnosis.record
    none = float("nan")
    result: dict[str, Any] = json_ready(
        {
            "schema": "hd_diag/diagnosis/1",
            "joint": joint,
            "record": {
                **record.extent._asdict(),
                "has_torque": record.has_torque,
                "outliers": record.outliers,
                "dropped": record.dropped,
            },
            "findings": [finding.__dict__ for finding in diagnosis.findings],
            "nominal": {"rms": rms.nominal if rms else none},
            "refit": _refit(diagnosis),
            "causes": [*map(_finding_cause, diagnosis.findings), *map(_cause, diagnosis.causes)],
            "unexplained": [_unexplained(line) for line in diagnosis.unexplained],
            "extended": {
                "rms": rms.extended if rms else none,
                "rms_offline": rms.offline if rms else none,
                "rms_live": rms.live if rms else none,
            },
            "noise_floor": {
                "rms": rms.noise if rms else none,
                "low": rms.noise_low if rms else none,
                "high": rms.noise_high if rms else none,
            },
            "gain": {
                "rms_nominal": rms.nominal if rms else none,
                "rms_refit": rms.refit if rms else none,
                "rms_extended": rms.extended if rms else none,
                "fraction_explained": gain.fraction if gain else none,
                "low": gain.low if gain else none,
                "high": gain.high if gain else none,
                "held_out": gain.held_out if gain else "nothing",
            },
            "testability": [test.__dict__ for test in diagnosis.testable],
            "model": model,
            "verdict": sentence(diagnosis),
        }
    )
    return result


def model_document(
    diagnosis: Diagnosis, joint: str, configured: Mapping[str, Value], bags: Sequence[Path]
) -> dict[str, Any]:
    """What `hd-diag diagnose --model` writes.

    Parameters
    ----------
    diagnosis : Diagnosis
        With a model.
    joint : str
    configured : mapping
        Parameters of the joint by their names within it.
    bags : sequence of Path
        The records.

    Returns
    -------
    dict
        Schema ``hd_diag/model/1``; SI.
    """
    refitted = diagnosis.refitted
    assert diagnosis.model is not None
    assert refitted is not None
    values = fit_parameters.physical(refitted.parameters, refitted.covariance, diagnosis.configured)
    spreads = {name: value["std"] for name, value in values.items()}
    effects = [
        (cause.effect.standard_deviations(cause.coefficients, cause.nonlinear, cause.covariance), cause.alike)
        for cause in diagnosis.causes
    ]
    told = as_json(diagnosis, joint)
    evidence = {key: told[key] for key in ("record", "gain", "noise_floor", "extended", "unexplained")}
    evidence["trustworthy"] = refitted.trustworthy
    evidence["bags"] = [{"path": str(path), "sha256": digests(path)} for path in bags]
    content = document(joint, configured, diagnosis.model, spreads, effects, evidence, __version__)
    return dict(json_ready(content))


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of a file, or of every file of a folder."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    found = {}
    for file in files:
        if file.is_file():
            digest = hashlib.sha256()
            with file.open("rb") as opened:
                while part := opened.read(1 << 20):
                    digest.update(part)
            found[file.name] = digest.hexdigest()
    return found


def sentence(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence."""
    fatal = [finding for finding in diagnosis.findings if finding.fatal]
    if fatal:
        return f"First of all: {fatal[0].text}."
    parts = [finding.text for finding in diagnosis.findings]
    parts.append(_parameters(diagnosis))
    if diagnosis.causes:
        parts.append("beside that: " + "; ".join(_cause_words(cause) for cause in diagnosis.causes))
    elif not diagnosis.unexplained:
        parts.append("no other cause is needed")
    else:
        parts.append("none of the known causes explains the rest")
    if diagnosis.unexplained:
        parts.append("unexplained: " + ", ".join(_line_words(line) for line in diagnosis.unexplained))
    parts += _doubts(diagnosis)
    record = diagnosis.record
    if record.whole is not None:
        parts.append(
            f"fitted to {record.size} of {record.whole.samples} samples, in stretches all over the record"
        )
    return "; ".join(parts) + "."


def _doubts(diagnosis: Diagnosis) -> list[str]:
    """What speaks against the causes found: data that nothing was fitted to."""
    rms = diagnosis.rms
    if rms is None or not diagnosis.causes or rms.extended < rms.refit:
        return []
    return [
        "but what nothing was fitted to is foretold no better with it than by the model's parameters alone "
        f"({rms.extended / ARCSEC:.2f} against {rms.refit / ARCSEC:.2f} arcsec): take it for a hint, and "
        "record more"
    ]


def _parameters(diagnosis: Diagnosis) -> str:
    refitted = diagnosis.refitted
    if refitted is None:
        return "the model's parameters could not be fitted"
    if not refitted.trustworthy:
        return "the model's parameters are ambiguous: several sets fit about as well"
    values = fit_parameters.physical(refitted.parameters, refitted.covariance, diagnosis.configured)
    size, turn = values["eccentricity.magnitude"], values["eccentricity.direction"]
    size_told = si(_number(size["value"]), _number(size["std"]), "m")
    turn_told = direction(_number(turn["value"]), _number(turn["std"]), math.pi).replace("modulo", "mod")
    configured = f"{_number(size['configured']) * 1e6:.1f} µm"
    same = abs(_number(size["value"]) - _number(size["configured"])) < _SIGMAS * _number(size["std"])
    if same:
        return f"the eccentricity is as configured ({configured})"
    return f"the eccentricity is {size_told} at {turn_told}, not {configured}"


def _cause_words(cause: Cause) -> str:
    name = cause.effect.name.replace("_", " ")
    if len(cause.alike) > 1:
        name = " or ".join(alias.replace("_", " ") for alias in cause.alike)
        name = f"{name} (this record cannot tell which)"
    return f"{name}, {cause.amplitude / ARCSEC:.2f} arcsec rms"


def _unexplained(line: Line) -> dict[str, Any]:
    """What has no period is order 0, its law what it looks like."""
    told = {**line.__dict__}
    description, where = told.pop("description"), told.pop("where")
    if description:
        told["torque_law"] = f"{description}; {line.torque_law}"
    if where:
        told["direction_law"] = f"strongest {where}; {line.direction_law}"
    return told


def _line_words(line: Line) -> str:
    if line.description:
        return f"a part that {line.description} ({line.amplitude / ARCSEC:.2f} arcsec)"
    unit = {"input": "per input turn", "output": "per output turn", "time": "Hz"}[line.frame]
    where = f" {line.where}" if line.where else ""
    return f"{line.order:.2f} {unit}{where}, {line.amplitude / ARCSEC:.2f} arcsec"


def _refit(diagnosis: Diagnosis) -> dict[str, Any]:
    refitted = diagnosis.refitted
    if refitted is None:
        return {"rms": float("nan"), "parameters": {}, "trustworthy": False}
    return {
        "rms": diagnosis.rms.refit if diagnosis.rms else float("nan"),
        "parameters": fit_parameters.physical(refitted.parameters, refitted.covariance, diagnosis.configured),
        "trustworthy": refitted.trustworthy,
    }


def _cause(cause: Cause) -> dict[str, Any]:
    effect = cause.effect
    values = effect.to_physical(cause.coefficients, cause.nonlinear)
    spread = effect.standard_deviations(cause.coefficients, cause.nonlinear, cause.covariance)
    return {
        "name": effect.name,
        "class": list(cause.alike),
        "parameters": {
            name: {"value": value, "std": spread.get(name, float("nan")), "unit": unit}
            for name, (value, unit) in values.items()
        },
        "amplitude": cause.amplitude,
        "gain": {"value": cause.gain, "low": cause.gain_low, "high": cause.gain_high},
        "p_value": cause.p_value,
        "explanation": effect.cause,
        "inspect": effect.inspect,
    }


def _finding_cause(finding: Finding) -> dict[str, Any]:
    return {
        "name": finding.name,
        "class": [finding.name],
        "parameters": {"size": {"value": finding.value, "std": float("nan"), "unit": finding.unit}},
        "amplitude": float("nan"),
        "gain": {"value": float("nan"), "low": float("nan"), "high": float("nan")},
        "p_value": 0.0,
        "explanation": finding.text,
        "inspect": finding.text,
    }


def summary(diagnosis: Diagnosis) -> list[str]:
    """The diagnosis in lines for a terminal."""
    lines = [sentence(diagnosis)]
    rms, gain = diagnosis.rms, diagnosis.gain
    if rms and gain:
        lines.append(
            f"held-out residual ({gain.held_out}): nominal {rms.nominal / ARCSEC:.2f}, "
            f"refit {rms.refit / ARCSEC:.2f}, extended {rms.extended / ARCSEC:.2f}, "
            f"noise {rms.noise / ARCSEC:.2f} arcsec rms; explained {100 * gain.fraction:.1f} % "
            f"({100 * gain.low:.1f} to {100 * gain.high:.1f} %)"
        )
    lines += [f"inspect: {cause.effect.inspect}" for cause in diagnosis.causes]
    lines += [_untested(test) for test in diagnosis.testable if not test.testable]
    return lines


def _untested(test: Testability) -> str:
    return f"not testable here: {test.name.replace('_', ' ')}: {test.reason}"


def _number(value: object) -> float:
    assert isinstance(value, (int, float))
    return float(value)
