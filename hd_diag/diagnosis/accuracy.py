"""A joint's error as a catalogue states it: peak to peak over an output turn, torsion and friction apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.fit.design import inverse
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.regression import centered, usual_laws
from hd_diag.effects.quantity import turning
from hd_diag.effects.recursions import slip
from hd_diag.formatting import ARCSEC
from hd_diag.model.transmission_error import Kinematics

WHOLE_TURN = 0.95
"""Share of an output turn from which a record covers it."""

_INPUT_ORDERS = (2.0, 1.0, 4.0, 3.0, 6.0, 8.0)  # per turn of the wave generator, the most likely first
_LOADED = 3  # of them, whose waves may change with the torque
_MEMBER_ORDERS = (2.0, 4.0)  # seen from the member that turns
_OUTPUT_ORDERS = (1.0, 2.0, 3.0, 4.0)  # per turn of the output
_SIDE = 0.05  # of the rated torque, over which a flank changes
_USUAL = 30.0 * ARCSEC  # amplitude of a wave of an arcminute from peak to peak, the prior of each
_ROWS_PER_COLUMN = 10
_PLAIN = 6.0  # square of a wave over that of its deviation: noise has 0.25 % of its waves beyond
_APART = 0.3  # of a wave at any phase, that torsion and friction must not explain
_MOST_ROWS, _MOST_SHOWN = 20_000, 4000  # to fit, and of the shape
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)  # quantiles of the torque
_STRETCHES = 12  # of a record, of which some are left out
_EVERY = np.ones(_STRETCHES)
_WITHOUT_ONE = 1.0 - np.eye(_STRETCHES)
# A median is not smooth: a hundred half samples tell its deviation (Shao and Wu, Ann. Stat. 17, 1989).
_HALF = list(combinations(range(_STRETCHES), _STRETCHES // 2))[::9]
_HALVES = [_WITHOUT_ONE[list(some)].min(axis=0) for some in _HALF]
_KNOTS = 10  # of the torsion's shape, at quantiles of the torque
_REACHES = (0.03, 0.1, 0.3)  # of the rated torque, over which friction sticks, as in a hysteresis
_PLACES = 72  # of an output turn
_EIGHT = 8.0  # square of a wave from peak to peak, over its mean square


class Accuracy(NamedTuple):
    """An error from peak to peak with its standard deviation [rad], and over what share of an output turn."""

    value: float
    std: float
    turns: float


def accuracy(
    record: Record,
    kinematics: Kinematics,
    rated_torque: float,
    orders: Sequence[float],
    noise: tuple[float, float],
) -> Accuracy:
    """The error of a record from peak to peak: its greatest positive and negative deviation together.

    Parameters
    ----------
    record : Record
    kinematics : Kinematics
    rated_torque : float
        [N m]
    orders : sequence of float
        Of waves that were found, per turn of the input.
    noise : (float, float)
        Its mean square and the standard deviation of that [rad^2].

    Notes
    -----
    The greatest of many noisy values is too large. So waves are fitted: low orders of the input's turn, which
    may change with the torque, of the member that turns and of the output, and those that were found; beside
    torsion of any shape with its loop, friction and an offset of every run. Their sum at the record's angles
    is the error's shape, and differs from torque to torque: the median over the `_LEVELS` of its torques
    counts. Its mean square is less what noise adds to it. What the waves leave within turns of the input,
    beyond the noise, counts as one more wave beside them. The deviation is by half samples of `_STRETCHES`
    stretches.
    """
    some = record.thinned(_MOST_ROWS)
    laws = np.stack([centered(law, some.run) for law in _slow_laws(some, rated_torque)], axis=1)
    error = centered(some.output_angle - some.input_angle / kinematics.ratio, some.run)
    rest = error - laws @ (inverse(laws.T @ laws) @ (laws.T @ error))
    # Of a part of a turn a wave of it is no wave.
    turns = _covered(record)
    told = _told_apart(orders, float(np.ptp(record.input_angle)))
    given = kinematics, rated_torque, told, _OUTPUT_ORDERS if turns >= WHOLE_TURN else ()
    waves = _waves(some, some.torque, *given)
    own, kept = _apart(waves, laws, some.run)
    levels = np.unique(np.quantile(some.torque, _LEVELS)).tolist()
    shown = some.thinned(_MOST_SHOWN)
    shapes = [_waves(shown, np.full(shown.size, level), *given)[:, kept] for level in levels]
    fit = _Fit(waves[:, kept], own, rest, shapes, noise[0])
    shape, std = fit.peak_to_peak()
    # What is slower than a turn of the input is torsion, or drifts.
    left = centered(rest - own @ fit.coefficients(_EVERY), some.turn)
    beyond = max(float(np.mean(left**2)) * fit.freedom - noise[0], 0.0)
    scatter = float(np.std([np.mean(part**2) for part in np.array_split(left, _STRETCHES)], ddof=1))
    square = shape**2 / _EIGHT + beyond
    spread = math.hypot(shape * std / (0.5 * _EIGHT), scatter / math.sqrt(_STRETCHES), noise[1])
    # d sqrt(x) = dx / (2 sqrt(x)), and no more than sqrt(dx) where x vanishes.
    deviation = min(spread / (2.0 * math.sqrt(max(square, 1e-300))), math.sqrt(spread))
    return Accuracy(math.sqrt(_EIGHT * square), math.sqrt(_EIGHT) * deviation, turns)


def _slow_laws(record: Record, rated_torque: float) -> list[Floats]:
    """Regressors (n,) for a torsion of any shape, its loop, and friction."""
    load = record.torque / rated_torque
    knots = np.quantile(load, np.linspace(0.0, 1.0, _KNOTS)[1:-1])
    change = np.where(np.diff(record.run, prepend=record.run[0]), 0.0, np.diff(load, prepend=load[0]))
    loops = (slip(0.0, change / reach) for reach in _REACHES)
    return [*usual_laws(record, rated_torque), *np.maximum(load - knots[:, None], 0.0), *loops]


def _covered(record: Record) -> float:
    """Share of an output turn that a record covers."""
    place = np.floor(np.mod(record.output_angle / (2.0 * np.pi), 1.0) * _PLACES).astype(np.int64)
    return np.unique(np.minimum(place, _PLACES - 1)).size / _PLACES


def _told_apart(orders: Sequence[float], way: float) -> list[float]:
    """Orders that a way of the input [rad] tells from those of any gear, and from each other."""
    told: list[float] = []
    for order in orders:
        if all(abs(order - one) * way > 2.0 * np.pi for one in (*_INPUT_ORDERS, *told)):
            told.append(order)
    return told


def _waves(
    record: Record,
    torque: Floats,
    kinematics: Kinematics,
    rated_torque: float,
    orders: Sequence[float],
    of_output: Sequence[float],
) -> Floats:
    """Columns of waves that an error may have at torques (n,) [N m], the most likely first, (n, 2 k)."""
    angle, load = record.input_angle, torque / rated_torque
    own = [turning(order * angle) for order in (*_INPUT_ORDERS, *orders)]
    own += [turning(order * angle / kinematics.ratio) for order in of_output]
    if record.has_torque:
        own += [law[:, None] * wave for wave in own[:_LOADED] for law in (np.tanh(load / _SIDE), load)]
    side = 1.0 if kinematics.output == "flexspline" else -1.0
    member = angle * (1.0 + side / abs(kinematics.ratio))
    own += [turning(order * member) for order in _MEMBER_ORDERS]
    return np.concatenate(own, axis=1)


def _apart(waves: Floats, laws: Floats, run: Integers) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """What torsion and friction leave of waves (n, k) that they cannot imitate, and which these are (k,)."""
    middle = np.stack([centered(column, run) for column in waves.T], axis=1)
    own = middle - laws @ (inverse(laws.T @ laws) @ (laws.T @ middle))
    pairs = range(0, waves.shape[1], 2)
    kept = np.repeat([_least_apart(own[:, at : at + 2], waves[:, at : at + 2]) > _APART for at in pairs], 2)
    kept[2 * (run.size // (2 * _ROWS_PER_COLUMN)) :] = False
    return own[:, kept], kept


def _least_apart(own: Floats, wave: Floats) -> float:
    """Share of a wave (n, 2) that is its own (n, 2), at the phase at which it has least."""
    shares = np.linalg.eigvals(inverse(wave.T @ wave) @ (own.T @ own)).real
    return math.sqrt(max(float(shares.min()), 0.0))


class _Fit:
    """Waves (n, k) fitted to a rest (n,) by what laws leave of them (n, k), stretch by stretch.

    `shapes` are the same waves at some torques each (m, k); the noise is a mean square [rad^2].
    """

    def __init__(
        self, waves: Floats, own: Floats, rest: Floats, shapes: Sequence[Floats], noise: float
    ) -> None:
        stretch = np.arange(rest.size) * _STRETCHES // rest.size
        parts = [stretch == number for number in range(_STRETCHES)]
        self._gram = np.stack([own[part].T @ own[part] for part in parts])
        self._moment = np.stack([own[part].T @ rest[part] for part in parts])
        self._prior = noise / _USUAL**2 * np.eye(own.shape[1])
        self._square, self._shapes = np.cov(waves, rowvar=False), shapes
        self.freedom = rest.size / max(rest.size - own.shape[1], 1)

    def coefficients(self, weight: Floats) -> Floats:
        """Of all waves (k,), stretches counting by a weight (_STRETCHES,)."""
        gram, moment = (np.tensordot(weight, one, 1) for one in (self._gram, self._moment))
        return np.asarray(inverse(gram + self._prior) @ moment)

    def peak_to_peak(self) -> tuple[float, float]:
        """Of the waves' sum, less what noise adds to it, and its standard deviation [rad]."""
        if not self._gram.shape[1]:
            return 0.0, 0.0
        whole = self.coefficients(_EVERY)
        found = np.stack([self.coefficients(weight) for weight in _WITHOUT_ONE])
        spread = (_STRETCHES - 1.0) * np.cov(found, rowvar=False, ddof=0)  # by the jackknife
        square, noise = (np.repeat(one.reshape(-1, 2).sum(axis=1), 2) for one in (whole**2, np.diag(spread)))
        plain, more = square > _PLAIN * noise, float(np.sum(self._square * spread))
        sizes = [self._size(weight, plain, more) for weight in _HALVES]
        return self._size(_EVERY, plain, more), float(np.std(sizes))

    def _size(self, weight: Floats, plain: npt.NDArray[np.bool_], more: float) -> float:
        """From peak to peak by stretches of a weight (_STRETCHES,), the median over the torques [rad].

        Its mean square is less what noise adds [rad^2], its form that of the waves that are plain (k,).
        """
        whole = self.coefficients(weight)
        common = math.sqrt(max(float(whole @ self._square @ whole) - more, 0.0))
        shown = np.where(plain, whole, 0.0)
        rms = math.sqrt(max(float(shown @ self._square @ shown), 0.0))
        if not rms:
            return math.sqrt(_EIGHT) * common
        return common / rms * float(np.median([np.ptp(shape @ shown) for shape in self._shapes]))
