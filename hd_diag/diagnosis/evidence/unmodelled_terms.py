"""Terms without a known cause. They compete with the causes, so that no lookalike is named for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.noise import bounds, spans
from hd_diag.effects.effect import Effect, Kind, Stage, Starts, Values
from hd_diag.effects.encoder_interpolation import is_round
from hd_diag.effects.excitation import output_turns
from hd_diag.effects.order_spectrum import integer_orders, peaks
from hd_diag.effects.output_encoder_interpolation import EFFECT as OUTPUT_ENCODER_LINES
from hd_diag.effects.quantity import Quantity, amplitude, direction, switch, turning
from hd_diag.effects.remainders import LINES
from hd_diag.effects.signals import Signals
from hd_diag.formatting import ARCSEC

Shape = Callable[[Signals], Floats]

_STRETCHES = 12  # most stretches with a creep
_CELLS = 240  # per turn of the output
_WIDTHS = (0.06, 0.15)  # half widths of a bump, of output angle [rad]
_PERIODS = 4.0  # least periods of a line within the angle covered
_LOWEST, _HIGHEST = 8, 1.9  # lowest line per output turn; highest per input turn
_FEWEST = 8  # fewest lines of a usual input encoder
_EVERY = np.arange(3, 41)
# Orders of the input that are neither a line of any gear nor a usual line number of an encoder.
# Seen from the flexspline, those of its teeth.
_ORDERS = (
    _EVERY[~np.isin(_EVERY, LINES) & ((_EVERY < _FEWEST) | ~is_round(_EVERY))],
    np.array([2, 4, 6, 8]),
)
_PEAKS = 3  # highest peaks of a spectrum to start from


_SIZE = Quantity("size", "rad", -1.0, 1.0, 1e-4, "of the greatest column")


@dataclass(frozen=True, kw_only=True)
class UnmodelledTerm(Effect):
    """Columns of a shape without a known cause; `cause` describes the shape.

    Parameters
    ----------
    shape : callable
        Takes signals and gives columns of order one, shape (n, k); k = 0 if the record has none.
    """

    kind: Kind = "kinematic"
    needs: tuple[str, ...] = ()
    quantities: tuple[Quantity, ...] = (_SIZE,)
    confused_with: tuple[str, ...] = ()
    source: str = "no cause is known"
    inspect: str = ""
    stage: Stage = Stage.REPORTED
    shape: Shape = lambda signals: np.empty((signals.size, 0))

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """See :meth:`Effect.columns`."""
        return self.shape(signals) if signals.size else np.empty((0, 0))

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Whether the record has columns of it."""
        return bool(self.columns(signals, ()).shape[1]), "the record has nothing of the kind"


@dataclass(frozen=True, kw_only=True)
class LocalBump(UnmodelledTerm):
    """A Gaussian bump at one place of the output's turn; `width` is its half width to 1/e [rad]."""

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """See :meth:`Effect.columns`."""
        position, width = nonlinear
        away = np.angle(np.exp(1j * (signals.output_angle - position)))
        bump: Floats = np.exp(-((away / width) ** 2))
        return bump[:, None]

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Whether the output moves by more than half a radian."""
        moved = bool(signals.size) and float(np.ptp(signals.output_angle)) > 0.5
        return moved, "the output moves by less than half a radian"

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """For each width, the place where a bump explains most of a residual averaged over output turns."""
        trials = _CELLS * len(_WIDTHS)
        if residual is None:
            return Starts([(0.0, _WIDTHS[0])], trials)
        cell = np.floor(np.mod(signals.output_angle, 2.0 * np.pi) * (_CELLS / (2.0 * np.pi))).astype(np.int64)
        cell %= _CELLS
        total = np.bincount(cell, residual - residual.mean(), _CELLS).astype(np.float64)
        count = np.bincount(cell, minlength=_CELLS).astype(np.float64)
        place = 2.0 * np.pi / _CELLS * (np.arange(_CELLS) + 0.5)
        found: list[Values] = []
        for width in _WIDTHS:
            bump = np.exp(-((np.angle(np.exp(1j * (place - place[0]))) / width) ** 2))
            moment, norm = _around(total, bump), _around(count, bump**2)
            gain = np.where(norm > 0.02 * norm.max(), moment**2 / np.maximum(norm, 1e-300), 0.0)
            found.append((float(place[int(np.argmax(gain))]), width))
        return Starts(found, trials)


def _around(values: Floats, bump: Floats) -> Floats:
    """Sums of values weighted by a bump around every cell."""
    return np.asarray(np.fft.irfft(np.fft.rfft(values) * np.conj(np.fft.rfft(bump)), values.size))


@dataclass(frozen=True, kw_only=True)
class UnmodelledLine(UnmodelledTerm):
    """A wave; the first nonlinear value counts its periods."""

    def order(self, signals: Signals, nonlinear: Values) -> float:
        """Periods per turn of the input."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class OutputLine(UnmodelledLine):
    """A wave with a whole number of periods per output turn, as rollers of an output bearing would leave.

    Orders of the gear and line numbers of encoders are excluded: they belong to causes.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """See :meth:`Effect.columns`."""
        return turning(nonlinear[0] * signals.output_angle)

    def order(self, signals: Signals, nonlinear: Values) -> float:
        """See :meth:`UnmodelledLine.order`."""
        return nonlinear[0] / abs(signals.ratio)

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Whether some line passes several periods."""
        return bool(_line_numbers(signals).size), "the output moves too little to show a line"

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """The strongest whole orders of a residual and their neighbours, as a partial turn blurs orders."""
        numbers = _line_numbers(signals)
        if residual is None or not numbers.size:
            return Starts([(float(one),) for one in numbers[:1]], numbers.size)
        strength = integer_orders(signals.output_angle, residual, int(numbers[-1]))[numbers]
        strongest = numbers[peaks(strength, 0)[:_PEAKS]]
        around = np.unique(strongest[:, None] + np.array([-1, 0, 1]))
        return Starts([(float(one),) for one in np.intersect1d(around, numbers)], numbers.size)


