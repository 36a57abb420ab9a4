"""A diagnosis in words and in JSON."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.evidence.calibration import TWO_SIDED
from hd_diag.diagnosis.evidence.order_table import OrderRow
from hd_diag.diagnosis.evidence.search import FURTHER_CAUSES
from hd_diag.diagnosis.evidence.solution import Cause, Function
from hd_diag.diagnosis.evidence.unexplained import Unexplained
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit.fit_parameters import direction_period
from hd_diag.diagnosis.gain import Gain, Rms
from hd_diag.diagnosis.judgement import Answer, Change, first_words, is_usual
from hd_diag.effects.effect import Effect
from hd_diag.effects.remainders import ORDERS
from hd_diag.formatting import (
    ARCSEC,
    arcsec,
    direction,
    json_ready,
    percent,
    percents,
    si,
    spread_number,
    words,
)

_NO_RMS, _NO_GAIN = Rms(*[math.nan] * 9), Gain(math.nan, math.nan, math.nan, "nothing")
_HOW_TO_FIND = (
    "counter-clockwise from where the wave generator's long axis stands at input angle zero "
    "(wave_generator_phase); an axis points to either side, so 180° more is the same"
)
_DISPLACED = {
    "eccentricity": ("the eccentricity", 1e6, "µm"),
    "runout": ("the wave generator's runout", 1e6, "µm"),
    "tilt": ("the wave generator's tilt", 1e3, "mrad"),
}  # in words, and as people state it
_SAME_ORDER = 0.02  # of an order, by which two estimates of it may differ
_PER = {"input": "per input turn", "output": "per output turn", "time": "Hz"}


def as_json(diagnosis: Diagnosis, joint: str, model: str | None = None) -> dict[str, Any]:
    """What `hd-diag diagnose --json` writes: schema ``hd_diag/diagnosis/1``; SI.

    `model` is where the extended model was written.
    """
    rms, gain, record = diagnosis.rms or _NO_RMS, diagnosis.gain or _NO_GAIN, diagnosis.record
    counts = {"has_torque": record.has_torque, "outliers": record.outliers, "dropped": record.dropped}
    trustworthy = diagnosis.refitted is not None and diagnosis.refitted.trustworthy
    answer, most = Answer(diagnosis), diagnosis.allowed
    usual, assembly = answer.normal, answer.tolerance
    effects = {effect.name for effect in diagnosis.catalogue}
    named = [finding for finding in diagnosis.findings if finding.name in effects]
    content = {
        "schema": "hd_diag/diagnosis/1",
        "joint": joint,
        "record": {**record.extent._asdict(), **counts, **record.stamps.reported},
        "findings": [finding.__dict__ for finding in diagnosis.findings],
        "nominal": {"rms": rms.nominal},
        "refit": {"rms": rms.refit, "parameters": diagnosis.parameters, "trustworthy": trustworthy},
        "causes": [*map(_finding, named), *map(_cause, diagnosis.causes)],
        "hints": [*map(_cause, diagnosis.hints)],
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
        "action": answer.action,
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
        "motor_current": _motor(diagnosis),
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


def _cause(cause: Cause) -> dict[str, Any]:
    effect, sizes = cause.effect, (cause.coefficients, cause.nonlinear)
    return {
        "name": effect.name,
        "class": cause.alike,
        "parameters": _values(effect, *sizes, effect.standard_deviations(*sizes, cause.covariance)),
        "amplitude": cause.amplitude,
        "gain": {"value": cause.gain, "low": cause.gain_low, "high": cause.gain_high},
        "probability": cause.standing.probability,
        "usual": is_usual(cause),
        "p_value": cause.standing.chance,
        "explanation": effect.cause,
        "inspect": effect.inspect,
    }


def _values(
    effect: Effect, coefficients: Floats, nonlinear: tuple[float, ...], stds: dict[str, float]
) -> dict[str, Any]:
    """Physical quantities of an effect, with what is known of their standard deviations."""
    return {
        name: {"value": value, "std": stds.get(name, math.nan), "unit": unit}
        for name, (value, unit) in effect.to_physical(coefficients, nonlinear).items()
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
    """A part without a period has order 0; its description stands before its torque law."""
    content = {**line.__dict__}
    if description := content.pop("description"):
        content["torque_law"] = f"{description}; {line.torque_law}"
    if where := content.pop("where"):
        content["direction_law"] = f"strongest {where}; {line.direction_law}"
    return content


def sentence(answer: Answer) -> str:
    """The verdict in one sentence."""
    diagnosis, first = answer.diagnosis, first_words(answer)
    found = dict.fromkeys(finding.text for finding in diagnosis.findings)
    lost = diagnosis.record.stamps.lines
    if any(finding.fatal for finding in diagnosis.findings):
        return _ended("; ".join([first, *lost]))
    parts = [first, *(found | dict.fromkeys(lost))]
    parts += [_parameters(answer), *_current(diagnosis)]
    if diagnosis.refitted is not None:
        parts += _causes(answer)
    rows = [row for row in diagnosis.order_table if row.repeats]
    if lines := [one for one in diagnosis.unexplained if not any(_describes(row, one) for row in rows)]:
        parts.append("unexplained: " + ", ".join(map(_line_in_words, lines)))
    if rows:
        parts.append(f"described, not explained: {', '.join(map(_row_in_words, rows))}")
    rms, record = diagnosis.rms, diagnosis.record
    if larger := diagnosis.larger:
        parts.append("larger than usual, by no known cause: " + ", ".join(map(_function_in_words, larger)))
    if rms is not None and diagnosis.hints and not diagnosis.predicting:
        left = rms.by_causes / ARCSEC
        parts.append(
            "held-out data are predicted no better with it than without "
            f"({left:.2f} against {arcsec(rms.without_causes)}): record more"
        )
    if record.size < record.extent.samples:
        samples = f"{record.size} of {record.extent.samples} samples"
        parts.append(f"fitted to {samples}, in stretches all over the record")
    if diagnosis.left_out:
        parts.append(f"the time limit was reached, so this was left out: {', '.join(diagnosis.left_out)}")
    return _ended("; ".join(parts))


def _causes(answer: Answer) -> list[str]:
    """Those that can be named, then those that are nearest to what is left; or why there are none."""
    found = answer.diagnosis
    parts = {"beside that": found.causes, "nearest to it, though not to be named for it": found.hints}
    if said := [f"{how}: {'; '.join(map(_cause_in_words, some))}" for how, some in parts.items() if some]:
        return said
    if FURTHER_CAUSES in found.left_out:
        return ["no cause was found within the time limit"]
    if not found.unexplained and answer.judgement != "misfit":
        return ["no other cause is needed"]
    return ["none of the known causes explains the rest"]


def _ended(text: str) -> str:
    return text if text.endswith("?") else f"{text}."


def _current(diagnosis: Diagnosis) -> list[str]:
    """What cannot be determined because the torque is a motor's current."""
    values = _motor(diagnosis)
    if values is None:
        return []
    gain, dry = values["relative_error"], values["friction"]
    constant = spread_number(100.0 * gain["value"], 100.0 * gain["std"], "%")
    return [
        f"the torque is a motor's current: its constant ({'+' if gain['value'] > 0.0 else ''}{constant}), "
        f"friction ({spread_number(dry['value'], dry['std'], 'N m')}) and inertia are fitted too, so neither "
        "the stiffness nor a small friction can be determined"
    ]


