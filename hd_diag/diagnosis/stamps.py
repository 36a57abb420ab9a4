"""Samples before they become a record: refused, unpaired, in bursts, or after a clock was set back."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.smoothing import smooth
from hd_diag.streams.rules import CLOCK_JUMP, PAIRING_GAP

UNPAIRED = (
    f"have no input angle within {PAIRING_GAP * 1e-6:.0f} ms of their stamp: was one clock used for both, "
    "and does the input come as often?"
)
"""Message about output angles without an input angle."""


LEAST_RATE = 2.0
"""Lowest plausible sampling rate of a joint's record [Hz]."""

LONGEST_TURN = 3600.0
"""Longest plausible time for one turn of a joint [s]."""

_PARTS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))  # of a second
_MOVED = 0.1  # travel below which a speed is noise [rad]
_CLOCK_WINDOW = 0.5  # time over which a clock runs evenly [s]
_LEAST_JITTER = 1e-3  # rms, over the usual step
_BETWEEN = 0.5  # half-way between even sampling and sampling at the stamps
_SOME = 0.05  # least share of rows that follow at once; fewer are delayed messages
_AT_ONCE = 1e-4  # step of stamps below which samples were not taken one after the other [s]: 10 kHz
_PAUSED = 2.0  # usual lengths of a burst, beyond which the recording paused


def usual_step(time: Floats) -> float:
    """Median step of rising stamps [s]; nan if none rises."""
    step = np.diff(time)
    return float(np.median(step[step > 0.0])) if (step > 0.0).any() else math.nan


def without_jitter(time: Floats, angle: Floats, segment: Integers) -> Floats:
    """Times of sampling [s], (n,): the stamps without jitter, if only the stamps jitter.

    A control loop reads its encoders evenly, but messages are stamped with a varying delay. The angle then
    does not follow the stamps' jitter. At full speed a tenth of a millisecond is 20 arcsec.

    Parameters
    ----------
    time, angle : ndarray, shape (n,)
        Stamps [s], and an angle that moves [rad].
    segment : ndarray of int64, shape (n,)
        Number of the gap-free stretch of each sample, ascending.
    """
    step = usual_step(time)
    inside = np.diff(segment) == 0
    steps = np.maximum(np.rint(np.diff(time) / step), 1.0)
    evenly = step * np.concatenate(([0.0], np.cumsum(np.where(inside, steps, 0.0))))
    own = time - evenly
    even = evenly + smooth(own - own[0], segment, step, _CLOCK_WINDOW) + own[0]
    late = time - even
    if np.std(late) <= _LEAST_JITTER * step or np.any(np.abs(late) > 0.5 * step):
        return time
    speed = np.gradient(angle) / step
    near = np.convolve(inside & (steps == 1.0), np.ones(5), "valid") == 5.0
    moved, jitter = (np.diff(values, 3)[1:-1][near] for values in (angle, speed * late))
    return even if moved @ jitter < _BETWEEN * (jitter @ jitter) else time


def without_bursts(time: Floats, angle: Floats, bag: Integers) -> tuple[Floats, float]:
    """Times of sampling [s], (n,), and the rows in a burst; the stamps and 0 if they are in no bursts.

    A recorder that empties a buffer stamps its rows together: some rows, closer than any joint is sampled,
    after a pause. It may do so all the time or now and then. The rows were sampled evenly since the row
    before if the angle moves as much within a burst as between bursts.

    Parameters
    ----------
    time, angle : ndarray, shape (n,)
        Stamps [s], and an angle that moves [rad].
    bag : ndarray of int64, shape (n,)
        Recording of each row, ascending.
    """
    step, moved, same = np.diff(time), np.abs(np.diff(angle)), np.diff(bag) == 0
    within, across = same & (step < _AT_ONCE), same & ~(step < _AT_ONCE)
    if within.sum() < _SOME * time.size or not across.any():
        return time, 0.0
    last = np.append(np.flatnonzero(~within), time.size - 1)  # row of each burst, or a row alone
    count = np.diff(last, prepend=-1)
    period = np.diff(time[last], prepend=-np.inf)
    period[np.diff(bag[last], prepend=-1) != 0] = np.inf
    pace = float(np.median((period / count)[np.isfinite(period)]))
    if np.median(step[within]) > _BETWEEN * pace or moved[within].mean() < _BETWEEN * moved[across].mean():
        return time, 0.0
    local = np.where(period > _PAUSED * count * pace, pace, period / count)
    rows = np.repeat(last, count) - np.arange(time.size)
    return np.repeat(time[last], count) - rows * np.repeat(local, count), float(count[count > 1].mean())