@dataclass(frozen=True, kw_only=True)
class InputLine(UnmodelledLine):
    """A wave with a whole number of periods per input turn, seen from the case or from the flexspline.

    Seen from the case, lines of any gear and line numbers of encoders are excluded: they have terms of their
    own. The amplitude may change with the torque, as that of a wave from the teeth does. Such a wave is no
    pure sine: both lobes pass each tooth, so its next part has two periods more.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """The wave, the wave times the root of the load, and its next part; see :meth:`Effect.columns`."""
        number, angle = nonlinear[0], signals.seen_from(nonlinear[1])
        wave, following = turning(number * angle), turning((number + 2.0) * angle)
        load = np.sqrt(np.minimum(np.abs(signals.torque) / signals.rated_torque, 1.0))
        return np.concatenate((wave, load[:, None] * wave, following), axis=1)

    def order(self, signals: Signals, nonlinear: Values) -> float:
        """See :meth:`UnmodelledLine.order`."""
        number, member = nonlinear
        return number * (1.0 + member / signals.contact.drive.mesh.geometry.reduction)

    def testable(self, signals: Signals) -> tuple[bool, str]:
        """Whether the input turns several times."""
        turned = float(np.ptp(signals.wave_generator_angle)) if signals.size else 0.0
        return turned > 2.0 * np.pi * _PERIODS, "the input turns too little to show a line"

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """The strongest whole orders of a residual, seen from either member."""
        trials = sum(orders.size for orders in _ORDERS)
        if residual is None:
            return Starts([(float(_ORDERS[0][0]), 0.0)], trials)
        found = list[Values]()
        for member, orders in enumerate(_ORDERS):
            strength = integer_orders(signals.seen_from(member), residual, int(orders[-1]))[orders]
            found += [(float(one), float(member)) for one in orders[peaks(strength, 0)[:_PEAKS]]]
        return Starts(found, trials)


def _line_numbers(signals: Signals) -> Integers:
    """Whole numbers per output turn that a line of unknown cause may have."""
    turned = output_turns(signals)
    if turned == 0.0:
        return np.empty(0, np.int64)
    ratio = abs(signals.ratio)
    number = np.arange(max(_LOWEST, math.ceil(_PERIODS / turned)), int(_HIGHEST * ratio))
    of_gear = np.abs(number - ratio * np.rint(number / ratio)) < 1.0
    return number[~of_gear & ~OUTPUT_ENCODER_LINES.divides(number)]


def _full(values: Floats) -> Floats:
    return np.asarray(values / max(float(np.max(np.abs(values), initial=0.0)), 1e-300))


def _creep(signals: Signals) -> Floats:
    """Travel, torque times travel, and a constant for every stretch, which holds the creep before it."""
    stretches = bounds(signals.run)
    if len(stretches) > _STRETCHES:
        return np.empty((signals.size, 0))
    columns = np.zeros((signals.size, 2))
    for begin, end in stretches:
        rows = slice(begin, end)
        way = np.abs(np.diff(signals.output_angle[rows], prepend=signals.output_angle[begin]))
        columns[rows] = np.cumsum(np.stack((way, way * signals.torque[rows]), axis=1), axis=0)
    started = _constants(signals, signals.run, np.arange(signals.size))
    return np.concatenate((np.stack([_full(c) for c in columns.T], axis=1), started), axis=1)


def _constants(signals: Signals, part: Integers, rows: Integers) -> Floats:
    """A constant for every part of a record, shape (n, k), except where a free encoder zero covers it.

    That is the first part of a recording. `part` is the number of each sample's part (n,), rising; `rows` are
    the samples that count.
    """
    recording = np.zeros(signals.size, np.int64) if signals.recording is None else signals.recording
    first = np.flatnonzero(np.diff(part[rows])) + 1
    goes_on = recording[rows[first]] == recording[rows[first - 1]]
    return np.asarray(part[:, None] == part[rows[first[goes_on]]], np.float64)


def _rests(signals: Signals) -> Floats:
    """A constant for every run, from the middle of one rest to that of the next."""
    speed = np.abs(signals.speed)
    least = 0.01 * float(np.percentile(speed, 95))
    began = np.concatenate(([False], np.diff(signals.run) != 0))
    began[_rest_middles(speed, least)] = True
    number = np.cumsum(began)
    count = np.bincount(number, speed >= least)
    kept = np.flatnonzero(count > 0.01 * signals.size)
    if not 3 <= kept.size <= 60:
        return np.empty((signals.size, 0))
    # A short flicker of motion belongs to the run before it.
    place = np.maximum(np.searchsorted(kept, number, side="right") - 1, 0)
    return _constants(signals, place, np.flatnonzero((speed >= least) & np.isin(number, kept)))


def _rest_middles(speed: Floats, least: float) -> list[int]:
    """Rows in the middle of the slowest part of every rest, since a slow run begins slowly."""
    found = []
    for begin, end in spans(speed < least):
        part = speed[begin:end]
        slowest = np.flatnonzero(part <= max(0.1 * least, float(part.min())))
        found.append(begin + int(slowest[0] + slowest[-1]) // 2)
    return found


OUTPUT_LINES = tuple(
    OutputLine(
        name=f"output_line_{number}",
        cause="belongs to the output's turn",
        frame="output",
        quantities=(
            amplitude("amplitude", "rad", 1e-3, 3.0 * ARCSEC, "of the transmission error"),
            direction("phase", "of the wave at output angle zero"),
            Quantity("number", "-", _LOWEST, 1e3, 1.0, "periods per output turn", False, discrete=True),
        ),
    )
    for number in (1, 2, 3)
)
"""Several terms of one kind. The search tries the first that is not in the set."""

UNMODELLED_TERMS = (
    UnmodelledTerm(
        name="creep",
        shape=_creep,
        cause="grows with the way, and with torque times way: something creeps",
        frame="input",
        remembers=True,  # it adds up the way between fitted rows
    ),
    UnmodelledTerm(
        name="rests",
        shape=_rests,
        cause="settles again at every rest: something is loose",
        frame="time",
        remembers=True,  # it changes at rest, where rows are not fitted
    ),
    LocalBump(
        name="place",
        cause="belongs to one place of the output's turn",
        frame="output",
        quantities=(
            _SIZE,
            Quantity("position", "rad", 0.0, 2.0 * np.pi, 6.3, "output angle", False, 2.0 * np.pi, True),
            Quantity("width", "rad", 0.01, 1.0, 0.1, "half width to 1/e", False, None, True),
        ),
    ),
    *OUTPUT_LINES,
    InputLine(
        name="input_line",
        cause="belongs to the input's turn",
        frame="input",
        quantities=(
            amplitude("amplitude", "rad", 1e-3, 3.0 * ARCSEC, "of the transmission error"),
            direction("phase", "of the wave at the wave generator's angle zero"),
            Quantity("number", "-", 2.0, 1e3, 1.0, "periods per input turn", False, discrete=True),
            switch("member", "seen from 0: the case, 1: the flexspline"),
        ),
    ),
)
"""Each is tested like a cause, and described if it wins."""
