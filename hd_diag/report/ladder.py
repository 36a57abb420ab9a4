"""A ladder of models, one cause more each time: what a rung leaves of stretches that its fit did not see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.fit.design import solve
from hd_diag.diagnosis.fit.linearised_fit import Chosen, Workbench, settle
from hd_diag.formatting import words
from hd_diag.report.stages import NOMINAL, REFIT

_DRAWS = 2000
_INTERVAL = (0.025, 0.975)


@dataclass(frozen=True)
class Rung:
    """One model of the ladder.

    Attributes
    ----------
    name : str
    rms, low, high : float
        Of stretches predicted by a fit to all others, with a 95 % interval [rad].
    gain, gain_low, gain_high : float
        Share of the rung before's mean square that it explains, with its interval; nan on the first.
    """

    name: str
    rms: float
    low: float
    high: float
    gain: float
    gain_low: float
    gain_high: float


def benches(diagnosis: Diagnosis) -> list[Workbench]:
    """The record with each fitted rung's model, parameters settled; empty where nothing was fitted."""
    if diagnosis.found is None or diagnosis.refitted is None:
        return []
    whole, chosen = diagnosis.found.bench, diagnosis.found.chosen
    start = diagnosis.refitted.parameters
    fewer = [settle(whole.moved(start), chosen[:count]) for count in range(len(chosen))]
    return [*fewer, whole]


def ladder(diagnosis: Diagnosis, nominal: Floats, rungs: list[Workbench]) -> list[Rung]:
    """Rungs from the configured model to the extended one.

    Parameters
    ----------
    diagnosis : Diagnosis
    nominal : ndarray, shape (n,)
        What the configured model leaves of the usable samples [rad].
    rungs : list of Workbench
        From :func:`benches`.

    Returns
    -------
    list of Rung
    """
    if diagnosis.found is None or not rungs:
        return []
    chosen = diagnosis.found.chosen
    names = [NOMINAL, REFIT, *(f"+ {words(effect.name)}" for effect, _ in chosen)]
    rests = [nominal, *(_unseen(bench, chosen[:count]) for count, bench in enumerate(rungs))]
    block = rungs[-1].block
    squares = np.stack([np.bincount(block, rest**2) for rest in rests])
    counts = np.bincount(block)
    draws = np.random.default_rng(0).integers(0, counts.size, (_DRAWS, counts.size))
    drawn = squares[:, draws].sum(axis=2)  # shape (rungs, draws)
    rms = np.sqrt(drawn / counts[draws].sum(axis=1))
    return [_rung(name, at, squares.sum(axis=1), drawn, rms, block.size) for at, name in enumerate(names)]


def _rung(name: str, at: int, total: Floats, drawn: Floats, rms: Floats, rows: int) -> Rung:
    low, high = np.quantile(rms[at], _INTERVAL)
    gain, gain_low, gain_high = float("nan"), float("nan"), float("nan")
    if at:
        gain = 1.0 - float(total[at] / total[at - 1])
        gain_low, gain_high = map(float, np.quantile(1.0 - drawn[at] / drawn[at - 1], _INTERVAL))
    return Rung(name, float(np.sqrt(total[at] / rows)), float(low), float(high), gain, gain_low, gain_high)


def _unseen(bench: Workbench, chosen: Chosen) -> Floats:
    """What is left of every stretch by coefficients fitted to the others [rad]."""
    normal = bench.design(chosen)
    gram, moment = normal.gram.sum(axis=0), normal.moment.sum(axis=0)
    columns = np.concatenate((bench.always(), bench.joined(chosen)), axis=1)
    rest = np.empty(bench.left.size)
    for block in range(normal.square.size):
        rows = bench.block == block
        beta = solve(gram - normal.gram[block], moment - normal.moment[block])
        rest[rows] = bench.left[rows] - columns[rows] @ beta
    return rest
