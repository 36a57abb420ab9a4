"""A diagnosis in words: a headline, and one statement for each result."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.calibration import TWO_SIDED
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.evidence.order_table import OrderRow
from hd_diag.diagnosis.evidence.search import FURTHER_CAUSES
from hd_diag.diagnosis.evidence.solution import Cause, Function
from hd_diag.diagnosis.evidence.unexplained import Unexplained
from hd_diag.diagnosis.fit.fit_parameters import direction_period
from hd_diag.diagnosis.judgement import Answer, Change, first_words
from hd_diag.effects.effect import Effect
from hd_diag.effects.remainders import EVEN, SPEED, Line
from hd_diag.formatting import ARCSEC, arcsec, direction, si, spread_number, words

_DISPLACED = {
    "eccentricity": ("the eccentricity", 1e6, "µm"),
    "runout": ("the wave generator's runout", 1e6, "µm"),
    "tilt": ("the wave generator's tilt", 1e3, "mrad"),
}  # name, scale and unit in messages
_SAME_ORDER = 0.02  # relative difference of two estimates of the same order
_DECLARE = "give the signal the unit A, as in current[A]*11.2"
_PER = {"input": "per input turn", "output": "per output turn", "time": "Hz"}


def sentence(answer: Answer) -> str:
    """The verdict in one sentence: the headline, then all statements."""
    return ended("; ".join([first_words(answer), *statements(answer)]))


def sentences(answer: Answer) -> list[str]:
    """The verdict as separate sentences, without a fatal finding, because the advice states it."""
    fatal = any(finding.fatal for finding in answer.diagnosis.findings)
    parts = [*([] if fatal else [first_words(answer)]), *statements(answer)]
    return [ended(f"{part[:1].upper()}{part[1:]}") for part in parts]


def statements(answer: Answer) -> list[str]:
    """All statements of the diagnosis after its headline."""
    diagnosis = answer.diagnosis
    lost = diagnosis.record.stamps.lines
    if any(finding.fatal for finding in diagnosis.findings):
        return list(lost)
    parts = list(dict.fromkeys([*(finding.text for finding in diagnosis.findings), *lost]))
    parts += [_parameters(answer), *_current(diagnosis)]
    if diagnosis.refitted is not None:
        parts += _causes(answer)
    return [*parts, *_without_a_name(diagnosis), *_limits(diagnosis)]


def _without_a_name(diagnosis: Diagnosis) -> list[str]:
    """Unexplained lines, described lines, and remainders that are larger than usual."""
    rows = [row for row in diagnosis.order_table if row.repeats]
    lines = [one for one in diagnosis.unexplained if not any(_describes(row, one) for row in rows)]
    groups = {
        "unexplained": map(line_in_words, lines),
        "described, not explained": map(_row_in_words, rows),
        "larger than usual, by no known cause": map(function_in_words, diagnosis.larger),
    }
    told = {name: ", ".join(some) for name, some in groups.items()}
    return [f"{name}: {some}" for name, some in told.items() if some]


def _limits(diagnosis: Diagnosis) -> list[str]:
    """Limits of the diagnosis: hints that do not improve prediction, unused rows, and lack of time."""
    rms, record, parts = diagnosis.rms, diagnosis.record, []
    if rms is not None and diagnosis.hints and not diagnosis.predicting:
        parts.append(
            "held-out data are predicted no better with it than without "
            f"({rms.with_causes / ARCSEC:.2f} against {arcsec(rms.without_causes)}): record more"
        )
    if record.size < record.extent.samples:
        samples = f"{record.size} of {record.extent.samples} samples"
        parts.append(f"fitted to {samples}, in stretches all over the record")
    if diagnosis.left_out:
        parts.append(f"the time limit was reached, so this was left out: {', '.join(diagnosis.left_out)}")
    return parts


def _causes(answer: Answer) -> list[str]:
    """Named causes, then hints; or why there are none."""
    found = answer.diagnosis
    hints = [f"{_cause_in_words(answer, cause)}: {found.doubt(cause)}" for cause in found.hints]
    parts = {
        "beside that": [_cause_in_words(answer, cause) for cause in found.causes],
        "possible, but not named": hints,
    }
    if said := [f"{how}: {'; '.join(some)}" for how, some in parts.items() if some]:
        return said
    if FURTHER_CAUSES in found.left_out:
        return ["no cause was found within the time limit"]
    if not found.unexplained and answer.judgement != "misfit":
        return ["no other cause is needed"]
    return ["none of the known causes explains the rest"]


def ended(text: str) -> str:
    """A text with a full stop, unless it ends with one or with a question mark."""
    return text if text.endswith(("?", ".")) else f"{text}."


def _current(diagnosis: Diagnosis) -> list[str]:
    """What cannot be determined if the torque is a motor's current, or how to state that; else empty."""
    values = motor_values(diagnosis)
    if values is None:
        known = diagnosis.record.by_current or not diagnosis.record.has_torque
        if known or all(one.effect is not SPEED for one in diagnosis.larger):
            return []
        return [
            "friction of a motor makes a part that follows the speed: if the torque was computed from its "
            f"current, {_DECLARE}, and this friction is fitted"
        ]
    gain, dry = values["relative_error"], values["friction"]
    constant = spread_number(100.0 * gain["value"], 100.0 * gain["std"], "%")
    seen = f" (the record shows it; {_DECLARE})" if diagnosis.record.undeclared else ""
    return [
        f"the torque is a motor's current{seen}: its constant "
        f"({'+' if gain['value'] > 0.0 else ''}{constant}), friction "
        f"({spread_number(dry['value'], dry['std'], 'N m')}) and inertia are fitted too, so neither the "
        "stiffness nor a small friction can be determined"
    ]


