"""What this record's motion could have shown: the least size of each effect that would have been named."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import optimize, stats

from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.gain import Rms
from hd_diag.diagnosis.search.acceptance import (
    FAMILY_ERROR,
    LEAST_SIZE,
    OVERSTATED,
    by_chance,
    least_size,
    own_part,
    size,
)
from hd_diag.diagnosis.search.causes import Search
from hd_diag.diagnosis.search.ranking import Candidate, competes, family_size, ranked
from hd_diag.effects.effect import Effect
from hd_diag.effects.excitation import torque_known

NOT_PROVED = "what is left looks like it, and does not prove it"
"""Why an effect is neither found nor absent."""

_POWER = 0.99
_LEARNED = 0.6  # of what an effect gains, that a likelihood gains: noise learned without it follows it
_OWN = 1e-3  # least share of an effect that the model's own parameters cannot imitate
_LARGE = 3.0  # times the usual size
_TOO_SMALL = "what is usual would not stand out here: record more of it, or more slowly"
_NO_START = "none of its lines would stand apart from others here: let the wave generator turn further"
_IMITATED = "the model's own parameters imitate it: this record cannot tell them apart"


@dataclass(frozen=True)
class Detectability:
    """Whether an effect could be tested, the least size named with 99 % chance [rad rms], and why."""

    name: str
    testable: bool
    least_size: float
    reason: str


def testability(found: Search, rms: Rms, undecided: Mapping[str, str]) -> tuple[Detectability, ...]:
    """Detectability of every effect of the catalogue on a record, beside the causes found in the fitted rows.

    `undecided` are those that would not be named, or not be absent, whatever this record shows, and why; what
    may be left beyond the noise is in `rms`. Parameters that stay as configured are free here, as they are
    while causes are looked for.
    """
    fit, chosen = replace(found.fit, held=()), found.chosen
    named = {effect.name for effect, _ in chosen}
    family = max(family_size(fit), 1)
    rivals = [effect for effect in fit.data.searched if effect.name not in undecided]
    best = {one.effect.name: one for one in ranked(fit, chosen, rivals)}
    tests = []
    for effect in fit.data.searched:
        lacking = _lacking(fit, effect)
        if effect.name in undecided or not competes(fit, effect):
            tests.append(Detectability(effect.name, False, math.nan, lacking or undecided[effect.name]))
        elif effect.name in named:
            tests.append(Detectability(effect.name, True, LEAST_SIZE, "found"))
        else:
            tests.append(_tested(fit, chosen, effect, best.get(effect.name), rms, family, lacking))
    return tuple(tests)


def _lacking(fit: LinearisedFit, effect: Effect) -> str:
    """What the motion lacks to show an effect; where it lacks nothing, that the torque is not known."""
    lacking = fit.data.testable(effect)[1]
    return lacking or ("" if competes(fit, effect) else torque_known(fit.signals)[1])


def _tested(
    fit: LinearisedFit,
    chosen: Chosen,
    effect: Effect,
    best: Candidate | None,
    rms: Rms,
    family: int,
    lacking: str,
) -> Detectability:
    """By what the record determines with everything else free; the motion says what it lacks, in words."""
    if not best and not effect.starts(fit.signals, fit.remainder(chosen)).points:
        return Detectability(effect.name, False, math.nan, lacking or _NO_START)
    nonlinear = best.nonlinear if best else fit.data.grid(effect)[len(fit.data.grid(effect)) // 2]
    columns = fit.columns(effect, nonlinear)
    own = own_part(fit, chosen, columns)
    every, alone = (float(np.sum(np.var(one, axis=0))) for one in (columns, own))
    information = float(np.sum(fit.whiten(own, fit.data.run) ** 2))
    share = math.sqrt(alone / max(every, 1e-300))
    noise = math.sqrt(every / max(information, 1e-300))  # of a size [rad rms]
    least = least_size(fit, effect, nonlinear)
    beyond = 0.0
    if rms.misfit.suspected:
        beyond, noise = rms.beyond_noise, noise * rms.misfit.value
    by_size = max(least, beyond) / max(share, 1e-150) + stats.norm.ppf(_POWER) * noise
    wanted = max(by_size, noise * math.sqrt(_noncentrality(columns.shape[1], family)))
    if share**2 < _OWN:
        return Detectability(effect.name, False, wanted, lacking or _IMITATED)
    if best and by_chance(best, family) <= FAMILY_ERROR and size(fit, chosen, effect, nonlinear) >= least:
        return Detectability(effect.name, False, wanted, lacking or NOT_PROVED)
    usual = np.std(columns[:, : effect.size], axis=0) * effect.usual
    if wanted > _LARGE * np.max(usual, initial=0.0):
        return Detectability(effect.name, False, wanted, lacking or _TOO_SMALL)
    return Detectability(effect.name, True, wanted, "tested")


@lru_cache(maxsize=64)
def _noncentrality(width: int, family: int) -> float:
    """Noncentrality at which the likelihood's gain is what a name asks for with the power wanted."""
    threshold = OVERSTATED / _LEARNED * stats.chi2.isf(FAMILY_ERROR / family, width)
    return float(optimize.brentq(lambda x: stats.ncx2.sf(threshold, width, x) - _POWER, 1.0, 5000.0))
