"""Detection limits of a record's motion: the least size at which each effect would have been named."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.calibration import CERTAIN_SIZE, LEAST_SIZE, ODDS
from hd_diag.diagnosis.evidence.evidence import Evidence
from hd_diag.diagnosis.evidence.search import competes, is_searched
from hd_diag.diagnosis.evidence.sets import Set, presence
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.effects.effect import Effect, Values
from hd_diag.effects.excitation import torque_known
from hd_diag.effects.remainders import ORDERS
from hd_diag.formatting import words

NOT_PROVED = "possible, not proven"
"""Why an effect is neither found nor excluded."""

_LARGE = 3.0  # largest testable detection limit, in usual sizes
_MOST = 2.0  # least gain of information when an imitating effect is removed
_IMITATED = 0.02  # least share of an effect's information that nothing else imitates
_TOO_SMALL = "what is usual would not stand out here: record more of it, or more slowly"
_NO_START = "none of its lines would stand apart from others here: let the wave generator turn further"
_BY_PARAMETERS = "the model's own parameters imitate it: this record cannot tell them apart"


@dataclass(frozen=True)
class Detectability:
    """Whether an effect could be tested, the least size named with 99 % chance [rad rms], and the reason."""

    name: str
    testable: bool
    least_size: float
    reason: str


def testability(best: Set, undecided: Mapping[str, str]) -> tuple[Detectability, ...]:
    """Detectability of every effect of the catalogue on a record, given the best set of causes.

    `undecided` maps effects that are neither found nor excluded by this record to the reason.
    """
    fit, rest = best.fit, best.fit.remainder(best.chosen)
    points = {e.name: (e, point) for e in fit.data.searched if (point := _point(fit, rest, e)) is not None}
    evidence = best.evidence((f"?{name}", item) for name, item in points.items())
    tests = []
    for effect in fit.data.searched:
        lacking = fit.data.testable(effect)[1]
        if not competes(fit, effect):
            tests.append(Detectability(effect.name, False, math.nan, lacking or torque_known(fit.signals)[1]))
        elif effect.name in undecided:
            tests.append(Detectability(effect.name, False, math.nan, lacking or undecided[effect.name]))
        elif effect.name in best.names:
            tests.append(Detectability(effect.name, True, LEAST_SIZE, "found"))
        elif effect.name not in points or not is_searched(fit, effect):
            tests.append(Detectability(effect.name, False, math.nan, lacking or _NO_START))
        else:
            tests.append(_tested(best, evidence, *points[effect.name], lacking))
    return tuple(tests)


def _point(fit: LinearisedFit, rest: Floats, effect: Effect) -> Values | None:
    """Nonlinear values in the middle of the grid for a fit's residual (n,) [rad]; None without columns."""
    rough = fit.roughly(effect)
    points = effect.starts(rough.signals, rest).points if competes(fit, effect) else []
    point = points[len(points) // 2] if points else None
    return point if point is not None and rough.white(effect, point).shape[1] else None


def _tested(best: Set, evidence: Evidence, effect: Effect, point: Values, lacking: str) -> Detectability:
    """Detectability from the expected log odds of the effect, with everything else free and equal columns.

    The odds grow with the squared size times the information that nothing else imitates. They must exceed the
    threshold for a name by a margin for their own scatter.
    """
    inner, whole = evidence.information(best.widths, f"?{effect.name}")
    columns = best.fit.roughly(effect).columns(effect, point)[:, : effect.size] * effect.usual
    usual = float(np.sqrt(np.sum(np.var(columns, axis=0)) / effect.size))
    own = {name: width for name, width in best.widths.items() if name in best.names}
    share = float(np.trace(evidence.information(own, f"?{effect.name}")[0]) / max(np.trace(whole), 1e-300))
    width = 1.0  # prior width in usual sizes
    occam = 0.5 * float(np.sum(np.log1p(width**2 * np.maximum(np.linalg.eigvalsh(inner), 0.0))))
    needed = ODDS - presence(best.fit, effect) + occam
    root = math.sqrt(2.0 * needed) + CERTAIN_SIZE  # standard deviations: threshold plus 99 % margin
    by_odds = root / math.sqrt(max(float(np.trace(inner)) / effect.size, 1e-300))
    least = max(usual * by_odds, LEAST_SIZE / math.sqrt(max(share, 1e-12)))
    if share < _IMITATED:
        return Detectability(effect.name, False, math.nan, lacking or _BY_PARAMETERS)
    if by_odds > _LARGE:
        return Detectability(effect.name, False, least, lacking or _imitated(best, evidence, effect))
    return Detectability(effect.name, True, least, "tested")


def _imitated(best: Set, evidence: Evidence, effect: Effect) -> str:
    """The set's effect that imitates an effect most, in words; removing it frees the most information."""
    name = f"?{effect.name}"

    def left(without: str) -> float:
        rest = {one: width for one, width in best.widths.items() if one != without}
        return float(np.trace(evidence.information(rest, name)[0]))

    most = max(best.widths, key=left, default="")
    if not most or left(most) < _MOST * left(""):
        return _TOO_SMALL
    lines = {line.name: f"wave of order {line.order}" for line in ORDERS}
    what = lines.get(most) or words(most)
    return f"{what}, of which any joint has some, imitates it: this record cannot tell them apart"
