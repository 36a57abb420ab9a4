"""Measured records of joints from bags: columns of time, angles, torque, temperature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.bag.reader import BagReader
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.blocks import unwrapped
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.outliers import torque_outliers
from hd_diag.diagnosis.record import (
    GAP_STEPS,
    Record,
    RecordError,
    check_speed,
    measured_torque,
    prepare,
    segments,
)
from hd_diag.diagnosis.stamps import UNTOLD, Stamps, doubtful_clock
from hd_diag.formatting import listed
from hd_diag.messages.publications import TEMPERATURE, read_temperature
from hd_diag.records.joint_topics import JointTopics, offered, place
from hd_diag.streams.alignment import Aligned, Alignment, torque_between
from hd_diag.streams.columns import LARGEST_TEMPERATURE
from hd_diag.streams.second_publisher import other_rows
from hd_diag.streams.signals import temperatures

_REMEMBERED = 1 << 14  # samples over which topics of one bag may lag behind each other
_STAMPS, _VALUES = ("stamp", "torque_stamp", "stretch"), ("input_angle", "output_angle", "torque", "speed")
_ROOM = 1 << 22  # rows allocated at first: an hour at 1 kHz
_TURN = 2.0 * np.pi + 1e-6  # range of an encoder that wraps [rad]


class _Samples(NamedTuple):
    """Samples of a joint as columns (n,), None if no bag has them; `stamps` describes samples left out.

    Time since the first sample [s], number of the stretch, angles [rad], torque [N m], speed of the input
    [rad/s], temperature [degree Celsius].
    """

    time: Floats
    stretch: Integers
    input_angle: Floats
    output_angle: Floats
    torque: Floats | None
    speed: Floats | None
    temperature: Floats | None
    stamps: Stamps


def read_bags(paths: Sequence[str | Path], joint: JointConfig) -> Record:
    """A joint's record from one or more bags. Each bag, and each clock set back, begins a new run.

    Samples are at the output angle's stamps, by the rules of `hd_diag.streams.alignment`. Raises BagError if
    a bag cannot be read, RecordError if the bags lack the joint's input or output angle, or have too few.
    """
    found = _read_all(paths, joint, lambda samples: np.isfinite(samples.output_angle))
    time, stretch, given, own, torque, speed, warm, stamps = found
    if not time.size:
        raise RecordError(nothing(paths, joint, stamps))
    _check_clock(found, found.output_angle)
    ratio = joint.drive.kinematics.ratio
    columns = time, given, own, torque, warm, stretch, ratio, joint.torque, speed
    kind = joint.signals.is_current, joint.signals.is_velocity
    try:
        return prepare(*columns, *kind, stamps)
    except RecordError as error:
        raise RecordError(stamps.after(str(error))) from error


def nothing(paths: Sequence[str | Path], joint: JointConfig, stamps: Stamps | None = None) -> str:
    """Text on the angles that bags lack, with the reason or the bags' content, or advice for one angle."""
    roles = (joint.signals.input, joint.input_joint), (joint.signals.output, joint.output_joint)
    given, measured = (place(*role) for role in roles)
    text = f"no input angle ({given}) with output angle ({measured}) in {', '.join(map(str, paths))}"
    if not _read_all(paths, joint, _is_input).time.size and (own := _one_angle(paths, joint)).time.size:
        torque, no_torque = measured_torque(own.torque)
        instead = f" (the reported one {no_torque})" if no_torque else ""
        ripple = "what the torque shows: hd-diag ripple"
        return own.stamps.after(
            f"{text}; one angle has no transmission error: the robot's driver would have to publish the "
            "motor encoder's angle, or its velocity (input: velocity); "
            + (ripple if torque is not None else f"for hd-diag ripple an effort or a current{instead}")
            + f"; whether another topic holds it: hd-diag topics {paths[0]}"
        )
    if stamps is not None and stamps.why:
        return text + stamps.why
    return f"{text}; {offered(paths[0])}"


@dataclass(frozen=True)
class InputRecord:
    """Angle and torque at a joint's input; its output need not be measured.

    Columns of shape (n,): time [s], angle, continuous over the turns [rad], torque on the link [N m] or None,
    number of the recording. `stamps` describes samples that were left out. `no_torque` says why a reported
    torque was not measured. RecordError if no stamps rise, or if the input turns faster than is possible.
    """

    time: Floats
    input_angle: Floats
    torque: Floats | None
    bag: Integers
    stamps: Stamps = UNTOLD
    no_torque: str = ""

    def __post_init__(self) -> None:
        rising = (np.diff(self.time) > 0.0) & (np.diff(self.bag) == 0)
        if not rising.any():
            rows = f"{self.time.size} samples" if self.time.size else "no sample"
            raise RecordError(f"too short: {rows} with all that is needed, and no two stamps that rise")
        check_speed(self.time, self.input_angle, segments(self.time, self.bag, GAP_STEPS))


