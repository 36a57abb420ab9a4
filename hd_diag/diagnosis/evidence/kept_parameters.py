"""Which of the model's parameters a record moves. The others stay as configured, with an upper bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.calibration import ODDS, TWO_SIDED
from hd_diag.diagnosis.evidence.sets import Set
from hd_diag.diagnosis.evidence.solution import Solution, parameters_of
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import DATUM, GROUPS, alike, displacements, groups, numbers_of
from hd_diag.diagnosis.fit.joint_refinement import covariance
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.drive import Drive

DISPLACEMENTS = frozenset(("eccentricity", "runout"))
HELD = DISPLACEMENTS | {"tilt"}
"""Groups that may be held at their configured values."""

_BOUND_STEPS = {"eccentricity": 1, "tilt": 4}  # iterations of a bound, from one unit on


@dataclass(frozen=True)
class Kept:
    """Groups of parameters held at their configured values, and how far off each may be, at 95 %.

    Attributes
    ----------
    bounds : dict
        By the group's name, in units of :func:`fit_parameters.units`.
    free : tuple of Set
        The same causes with no group held; empty if none is held in the best set.
    """

    bounds: dict[str, float]
    free: tuple[Set, ...] = ()

    @property
    def held(self) -> tuple[int, ...]:
        """Indices of the held parameters."""
        return tuple(numbers_of(self.bounds))

    def physical(self, configured: Drive) -> dict[str, float]:
        """The bounds in SI units."""
        units = fit_parameters.units(configured)
        units[5] *= configured.mesh.tooth_compliance
        return {name: bound * float(units[GROUPS[name][0]]) for name, bound in self.bounds.items()}

    def spread(
        self, whole: Solution, rivals: Sequence[Set], datum_reach: float = 0.0
    ) -> tuple[Floats, Floats]:
        """Parameters of a fit with these groups held, shape (p,), and their covariance, shape (p, p).

        Intervals of held groups reach as far as their bounds. The others cover the intervals of every rival
        minimum and of the fit with no group held; that of the datum also covers `datum_reach`.
        """
        fit = whole.fit
        found, spread = parameters_of(whole)
        plain = _half_widths(spread)
        reach = plain.copy()
        reach[DATUM] = max(reach[DATUM], datum_reach)
        for rival in (*rivals, *self.free):
            other, own = _fitted(rival.fit, rival.chosen), covariance(rival.fit, rival.chosen)[0]
            ways = (np.abs(one - found) for one in alike(other, fit.data.configured))
            away = min(ways, key=_squared_displacement)
            reach = np.maximum(reach, away + _half_widths(own[: found.size, : found.size]))
        longer = reach / np.maximum(plain, 1e-150)
        spread = spread * np.multiply.outer(longer, longer)
        for name, bound in self.bounds.items():
            for number in GROUPS[name]:
                spread[number], spread[:, number] = 0.0, 0.0
                spread[number, number] = (bound / TWO_SIDED) ** 2
        return found, spread


def kept_parameters(free: Set) -> tuple[Set, Kept]:
    """Hold displacements at their configured values if the evidence is nearly as good that way.

    Near zero their slopes vanish, so a free displacement could take any value. The datum and the compliances
    have slopes and stay free; if they were held, remainders of the torque would replace them. A runout shows
    only by its product with an eccentricity: without one, it stands for something else.

    Parameters
    ----------
    free : Set
        Settled. If it holds parameters, it is settled again with all of them free.

    Returns
    -------
    best : Set
        The same with these groups held.
    kept : Kept
    """
    free = free.at(free.fit.parameters).settled() if free.fit.held else free
    fit, chosen = free.fit, free.chosen
    away, spread = _away(fit, chosen)
    own = groups(fit.data.configured)
    undetermined = [name for name, numbers in own.items() if set(numbers) <= set(fit.data.held)]
    certain = {name: _certainty(away, spread, name) for name in own if name not in undetermined}
    doubtful = sorted((name for name in certain if name in HELD), key=certain.__getitem__)
    best, held, tried = free, list[str](), [list[str]()]
    for more in (doubtful, *([name] for name in doubtful)):
        names = [*held, *(name for name in more if name not in held)]
        if names in tried:
            continue
        tried.append(names)
        trial = _trial(free, names)
        if trial.value > free.value - ODDS:
            best, held = trial, names
    if "eccentricity" in held and "runout" in certain.keys() - set(held) and not _eccentric(fit):
        held = [*held, "runout"]
        best = _trial(free, held)
    bounds = _bounds(fit, chosen, [*undetermined, *held])
    if bounds.keys() >= DISPLACEMENTS:  # without an eccentricity a runout can take any value
        bounds["runout"] = _bound(replace(best.fit, held=()), best.chosen, "runout")
    return best, Kept(bounds, (free,) if held else ())


def _configured(fit: LinearisedFit) -> Floats:
    """Parameters of the configured drive, shape (p,)."""
    return fit_parameters.vector(fit.data.configured, fit.data.configured)


def _away(fit: LinearisedFit, chosen: Chosen) -> tuple[Floats, Floats]:
    """Parameters less the configured ones, of the nearest equivalent drive, and their covariance."""
    configured = _configured(fit)
    found, own = _fitted(fit, chosen), slice(configured.size)
    ways = (each - configured for each in alike(found, fit.data.configured))
    away = min(ways, key=_squared_displacement)
    open_ = fit_parameters.scaling(found, fit.data.held, fit.data.configured)
    return away, covariance(fit, chosen)[0][own, own] + open_


def _fitted(fit: LinearisedFit, chosen: Chosen) -> Floats:
    """Fitted parameters, shape (p,)."""
    return np.asarray(fit.parameters + fit.fit(chosen)[0][: fit.parameters.size])


def _squared_displacement(away: Floats) -> float:
    """Sum of squares of the displacements."""
    return float(np.sum(displacements(away) ** 2))


def _half_widths(spread: Floats) -> Floats:
    """Half widths of 95 % intervals, shape (p,)."""
    return np.asarray(TWO_SIDED * np.sqrt(np.diag(spread)))


def _certainty(away: Floats, spread: Floats, name: str) -> float:
    """Squared distance of a group from its configured values, in standard deviations."""
    numbers = list(GROUPS[name])
    return float(away[numbers] @ np.linalg.solve(spread[np.ix_(numbers, numbers)], away[numbers]))


def _start(fit: LinearisedFit, names: list[str]) -> tuple[Floats, list[int]]:
    """Parameters of the nearest equivalent drive with groups as configured, and the groups' indices."""
    numbers = numbers_of(names)
    configured = _configured(fit)
    points = alike(fit.parameters, fit.data.configured)
    start = min(points, key=lambda x: _squared_displacement(x - configured)).copy()
    start[numbers] = configured[numbers]
    return start, numbers


