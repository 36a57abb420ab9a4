"""Which causes are named: probability of every cause of a set, and of the alternatives in its place."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.calibration import (
    CERTAIN_SIZE,
    CLASS_SHARE,
    LEAST_SIZE,
    MOST_ALIKE,
    NAMED,
    UNPROVED,
)
from hd_diag.diagnosis.evidence.search import Found
from hd_diag.diagnosis.evidence.sets import Set, presence
from hd_diag.diagnosis.fit.design import solve
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.diagnosis.regression import centered
from hd_diag.effects.effect import Effect
from hd_diag.formatting import ARCSEC, words


@dataclass(frozen=True)
class Standing:
    """How certain a cause is.

    Attributes
    ----------
    values : dict
        Log odds by name: of the cause, of others in its place, and of none under the empty name.
    known : frozenset of str
        Names of known causes; other names are terms without a known cause.
    own, deviation : float
        Rms of the part that it alone explains, and the standard deviation of this rms by noise [rad].
    foretold : bool
        Whether it predicts held-out blocks of the record.
    slow : float
        Share of the square of its own part that is slower than a turn of the input.
    """

    values: Mapping[str, float]
    known: frozenset[str]
    own: float
    deviation: float
    foretold: bool = True
    slow: float = 1.0

    @cached_property
    def _class(self) -> tuple[tuple[str, ...], float, float]:
        return in_class(self.values, self.known)

    @property
    def alike(self) -> tuple[str, ...]:
        """Its class: the fewest known causes with 99 % of their total probability, most probable first."""
        return self._class[0]

    @property
    def probability(self) -> float:
        """Probability that one cause of the class is present."""
        return self._class[1]

    @property
    def chance(self) -> float:
        """Probability of the best set with nothing in the cause's place."""
        return self._class[2]

    @property
    def doubt(self) -> str:
        """The first reason not to name the class; empty if there is none."""
        if len(self.values) < 2:
            return "there was no time to weigh it"
        if self.probability < NAMED:
            return f"its probability is {100.0 * self.probability:.3g} %; {100.0 * NAMED:.0f} % is needed"
        if not self.foretold:
            return "other blocks of the record do not predict it"
        if self.own - CERTAIN_SIZE * self.deviation < LEAST_SIZE:
            return (
                f"it alone explains {self.own / ARCSEC:.2f} arcsec rms; "
                f"certainly more than {LEAST_SIZE / ARCSEC:.2f} arcsec is needed"
            )
        if len(self.alike) > MOST_ALIKE:
            return f"{len(self.alike)} causes explain it equally well: {', '.join(map(words, self.alike))}"
        return ""

    def beside(self, misfit: float) -> Standing:
        """Standing if the residual is `misfit` times the noise. Log odds are divided by the misfit's square.

        The standard deviation is multiplied by the misfit (Birge, Phys. Rev. 40, 1932).
        """
        most = max(self.values.values())
        share = max(misfit, 1.0) ** -2.0
        weaker = {name: most + share * (value - most) for name, value in self.values.items()}
        return replace(self, values=weaker, deviation=self.deviation * max(misfit, 1.0))


def standings(found: Found) -> dict[str, Standing]:
    """Standing of every cause of the best set, by name."""
    return {effect.name: _standing(found, (effect, nonlinear)) for effect, nonlinear in found.best.causes}


def _standing(found: Found, item: Item) -> Standing:
    best, effect = found.best, item[0]
    values = {**found.instead.get(effect.name, {}), effect.name: 0.0}  # the best of its forms
    if len(values) > 1:
        for name in effect.always_confused:
            values[name] = 0.0
        values |= dict.fromkeys(
            [name for name, odds in values.items() if _is_unproved(best, name, odds, effect)], 0.0
        )
    others = tuple(one for one in (*best.motor, *best.causes) if one[0].name != effect.name)
    known = frozenset(one.name for one in best.fit.data.searched)
    own, deviation, slow = own_part(best.fit, best.chosen, others, item)
    return Standing(values, known, own, deviation, best.foretells(effect.name), slow)


def _is_unproved(best: Set, name: str, odds: float, instead_of: Effect) -> bool:
    """Whether the motion cannot prove a cause. It may then be present even if another one fits better.

    The prior odds of both causes are taken out. They count forms that this motion does not distinguish.
    """
    effect = next((one for one in best.fit.data.searched if one.name == name), None)
    if effect is None or best.fit.data.testable(effect)[0]:
        return False
    return odds + presence(best.fit, instead_of) - presence(best.fit, effect) > -UNPROVED


def in_class(values: Mapping[str, float], known: Collection[str]) -> tuple[tuple[str, ...], float, float]:
    """Smallest class of known causes, its probability, and the probability of no cause.

    The class holds nearly all the probability of the known causes. `values` are log odds by name, under the
    empty name those of no cause. Causes with equal odds keep their order.
    """
    most = max(values.values())
    weight = {name: math.exp(value - most) for name, value in values.items()}
    total = sum(weight.values())
    named = sorted((name for name in values if name in known), key=lambda name: -weight[name])
    wanted, alike, held = CLASS_SHARE * sum(weight[name] for name in named), list[str](), 0.0
    for name in named:
        if held >= wanted:
            break
        alike.append(name)
        held += weight[name]
    return tuple(alike), held / total, weight.get("", 0.0) / total


def own_part(fit: LinearisedFit, chosen: Chosen, others: Chosen, item: Item) -> tuple[float, float, float]:
    """Rms of the part that a chosen effect alone explains, its standard deviation [rad], and its slow share.

    Parameters and other effects cannot reproduce this part. The slow share is the share of its variance in
    means over complete turns of the input.
    """
    rest = left_by(fit, chosen, others, (item,))
    own = float(np.std(rest))
    information = float(np.linalg.norm(fit.whiten(rest, fit.data.run)))
    rows, middle = fit.data.record.through, rest - rest.mean()
    within = float(np.var(centered(middle, fit.data.record.turn)[rows]) / max(np.var(middle[rows]), 1e-300))
    return own, own / max(information, 1e-300), 1.0 - min(within, 1.0)


def left_by(fit: LinearisedFit, chosen: Chosen, others: Chosen, items: Chosen) -> Floats:
    """The part (n,) [rad] of some chosen effects less its fit by the parameters and other effects."""
    beta, places = fit.fit(chosen)[0], fit.places(chosen)
    part = fit.joined(items) @ np.concatenate([beta[places[chosen.index(item)]] for item in items])
    fixed = np.concatenate((fit.always(), fit.joined(others)), axis=1)
    white = fit.whiten(part, fit.data.run)
    moment = [one.T @ white for one in (fit.always_white, *(fit.white(*other) for other in others))]
    return np.asarray(part - fixed @ solve(fit.design(others).whole[0], np.concatenate(moment)))