def _parameters(answer: Answer) -> str:
    """Result of the parameter fit in words; the parameter with the largest effect on the error first."""
    diagnosis, changed = answer.diagnosis, answer.changes
    if diagnosis.refitted is None:
        return "described by its orders alone, without a tooth model: nothing is said about causes"
    if not diagnosis.refitted.trustworthy:
        return f"the model's parameters are not judged: {diagnosis.refitted.doubt}"
    if not changed:
        size = diagnosis.parameters["eccentricity.magnitude"]
        text = f"the eccentricity is as configured ({size['configured'] * 1e6:.1f} µm)"
        away = abs(size["value"] - size["configured"]) + TWO_SIDED * size["std"]
        most = diagnosis.kept.get("eccentricity", away)
        # A bound is valid only if the model describes the record.
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


def _cause_in_words(answer: Answer, cause: Cause) -> str:
    which = " (this record cannot tell which)" if len(cause.alike) > 1 else ""
    usual = ", usual for a gear" if answer.is_usual(cause) else ""
    return f"{names_of(cause)}{which}, {arcsec(cause.amplitude)} rms{usual}"


def names_of(cause: Cause) -> str:
    """Name of a cause in words, with all causes that this record cannot distinguish from it."""
    return " or ".join(map(words, cause.alike))


_OF = {
    "torque": ("the torsion's shape", 1.0, "N m"),
    "history": ("a part that depends on where the torque came from", 1.0, "N m"),
    "speed": ("a part that follows the speed", 1.0, "rad/s"),
    "place": ("a part that follows the output's place", 180.0 / math.pi, "°"),
    "time": ("a slow drift", 1.0, "s"),
}  # in words; scale and unit of the place of the maximum


def function_in_words(one: Function) -> str:
    """A remainder in words, with its size."""
    name = one.effect.name.removeprefix("function_of_")
    if isinstance(one.effect, Line):
        law = "" if one.effect is EVEN else " that changes with the torque"
        return f"a wave of {one.effect.order} per input turn{law} ({arcsec(one.rms)} rms)"
    what, scale, unit = _OF[name]
    return f"{what} ({arcsec(one.largest)} at {one.at * scale:.3g} {unit})"


def line_in_words(line: Unexplained) -> str:
    """An unexplained part in words, with its size."""
    if line.description:
        return f"a part that {line.description} ({arcsec(line.amplitude)})"
    where = f" {line.where}" if line.where else ""
    return f"{line.order:.2f} {_PER[line.frame]}{where}, {arcsec(line.amplitude)}"


# Numbers ---


def motor_values(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Fitted torque constant, friction and inertia of the motor; None if the torque is not from current."""
    for term in diagnosis.model.effects if diagnosis.model else ():
        if term.effect.given:
            return values_of(term.effect, np.array(term.coefficients), term.nonlinear, diagnosis.motor_std)
    return None


def values_of(
    effect: Effect, coefficients: Floats, nonlinear: tuple[float, ...], stds: dict[str, float]
) -> dict[str, Any]:
    """Physical quantities of an effect, with their standard deviations; nan if unknown."""
    return {
        name: {"value": value, "std": stds.get(name, math.nan), "unit": unit}
        for name, (value, unit) in effect.to_physical(coefficients, nonlinear).items()
    }