def _trial(free: Set, names: list[str]) -> Set:
    """The set settled with groups held; remainders may grow in their place."""
    start, held = _start(free.fit, names)
    there = replace(free.fit.moved(start), held=tuple(held)).beside(free.fit.present)
    return replace(free, fit=there).valued().settled()


def _bounds(fit: LinearisedFit, chosen: Chosen, names: list[str]) -> dict[str, float]:
    return {name: _bound(fit, chosen, name) for name in names}


def _bound(fit: LinearisedFit, chosen: Chosen, name: str) -> float:
    """How far off a group may be, at 95 %.

    The effect of a displacement grows with its square, so its slope vanishes near zero. The slope is taken at
    least one unit away. A tilt may have a linear part too, as in a coned cup with an eccentricity: its slope
    is taken at the bound, by iteration.
    """
    away, spread = _away(fit, chosen)
    numbers = list(GROUPS[name])
    size = float(np.hypot(*away[numbers])) if len(numbers) > 1 else abs(float(away[numbers[0]]))
    if name not in ("eccentricity", "tilt") or np.any(_configured(fit)[numbers]):
        return size + TWO_SIDED * _deviation(spread, numbers)
    bound = start = max(size, 1.0)
    for _ in range(_BOUND_STEPS[name]):
        start, moved = bound, fit.parameters.copy()
        moved[numbers] = start * (moved[numbers] / size if size > 1e-6 else np.array([1.0, 0.0]))
        there = fit.moved(moved).beside(fit.present)
        own = covariance(there, chosen)[0][: away.size, : away.size]
        bound = float(np.sqrt(size**2 + 2.0 * start * TWO_SIDED * _deviation(own, numbers)))
    return bound


def _eccentric(fit: LinearisedFit) -> bool:
    """Whether the drive is configured with an eccentricity."""
    return bool(np.any(_configured(fit)[:2]))


def _deviation(spread: Floats, numbers: list[int]) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(spread[np.ix_(numbers, numbers)])[-1]))
