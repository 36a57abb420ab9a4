"""How bad a joint is: its error beside its accuracy, its eccentricity beside what the assembly may have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hd_diag.diagnosis.judgement import Answer, Beside, Limited
from hd_diag.formatting import si, size, words

RED, GREY, AMBER, GREEN = STATES = ("red", "not_judged", "amber", "green")
"""Of joints, the worst first: what is not known is worse than what is nearly too much."""

COLOURS: dict[Beside, str] = {"within": GREEN, "near": AMBER, "beyond": RED, "open": GREY}

_TOLD: dict[Beside, str] = {
    "within": "within",
    "near": "too near to its limit to judge",
    "beyond": "beyond",
    "open": "not known well enough",
}


class Gauge(NamedTuple):
    """A value beside its limit, in words; `share` of the limit that it has [-]."""

    name: str
    state: Beside
    text: str
    share: float

    @property
    def low(self) -> float:
        """End of the good part of a meter that goes to twice the limit."""
        return 1e-6 if self.state in ("near", "open") else 1.0

    @property
    def high(self) -> float:
        """Beginning of its bad part."""
        return 2.0 if self.state in ("near", "open") else 1.0


def gauges(answer: Answer) -> tuple[Gauge, ...]:
    """Error and eccentricity beside their limits, as far as there is something to tell."""
    found, allowed = [], answer.diagnosis.allowed
    if answer.normal is not None:
        name = "Transmission error without torsion, peak to peak"
        found.append(_gauge(name, "accuracy", answer.normal))
    if answer.tolerance is not None and allowed is not None:
        found.append(_gauge("Eccentricity", f"limit by {words(allowed.criterion)}", answer.tolerance))
    return tuple(found)


def worst(found: Sequence[Gauge]) -> str:
    """Colour of a joint with these gauges, as far as they are known."""
    known = [COLOURS[gauge.state] for gauge in found if gauge.state != "open"]
    return min(known, key=STATES.index, default=GREY)


def _gauge(name: str, limit: str, one: Limited) -> Gauge:
    value, most = si(one.value, one.std, one.unit), size(one.limit, one.unit)
    return Gauge(name, one.place, f"{value}; {limit} {most}: {_TOLD[one.place]}", one.value / one.limit)