def read_motion(paths: Sequence[str | Path], joint: JointConfig) -> InputRecord | None:
    """A joint's motion from one or more bags, at the input angle's stamps; None if there is none.

    If only the output angle and a torque are reported, the input angle is the output angle times the ratio,
    at the output's stamps. Raises BagError if a bag cannot be read.
    """
    found = _read_all(paths, joint, _is_input)
    if is_single := not found.time.size:
        found = _one_angle(paths, joint)
    measured, no_torque = measured_torque(found.torque)
    if not found.time.size or (is_single and measured is None):
        return None
    angle = found.input_angle
    for begin, end in bounds(found.stretch):
        if np.abs(angle[begin:end]).max() <= _TURN:
            angle[begin:end] = unwrapped(angle[begin:end])
    _check_clock(found, angle / joint.drive.kinematics.ratio)
    if measured is None:
        return InputRecord(found.time, angle, None, found.stretch, found.stamps, no_torque)
    known = np.isfinite(measured)
    return InputRecord(found.time[known], angle[known], measured[known], found.stretch[known], found.stamps)


def _check_clock(found: _Samples, output: Floats) -> None:
    """Raise RecordError with a question if stamps are implausible for the output angle [rad] (n,)."""
    if question := doubtful_clock(found.time, found.stretch, output):
        text = f"{question[0]} The robot's driver has to stamp in seconds and nanoseconds"
        raise RecordError(found.stamps.after(text))


def _is_input(samples: Aligned) -> Any:
    return samples.paired == 0


def _one_angle(paths: Sequence[str | Path], joint: JointConfig) -> _Samples:
    """Samples whose input angle is the output angle times the ratio."""
    signals = joint.signals._replace(input=joint.signals.output)
    own = replace(joint, input_joint=joint.output_joint, signals=signals, input_divided=True)
    return _read_all(paths, own, _is_input)


def _read_all(paths: Sequence[str | Path], joint: JointConfig, wanted: Callable[[Aligned], Any]) -> _Samples:
    """Samples of all bags that `wanted` selects; each bag and each clock set back begins a `stretch`."""
    bags, stamps, begun = [], Stamps(), 0
    for path in paths:
        columns, reported = _read(path, joint, wanted)
        stamps = stamps.and_then(reported)
        if columns[0].size > 1:
            columns[1] += begun - columns[1][0]
            begun = int(columns[1][-1]) + 1
            bags.append(columns)
    if not bags:
        nothing = np.zeros(0)
        return _Samples(nothing, np.zeros(0, np.int64), nothing, nothing, None, None, None, stamps)
    columns = bags[0] if len(bags) == 1 else [np.concatenate(parts) for parts in zip(*bags, strict=True)]
    stamp, stretch, given, own, torque, speed, warm = columns
    is_told = np.isfinite(torque).any() or joint.signals.torque is not None
    told_speed = speed if np.isfinite(speed).any() else None
    warmth = warm if warm.size == stamp.size else None
    told = torque if is_told else None, told_speed, warmth
    return _Samples(_seconds(stamp, stamp[0]), stretch, given, own, *told, stamps)


