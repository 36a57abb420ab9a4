"""Ripple of a joint's torque over its position: analysis of a gear by one angle and a torque or current.

At an order each window of the motion has a complex amplitude. These must agree in phase over the windows, and
their mean must exceed those at neighbouring orders. The ripple gives neither an error of the gear nor
a cause: a torque shows the combined effect of sensor, motor, friction and gear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.ripple.band import PASSING, Band, band
from hd_diag.diagnosis.ripple.delay import Delay, found_delay, late
from hd_diag.diagnosis.ripple.lines import BESIDE, LEAST_WINDOWS, Line, lines_at
from hd_diag.diagnosis.ripple.windows import TURN, TURNS, Windows, windows
from hd_diag.effects.order_spectrum import peaks, prominence, top
from hd_diag.model.transmission_error import Kinematics

MULTIPLES = (1.0, 2.0, 4.0)
"""Periods per turn of the wave generator: itself, its two lobes, and twice the lobes."""

NO_TORQUE = "the robot's driver would have to publish effort, or the current"
"""Message if the torque is not measured."""

_TOO_FEW = "the samples are too far apart to resolve its waves; record faster, or"
_LOWEST, _HIGHEST = 0.3, 4.5  # orders of the spectrum, per turn of the wave generator
_MOST_WINDOWS = 200  # in a spectrum
_MOST_OTHERS = 3
_WIDTH = 1.5  # width of a line, in periods over the reach


@dataclass(frozen=True)
class Unseen:
    """An order of the gear that the record cannot show.

    Attributes
    ----------
    order, frequency : float
        Periods per turn of the output; frequency at the median speed of the record [Hz].
    corner, slower : float
        Corner of the filter that removes it [Hz], inf if the sampling is too slow instead; speed of the
        output below which it would be visible [rad/s].
    """

    order: float
    frequency: float
    corner: float
    slower: float


@dataclass(frozen=True)
class Ripple:
    """Lines of a joint's torque; `ratio` is the magnitude of the gear's ratio.

    Attributes
    ----------
    lines, others : tuple of Line
        Lines at the gear's orders, found or not, by order; lines at other orders, the strongest first.
    orders, spectrum : ndarray, shape (k,)
        Orders per turn of the output; amplitude of the mean over the windows [N m].
    turns, reach : float
        Turns of the wave generator that the windows cover; turns of the output from end to end.
    unseen : tuple of Unseen
        Orders of the gear that the record cannot show.
    corner : float
        Corner of a low-pass filter of the torque [Hz]; inf if there is none.
    delay : Delay or None
        Delay of the torque against the angle, for which the lines are corrected; None if none was found.
    """

    ratio: float
    lines: tuple[Line, ...]
    others: tuple[Line, ...]
    orders: Floats
    spectrum: Floats
    windows: int
    runs: int
    records: int
    turns: float
    reach: float
    unseen: tuple[Unseen, ...]
    corner: float
    delay: Delay | None

    @property
    def found(self) -> tuple[Line, ...]:
        """The gear's lines that were found, the largest first."""
        return tuple(sorted((line for line in self.lines if line.found), key=lambda line: -line.amplitude))


def ripple(
    time: Floats, input_angle: Floats, torque: Floats | None, record: Integers, kinematics: Kinematics
) -> Ripple:
    """Lines of a torque at the orders of a gear.

    Parameters
    ----------
    time, input_angle, torque, record : ndarray, shape (n,)
        As in :func:`hd_diag.diagnosis.ripple.windows.windows`; a joint with only an output angle gives that
        times the ratio. None: the torque is not measured.
    kinematics : Kinematics
        Its ratio counts the wave generator's turns seen from the housing. Seen from the output, there is one
        more if the output is the flexspline, otherwise one less.

    Raises
    ------
    RecordError
        If the motion is too short, the sampling is too slow, or the torque does not change.
    """
    if torque is None:
        raise RecordError(f"the torque is not in it: {NO_TORQUE}")
    kept = np.flatnonzero(np.isfinite(time) & np.isfinite(input_angle) & np.isfinite(torque))
    if not kept.size:
        raise RecordError("no row has a time, an angle and a torque that are numbers")
    time, torque, record = time[kept], torque[kept], record[kept]
    if float(np.ptp(torque)) == 0.0:
        raise RecordError(f"the torque never changes: {NO_TORQUE}")
    size, angle = abs(kinematics.ratio), np.sign(kinematics.ratio) * input_angle[kept]
    whole = windows(time, angle, torque, record)
    if whole.size < LEAST_WINDOWS:
        raise RecordError(
            f"too little motion: {whole.size} times {TURNS:g} turns of the wave generator in one direction "
            f"({360.0 * TURNS / size:.0f}° of the output), {LEAST_WINDOWS} are needed"
        )
    shift = (1.0 if kinematics.output == "flexspline" else -1.0) / size
    passed = band(time, angle, torque, whole.rows, MULTIPLES)
    delay = found_delay(_within(whole, passed), MULTIPLES, shift)
    if delay is not None:
        whole = windows(time, late(time, angle, record, delay.value), torque, record)
    seen = _within(whole, passed)
    lines, unseen = list[Line](), list[Unseen]()
    for multiple in MULTIPLES:
        own = multiple, size, (0.0, multiple * shift), len(MULTIPLES)
        if not (found := lines_at(seen, *own)):
            unseen.append(_unseen(whole, passed, multiple, size))
            found = [replace(line, filtered=True) for line in lines_at(whole, *own) if line.found]
        lines += found
    if not lines:
        raise RecordError(not_seen(unseen))
    orders, spectrum = _spectrum(seen)
    others = _others(seen, orders, spectrum, lines, size)
    return Ripple(
        size,
        tuple(lines),
        tuple(others),
        orders * size,
        spectrum,
        whole.size,
        int(np.unique(whole.run).size),
        int(np.unique(whole.record).size),
        TURNS * whole.size,
        whole.reach / size,
        tuple(unseen),
        passed.corner,
        delay,
    )


