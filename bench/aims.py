"""Targets for the benchmark of the diagnosis, family by family."""

# ruff: noqa: D103

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from challenge.families import FAMILIES
from challenge.families import POOR as POOR_MOTIONS
from scoring import PARAMETERS as PARAMETERS
from scoring import Score

OWN = "hd_diag"
KNOWN = ("wrong_parameters", "one_effect", "pair", "triple")
POOR = tuple(POOR_MOTIONS)
ROBOT = tuple(family for family in FAMILIES if family.startswith("robot"))
Figure = Callable[[list[Score]], Iterable[float | bool | None]]


@dataclass(frozen=True)
class Aim:
    """Target range of one figure: of its share [%] if `share` is set, otherwise of its median."""

    name: str
    families: tuple[str, ...]
    figure: Figure
    low: float
    high: float
    share: bool = True

    def found(self, scores: list[Score]) -> float:
        """The share [%] or the median; nan if no record has the figure."""
        own = self.figure([s for s in scores if s.method == OWN and s.family in self.families])
        given = [float(v) for v in own if v is not None and np.isfinite(v)]
        if not given:
            return math.nan
        return 100.0 * float(np.mean(given)) if self.share else float(np.median(given))


def _right(scores: list[Score]) -> Iterable[bool]:
    return (s.right for s in scores)


def _false(scores: list[Score]) -> Iterable[bool]:
    return (s.false_names > 0 for s in scores)


TARGETS = (
    Aim("wrong parameters only: records with a false name [%]", KNOWN[:1], _false, 0.0, 0.4),
    Aim(
        "wrong parameters only: within their 95 % interval [%]",
        KNOWN[:1],
        lambda s: (x.covered / PARAMETERS for x in s if x.covered is not None),
        *(93.0, 97.0),
    ),
    Aim("one effect: right up to class [%]", KNOWN[1:2], _right, 99.0, 100.0),
    Aim(
        "one effect: amplitude error, median [%]",
        KNOWN[1:2],
        lambda s: (100.0 * e for x in s for e in x.amplitude_errors),
        *(0.0, 2.0, False),
    ),
    Aim("pairs: right up to class [%]", KNOWN[2:3], _right, 97.0, 100.0),
    Aim("triples: right up to class [%]", KNOWN[3:], _right, 93.0, 100.0),
    Aim("unknown effect: flagged [%]", ("unknown",), lambda s: (x.flagged for x in s), 99.0, 100.0),
    Aim("unknown effect: records with a false name [%]", ("unknown",), _false, 0.0, 2.0),
    Aim(
        "unknown effect: its order within 0.02 [%]",
        ("unknown",),
        lambda s: (x.order_right for x in s if x.order_right is not None),
        *(99.0, 100.0),
    ),
    Aim(
        "held-out residual over noise, median", KNOWN, lambda s: (x.over_floor for x in s), 0.0, 1.005, False
    ),
    Aim("poor motions: records with a false name [%]", POOR, _false, 0.0, 0.0),
    Aim("dropouts, outliers, jitter: right up to class [%]", ("degraded",), _right, 97.0, 100.0),
    Aim(
        "faultless: records with a name or an eccentricity [%]",
        ("faultless",),
        lambda s: (x.claimed or x.false_names > 0 for x in s),
        *(0.0, 0.4),
    ),
    Aim("robot, one mechanism: right up to class [%]", ("robot_single",), _right, 95.0, 100.0),
    Aim("robot, two mechanisms: right up to class [%]", ("robot_pair",), _right, 85.0, 100.0),
    Aim("robot: records with a false name [%]", ROBOT, _false, 0.0, 2.0),
    Aim("bench, one mechanism: right up to class [%]", ("bench_single",), _right, 95.0, 100.0),
    Aim("bench, two mechanisms: right up to class [%]", ("bench_pair",), _right, 85.0, 100.0),
    Aim("joint as its page: records with a false name [%]", ("page_none",), _false, 0.0, 1.0),
    Aim("joint as its page, one fault: right up to class [%]", ("page_single",), _right, 95.0, 100.0),
    Aim(
        "residual above 1.3 times the noise, and nothing said [%]",
        tuple(FAMILIES),
        lambda s: (x.passed_over for x in s if x.over_noise is not None),
        *(0.0, 0.0),
    ),
    Aim(
        "CPU time of a record, median [s]", tuple(FAMILIES), lambda s: (x.seconds for x in s), 0.0, 5.0, False
    ),
)


def targets(scores: list[Score]) -> str:
    lines = ["| target | wanted | found | reached |", "| --- | --- | --- | --- |"]
    for target in TARGETS:
        found = target.found(scores)
        if not np.isfinite(found):
            continue
        wanted = f"at most {target.high:g}" if target.low == 0.0 else f"{target.low:g} to {target.high:g}"
        reached = "yes" if target.low <= found <= target.high else "no"
        lines.append(f"| {target.name} | {wanted} | {found:.4g} | {reached} |")
    return "\n".join(lines)
