"""What to do about a joint: one action, its reasons, and how sure each is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

from scipy.special import ndtr

from hd_diag.diagnosis.calibration import NAMED, NOTICED
from hd_diag.diagnosis.judgement import Answer, Limited
from hd_diag.diagnosis.statements import ended, function_in_words, line_in_words, names_of
from hd_diag.effects.remainders import ORDERS
from hd_diag.formatting import percent, si, size, words

Action = Literal["nothing", "watch", "inspect"]

RED, GREY, AMBER, GREEN = LIGHTS = ("red", "not_judged", "amber", "green")
"""Traffic lights of joints, the worst first: an unknown state is worse than one near its limit."""

_SERIOUS = ("tooth_skip",)  # findings about the gear; all others are about signals
_MOST_REASONS = 3  # reasons in one line
_CERTAIN = 0.999  # highest probability that is stated
_NO_TORQUE = ", because its torque is not measured"
_CHECK = "Check ratio, units, signs, clock and torque first"


class Reason(NamedTuple):
    """Reason for an action, in words, and its probability; nan if unknown."""

    action: Action
    text: str
    probability: float = math.nan

    def __str__(self) -> str:
        return self.text if math.isnan(self.probability) else f"{self.text} ({_sure(self.probability)})"


class Advice(NamedTuple):
    """An action, its traffic light, and one line with the reasons and their probabilities.

    The light is ``not_judged`` if the joint cannot be judged; the action is then about the record.
    """

    action: Action
    light: str
    text: str


def cannot_be_judged(reason: str, action: Action = "watch") -> Advice:
    """Advice about a joint that cannot be judged, for a reason."""
    return Advice(action, GREY, ended(f"Cannot be judged: {reason}"))


def advice(answer: Answer) -> Advice:
    """What to do: inspect what was found or exceeds a limit; watch what is possible or unknown."""
    reasons = list(_reasons(answer))
    for finding in answer.diagnosis.findings:
        if finding.fatal:
            return cannot_be_judged(finding.text, "inspect")
    if asked := [reason for reason in reasons if reason.action == "inspect"]:
        return Advice("inspect", RED, f"Inspect: {_listed(asked)}")
    if why := _unjudged(answer):
        return cannot_be_judged(why)
    if reasons:
        return Advice("watch", AMBER, f"Watch: {_listed(reasons)}")
    if answer.normal is None or not answer.normal.within:
        why = "" if answer.diagnosis.record.has_torque else _NO_TORQUE
        return cannot_be_judged(f"whether its error is within the accuracy is not known{why}", "nothing")
    return Advice("nothing", GREEN, f"Nothing to do: {_all_within(answer)}")


def _reasons(answer: Answer) -> Iterator[Reason]:
    """Findings, limits, causes, hints, larger than usual remainders, and unexplained parts without a line."""
    found = answer.diagnosis
    for finding in found.findings:
        yield Reason("inspect" if finding.name in _SERIOUS else "watch", finding.text)
    for limited in (answer.normal, answer.tolerance):
        if limited is not None and limited.place in ("beyond", "near"):
            yield _of_limit(limited)
    for cause in found.causes:
        if not answer.is_usual(cause):
            yield Reason("inspect", names_of(cause), cause.standing.probability)
    for hint in found.hints:
        likely = hint.standing.probability
        if not answer.is_usual(hint):
            yield Reason("watch", f"{names_of(hint)}, not proven", likely if likely < NAMED else math.nan)
    noticed = 0.5 * NOTICED * found.configured.accuracy  # half of a peak-to-peak value
    for one in found.larger:
        if one.effect in ORDERS and answer.normal is not None and answer.normal.within:
            continue  # the catalogue's accuracy includes it
        if one.largest > noticed:
            yield Reason("watch", f"{function_in_words(one)} is larger than usual")
    for line in found.unexplained:
        if not line.order and line.amplitude > noticed:
            yield Reason("watch", line_in_words(line))


def _of_limit(limited: Limited) -> Reason:
    value, limit = si(limited.value, limited.std, limited.unit), size(limited.limit, limited.unit)
    is_beyond = limited.place == "beyond"
    verb = "is" if is_beyond else "may be"
    text = f"the {words(limited.quantity)} {verb} beyond its limit: {value}, allowed {limit}"
    return Reason("inspect" if is_beyond else "watch", text, _beyond(limited))


def _unjudged(answer: Answer) -> str:
    """Why the joint cannot be judged; empty if it can."""
    found = answer.diagnosis
    if answer.judgement == "misfit":
        return f"the model does not describe this record. {_CHECK}"
    if answer.judgement == "not_judged":
        return "the record does not allow a fit" if found.rms is None else "no line of its error repeats"
    return ""


def _all_within(answer: Answer) -> str:
    """Sentence that all limits are kept, with causes that are usual for a new gear."""
    limits = [one for one in (answer.normal, answer.tolerance) if one is not None and one.within]
    names = " and ".join(f"the {words(one.quantity)}" for one in limits)
    kept = "are within their limits" if len(limits) > 1 else "is within its limit"
    text = f"{names} {kept} ({_sure(min(1.0 - _beyond(one) for one in limits))})."
    usual = ", ".join(names_of(cause) for cause in answer.diagnosis.causes if answer.is_usual(cause))
    return f"{text} Usual for a new gear: {usual}." if usual else text


def _beyond(limited: Limited) -> float:
    """Probability that a value is beyond its limit, from its standard deviation; nan if that is unknown."""
    return float(ndtr((limited.value - limited.limit) / limited.std)) if limited.std > 0.0 else math.nan


def _sure(probability: float) -> str:
    if probability > _CERTAIN:
        return f"more than {percent(_CERTAIN)} sure"
    return f"{percent(probability)} sure" if probability >= NAMED else f"{percent(probability, 0)} likely"


def _listed(reasons: Sequence[Reason]) -> str:
    more = len(reasons) - _MOST_REASONS
    return ended("; ".join(map(str, reasons[:_MOST_REASONS])) + (f"; and {more} more" if more > 0 else ""))