def _within(whole: Windows, passed: Band) -> Windows:
    """Windows whose `highest` order is limited to the torque's band."""
    turns = np.maximum(np.abs(whole.speed), 1e-300) / TURN
    return replace(whole, highest=np.minimum(whole.highest, passed.seen / turns))


def _unseen(whole: Windows, passed: Band, multiple: float, ratio: float) -> Unseen:
    """Why the windows cannot show a multiple of the wave generator's turn."""
    turns, highest = np.abs(whole.speed) / TURN, multiple + BESIDE[1] / TURNS
    usual = float(np.median(turns))
    by_samples = bool(np.median(whole.highest) < highest)
    limit = float(np.median(whole.highest * turns)) if by_samples else np.inf
    slower = min(limit, PASSING * passed.corner) / highest * TURN / ratio
    return Unseen(multiple * ratio, multiple * usual, np.inf if by_samples else passed.corner, slower)


def not_seen(unseen: Sequence[Unseen]) -> str:
    """Why orders cannot be seen in a record, in a sentence or two; empty if all can be seen."""
    told = []
    for by_filter in (True, False):
        own = [one for one in unseen if np.isfinite(one.corner) == by_filter]
        if own:
            orders = ", ".join(f"{one.order:g}" for one in own)
            why = f"the torque is filtered at about {own[0].corner:.2g} Hz;" if by_filter else _TOO_FEW
            slower = f"move slower than {', '.join(f'{one.slower:.2g}' for one in own)} rad/s"
            told.append(f"{orders} per output turn cannot be seen here: {why} {slower}")
    return ". ".join(told)


def _spectrum(whole: Windows) -> tuple[Floats, Floats]:
    """Orders per turn of the wave generator (k,), and amplitudes of the mean over some windows (k,) [N m]."""
    some = whole.select(np.unique(np.linspace(0, whole.size - 1, _MOST_WINDOWS).astype(np.int64)))
    highest = min(_HIGHEST, float(np.median(some.highest)))
    orders = np.arange(_LOWEST, max(highest, _LOWEST + 1e-9), 0.5 / some.reach)
    return orders, np.abs(np.mean(some.amplitudes(orders), axis=0))


def _others(
    whole: Windows, orders: Floats, spectrum: Floats, lines: Sequence[Line], ratio: float
) -> list[Line]:
    """Lines at the spectrum's peaks that are neither at the gear's orders nor next to found lines."""
    beside = int(BESIDE[0] / TURNS / (orders[1] - orders[0])) if orders.size > 1 else 0
    height = prominence(spectrum, 2 * beside)
    for line in lines:
        near = BESIDE[0] / TURNS if line.found else _WIDTH / whole.reach
        height[np.abs(orders - line.order / ratio) <= near] = 0.0
    found: list[Line] = []
    tests = max(int((_HIGHEST - _LOWEST) * whole.reach), 1)
    for at in peaks(height, beside)[:_MOST_OTHERS]:
        seen = [
            line
            for line in lines_at(whole, top(orders, spectrum, int(at)), ratio, (0.0,), tests)
            if line.found
        ]
        if not seen:
            break
        found.append(max(seen, key=lambda line: line.amplitude))
    return found
