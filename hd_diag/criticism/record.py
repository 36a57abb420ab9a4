"""A joint's measured record: cleaned, cut into runs, with speed and a torque fit to be a regressor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.signal import savgol_filter

from hd_diag.criticism.noise import bounds

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MINIMUM_SAMPLES = 500
"""Fewer samples than this are too short a record."""

_PAUSE = 0.2  # rest that ends a run [s]
_REST_SPEED = 0.02  # of the record's 95th percentile of speed, below which the joint rests [-]
_GAP_STEPS = 5.5  # a step this many times the usual one is a gap: state and filters restart
_SPEED_WINDOW = 0.03  # [s]
_TORQUE_WINDOW = 0.06  # [s]; a longer one bends the torque's own steps
_WRAP_SLACK = 0.1  # what noise and outliers may add to the range of a wrapped angle [rad]
_OUTLIER = 8.0  # robust standard deviations of what neighbours do not foretell
_OUTLIER_WINDOW = 51  # over which that deviation is taken [samples]
_OUTLIER_PASSES = 3


class RecordError(ValueError):
    """A record that cannot be judged; the text says why."""


@dataclass(frozen=True)
class Record:
    """Samples of one joint, in time order within each run.

    Attributes
    ----------
    time, input_angle, output_angle, torque, speed : ndarray, shape (n,)
        [s], [rad], [rad], [N m] on the link, input speed [rad/s].
    temperature : ndarray, shape (n,), or None
        [degree Celsius]
    run : ndarray of int64, shape (n,)
        Index of the run; a run ends with a pause, a gap or a bag.
    has_torque : bool
        Whether the torque was measured; else it is what the configuration assumes.
    outliers, dropped : int
        Samples taken out: far off their neighbours, or not finite or out of order.
    bag : ndarray of int64, shape (n,)
        Which recording each sample comes from.
    reported_torque : ndarray, shape (n,)
        Without smoothing, as a model that runs has it [N m].
    reported_speed : ndarray, shape (n,), or None
        Of the input, as the joint itself reports it [rad/s]; nan where it does not.
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
    reported_speed: Floats | None = None

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return int(self.run[-1]) + 1

    @property
    def duration(self) -> float:
        """Time covered by the runs [s]."""
        edges = np.flatnonzero(np.diff(self.run)) + 1
        starts, ends = np.append(0, edges), np.append(edges, self.size) - 1
        return float(np.sum(self.time[ends] - self.time[starts]))

    @property
    def input_turns(self) -> float:
        """Turns of the input, both directions counted [-]."""
        same = np.diff(self.run) == 0
        return float(np.sum(np.abs(np.diff(self.input_angle))[same]) / (2.0 * np.pi))

    def select(self, rows: npt.NDArray[np.bool_] | Integers) -> Record:
        """The record of some rows; their run numbers stay."""
        temperature = None if self.temperature is None else self.temperature[rows]
        reported_speed = None if self.reported_speed is None else self.reported_speed[rows]
        return replace(
            self,
            time=self.time[rows],
            input_angle=self.input_angle[rows],
            output_angle=self.output_angle[rows],
            torque=self.torque[rows],
            speed=self.speed[rows],
            temperature=temperature,
            run=self.run[rows],
            bag=self.bag[rows],
            reported_torque=self.reported_torque[rows],
            reported_speed=reported_speed,
        )


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
) -> Record:
    """A record from raw columns.

    Parameters
    ----------
    time : ndarray, shape (n,)
        [s]
    input_angle, output_angle : ndarray, shape (n,)
        As reported [rad]; wrapped angles are unwrapped.
    torque : ndarray, shape (n,), or None
        On the link [N m].
    temperature : ndarray, shape (n,), or None
        [degree Celsius]
    bag : ndarray of int64, shape (n,)
        Which recording each sample comes from.
    ratio : float
        Reported input angle over reported output angle [-].
    assumed_torque : float
        Used where no torque was measured [N m].
    reported_speed : ndarray, shape (n,), or None
        Of the input, as the joint reports it [rad/s]; nan where it does not.

    Returns
    -------
    Record

    Raises
    ------
    RecordError
        If too little is left, nothing moves, or stamps contradict each other.
    """
    torque, temperature = _measured(torque), _measured(temperature)
    columns = [time, input_angle, output_angle] + [c for c in (torque, temperature) if c is not None]
    usable = np.all(np.isfinite(columns), axis=0)
    usable &= np.concatenate(([True], (np.diff(time) > 0.0) | (np.diff(bag) != 0)))
    dropped = int(np.sum(~usable))
    if usable.sum() < MINIMUM_SAMPLES:
        raise RecordError(
            f"too short: {int(usable.sum())} usable samples, at least {MINIMUM_SAMPLES} are needed"
        )
    if dropped > 0.5 * usable.size:
        raise RecordError(
            f"{dropped} of {usable.size} samples are not finite or their stamps contradict each other"
        )
    time, bag = time[usable], bag[usable]
    segment, output = _segments(time, bag), _unwrapped(output_angle[usable], bag)
    angle = _with_turns(input_angle[usable], output, bag, segment, ratio)
    load = None if torque is None else torque[usable]
    heat = None if temperature is None else temperature[usable]
    if float(np.ptp(angle)) < np.pi:
        raise RecordError(
            f"no motion: the input turns by {float(np.ptp(angle)):.3g} rad, at least half a turn is needed"
        )
    keep = ~_outliers(output - angle / ratio, segment)
    outliers = int(np.sum(~keep))
    time, angle, output, segment = time[keep], angle[keep], output[keep], segment[keep]
    step = float(np.median(np.diff(time)))
    speed = _per_segment(segment, angle, lambda x: _derivative(x, step))
    raw = np.full(time.shape, assumed_torque) if load is None else load[keep]
    smooth = raw if load is None else _per_segment(segment, raw, lambda x: _smooth(x, step, _TORQUE_WINDOW))
    heat = None if heat is None else _per_segment(segment, heat[keep], lambda x: _smooth(x, step, 2.0))
    run = _runs(time, speed, segment)
    own_speed = None if reported_speed is None else reported_speed[usable][keep]
    return Record(
        time,
        angle,
        output,
        smooth,
        speed,
        heat,
        run,
        load is not None,
        outliers,
        dropped,
        bag[keep],
        raw,
        own_speed,
    )


