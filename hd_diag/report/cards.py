"""Cards for every cause and parameter that was found, and the joint compared with its limits."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from hd_diag.diagnosis.evidence.solution import Cause
from hd_diag.diagnosis.fit.fit_parameters import direction_period
from hd_diag.diagnosis.judgement import Answer, Beside, Limited
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE
from hd_diag.effects.quantity import Quantity
from hd_diag.formatting import direction, si, size, spread_number, words

_OWN = {effect.name: effect for effect in CATALOGUE}

_SIGMAS = 2.0
"""Least distance from zero, or from the configured value, of a number on a card [standard deviations]."""

_TOLD: dict[Beside, str] = {
    "within": "within",
    "near": "too near to its limit to judge",
    "beyond": "beyond",
    "open": "not known well enough",
}

_USUAL = "Usual for a new gear"
_WITHIN = "No limit is exceeded"

_Entries = Mapping[str, Mapping[str, Any]]  # value, std, unit and configured value of parameters
_Measures = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Card:
    """One finding: its `size` in the error [rad rms], its cause in a sentence, and what to measure.

    `inspect` says what to look at and which test would confirm the cause; `alternatives` are causes that look
    alike in this record. For a `setting` the configured number may be wrong, not the joint. `usual` says why
    no action is needed; empty if action is needed.
    """

    title: str
    size: float
    cause: str
    measures: _Measures
    inspect: str
    alternatives: _Measures = ()
    setting: bool = False
    usual: str = ""


def cards(answer: Answer) -> list[Card]:
    """Findings, then causes and parameters at least two standard deviations off, the largest first."""
    diagnosis = answer.diagnosis
    effects = _OWN | {effect.name: effect for effect in diagnosis.catalogue}
    advice = {name: effect.inspect for name, effect in effects.items()}
    first = [
        Card(words(f.name).capitalize(), math.nan, f.text, (), advice.get(f.name, ""))
        for f in diagnosis.findings
    ]
    found = [card for cause in diagnosis.causes if (card := _of_cause(answer, cause, advice))]
    kept = _kept(answer)
    by_title: dict[str, Card] = {}  # both compliances share a card
    if diagnosis.refitted is not None:
        for change in answer.changes:
            card = _OF_PARAMETER[change.name](diagnosis.parameters, diagnosis.refitted.drive)
            by_title.setdefault(card.title, replace(card, size=change.explains, usual=kept))
    return first + sorted([*found, *by_title.values()], key=lambda card: -card.size)


def _kept(answer: Answer) -> str:
    """Why parameters that are not as configured need no action; empty if they do."""
    places = [one.place for one in (answer.normal, answer.tolerance) if one is not None]
    return "" if "beyond" in places or "near" in places else _WITHIN


def _of_cause(answer: Answer, cause: Cause, advice: Mapping[str, str]) -> Card | None:
    """The card of a cause; None if all its sizes may be zero."""
    effect = cause.effect
    values = effect.to_physical(cause.coefficients, cause.nonlinear)
    spread = effect.standard_deviations(cause.coefficients, cause.nonlinear, cause.covariance)
    sizes, sure, measures = 0, 0, []
    for entry in effect.quantities:
        value, std = values[entry.name][0], spread.get(entry.name, math.nan)
        known = _known(entry, value, std)
        if known and not entry.shape and (told := quantity(entry, value, std)):
            measures.append((words(entry.name), told))
        if entry.linear and entry.periodic is None:
            sizes, sure = sizes + 1, sure + known
    if sizes and not sure:
        return None
    others = tuple((words(name), advice.get(name, "")) for name in cause.alike if name != effect.name)
    title = words(effect.name).capitalize()
    usual = _USUAL if answer.is_usual(cause) else ""
    return Card(title, cause.amplitude, effect.cause, tuple(measures), effect.inspect, others, usual=usual)


def _known(entry: Quantity, value: float, std: float) -> bool:
    """Whether a size is two standard deviations off zero, or a direction is as certain as such a wave's."""
    if entry.periodic is not None:
        return not std * math.tau / entry.periodic > 1.0 / _SIGMAS
    return not (entry.linear and abs(value) < _SIGMAS * std)


def quantity(entry: Quantity, value: float, spread: float) -> str:
    """Text of an effect's quantity; for a switch the words of its meaning, which may be empty."""
    if entry.discrete and (entry.low, entry.high) == (0.0, 1.0):
        forms = dict(form.split(": ", 1) for form in re.split(r", (?=1: )", entry.meaning))
        return forms.get(f"{value:.0f}", "")
    if entry.periodic is not None:
        return direction(value, spread, entry.periodic)
    if entry.unit == "rad" and entry.name == "angle":
        return spread_number(math.degrees(value), math.degrees(spread), "°")
    return si(value, spread, entry.unit)


def _eccentricity(values: _Entries, drive: Drive) -> Card:
    magnitude, turned = values["eccentricity.magnitude"], values["eccentricity.direction"]
    # Input angle at which the long axis points along the eccentricity.
    rate = drive.frame.turning
    angle, period = (turned["value"] - drive.frame.phase) / rate, math.pi / abs(rate)
    return Card(
        "Eccentricity of the wave generator in the housing",
        math.nan,
        "The wave generator's axis stands beside the circular spline's: flange, seat or bearing is off "
        "centre.",
        (
            *_displacement("eccentricity", magnitude),
            ("direction, from slot 0", direction(turned["value"], turned["std"], math.pi)),
            ("input angle with the long axis there", direction(angle, turned["std"] / abs(rate), period)),
        ),
        "Hold a dial gauge on the motor shaft and sweep the circular spline's centring diameter over a turn: "
        "the total travel is twice the eccentricity, highest and lowest along the direction given "
        "(counter-clockwise, seen against the circular spline's axis). Then the motor flange's spigot and "
        "the circular spline's seat. To confirm: turn the motor flange by a quarter turn, tighten crosswise, "
        "record again. The direction follows an off-centre flange and stays with an off-centre circular "
        "spline; half a turn would show nothing, for opposite directions act alike.",
    )