def _motor(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """What a motor needs of its torque, as fitted; None where the torque is no current."""
    for term in diagnosis.model.effects if diagnosis.model else ():
        if term.effect.given:
            return _values(term.effect, np.array(term.coefficients), term.nonlinear, diagnosis.motor_std)
    return None


def _zeros(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Zeros of several recordings and their scatter; None of one."""
    zeros = diagnosis.encoder_zeros
    return {"values": zeros, "scatter": float(np.std(zeros, ddof=1))} if len(zeros) > 1 else None


def _parameters(answer: Answer) -> str:
    """What the fit of the model's own parameters says, in words: what changes the error most first."""
    diagnosis, changed = answer.diagnosis, answer.changes
    if diagnosis.refitted is None:
        return "described by its orders alone, without a tooth model: nothing is said about causes"
    if not diagnosis.refitted.trustworthy:
        return "the model's parameters are ambiguous: several sets fit about as well"
    if not changed:
        size = diagnosis.parameters["eccentricity.magnitude"]
        text = f"the eccentricity is as configured ({size['configured'] * 1e6:.1f} µm)"
        away = abs(size["value"] - size["configured"]) + TWO_SIDED * size["std"]
        most = diagnosis.kept.get("eccentricity", away)
        # A bound stands on a model that describes the record.
        if answer.judgement == "misfit" or answer.vague:
            return f"{text}, and how far off it may be cannot be determined"
        return f"{text}, as far as this record tells: no more than {most * 1e6:.1f} µm off"
    text = ", ".join(_change_in_words(diagnosis, change) for change in changed)
    if changed[0].name in _DISPLACED:
        return text
    return f"the configured drive is not this gear: {text}"


def _change_in_words(diagnosis: Diagnosis, change: Change) -> str:
    if change.name in _DISPLACED:
        what, scale, unit = _DISPLACED[change.name]
        turned, drive = diagnosis.parameters[f"{change.name}.direction"], diagnosis.configured
        angle = turned["value"] - (0.0 if change.name == "runout" else drive.kinematics.phase)
        period = direction_period(change.name, drive)
        towards = direction(angle, turned["std"], period).replace("modulo", "mod")
        size = spread_number(change.value * scale, change.std * scale, unit)
        return f"{what} is {size} at {towards} from the long axis, not {change.configured * scale:.1f} {unit}"
    name = {"circular_spline_datum": "datum"}.get(change.name, words(change.name))
    more = change.value - change.configured
    size = si(abs(more), change.std, change.unit)
    if change.name == "tooth_compliance":
        scale = 100.0 / change.configured
        size = spread_number(abs(more * scale), change.std * scale, "%")
    return f"{name} {'+' if more > 0.0 else '−'}{size}"


def _row_in_words(row: OrderRow) -> str:
    order = f"{row.order:.0f}" if row.order == round(row.order) else f"{row.order:.3f}"
    law = " at the rated torque" if row.nonlinear[1] else ""
    return f"{order} {_PER[row.frame]} ({arcsec(row.amplitude)}{law})"


def _describes(row: OrderRow, line: Unexplained) -> bool:
    """Whether a row of the order table describes the same wave."""
    is_wave = not line.description and line.frame == row.frame
    return is_wave and math.isclose(line.order, row.order, rel_tol=_SAME_ORDER)


def _cause_in_words(cause: Cause) -> str:
    name = words(cause.effect.name)
    if len(cause.alike) > 1:
        name = f"{' or '.join(map(words, cause.alike))} (this record cannot tell which)"
    usual = ", usual for a gear" if is_usual(cause) else ""
    return f"{name}, {arcsec(cause.amplitude)} rms{usual}"


_OF = {
    "torque": ("the torsion's shape", 1.0, "N m"),
    "speed": ("a part that follows the speed", 1.0, "rad/s"),
    "place": ("a part that follows the output's place", 180.0 / math.pi, "°"),
    "time": ("a slow drift", 1.0, "s"),
}  # in words, and the unit of where it is greatest


def _function_in_words(one: Function) -> str:
    name = one.effect.name.removeprefix("function_of_")
    if name not in _OF:
        order = name.removeprefix("line_")
        return f"a wave of {order} per input turn that changes with the torque ({arcsec(one.rms)} rms)"
    what, scale, unit = _OF[name]
    return f"{what} ({arcsec(one.largest)} at {one.at * scale:.3g} {unit})"


def _line_in_words(line: Unexplained) -> str:
    if line.description:
        return f"a part that {line.description} ({arcsec(line.amplitude)})"
    where = f" {line.where}" if line.where else ""
    return f"{line.order:.2f} {_PER[line.frame]}{where}, {arcsec(line.amplitude)}"


def summary(diagnosis: Diagnosis) -> list[str]:
    """The diagnosis in lines for a terminal."""
    answer = Answer(diagnosis)
    lines = [sentence(answer)]
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
    lines += [f"inspect: {cause.effect.inspect}" for cause in diagnosis.causes]
    untested = defaultdict[str, list[str]](list)
    for test in diagnosis.testable:
        if not test.testable:
            untested[test.reason].append(words(test.name))
    return lines + [f"not testable here: {', '.join(names)}: {why}" for why, names in untested.items()]
