"""The residual of a record after all known parts are removed, and the waves in it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.calibration import LEAST_SIZE
from hd_diag.diagnosis.evidence.unmodelled_terms import UnmodelledLine
from hd_diag.diagnosis.fit.design import design, f_test, holds, orthonormal, projection
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.noise import Whitening, whitening
from hd_diag.effects.effect import Effect
from hd_diag.effects.order_spectrum import prominence, spectrum, top
from hd_diag.effects.quantity import turning
from hd_diag.effects.remainders import Line

Rows = npt.NDArray[np.bool_]

_MOST_ORDERS = 40.0
_LEAST_TURNS = 3.0  # that show an order
_LEAST_BESIDE, _PARTS = 50, 120  # least number of values beside a peak; spectrum size over that number
_LEAST_ORDER = 0.012  # once and twice per output turn are causes of their own
_LEAST_PART = 0.08  # smallest share of the record in which a wave is searched for separately
_CONFIRMED = 0.5  # least gain of held-out blocks over the predicted gain
_UNLIKE = 0.8  # ratio of speeds below which they differ
_CHANCE = 1e-4  # probability of a wave by noise alone, over all orders searched


class Weight(NamedTuple):
    """A factor of a wave, shape (n,), and in words where that is not zero."""

    values: Floats
    where: str = ""


class Wave(NamedTuple):
    """A wave: periods per turn of the input or per second, and the factor it is multiplied by."""

    order: float
    frame: str
    weight: Weight


@dataclass(frozen=True, eq=False)
class Remainder:
    """Rows of a record with the residual that no cause explains, shape (n,) each.

    Parameters
    ----------
    time, input_angle, torque, speed : ndarray
        [s], [rad], on the link [N m], input speed, positive where the output angle grows [rad/s].
    residual : ndarray
        [rad]
    beside : ndarray, shape (n, k)
        All fitted columns: a wave has to explain more than they would.
    run, block : ndarray of int64
        Numbers of the runs; numbers of the blocks that can be held out.
    ratio : float
    lines : tuple of float
        Orders per turn of the input of waves known to be in the residual.
    """

    time: Floats
    input_angle: Floats
    torque: Floats
    speed: Floats
    residual: Floats
    beside: Floats
    run: Integers
    block: Integers
    ratio: float
    lines: tuple[float, ...] = ()

    @staticmethod
    def of(fit: LinearisedFit, chosen: Chosen, described: Collection[str] = ()) -> Remainder:
        """Residual of a fit with the chosen effects, with lines of unknown cause added back.

        Lines that any gear has are added back if `described` names one of their order, as larger than usual.
        """
        orders = {item[0].order for item in chosen if isinstance(item[0], Line) and item[0].name in described}
        s, beta = fit.signals, fit.fit(chosen)[0]
        known = tuple(item for item in chosen if not _is_line(item[0]))
        beside = np.concatenate((fit.always(), fit.joined(known)), axis=1)
        residual, lines = fit.remainder(chosen), []
        for item, place in zip(chosen, fit.places(chosen), strict=True):
            effect, nonlinear = item
            if isinstance(effect, UnmodelledLine):
                lines.append(effect.order(s, nonlinear))
            elif isinstance(effect, Line) and effect.order in orders:
                lines.append(float(effect.order))
            else:
                continue
            residual = residual + fit.columns(*item) @ beta[place]
        return Remainder(
            s.time,
            s.input_angle,
            s.torque,
            s.forward_speed,
            residual,
            beside,
            fit.data.run,
            fit.data.block,
            s.ratio,
            tuple(dict.fromkeys(lines)),
        )

    def phase(self, frame: str) -> Floats:
        """Angle whose periods per turn are counted [rad]: the input angle, or one turn a second."""
        return self.input_angle if frame == "input" else 2.0 * np.pi * self.time

    def pair(self, wave: Wave) -> Floats:
        """Cosine and sine of a wave, shape (n, 2)."""
        return turning(wave.order * self.phase(wave.frame)) * wave.weight.values[:, None]

    @cached_property
    def load(self) -> Floats:
        """Torque over its greatest magnitude [-]."""
        return np.asarray(self.torque / max(float(np.max(np.abs(self.torque))), 1e-300))

    @cached_property
    def weights(self) -> list[Weight]:
        """Factors to try: one; `load` if it has both signs; one within a part of the record only."""
        both = float(self.load.min()) < -0.2 and float(self.load.max()) > 0.2
        whole = [Weight(np.ones(self.load.size)), *([Weight(self.load)] if both else [])]
        parts = [*_signs(self.load, "under positive torque", "under negative torque"), *_speeds(self.speed)]
        return [*whole, *(Weight(rows.astype(np.float64), where) for rows, where in parts)]

    def without(self, wave: Wave) -> Remainder:
        """The rows after a wave is fitted and subtracted."""
        pair = self.pair(wave)
        rest = self.residual - projection(pair, self.residual)
        beside = np.concatenate((self.beside, pair), axis=1)
        return replace(self, residual=rest, beside=beside)


def _is_line(effect: Effect) -> bool:
    return isinstance(effect, (UnmodelledLine, Line))


def strongest(rest: Remainder) -> Wave | None:
    """The most prominent wave: constant, in proportion to the torque, or in a part of the record."""
    residual = rest.residual
    peaks = [
        (*peak, frame)
        for frame in ("input", "time")
        for weight in rest.weights
        if (peak := _peak(rest.phase(frame), residual * weight.values)) is not None
    ]
    if not peaks:
        return None
    _, order, frame = max(peaks, key=lambda one: one[0])
    # Waves of this order in every part are removed before noise is learned; else they count as noise.
    every = [Wave(order, frame, one) for one in rest.weights]
    pairs = [rest.pair(wave) for wave in every]
    whiten = whitening(residual - projection(np.concatenate(pairs, axis=1), residual), rest.run)
    white = whiten(residual, rest.run)
    gains = [float(np.sum(projection(whiten(pair, rest.run), white) ** 2)) for pair in pairs]
    best = int(np.argmax(gains))
    pair = pairs[best]
    tests = 4.0 * len(every) * _MOST_ORDERS * max(turns(rest.input_angle), 1.0)
    small = float(np.std(projection(pair, residual))) < LEAST_SIZE
    if small or tests * _chance(rest, pair, whiten) > _CHANCE:
        return None
    gain, predicted, variance = design(whiten(pair, rest.run), white, rest.block).held_out_gain(slice(0, 2))
    if not holds(gain, predicted, variance) and gain.sum() < _CONFIRMED * predicted.sum():
        return None
    return every[best]


def turns(phase: Floats) -> float:
    """Turns that an angle [rad] covers."""
    return float(np.ptp(phase)) / (2.0 * np.pi)


def _chance(rest: Remainder, pair: Floats, whiten: Whitening) -> float:
    """Probability that noise alone gives the gain of a wave."""
    white, residual = whiten(rest.beside, rest.run), whiten(rest.residual, rest.run)
    basis = orthonormal(white)
    before = residual - basis @ (basis.T @ residual)
    own = whiten(pair, rest.run)
    after = before - projection(own - basis @ (basis.T @ own), before)
    rows = int(np.count_nonzero(residual))
    return f_test(float(before @ before), float(after @ after), 2, rows, basis.shape[1] + 2)


def _signs(values: Floats, above: str, below: str) -> list[tuple[Rows, str]]:
    """Rows with values of either sign, if there are enough of both."""
    parts = [(values > 0.0, above), (values < 0.0, below)]
    return parts if min(float(np.mean(rows)) for rows, _ in parts) > _LEAST_PART else []


def _speeds(speed: Floats) -> list[tuple[Rows, str]]:
    """Rows of each direction, and in it of each third of the speeds if the speeds differ."""
    speed = speed / (2.0 * np.pi)
    found = _signs(speed, "forward", "backward") or [(speed != 0.0, "")]
    edges = np.quantile(np.abs(speed), (0.0, 1 / 3, 2 / 3, 1.0))
    bands = []
    for rows, way in found:
        for low, high in pairwise(edges.tolist()):
            inside = rows & (np.abs(speed) >= low) & (np.abs(speed) <= high)
            if edges[1] < _UNLIKE * edges[2] and float(np.mean(inside)) > _LEAST_PART:
                bands.append((inside, f"{way} at {low:.2g} to {high:.2g} turns/s of the input".strip()))
    return [*(one for one in found if one[1]), *bands]


def _peak(phase: Floats, residual: Floats) -> tuple[float, float] | None:
    """Height of the spectrum's highest peak relative to its neighbourhood, and its order."""
    covered = turns(phase)
    if covered < _LEAST_TURNS:
        return None
    order, strength = spectrum(phase, residual, _MOST_ORDERS)
    use = order > max(_LEAST_ORDER, 2.0 / covered)
    order, strength = order[use], strength[use]
    height = prominence(strength, max(_LEAST_BESIDE, strength.size // _PARTS))
    best = int(np.argmax(height))
    return float(height[best]), top(order, strength, best)
