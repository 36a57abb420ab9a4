"""What is named: the probability of every cause of a set, and of all that may be in its place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hd_diag.diagnosis.evidence.calibration import (
    CERTAIN_SIZE,
    CLASS_SHARE,
    LEAST_SIZE,
    MOST_ALIKE,
    NAMED,
)
from hd_diag.diagnosis.evidence.search import Found
from hd_diag.diagnosis.fit.design import solve
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.formatting import ARCSEC, words


@dataclass(frozen=True)
class Standing:
    """How sure a cause is.

    Attributes
    ----------
    alike : tuple of str
        Its class: names that hold 99 % of the probability together, the most probable first.
    probability : float
        That one of these is there.
    chance : float
        That none is: probability of the best set without the cause.
    own : float
        Rms of its part that nothing else in the fit imitates [rad].
    doubt : str
        Why it is not named, in words; empty where it is.
    """

    alike: tuple[str, ...]
    probability: float
    chance: float
    own: float
    doubt: str


def standings(found: Found) -> dict[str, Standing]:
    """How sure every cause of the best set is, by name."""
    return {effect.name: _standing(found, (effect, nonlinear)) for effect, nonlinear in found.best.causes}


def _standing(found: Found, item: Item) -> Standing:
    best, effect = found.best, item[0]
    values = {**found.instead[effect.name], effect.name: best.value}
    for name in effect.always_confused:
        values[name] = max(values.get(name, -math.inf), best.value)
    others = tuple(one for one in (*best.fit.data.given, *best.causes) if one[0].name != effect.name)
    own, deviation = own_size(best.fit, others, item)
    alike, probability, chance = in_class(values, {e.name for e in best.fit.data.searched})
    return Standing(alike, probability, chance, own, _doubt(alike, probability, own, deviation))


def in_class(values: Mapping[str, float], known: set[str]) -> tuple[tuple[str, ...], float, float]:
    """The fewest known causes that hold nearly all the weight of those known, their share, and that of none.

    `values` are log evidences by name, that of no cause under the empty one.
    """
    most = max(values.values())
    weight = {name: math.exp(value - most) for name, value in values.items()}
    total, named = sum(weight.values()), sorted(known & weight.keys(), key=lambda name: -weight[name])
    wanted, alike, held = CLASS_SHARE * sum(weight[name] for name in named), list[str](), 0.0
    for name in named:
        if held >= wanted:
            break
        alike.append(name)
        held += weight[name]
    return tuple(alike), held / total, weight[""] / total


def _doubt(alike: tuple[str, ...], probability: float, own: float, deviation: float) -> str:
    """The first reason for which a class is not named; empty where there is none."""
    if probability < NAMED:
        return f"its probability is {100.0 * probability:.0f} %, and {100.0 * NAMED:.0f} % are asked for"
    if own - CERTAIN_SIZE * deviation < LEAST_SIZE:
        return (
            f"what it alone explains is {own / ARCSEC:.2f} arcsec rms, "
            f"and {LEAST_SIZE / ARCSEC:.2f} arcsec for certain are asked for"
        )
    if len(alike) > MOST_ALIKE:
        return f"{len(alike)} causes explain it alike: {', '.join(map(words, alike))}"
    return ""


def own_size(fit: LinearisedFit, others: Chosen, item: Item) -> tuple[float, float]:
    """Rms of what the model and other effects leave of an effect's part, and its deviation by noise [rad]."""
    whole = (*others, item)
    columns = fit.columns(*item)
    part = columns @ fit.fit(whole)[0][-columns.shape[1] :]
    fixed = np.concatenate((fit.always(), fit.joined(others)), axis=1)
    white = fit.whiten(part, fit.data.run)
    moment = [one.T @ white for one in (fit.always_white, *(fit.white(*other) for other in others))]
    rest = part - fixed @ solve(fit.design(others).whole[0], np.concatenate(moment))
    own = float(np.std(rest))
    information = float(np.linalg.norm(fit.whiten(rest, fit.data.run)))
    return own, own / max(information, 1e-300)