def _measured(values: Floats | None) -> Floats | None:
    """A column that holds a value at all, else None."""
    return None if values is None or not np.isfinite(values).any() else values


def _wrapped(angle: Floats) -> bool:
    """Whether angles stay within one turn [rad], as those of wrapped encoders do."""
    return float(np.ptp(angle)) < 2.0 * np.pi + _WRAP_SLACK


def _unwrapped(angle: Floats, bag: Integers) -> Floats:
    """Angles without jumps of whole turns, bag by bag; continuous angles stay as they are."""
    parts = [angle[a:b] for a, b in bounds(bag)]
    return np.concatenate([np.unwrap(part) if _wrapped(part) else part for part in parts])


def _with_turns(angle: Floats, output: Floats, bag: Integers, segment: Integers, ratio: float) -> Floats:
    """Input angles without jumps of whole turns; the output tells those that no sample saw."""
    result = angle.copy()
    first = ratio * output[0] - angle[0]
    for begin, end in bounds(bag):
        if not _wrapped(angle[begin:end]):
            continue
        for a, b in bounds(segment[begin:end]):
            part = slice(begin + a, begin + b)
            result[part] = np.unwrap(angle[part])
            missing = float(np.median(ratio * output[part] - result[part])) - first
            result[part] += 2.0 * np.pi * np.round(missing / (2.0 * np.pi))
    return result


def _segments(time: Floats, bag: Integers) -> Integers:
    """Stretches without a gap and without a stamp that goes back."""
    step = np.diff(time)
    usual = np.median(step[step > 0.0])
    breaks = (step > _GAP_STEPS * usual) | (step <= 0.0) | (np.diff(bag) != 0)
    return np.concatenate(([0], np.cumsum(breaks))).astype(np.int64)


def _per_segment(segment: Integers, values: Floats, function: object) -> Floats:
    assert callable(function)
    return np.concatenate([function(values[a:b]) for a, b in bounds(segment)])


def _window(size: int, step: float, width: float, order: int) -> int:
    wanted = int(width / step) | 1
    largest = size if size % 2 else size - 1
    return min(max(wanted, order + 2 | 1), largest)


def _derivative(angle: Floats, step: float) -> Floats:
    window = _window(angle.size, step, _SPEED_WINDOW, 2)
    if window < 3:
        return np.gradient(angle, step) if angle.size > 1 else np.zeros_like(angle)
    return np.asarray(savgol_filter(angle, window, min(2, window - 1), deriv=1, delta=step))


def _smooth(values: Floats, step: float, width: float) -> Floats:
    window = _window(values.size, step, width, 2)
    return values if window < 4 else np.asarray(savgol_filter(values, window, 2))


def _outliers(error: Floats, segment: Integers) -> npt.NDArray[np.bool_]:
    """Single samples off both their neighbours; taken out, they may show others beside them."""
    found = np.zeros(error.size, dtype=bool)
    for a, b in bounds(segment):
        rows = np.arange(a, b)
        for _ in range(_OUTLIER_PASSES):
            off = _spikes(error[rows])
            found[rows[off]] = True
            rows = rows[~off]
    return found


def _spikes(values: Floats) -> npt.NDArray[np.bool_]:
    """Samples far off the cubic through their four neighbours, and beyond both next to them.

    The cubic follows the gear's ripple, which a running median would cut; flanks that change are a step,
    beyond one neighbour only.
    """
    if values.size < 9:
        return np.zeros(values.size, dtype=bool)
    far, near, x, after, last = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, "reflect"), 5).T
    off = np.abs(x - (4.0 * (near + after) - far - last) / 6.0)
    local = median_filter(off, _OUTLIER_WINDOW, mode="nearest")
    spread = 1.4826 * np.maximum(local, np.median(off))
    single = ((x - near) * (x - after) > 0.0) & (np.minimum(np.abs(x - near), np.abs(x - after)) > 0.5 * off)
    return np.asarray(single & (spread > 0.0) & (off > _OUTLIER * spread))


def _runs(time: Floats, speed: Floats, segment: Integers) -> Integers:
    """Runs: segments, cut in the middle of every rest that lasts."""
    resting = np.abs(speed) < _REST_SPEED * np.percentile(np.abs(speed), 95)
    cut = np.concatenate(([False], np.diff(segment) != 0))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], resting, [False])).astype(np.int8)))
    for begin, end in edges.reshape(-1, 2):
        if time[end - 1] - time[begin] >= _PAUSE and begin > 0 and end < time.size:
            cut[(begin + end) // 2] = True
    return np.cumsum(cut).astype(np.int64)
