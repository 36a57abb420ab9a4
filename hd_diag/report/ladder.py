"""A ladder of models, one cause more each time: rms residual on stretches that the rung's fit did not see."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.fit.design import solve
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.formatting import words
from hd_diag.report.stages import NOMINAL, REFIT

_DRAWS = 2000
_INTERVAL = (0.025, 0.975)


class Rung(NamedTuple):
    """One model of the ladder: rms residual of stretches predicted by a fit to all others [rad].

    The gain is the share of the rung before's mean square that it explains; nan on the first. Intervals are
    of 95 %.
    """

    name: str
    rms: float
    low: float
    high: float
    gain: float = float("nan")
    gain_low: float = float("nan")
    gain_high: float = float("nan")


def benches(diagnosis: Diagnosis) -> list[LinearisedFit]:
    """The record with each fitted rung's model, parameters settled; empty where nothing was fitted."""
    if diagnosis.found is None or diagnosis.refitted is None:
        return []
    whole, chosen = diagnosis.found.fit, diagnosis.found.chosen
    start = diagnosis.refitted.parameters
    fewer = [settle(whole.moved(start), chosen[:count]) for count in range(len(chosen))]
    return [*fewer, whole]


def ladder(
    diagnosis: Diagnosis, nominal: Floats, fitted: list[LinearisedFit], rng: np.random.Generator
) -> list[Rung]:
    """Rungs from the configured model, whose residual [rad] is given, over the benches' to the extended one.

    Stretches are drawn for the intervals.
    """
    if diagnosis.found is None or not fitted:
        return []
    chosen = diagnosis.found.chosen
    names = [NOMINAL, REFIT, *(f"+ {words(effect.name)}" for effect, _ in chosen)]
    residuals = [nominal, *(_unseen(bench, chosen[:count]) for count, bench in enumerate(fitted))]
    block = fitted[-1].data.block
    squares, counts = np.stack([np.bincount(block, rest**2) for rest in residuals]), np.bincount(block)
    draws = rng.integers(0, counts.size, (_DRAWS, counts.size))
    drawn, total = squares[:, draws].sum(axis=2), squares.sum(axis=1)
    spread = np.quantile(np.sqrt(drawn / counts[draws].sum(axis=1)), _INTERVAL, axis=1)
    gains = [1.0 - total[1:] / total[:-1], *np.quantile(1.0 - drawn[1:] / drawn[:-1], _INTERVAL, axis=1)]
    rms = np.stack([np.sqrt(total / block.size), *spread], axis=1).tolist()
    gained = [[], *np.stack(gains, axis=1).tolist()]
    return [Rung(name, *of_rms, *of_gain) for name, of_rms, of_gain in zip(names, rms, gained, strict=True)]


def _unseen(bench: LinearisedFit, chosen: Chosen) -> Floats:
    """Residual of every stretch by coefficients fitted to the others [rad]."""
    normal = bench.design(chosen)
    gram, moment = normal.gram.sum(axis=0), normal.moment.sum(axis=0)
    columns = np.concatenate((bench.always(), bench.joined(chosen)), axis=1)
    rest = np.empty(bench.residual.size)
    for block in range(normal.square.size):
        rows = bench.data.block == block
        beta = solve(gram - normal.gram[block], moment - normal.moment[block])
        rest[rows] = bench.residual[rows] - columns[rows] @ beta
    return rest
