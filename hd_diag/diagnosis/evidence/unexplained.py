"""Parts without a known cause: their order, amplitude and dependence on torque and direction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.evidence.order_table import order_table
from hd_diag.diagnosis.evidence.solution import Solution
from hd_diag.diagnosis.evidence.unmodelled_terms import UnmodelledLine, UnmodelledTerm
from hd_diag.diagnosis.evidence.waves import Remainder, Rows, Wave, Weight, strongest
from hd_diag.diagnosis.fit.present_effects import Item
from hd_diag.formatting import ARCSEC

_MOST_WAVES = 8


@dataclass(frozen=True)
class Unexplained:
    """A part of the residual that no known cause explains.

    Attributes
    ----------
    order : float
        Cycles per turn of the input, or per turn of the output, or hertz; 0 if the part is not periodic.
    frame : str
        ``input``, ``output`` or ``time``.
    amplitude : float
        [rad]
    torque_law, direction_law : str
        How it depends on torque and direction, in words.
    description : str
        In words, of a part that is not periodic.
    where : str
        In words, if the part shows in one direction, at some speeds or under one sign of the torque only.
    """

    order: float
    frame: str
    amplitude: float
    torque_law: str
    direction_law: str
    description: str = ""
    where: str = ""


def waves(rest: Remainder) -> list[Wave]:
    """Waves known to be in the residual, then those that stand out of the noise, strongest first."""
    even = Weight(np.ones(rest.residual.size))
    found = [Wave(order, "input", even) for order in rest.lines]
    for known in found:
        rest = rest.without(known)
    while len(found) < _MOST_WAVES and (wave := strongest(rest)) is not None:
        found.append(wave)
        rest = rest.without(wave)
    return found


def with_table(found: Solution) -> Solution:
    """The solution with the order table of its fit's residual."""
    rest = Remainder.of(found.fit, found.chosen, found.larger)
    return replace(found, table=order_table(rest, waves(rest), found.fit.signals.rated_torque))


def unexplained(found: Solution) -> list[Unexplained]:
    """Unmodelled terms, and periodic parts of the residual that stand out of the noise."""
    rest = Remainder.of(found.fit, found.chosen, found.larger)
    terms = [
        item
        for item in found.given
        if isinstance(item[0], UnmodelledTerm) and not isinstance(item[0], UnmodelledLine)
    ]
    return [_term(found, item, rest) for item in terms] + lines(rest, waves(rest))


def lines(rest: Remainder, found: list[Wave]) -> list[Unexplained]:
    """Waves with their size and laws, each after those before it are removed."""
    result = []
    for wave in found:
        result.append(_line(rest, wave))
        rest = rest.without(wave)
    return result


def _term(found: Solution, item: Item, rest: Remainder) -> Unexplained:
    """A part without a period; its amplitude is its rms times the root of two."""
    fit, (term, _) = found.fit, item
    place = fit.places(found.chosen)[found.chosen.index(item)]
    part = fit.columns(*item) @ fit.fit(found.chosen)[0][place]
    part = part - part.mean()
    amplitude = float(np.sqrt(2.0) * np.std(part))
    laws = _laws(replace(rest, residual=part + rest.residual), part / max(amplitude, 1e-300))
    return Unexplained(0.0, "input" if term.frame == "torque" else term.frame, amplitude, *laws, term.cause)


def _line(rest: Remainder, wave: Wave) -> Unexplained:
    pair = rest.pair(wave)
    coefficients = np.linalg.lstsq(pair, rest.residual, rcond=None)[0]
    amplitude = float(np.sqrt(2.0) * np.std(pair @ coefficients))
    phase = wave.order * rest.phase(wave.frame)
    even = np.cos(phase - np.arctan2(coefficients[1], coefficients[0]))
    if float(wave.weight.values.min()) < 0.0:
        even *= np.sign(rest.torque)
    return Unexplained(wave.order, wave.frame, amplitude, *_laws(rest, even), where=wave.weight.where)


def _laws(rest: Remainder, wave: Floats) -> tuple[str, str]:
    """How a wave depends on torque and direction."""

    def size(rows: Rows) -> float:
        own = wave[rows]
        return float(rest.residual[rows] @ own / max(float(own @ own), 1e-300)) / ARCSEC

    load, speed = np.abs(rest.torque), rest.speed
    torque_law = "not tested: the torque did not change"
    if np.ptp(load) >= 0.2 * max(float(load.max()), 1e-9):
        low, high = np.quantile(load, (0.33, 0.67))
        small, large = size(load < low), size(load > high)
        trend = "grows" if large > small else "falls"
        torque_law = f"{trend} with torque: {small:.2f} to {large:.2f} arcsec"
        if _alike(small, large):
            torque_law = "independent of torque"
    direction_law = "not tested: one direction only"
    if min(np.mean(speed > 0.0), np.mean(speed < 0.0)) >= 0.1:
        forward, backward = size(speed > 0.0), size(speed < 0.0)
        direction_law = f"{forward:.2f} arcsec forward, {backward:.2f} arcsec backward"
        if _alike(forward, backward):
            direction_law = "the same in both directions"
    return torque_law, direction_law


def _alike(one: float, other: float) -> bool:
    return abs(one - other) < 0.25 * max(abs(one), abs(other))
