"""A joint's measured record: cleaned, cut into runs, with speed and a smoothed torque as regressors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers, Rows
from hd_diag.diagnosis.blocks import unwrapped
from hd_diag.diagnosis.noise import ORDER, bounds, numbered, spans
from hd_diag.diagnosis.outliers import outliers, torque_outliers
from hd_diag.diagnosis.smoothing import deviation, rate, smooth
from hd_diag.diagnosis.stamps import UNTOLD, Stamps, by_clock, usual_step, without_bursts, without_jitter
from hd_diag.diagnosis.torque_smoothing import SmoothedTorque, smoothed_torque
from hd_diag.formatting import words
from hd_diag.streams.no_torque import no_torque

# Columns of one length by name; None for those that were not recorded.
Columns = dict[str, Any]

MINIMUM_SAMPLES = 200
"""A record with fewer samples is too short."""

FASTEST = 1e4
"""Ten times the top speed of the smallest drives [rad/s]."""

_ROUNDING = 1e-12  # range of a constant angle, over its largest value
_PAUSE = 0.2  # shortest rest that ends a run [s]
_THROUGH = 0.8 * 2.0 * np.pi  # travel of a complete input turn, as its end rows may be missing [rad]
_SLOW = 0.02  # speed range of friction's reversal, over the top speed [-]
_REST_SPEED = 0.02  # highest speed at rest, over the 95th percentile of the record's speed [-]
_BITS = range(10, 25)  # encoder resolutions that are recognised
_COUNTS_MISS = 0.01  # tolerance of the factor between counts and radians, relative
GAP_STEPS = 5.5
"""A step this many times the usual one is a gap: state and filters restart."""

_SPEED_WINDOW = 0.03  # [s]
_HEAT_WINDOW = 2.0  # [s]
_SEVERAL, _HELD_SHARE = 3.0, 0.4  # counts of a visible move; share of repeats (half of them at half the rate)
_LONG_GAP_STEPS = 200.0  # causes with memory restart after a step this many times the usual one
_WRAP_SLACK = 0.1  # range that noise and outliers may add to a wrapped angle [rad]


class RecordError(ValueError):
    """A record that cannot be judged; the text says why."""


class Extent(NamedTuple):
    """Samples and runs of a record, time in the runs [s], and turns of the input in both directions."""

    samples: int
    runs: int
    duration: float
    input_turns: float


@dataclass(frozen=True)
class Record:
    """Samples of one joint, in time order within each run; columns of shape (n,).

    Attributes
    ----------
    time, input_angle, output_angle, torque, speed, temperature
        [s], [rad], [rad], [N m] on the link, input speed [rad/s], [degree Celsius] or None.
    run, bag, stretch : ndarray of int64
        Number of the run, which ends with a pause, a gap or a bag; of the recording; of the stretch without
        a long gap. The state of causes with memory continues over pauses between runs, and into a recording
        that follows at once.
    has_torque, by_current, by_velocity : bool
        Whether the torque was measured (otherwise the configured one is assumed); whether it is a motor's
        current times a constant; whether the input angle is an integrated velocity, whose drift is free.
    undeclared : bool
        Whether nobody said that the torque is a motor's current: the record itself shows it.
    outliers, dropped : int
        Number of removed samples: far off their neighbours; not finite or out of order.
    reported_torque, reported_speed : ndarray, or None
        Torque before smoothing, as a running model gets it [N m]; input speed as the joint reports it
        [rad/s], nan where it does not.
    extent : Extent
        Extent of the whole record, including rows that were left out.
    torque_window : ndarray
        Window of the torque's smoothing [s]; 0: none.
    torque_with_waves : bool
        Whether the smoothed torque keeps waves of the input's turn, see :func:`smoothed_torque`.
    stamps : Stamps
        Counts of samples that were lost before.
    taken : ndarray, or None
        Correction added to a torque from current, because the motor itself takes part of it [N m].
    no_torque : str
        Why the reported torque is not a measured one, in words; otherwise empty.
    """

    time: Floats
    input_angle: Floats
    output_angle: Floats
    torque: Floats
    speed: Floats
    temperature: Floats | None
    run: Integers
    has_torque: bool
    outliers: int
    dropped: int
    bag: Integers
    reported_torque: Floats
    reported_speed: Floats | None
    stretch: Integers
    extent: Extent
    torque_window: Floats
    torque_with_waves: bool = False
    by_current: bool = False
    by_velocity: bool = False
    undeclared: bool = False
    stamps: Stamps = UNTOLD
    taken: Floats | None = None
    no_torque: str = ""

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    @property
    def top_speed(self) -> float:
        """Input speed that 1 % of the samples exceed [rad/s]."""
        return max(float(np.percentile(np.abs(self.speed), 99)), 1e-9)

    @property
    def way(self) -> Floats:
        """Direction of the motion, from -1 to 1, smooth through rest as friction is; shape (n,)."""
        return np.asarray(np.tanh(self.speed / (_SLOW * self.top_speed)))

    def less_motor(self, taken: Floats) -> Record:
        """The record with `taken` (n,) added to its reported torque: minus the motor's own share [N m]."""
        return replace(self, torque=self.by_sensor + taken, taken=taken)

    @property
    def turn(self) -> Integers:
        """Number of the input's turn, from zero; each run begins a new one; shape (n,)."""
        turn = np.floor(self.input_angle / (2.0 * np.pi))
        return numbered((np.diff(turn) != 0) | (np.diff(self.run) != 0))

    @property
    def through(self) -> Rows:
        """Mask (n,) of rows in complete turns of the input; all rows if no turn is complete."""
        turn = self.turn
        ends = np.append(np.flatnonzero(np.diff(turn, prepend=-1)), turn.size)
        whole = np.abs(self.input_angle[ends[1:] - 1] - self.input_angle[ends[:-1]]) > _THROUGH
        return np.asarray(whole[turn] | ~whole.any())

    @property
    def by_sensor(self) -> Floats:
        """Torque as reported, smoothed [N m], shape (n,)."""
        return self.torque if self.taken is None else self.torque - self.taken

    @property
    def torque_deviation(self) -> Floats:
        """Standard deviation of the torque by its noise [N m], shape (n,); zero for a constant torque."""
        if np.ptp(self.by_sensor) == 0.0 or not self.torque_window.any():
            return np.zeros(self.size)
        step, width = usual_step(self.time), self.torque_window
        return deviation(self.reported_torque, self.by_sensor, step, width)

    def select(self, rows: Rows | Integers) -> Record:
        """The record of some rows, with unchanged run numbers."""
        columns: Columns = {name: c[rows] for name, c in vars(self).items() if isinstance(c, np.ndarray)}
        return replace(self, **columns)

    def thinned(self, most: int) -> Record:
        """Evenly spaced rows, about `most` at most."""
        return self.select(np.arange(0, self.size, 1 + self.size // most))


def prepare(
    time: Floats,
    input_angle: Floats,
    output_angle: Floats,
    torque: Floats | None,
    temperature: Floats | None,
    bag: Integers,
    ratio: float,
    assumed_torque: float = 0.0,
    reported_speed: Floats | None = None,
    by_current: bool = False,
    by_velocity: bool = False,
    stamps: Stamps = UNTOLD,
) -> Record:
    """A record from raw columns of shape (n,).

    Parameters
    ----------
    time, input_angle, output_angle, torque, temperature, bag, reported_speed : ndarray, shape (n,), or None
        As in `Record`, with noise and outliers; angles may be wrapped. An infinite torque is an outlier.
    ratio : float
        Reported input angle over reported output angle [-].
    assumed_torque : float
        Torque if none was measured [N m].
    by_current, by_velocity, stamps
        As in `Record`. A clock that is set back within a recording begins a new one.

    Raises
    ------
    RecordError
        If too few samples remain, nothing moves, or stamps contradict each other.
    """
    columns: Columns = {
        "time": time,
        "input_angle": input_angle,
        "output_angle": output_angle,
        "torque": torque,
        "temperature": _measured(temperature),
    }
    columns["torque"], unmeasured = measured_torque(columns["torque"])
    refused = stamps.refused
    bag, stamps = by_clock(time, bag, stamps)
    usable = _usable(columns, bag)
    count = int(np.count_nonzero(usable))
    outlying = 0 if columns["torque"] is None else int(np.count_nonzero(np.isinf(columns["torque"])))
    dropped = usable.size - count - outlying
    if count < MINIMUM_SAMPLES:
        raise RecordError(
            f"too short: {count} usable samples, at least {MINIMUM_SAMPLES} are needed{stamps.why}"
        )
    if dropped > 0.5 * usable.size:
        raise RecordError(
            f"{dropped} of {usable.size} samples are not finite or their stamps contradict each other"
            f"{_emptiest(columns)}"
        )
    columns |= {"bag": bag, "reported_speed": reported_speed}
    columns = _kept(columns, usable)
    bag, output = columns["bag"], _unwrapped(columns["output_angle"], columns["bag"])
    columns["time"], in_bursts = without_bursts(columns["time"], output, bag)
    stamps, segment = stamps._replace(in_bursts=in_bursts), segments(columns["time"], bag, GAP_STEPS)
    _check_whole(segment)
    angle = _with_turns(columns["input_angle"], output, bag, segment, ratio)
    if (held := _held(angle / ratio, output, segment)).any():
        columns |= {"input_angle": angle, "output_angle": output}
        columns, dropped = _kept(columns, ~held), dropped + int(np.count_nonzero(held))
        bag, angle, output = (columns[name] for name in ("bag", "input_angle", "output_angle"))
        segment = segments(columns["time"], bag, GAP_STEPS)
        _check_whole(segment)
    keep = ~outliers(output - angle / ratio, bag, together=2)
    if columns["torque"] is not None:
        keep &= ~torque_outliers(columns["torque"], bag)
    columns |= {"input_angle": angle, "output_angle": output, "segment": segment}
    columns = _kept(columns, keep)
    _check_whole(columns["segment"])
    _check_motion(columns["input_angle"], columns["output_angle"], ratio)
    turned, followed = (float(np.ptp(columns[name])) for name in ("input_angle", "output_angle"))
    if not encoder_bits(turned / max(abs(ratio) * followed, 1e-300)):  # the ratio check reports counts better
        check_speed(columns["time"], columns["input_angle"], columns["segment"])
    time, load, heat, segment = (columns.pop(n) for n in ("time", "torque", "temperature", "segment"))
    step, time = usual_step(time), without_jitter(time, columns["input_angle"], segment)
    speed = rate(columns["input_angle"], segment, step, _SPEED_WINDOW)
    run, bag = _runs(time, speed, segment), columns["bag"]
    raw = np.full(time.shape, assumed_torque) if load is None else load
    smoothed = SmoothedTorque(raw, np.zeros(raw.size), False)
    if load is not None:
        smoothed = smoothed_torque(load, columns["input_angle"], ratio, segment, step)
    return Record(
        **columns,
        time=time,
        torque=smoothed.torque,
        speed=speed,
        temperature=None if heat is None else smooth(heat, segment, step, _HEAT_WINDOW),
        run=run,
        has_torque=load is not None,
        outliers=outlying + keep.size - int(np.count_nonzero(keep)),
        dropped=dropped + refused,
        reported_torque=raw,
        stretch=segments(time, bag if by_velocity else np.zeros_like(bag), _LONG_GAP_STEPS),
        extent=extent(time, columns["input_angle"], run),
        torque_window=smoothed.window,
        torque_with_waves=smoothed.with_waves,
        by_current=by_current and load is not None,
        by_velocity=by_velocity,
        stamps=stamps,
        no_torque=unmeasured,
    )


def _emptiest(columns: Columns) -> str:
    """Which column has the most rows without a value, in words; empty if all have values."""
    count = {name: int(np.sum(np.isnan(one))) for name, one in columns.items() if one is not None}
    name = max(count, key=lambda one: count[one])
    return f": {words(name)} has {count[name]} without a value" if count[name] else ""


def _held(input_angle: Floats, output: Floats, segment: Integers) -> Rows:
    """Mask (n,) of rows that repeat the previous output sample, because the output is published slower.

    Both angles are at the output [rad]. A counting encoder repeats values too, but never while it should move
    by several counts. Rows at rest are removed at the same rate.
    """
    inside = np.diff(segment) == 0
    change, expected = np.abs(np.diff(output)), np.abs(np.diff(input_angle))
    repeated = inside & (change == 0.0)
    least = float(change[change > 0.0].min(initial=math.inf))
    fast = inside & (expected > _SEVERAL * least)
    fresh = fast & ~repeated
    if not fresh.any() or np.count_nonzero(repeated & fast) <= _HELD_SHARE * np.count_nonzero(fast):
        return np.zeros(output.size, bool)
    row = np.arange(output.size)
    since = row - np.maximum.accumulate(np.where(np.append(False, repeated), 0, row))
    every = 1 + int(np.median(since[:-1][fresh]))
    return np.asarray(since % every != 0)


def _check_whole(segment: Integers) -> None:
    """Raise RecordError if too few samples are in stretches (n,) long enough for a noise model."""
    count = np.bincount(segment)
    whole = int(count[count > ORDER].sum())
    if whole < MINIMUM_SAMPLES:
        raise RecordError(
            f"torn: {segment.size} usable samples are in {np.count_nonzero(count)} pieces between gaps and "
            f"recordings; {whole} of them are in pieces of more than {ORDER} samples, at least "
            f"{MINIMUM_SAMPLES} are needed"
        )


def _check_motion(angle: Floats, output: Floats, ratio: float) -> None:
    """Raise RecordError if the input (n,) [rad] hardly turns, or the output (n,) [rad] never."""
    turned, followed = float(np.ptp(angle)), float(np.ptp(output))
    if turned < np.pi:
        text = f"no motion: the input turns by {turned:.3g} rad, at least half a turn is needed"
        swapped = f"; the output turns by {followed:.3g} rad: are input and output swapped?"
        raise RecordError(text + swapped * (abs(ratio) > 1.0 and followed > np.pi))
    if followed <= _ROUNDING * float(np.abs(output).max()):
        raise RecordError(f"no motion: the output angle is {output[0]:.6g} rad throughout")


def encoder_bits(times: float) -> int:
    """Bits of the encoder whose counts, taken as radians, are `times` too large; 0 if there is none."""
    counts = 2.0 * math.pi * times
    near = [bits for bits in _BITS if abs(counts / 2.0**bits - 1.0) < _COUNTS_MISS]
    return near[0] if near else 0


def check_speed(time: Floats, angle: Floats, segment: Integers) -> None:
    """Raise RecordError if the input turns faster than any drive, as spectra grow with the number of turns.

    Times [s], angles [rad] and numbers of the stretches without a gap have shape (n,).
    """
    inside = np.diff(segment) == 0
    way, duration = np.abs(np.diff(angle))[inside].sum(), np.diff(time)[inside].sum()
    if not way <= FASTEST * duration:
        raise RecordError(
            f"the input turns at {way / max(duration, 1e-300):.3g} rad/s in the mean, and no drive's faster "
            f"than {FASTEST:g} rad/s: give the units of its angle and of the stamps"
        )


def extent(time: Floats, input_angle: Floats, run: Integers) -> Extent:
    """Extent of the runs (n,)."""
    duration = sum(float(time[end - 1] - time[begin]) for begin, end in bounds(run))
    way = np.abs(np.diff(input_angle))[np.diff(run) == 0]
    return Extent(time.size, int(run[-1]) + 1, duration, float(np.sum(way)) / (2.0 * np.pi))


def _usable(columns: Columns, bag: Integers) -> Rows:
    """Mask of rows that are finite in all columns and later than the previous row."""
    later = (np.diff(columns["time"]) > 0.0) | (np.diff(bag) != 0)
    usable = np.concatenate(([True], later))[: bag.size]
    for column in columns.values():
        if column is not None:
            usable &= np.isfinite(column)
    return usable


def _kept(columns: Columns, rows: Rows) -> Columns:
    """Some rows of all columns; without a copy if all are kept."""
    if rows.all():
        return columns
    return {name: None if column is None else column[rows] for name, column in columns.items()}


def measured_torque(torque: Floats | None) -> tuple[Floats | None, str]:
    """The torque [N m], shape (n,), or None if it was not measured, and then the reason in words."""
    if torque is None:
        return None, ""
    known = torque[np.isfinite(torque)]
    why = no_torque(*(known.min(), known.max()) if known.size else (math.inf, -math.inf))
    return None if why else torque, why


def _measured(values: Floats | None) -> Floats | None:
    """The column, or None if it has no value."""
    return None if values is None or not np.isfinite(values).any() else values


def _wrapped(angle: Floats) -> bool:
    """Whether angles [rad] stay within one turn, as those of a wrapping encoder do."""
    return float(np.ptp(angle)) < 2.0 * np.pi + _WRAP_SLACK


def _unwrapped(angle: Floats, bag: Integers) -> Floats:
    """Angles without jumps of whole turns, bag by bag; continuous angles are unchanged."""
    parts = [angle[a:b] for a, b in bounds(bag)]
    done = [unwrapped(part) if _wrapped(part) else part for part in parts]
    return done[0] if len(done) == 1 else np.concatenate(done)


def _with_turns(angle: Floats, output: Floats, bag: Integers, segment: Integers, ratio: float) -> Floats:
    """Input angles without jumps of whole turns; the output angle gives turns lost in a gap."""
    result = angle
    first = ratio * output[0] - angle[0]
    for begin, end in bounds(bag):
        if not _wrapped(angle[begin:end]):
            continue
        result = angle.copy() if result is angle else result
        for a, b in bounds(segment[begin:end]):
            part = slice(begin + a, begin + b)
            result[part] = unwrapped(angle[part])
            missing = float(np.median(ratio * output[part] - result[part])) - first
            result[part] += 2.0 * np.pi * np.round(missing / (2.0 * np.pi))
    return result


def segments(time: Floats, bag: Integers, gap: float) -> Integers:
    """Stretch numbers (n,); a step above `gap` usual steps, a stamp going back or a new bag begins one."""
    step = np.diff(time)
    breaks = (step > gap * usual_step(time)) | (step <= 0.0) | (np.diff(bag) != 0)
    return numbered(breaks)


def _runs(time: Floats, speed: Floats, segment: Integers) -> Integers:
    """Run numbers (n,): segments, cut in the middle of every rest of at least `_PAUSE`."""
    resting = np.abs(speed) < _REST_SPEED * np.percentile(np.abs(speed), 95)
    cut = np.concatenate(([False], np.diff(segment) != 0))
    for begin, end in spans(resting):
        if time[end - 1] - time[begin] >= _PAUSE and begin > 0 and end < time.size:
            cut[(begin + end) // 2] = True
    return np.cumsum(cut).astype(np.int64)
