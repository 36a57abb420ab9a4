"""What this record's motion could have shown: the least size of each effect that would have been found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import optimize, stats

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.search.acceptance import FAMILY_ERROR, LEAST_SIZE
from hd_diag.diagnosis.search.causes import Search
from hd_diag.diagnosis.search.ranking import Projector, competes, family_size
from hd_diag.effects.effect import Effect
from hd_diag.effects.excitation import torque_known

_POWER = 0.99
_OWN = 1e-3  # least share of an effect that the model's own parameters cannot imitate
_LARGE = 3.0  # times the usual size
_TOO_SMALL = "what is usual would not stand out here: record more of it, or more slowly"
_NO_START = "none of its lines would stand apart from others here: let the wave generator turn further"
_IMITATED = "the model's own parameters imitate it: this record cannot tell them apart"


@dataclass(frozen=True)
class Detectability:
    """Whether an effect could be tested, the least size found with 99 % chance [rad rms], and why."""

    name: str
    testable: bool
    least_size: float
    reason: str


def testability(found: Search) -> list[Detectability]:
    """Detectability of every effect of the catalogue on a record."""
    fit = found.fit
    named = {effect.name for effect, _ in found.chosen}
    beside, family = Projector(fit, found.chosen), max(family_size(fit), 1)
    rest = fit.remainder(found.chosen)
    return [
        Detectability(effect.name, True, LEAST_SIZE, "found")
        if effect.name in named
        else _tested(fit, effect, beside, rest, family)
        for effect in fit.data.searched
    ]


def _tested(
    fit: LinearisedFit, effect: Effect, beside: Projector, rest: Floats, family: int
) -> Detectability:
    """By what the record determines with everything else free; the motion says what it lacks, in words."""
    lacking = fit.data.testable(effect)[1]
    if not competes(fit, effect):  # where the motion lacks nothing the torque is not known
        return Detectability(effect.name, False, math.nan, lacking or torque_known(fit.signals)[1])
    if not effect.starts(fit.signals, rest).points:
        return Detectability(effect.name, False, math.nan, lacking or _NO_START)
    nonlinear = fit.data.grid(effect)[len(fit.data.grid(effect)) // 2]
    columns, white = fit.columns(effect, nonlinear), fit.white(effect, nonlinear)
    own = float(np.sum(beside.off(white) ** 2))
    information = own / max(float(np.sum(np.mean(columns**2, axis=0))), 1e-300)
    size = math.sqrt(_noncentrality(columns.shape[1], family) / max(information, 1e-300))
    if own < _OWN * max(float(np.sum(white**2)), 1e-300):
        return Detectability(effect.name, False, size, lacking or _IMITATED)
    if size > _usual(effect, columns):
        return Detectability(effect.name, False, size, lacking or _TOO_SMALL)
    return Detectability(effect.name, True, max(size, LEAST_SIZE), "tested")


def _usual(effect: Effect, columns: Floats) -> float:
    """Size that the effect has where it is large, by what is usual for its quantities [rad rms]."""
    scales = np.array([quantity.prior_scale**quantity.power for quantity in effect.linear])
    used = [not quantity.periodic for quantity in effect.linear]
    rms = np.sqrt(np.mean(columns[:, : effect.size] ** 2, axis=0))
    return _LARGE * float(np.max((rms * scales)[used], initial=0.0))


@lru_cache(maxsize=64)
def _noncentrality(width: int, family: int) -> float:
    """Noncentrality at which a chi-square test at the family's level has the power wanted."""
    threshold = stats.chi2.isf(FAMILY_ERROR / family, width)
    return float(optimize.brentq(lambda x: stats.ncx2.sf(threshold, width, x) - _POWER, 1.0, 1000.0))