def _runout(values: _Entries, _: Drive) -> Card:
    magnitude, turned = values["runout.magnitude"], values["runout.direction"]
    return Card(
        "Runout of the wave generator on its shaft",
        math.nan,
        "The wave generator's plug turns off centre: its bore, the key or the shaft.",
        (
            *_displacement("runout", magnitude),
            ("direction, from the long axis", direction(turned["value"], turned["std"], 2.0 * math.pi)),
        ),
        "Dial gauge on the shaft's seat for the plug, then on the plug's own bore: the total travel is twice "
        "the runout. Its direction and the eccentricity's may both be turned by 180°: only together are they "
        "known. To confirm: turn the plug on the shaft and record again; the direction moves with it.",
    )


def _tilt(values: _Entries, drive: Drive) -> Card:
    magnitude, turned = values["tilt.magnitude"], values["tilt.direction"]
    size = spread_number(magnitude["value"] * 1e3, magnitude["std"] * 1e3, "mrad")
    return Card(
        "Tilt of the wave generator in the housing",
        math.nan,
        "The wave generator's axis leans against the circular spline's: a flange that is not square, dirt or "
        "a burr under it, or play of the motor's bearings.",
        (
            ("tilt", f"{size} (configured: {magnitude['configured'] * 1e3:.2g} mrad)"),
            (
                "direction, from slot 0",
                direction(turned["value"], turned["std"], direction_period("tilt", drive)),
            ),
        ),
        "Dial gauge on the motor shaft against the circular spline's face, over a turn: the total travel "
        "over twice the gauge's radius is the tilt. Check the motor flange's face. To confirm: turn "
        "the motor flange by a quarter turn and record again. Along the teeth the tilt adds to the "
        "eccentricity: towards the open end in the direction given, towards the cup's bottom against it.",
    )


def _datum(values: _Entries, _: Drive) -> Card:
    entry = values["circular_spline_datum"]
    change = entry["value"] - entry["configured"]
    more, out = ("more", "farther out") if change > 0.0 else ("less", "farther in")
    return Card(
        f"The teeth have {more} clearance than configured",
        math.nan,
        f"The circular spline's slots stand {size(abs(change), 'm')} {out} than configured.",
        (("datum radius", _beside(entry)),),
        _OWN["wear_backlash"].inspect,
        setting=True,
    )


def _compliance(values: _Entries, _: Drive) -> Card:
    names = ("tooth_compliance", "cup_compliance")
    both = [(words(name), values[name]) for name in names]
    changed = [(name, e) for name, e in both if not abs(e["value"] - e["configured"]) < _SIGMAS * e["std"]]
    return Card(
        "Torsional stiffness",
        math.nan,
        "The torsion under load is not as configured.",
        tuple((name, _beside(entry)) for name, entry in changed),
        _OWN["torsional_hardening"].inspect,
        setting=True,
    )


def _beside(entry: Mapping[str, Any]) -> str:
    """A fitted value beside the configured one."""
    unit = entry["unit"]
    return f"{si(entry['value'], entry['std'], unit)} (configured: {size(entry['configured'], unit)})"


def _displacement(name: str, entry: Mapping[str, Any]) -> _Measures:
    """A displacement, and the travel of a dial gauge over a turn, which is twice as large."""
    travel = si(2.0 * entry["value"], 2.0 * entry["std"], "m")
    return (name, _beside(entry)), ("dial gauge, total travel", travel)


_OF_PARAMETER: dict[str, Callable[[_Entries, Drive], Card]] = {
    "eccentricity": _eccentricity,
    "runout": _runout,
    "tilt": _tilt,
    "circular_spline_datum": _datum,
    "tooth_compliance": _compliance,
    "cup_compliance": _compliance,
}


# Limits ---


class Gauge(NamedTuple):
    """A value compared with its limit, in words; `share` is value over limit [-]."""

    name: str
    state: Beside
    text: str
    share: float


def gauges(answer: Answer) -> tuple[Gauge, ...]:
    """Error and eccentricity compared with their limits, as far as they are known."""
    found, allowed = [], answer.diagnosis.allowed
    if answer.normal is not None:
        name = "Transmission error without torsion, peak to peak"
        found.append(_gauge(name, "accuracy", answer.normal))
    if answer.tolerance is not None and allowed is not None:
        found.append(_gauge("Eccentricity", f"limit by {words(allowed.criterion)}", answer.tolerance))
    return tuple(found)


def _gauge(name: str, limit: str, one: Limited) -> Gauge:
    value, most = si(one.value, one.std, one.unit), size(one.limit, one.unit)
    share = one.value / one.limit if one.limit > 0.0 else 2.0  # a limit of zero: the end of the scale
    return Gauge(name, one.place, f"{value}; {limit} {most}: {_TOLD[one.place]}", share)