def _read(path: str | Path, joint: JointConfig, wanted: Callable[[Aligned], Any]) -> tuple[list[Any], Stamps]:
    """Columns of one bag as in `_Samples`, but with stamps [ns]; sorted by stamp within each stretch."""
    streams = Alignment([joint.names._replace(torque=nan)], _REMEMBERED)
    nothing = np.zeros(0, np.int64)
    times, heat, size = [nothing], [np.zeros(0)], 0
    with BagReader(path) as reader:
        room = max(1, min(reader.message_count, _ROOM))
        columns: list[Any] = [np.empty(room, np.int64) for _ in _STAMPS]
        columns += [np.empty(room) for _ in _VALUES]
        topics = JointTopics(reader, {joint.name: joint.signals})
        for mixed in reader.mixed(topics.types, topics.is_read):
            _, batch = mixed.batches[0]
            if not topics.is_read(batch.topic):
                if batch.topic.type_name != TEMPERATURE:
                    continue
                times.append(mixed.log_time)
                heat.append(np.array([_degrees(bytes(data), streams) for data in batch.messages()]))
            else:
                shapes, refused = topics.columns(mixed)
                for states in shapes:
                    for column in temperatures(states).values():
                        times.append(states.stamp)
                        heat.append(column)
                found = streams.take(mixed.log_time, shapes, refused)
                rows = np.flatnonzero(wanted(found))
                while size + rows.size > columns[0].size:
                    columns = [np.concatenate((column, np.empty_like(column))) for column in columns]
                for name, column in zip(_STAMPS + _VALUES, columns, strict=True):
                    column[size : size + rows.size] = getattr(found, name)[rows]
                size += rows.size
    columns = [column[:size] for column in columns]
    if not (columns[0][1:] >= columns[0][:-1]).all():
        order = np.lexsort((columns[0], columns[2]))
        columns = [column[order] for column in columns]
    others: tuple[str, ...] = ()
    if size:
        columns, others = _own_rows(joint, streams, topics, columns)
    stamp, torque_stamp, stretch, given, own, torque, speed = columns
    encoder = streams.encoders[0, 0]
    if (
        given.size
        and not (joint.input_divided or joint.signals.is_velocity)
        and encoder["high"] - encoder["low"] <= _TURN < np.ptp(given)
    ):
        # The encoder wraps: `prepare` finds turns that are lost in a gap from the output.
        given = np.remainder(given + np.pi, 2.0 * np.pi) - np.pi
    torque[torque_outliers(torque, stretch)] = inf  # removed later with the samples around it, and counted
    torque = torque_between(stamp, stretch, torque, torque_stamp)
    warm = _temperature(np.concatenate(times), np.concatenate(heat), stamp)
    seen = streams.joints[0]
    unpaired = int(seen["unpaired"] + seen["waiting"])  # those that still wait got no input
    counts = int(seen["rejected"]), streams.last_rejection(0), unpaired, int(seen["clock_jumps"])
    reported = Stamps(*counts, tuple(reader.problems), int(seen["unstamped"]), others)
    return [stamp, stretch, given, own, torque, speed, warm], reported


def _own_rows(
    joint: JointConfig, streams: Alignment, topics: JointTopics, columns: list[Any]
) -> tuple[list[Any], tuple[str, ...]]:
    """Columns without the rows of a second publisher, and the text about it.

    Whole turns that a wrapping angle seemed to make between the two publishers are removed.
    """
    stamp, _, stretch, given, own, torque, _ = columns
    within = streams.encoders[0]["high"] - streams.encoders[0]["low"] <= _TURN
    turns = 2.0 * np.pi * np.array([abs(joint.names.input_factor), 1.0])
    period = dict(zip(("input", "output"), np.where(within, turns, inf).tolist(), strict=True))
    values = {"input": given, "output": own, "torque": torque}
    measured = {name: column for name, column in values.items() if np.isfinite(column).any()}
    if joint.signals.is_velocity:
        del measured["input"]
    where = f" on {listed(sorted(topics.readers), 3)}"
    rows, said = other_rows(_seconds(stamp, stamp[0]), stretch, measured, period, where)
    if not said:
        return columns, ()
    columns = [column[~rows] for column in columns]
    for number, name in ((3, "input"), (4, "output")):
        for begin, end in bounds(columns[2]) if name in measured and period[name] < inf else ():
            known = begin + np.flatnonzero(np.isfinite(columns[number][begin:end]))
            columns[number][known] = np.unwrap(columns[number][known], period=period[name])
    return columns, (f"{said}; they are left out",)


def _degrees(data: bytes, streams: Alignment) -> float:
    """Temperature in a message [degree Celsius]; an impossible one is rejected and becomes nan."""
    try:
        return read_temperature(data)
    except ValueError as error:
        streams.reject(0, str(error))
        return nan


def _temperature(time: Times, value: Floats, at: Times) -> Floats:
    """Temperature interpolated at some times [ns]; empty if fewer than two values are known."""
    known = np.abs(value) <= LARGEST_TEMPERATURE
    time, first = np.unique(time[known], return_index=True)
    if time.size < 2:
        return np.empty(0)
    return np.interp(_seconds(at, time[0]), _seconds(time, time[0]), value[known][first])


def _seconds(stamp: Times, origin: int) -> Floats:
    """Times after an origin [s]; since 1970 a double would resolve only a quarter of a microsecond."""
    return (stamp - origin).astype(np.float64) * 1e-9
