"""What this record's motion could have shown: the least size of each effect that would have been found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from hd_diag.diagnosis.search.acceptance import FAMILY_ERROR, LEAST_SIZE
from hd_diag.diagnosis.search.causes import Search
from hd_diag.diagnosis.search.ranking import Projector, family_size

_POWER = 0.99


@dataclass(frozen=True)
class Testability:
    """Whether an effect could be tested, the least size found with 99 % chance [rad rms], and why."""

    name: str
    testable: bool
    least_size: float
    reason: str


def testability(found: Search) -> list[Testability]:
    """Testability of every effect of the catalogue on a record.

    Parameters
    ----------
    found : Search

    Returns
    -------
    list of Testability
    """
    bench, chosen = found.bench, found.chosen
    named = {effect.name for effect, _ in chosen}
    basis, family = Projector(bench, chosen).basis, max(family_size(bench), 1)
    result = []
    for effect in bench.data.searched:
        possible, reason = bench.data.testable(effect)
        if effect.name in named:
            result.append(Testability(effect.name, True, LEAST_SIZE, "found"))
        elif not possible:
            result.append(Testability(effect.name, False, float("nan"), reason))
        else:
            nonlinear = bench.data.grid(effect)[len(bench.data.grid(effect)) // 2]
            columns, white = bench.columns(effect, nonlinear), bench.white(effect, nonlinear)
            own = white - basis @ (basis.T @ white)
            information = float(np.sum(own**2)) / max(float(np.sum(np.mean(columns**2, axis=0))), 1e-300)
            size = float(np.sqrt(_noncentrality(columns.shape[1], family) / max(information, 1e-300)))
            share = float(np.sum(own**2) / max(float(np.sum(white**2)), 1e-300))
            if share < 1e-3:
                text = "the model's own parameters imitate it: this record cannot tell them apart"
                result.append(Testability(effect.name, False, size, text))
            else:
                result.append(Testability(effect.name, True, max(size, LEAST_SIZE), "tested"))
    return result


def _noncentrality(width: int, family: int) -> float:
    """Noncentrality at which a chi-square test at the family's level has the power wanted."""
    threshold = stats.chi2.isf(FAMILY_ERROR / family, width)
    low, high = 1.0, 1000.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        if stats.ncx2.sf(threshold, width, middle) < _POWER:
            low = middle
        else:
            high = middle
    return high
