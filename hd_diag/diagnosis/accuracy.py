"""A joint's error as in a catalogue: peak to peak over an output turn, without torsion and friction."""

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
"""Least share of an output turn for a record that covers it."""

_INPUT_ORDERS = (2.0, 1.0, 4.0, 3.0, 6.0, 8.0)  # per turn of the wave generator, the most likely first
_LOADED = 3  # the first of them may change with the torque
_MEMBER_ORDERS = (2.0, 4.0)  # seen from the member that turns
_OUTPUT_ORDERS = (1.0, 2.0, 3.0, 4.0)  # per turn of the output
_SIDE = 0.05  # width of a flank change, over the rated torque
_USUAL = 30.0 * ARCSEC  # prior width: amplitude of a wave of one arcminute peak to peak
_ROWS_PER_COLUMN = 10
_PLAIN = 6.0  # squared wave over squared deviation that 0.25 % of noise waves exceed
_APART = 0.3  # share of a wave at any phase that torsion and friction must leave
_MOST_ROWS, _MOST_SHOWN = 20_000, 4000  # rows of the fit, and of the shape
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)  # quantiles of the torque
_STRETCHES = 12  # parts of a record for the jackknife and half samples
_EVERY = np.ones(_STRETCHES)
_WITHOUT_ONE = 1.0 - np.eye(_STRETCHES)
# A median is not smooth, so its deviation needs a hundred half samples (Shao and Wu, Ann. Stat. 17, 1989).
_HALF = list(combinations(range(_STRETCHES), _STRETCHES // 2))[::9]
_HALVES = [_WITHOUT_ONE[list(some)].min(axis=0) for some in _HALF]
_KNOTS = 10  # knots of the torsion's shape, at quantiles of the torque
_REACHES = (0.03, 0.1, 0.3)  # torque changes over which hysteresis sticks, over the rated torque
_PLACES = 72  # bins of an output turn
_EIGHT = 8.0  # squared peak to peak of a wave over its mean square


class Accuracy(NamedTuple):
    """Peak-to-peak error, its standard deviation [rad], and the share of an output turn that it covers."""

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
    """Peak-to-peak error of a record: the sum of its greatest positive and negative deviation.

    Parameters
    ----------
    record : Record
    kinematics : Kinematics
    rated_torque : float
        [N m]
    orders : sequence of float
        Periods per turn of the input of the waves that were found.
    noise : (float, float)
        Mean square of the noise and the standard deviation of this mean square [rad^2].

    Notes
    -----
    The maximum of many noisy values is too large, so the error's shape is fitted. Its waves are those that
    were found and low orders of the input, the member that turns and the output; some input waves may change
    with the torque. The fit includes torsion of any shape, its loop, friction and an offset of every run. The
    shape is the sum of the waves at the record's angles. As it varies with torque, the median peak to peak
    over the `_LEVELS` of the torque counts. The noise's contribution to the mean square is subtracted. The
    residual within turns of the input, beyond the noise, counts as one more wave. The deviation comes from
    half samples of `_STRETCHES` stretches.
    """
    some = record.thinned(_MOST_ROWS)
    laws = np.stack([centered(law, some.run) for law in _slow_laws(some, rated_torque)], axis=1)
    error = centered(some.output_angle - some.input_angle / kinematics.ratio, some.run)
    rest = error - laws @ (inverse(laws.T @ laws) @ (laws.T @ error))
    # Over part of an output turn, its waves cannot be identified.
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
    # Parts slower than a turn of the input are torsion or drift.
    left = centered(rest - own @ fit.coefficients(_EVERY), some.turn)
    beyond = max(float(np.mean(left**2)) * fit.freedom - noise[0], 0.0)
    scatter = float(np.std([np.mean(part**2) for part in np.array_split(left, _STRETCHES)], ddof=1))
    square = shape**2 / _EIGHT + beyond
    spread = math.hypot(shape * std / (0.5 * _EIGHT), scatter / math.sqrt(_STRETCHES), noise[1])
    # d sqrt(x) = dx / (2 sqrt(x)), limited to sqrt(dx) where x vanishes.
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
    """Orders that an input travel [rad] distinguishes from those of any gear, and from each other."""
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
    """Columns (n, 2 k) of waves that an error may have at torques (n,) [N m], the most likely first."""
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
    """Parts (n, m) of waves (n, k) that torsion and friction cannot imitate, and the mask of these m (k,)."""
    middle = np.stack([centered(column, run) for column in waves.T], axis=1)
    own = middle - laws @ (inverse(laws.T @ laws) @ (laws.T @ middle))
    pairs = range(0, waves.shape[1], 2)
    kept = np.repeat([_least_apart(own[:, at : at + 2], waves[:, at : at + 2]) > _APART for at in pairs], 2)
    kept[2 * (run.size // (2 * _ROWS_PER_COLUMN)) :] = False
    return own[:, kept], kept


def _least_apart(own: Floats, wave: Floats) -> float:
    """Rms of a wave's own part (n, 2) over that of the wave (n, 2), at the least favourable phase."""
    shares = np.linalg.eigvals(inverse(wave.T @ wave) @ (own.T @ own)).real
    return math.sqrt(max(float(shares.min()), 0.0))


class _Fit:
    """Fit of waves (n, k) to a residual (n,), with normal equations per stretch.

    `own` (n, k) are the waves with torsion and friction projected out. `shapes` are the same waves (m, k) at
    one torque level each; `noise` is a mean square [rad^2].
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
        """Coefficients of all waves (k,), with a weight per stretch (_STRETCHES,)."""
        gram, moment = (np.tensordot(weight, one, 1) for one in (self._gram, self._moment))
        return np.asarray(inverse(gram + self._prior) @ moment)

    def peak_to_peak(self) -> tuple[float, float]:
        """Peak to peak of the waves' sum, corrected for noise, and its standard deviation [rad]."""
        if not self._gram.shape[1]:
            return 0.0, 0.0
        whole = self.coefficients(_EVERY)
        found = np.stack([self.coefficients(weight) for weight in _WITHOUT_ONE])
        spread = (_STRETCHES - 1.0) * np.cov(found, rowvar=False, ddof=0)  # jackknife covariance
        square, noise = (np.repeat(one.reshape(-1, 2).sum(axis=1), 2) for one in (whole**2, np.diag(spread)))
        plain, more = square > _PLAIN * noise, float(np.sum(self._square * spread))
        sizes = [self._size(weight, plain, more) for weight in _HALVES]
        return self._size(_EVERY, plain, more), float(np.std(sizes))

    def _size(self, weight: Floats, plain: npt.NDArray[np.bool_], more: float) -> float:
        """Peak to peak [rad] with a weight per stretch (_STRETCHES,), as median over the torques.

        `more` is subtracted from its mean square for noise [rad^2]. Only `plain` waves (k,) give its shape.
        """
        whole = self.coefficients(weight)
        common = math.sqrt(max(float(whole @ self._square @ whole) - more, 0.0))
        shown = np.where(plain, whole, 0.0)
        rms = math.sqrt(max(float(shown @ self._square @ shown), 0.0))
        if not rms:
            return math.sqrt(_EIGHT) * common
        return common / rms * float(np.median([np.ptp(shape @ shown) for shape in self._shapes]))