class Stamps(NamedTuple):
    """Counts of samples that are in no record, and other problems of the stamps.

    In order: the number of refused samples and the reason of the last; output angles without an input angle
    at their stamp; how often the clock was set back within a recording; unfinished, damaged or missing files;
    messages with a stamp of zero, which get their time of reception; texts about rows of a second publisher,
    which are left out; rows in a burst of stamps.
    """

    refused: int = 0
    reason: str = ""
    unpaired: int = 0
    set_back: int = 0
    problems: tuple[str, ...] = ()
    unstamped: int = 0
    others: tuple[str, ...] = ()
    in_bursts: float = 0.0

    @property
    def reported(self) -> dict[str, Any]:
        """The fields by name, for JSON."""
        names = (
            *("refused", "last_refusal", "unpaired", "clock_set_back"),
            *("problems", "stamps_zero", "second_publisher"),
        )
        lists = {"problems": list(self.problems), "second_publisher": list(self.others)}
        return dict(zip(names, self, strict=False)) | lists

    @property
    def lines(self) -> list[str]:
        """All problems in words: incomplete files, zero stamps, second publishers, refused samples."""
        count = f"{self.refused} samples are" if self.refused > 1 else "1 sample is"
        refused = f"{count} left out, the last because: {self.reason}"
        broken = [self.broken] if self.problems else []
        received = [self.received] if self.unstamped else []
        received += [self.burst] if self.in_bursts else []
        return [*broken, *received, *self.others, *([refused] if self.refused else [])]

    @property
    def received(self) -> str:
        """Message about stamps of zero."""
        return f"the stamps of {self.unstamped} messages are zero: the time of reception stands for them"

    @property
    def burst(self) -> str:
        """Message about stamps in bursts."""
        return f"the stamps come in bursts of {self.in_bursts:.0f} rows, which count as sampled evenly"

    def after(self, text: str) -> str:
        """A text, followed by the message about incomplete files unless it contains this already."""
        return f"{text}; {self.broken}" if self.problems and self.broken not in text else text

    @property
    def broken(self) -> str:
        """Message about incomplete files, as part of a sentence."""
        return (
            f"the recording is not whole ({'; '.join(self.problems)}): the result is for what could be read"
        )

    @property
    def why(self) -> str:
        """Why there are so few samples, in words; empty if unknown."""
        if self.unstamped:
            both = "`stamp: reception` for the joint's other signals puts all on one clock"
            return self.after(f": {self.received}; {both}")
        if self.unpaired:
            return self.after(f": {self.unpaired} output angles {UNPAIRED}")
        refused = f": {self.refused} were refused, the last because: {self.reason}"
        return self.after(refused if self.refused else "")

    def and_then(self, later: Stamps) -> Stamps:
        """Counts of this recording and a later one together."""
        counts = self.unpaired + later.unpaired, self.set_back + later.set_back
        problems = tuple(dict.fromkeys(self.problems + later.problems))
        both = self.unstamped + later.unstamped, tuple(dict.fromkeys(self.others + later.others))
        refused, in_bursts = self.refused + later.refused, max(self.in_bursts, later.in_bursts)
        return Stamps(refused, later.reason or self.reason, *counts, problems, *both, in_bursts)


UNTOLD = Stamps()
"""For records without information about their stamps."""


def by_clock(time: Floats, bag: Integers, stamps: Stamps) -> tuple[Integers, Stamps]:
    """Recording numbers (n,), with a new one after each clock set back, and the updated stamps.

    Times [s] and recording numbers have shape (n,); `stamps` holds earlier counts.
    """
    step = np.where(np.diff(bag) == 0, np.diff(time), np.nan)
    back = step < -CLOCK_JUMP * 1e-9
    late = int(np.count_nonzero((step <= 0.0) & ~back))
    bag = bag + np.concatenate(([0], np.cumsum(back)))[: bag.size]
    set_back = stamps.set_back + int(np.count_nonzero(back))
    reason = "their stamps repeat the last, or are before it" if late else stamps.reason
    return bag, stamps._replace(refused=stamps.refused + late, reason=reason, set_back=set_back)


def doubtful_clock(time: Floats, bag: Integers, angle: Floats) -> tuple[str, str] | None:
    """A message and the likely unit of time if it cannot be s; None if rate and motion are plausible.

    Times [s], recording numbers and output angles [rad] have shape (n,). Plausible is a rate of at least
    :data:`LEAST_RATE`, and a speed at which the joint turns within :data:`LONGEST_TURN`.
    """
    step = np.diff(time)
    step = step[(step > 0.0) & (np.diff(bag) == 0)]
    if not step.size:
        return None
    usual, turn = float(np.median(step)), _turn_time(time, bag, angle)
    fits = [n for n, k in _PARTS if usual * k * LEAST_RATE <= 1.0 and turn * k <= LONGEST_TURN]
    likely = next(iter(fits), "ms")
    if usual * LEAST_RATE > 1.0:
        return f"the stamps are {usual:.3g} s apart ({1.0 / usual:.2g} Hz): is the time in {likely}?", likely
    if turn > LONGEST_TURN:
        return f"the joint would need {turn / 3600.0:.2g} hours for a turn: is the time in {likely}?", likely
    return None


def _turn_time(time: Floats, bag: Integers, angle: Floats) -> float:
    """Time for a turn at the speed that a twentieth of the record exceeds [s]; zero if nothing moves."""
    lag = max(time.size // 400, 1)
    same = bag[lag:] == bag[:-lag]
    elapsed, way = (np.abs(column[lag:] - column[:-lag])[same] for column in (time, angle))
    good = np.isfinite(way) & (elapsed > 0.0)
    fast = float(np.percentile(way[good] / elapsed[good], 95)) if good.any() else 0.0
    return 2.0 * np.pi / fast if fast > 0.0 and float(np.sum(way[good])) > _MOVED else 0.0
