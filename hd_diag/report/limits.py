"""How bad a joint is: its error beside its accuracy, its eccentricity beside what the assembly may have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hd_diag.diagnosis.judgement import Answer, Beside, beside
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
    told: str
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
    found, usual, assembly = [], answer.normal, answer.tolerance
    if usual is not None:
        name = "Transmission error without torsion, peak to peak"
        found.append(_gauge(name, "accuracy", usual.measured, usual.std, usual.accuracy, "rad"))
    if assembly is not None:
        limit = f"limit by {words(assembly.criterion)}"
        own = (assembly.eccentricity, assembly.std, assembly.allowed)
        found.append(_gauge("Eccentricity", limit, *own, "m"))
    return tuple(found)


def worst(found: Sequence[Gauge]) -> str:
    """Colour of a joint with these gauges, as far as they are known."""
    known = [COLOURS[gauge.state] for gauge in found if gauge.state != "open"]
    return min(known, key=STATES.index, default=GREY)


def _gauge(name: str, limit: str, value: float, std: float, most: float, unit: str) -> Gauge:
    state = beside(value, std, most)
    told = f"{si(value, std, unit)}; {limit} {size(most, unit)}: {_TOLD[state]}"
    return Gauge(name, state, told, value / most)
