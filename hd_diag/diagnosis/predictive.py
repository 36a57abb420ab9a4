"""The model that is kept: with most in it, as long as it predicts what was held out."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hd_diag.diagnosis.fit.fit_parameters import groups
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.gain import Gain, Rms, Rows, measured_gain
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.search.causes import Search, causes, refitted
from hd_diag.diagnosis.search.kept_parameters import (
    DISPLACEMENTS,
    Kept,
    is_displaced,
    keeping,
    kept_parameters,
    likelier,
)
from hd_diag.diagnosis.search.unexplained import with_table

_KEPT = 0.7  # of the time that a diagnosis may take, by which these must end
_WORSE = 1.02  # times the residual of a simpler model: then data speak against the richer one
_MUCH_WORSE = 1.3  # the same as the model runs, when its signals are late or smoothed


class Tried(NamedTuple):
    """What a search found, with the parameters kept as configured, and how it does on held-out rows."""

    found: Search
    kept: Kept
    every: LinearisedFit
    rms: Rms
    gain: Gain


def most_predictive(
    record: Record,
    test: Rows,
    which: str,
    plain: LinearisedFit,
    found: Search,
    rng: np.random.Generator,
) -> Tried:
    """The model with most in it that predicts held-out rows no worse than simpler ones do."""

    def tried(fit: LinearisedFit, kept: Kept, found: Search) -> Tried:
        before, found = plain if found.chosen else fit, refitted(fit, found)
        every = found.fit.on(usable(found.fit.data.source, found.torque_shift))
        return Tried(found, kept, every, *measured_gain(record, test, which, before, found, every, rng))

    fit, kept = found.fit, Kept({})
    with fit.work.until(_KEPT, "testing which parameters may be as configured"):
        fit, kept = kept_parameters(fit, found.chosen)
    best = tried(fit, kept, found)
    if best.rms.misfit.suspected:  # too much may be held
        for held in dict.fromkeys((DISPLACEMENTS.intersection(kept.bounds), frozenset[str]())):
            freed = kept.bounds.keys() - held
            if not freed or (freed & DISPLACEMENTS and not is_displaced(found.fit, found.chosen)):
                continue
            there = keeping(found.fit, found.chosen, held)
            if likelier(there[0], fit, found.chosen, freed):
                freer = tried(*there, found)
                if not freer.rms.misfit.suspected:
                    best = freer
                    break
    with fit.work.until(_KEPT, "testing whether fewer causes predict better"):
        while best.rms.misfit.suspected and len(found.chosen) > 1:  # two that undo each other may not
            places = [place for place, (effect, _) in enumerate(found.chosen) if not effect.given]
            simpler = [found.without(place) for place in places]
            trials = [(tried(*keeping(one.fit, one.chosen, best.kept.bounds), one), one) for one in simpler]
            least, fewer = min(trials, key=lambda trial: trial[0].rms.by_causes)
            if best.rms.by_causes <= _WORSE * least.rms.by_causes:
                break
            fewer = replace(fewer, causes=causes(fewer.fit, fewer.chosen, fewer.rivals, rng))
            best, found = tried(*kept_parameters(fewer.fit, fewer.chosen), fewer), fewer
    rms = best.rms
    worse = rms.by_causes > _WORSE * rms.without_causes or rms.named > _MUCH_WORSE * rms.without_causes
    if found.causes and worse:
        rest = found.unmodelled
        found = Search(settle(plain, rest) if rest else plain, (), rest)
        best = tried(*kept_parameters(found.fit, rest), found)
    if best.gain.low <= 0.0:
        best = tried(*keeping(found.fit, found.chosen, groups(found.fit.data.configured)), found)
    found = with_table(best.found)
    if any(row.repeats for row in found.table):
        rms, gain = measured_gain(record, test, which, plain, found, best.every, rng)
        if rms.extended < best.rms.extended:
            return best._replace(found=found, rms=replace(rms, named=best.rms.extended), gain=gain)
        found = replace(found, table=tuple(row for row in found.table if not row.repeats))
    return best._replace(found=found)
