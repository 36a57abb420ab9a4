"""Measured records of joints from bags and tables: columns of time, angles, torque, temperature."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.bag import BagError
from hd_diag.bag.reader import BagReader, Mixed
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.blocks import unwrapped
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record, RecordError, prepare
from hd_diag.diagnosis.stamps import Stamps
from hd_diag.messages.publications import JOINT_STATE, OWN_OUTPUTS, TEMPERATURE, read_temperature
from hd_diag.streams.alignment import Aligned, Alignment, Names, torque_between
from hd_diag.streams.columns import JointStates

COLUMNS = ("time", "input", "output", "torque", "temperature")
"""Columns of a table that `read_tables` knows."""

_REMEMBERED = 1 << 14  # samples over which topics of one bag may lag behind each other
_STAMPS, _VALUES = ("stamp", "torque_stamp", "stretch"), ("input_angle", "output_angle", "torque", "speed")
_ROOM = 1 << 22  # rows for which there is room at first: an hour at 1 kHz
_TURN = 2.0 * np.pi + 1e-6  # of an encoder that wraps [rad]


class _Samples(NamedTuple):
    """Samples of a joint, columns (n,), None where no bag tells it; what became of others.

    Times since the first [s], numbers of the stretches, angles [rad], torque [N m], speed of the input
    [rad/s], temperature [degree Celsius].
    """

    time: Floats
    stretch: Integers
    input_angle: Floats
    output_angle: Floats
    torque: Floats
    speed: Floats | None
    temperature: Floats | None
    stamps: Stamps


def joint_state_topics(reader: BagReader) -> list[str]:
    """Topics of a bag with joint states; a node's own outputs are none.

    Raises
    ------
    BagError
        Where there is none.
    """
    found = [topic.name for topic in reader.topics if topic.type_name == JOINT_STATE]
    found = [name for name in found if not name.endswith(OWN_OUTPUTS)]
    if not found:
        raise BagError(reader.path, f"has no topic with {JOINT_STATE}")
    return found


def layouts(reader: BagReader, mixed: Mixed) -> tuple[list[JointStates], list[tuple[int, str]]]:
    """Joint states of consecutive messages; positions of those that cannot be read, and why, in order."""
    shapes: list[JointStates] = []
    refused: list[tuple[int, str]] = []
    for rows, batch in mixed.batches:
        columns, rejected = reader.joint_states(batch)
        shapes += [states._replace(row=rows[states.row]) for states in columns]
        refused += [(int(rows[each.row]), each.reason) for each in rejected]
    return shapes, refused


def joints_in(paths: Sequence[str | Path]) -> set[str]:
    """Names that the joint states of bags hold."""
    names: set[str] = set()
    for path in paths:
        with BagReader(path) as reader:
            for batch in reader.batches(joint_state_topics(reader)):
                for states in reader.joint_states(batch)[0]:
                    names.update(states.names)
    return names


def read_bags(paths: Sequence[str | Path], joint: JointConfig) -> Record:
    """A joint's record from one bag or several, each of which begins a new run, as a clock set back does.

    It is at the output angle's stamps, by the rules of `hd_diag.streams.alignment`.

    Raises
    ------
    BagError
        Where a bag cannot be read.
    RecordError
        Where the joint has no input or output angle in them, or too little of them.
    """
    found = _read_all(paths, joint, lambda samples: np.isfinite(samples.output_angle))
    time, stretch, given, own, torque, speed, warm, stamps = found
    if not time.size:
        raise RecordError(
            f"no input angle ({joint.input_joint!r}) with output angle ({joint.output_joint!r}) "
            f"in {', '.join(map(str, paths))}{stamps.why}"
        )
    ratio = joint.drive.kinematics.ratio
    return prepare(time, given, own, torque, warm, stretch, ratio, joint.torque, speed, stamps=stamps)


@dataclass(frozen=True)
class InputRecord:
    """Where a joint's input was and what it bore, whether or not its output was measured.

    Attributes
    ----------
    time, input_angle : ndarray, shape (n,)
        [s]; continuous over the turns [rad].
    torque : ndarray, shape (n,), or None
        On the link [N m].
    bag : ndarray of int64, shape (n,)
        Which recording each sample comes from.
    """

    time: Floats
    input_angle: Floats
    torque: Floats | None
    bag: Integers


def read_motion(paths: Sequence[str | Path], joint: JointConfig) -> InputRecord | None:
    """A joint's motion from one bag or several, at the input angle's stamps; None where there is none.

    Raises
    ------
    BagError
        Where a bag cannot be read.
    """
    found = _read_all(paths, joint, lambda samples: samples.paired == 0)
    if not found.time.size:
        return None
    angle = found.input_angle
    for begin, end in bounds(found.stretch):
        if np.abs(angle[begin:end]).max() <= _TURN:
            angle[begin:end] = unwrapped(angle[begin:end])
    torque = found.torque if np.isfinite(found.torque).all() else None
    return InputRecord(found.time, angle, torque, found.stretch)


def _read_all(paths: Sequence[str | Path], joint: JointConfig, wanted: Callable[[Aligned], Any]) -> _Samples:
    """Samples of all bags that are wanted; `stretch` numbers what bags and clocks set back begin."""
    bags, stamps, begun = [], Stamps(), 0
    for path in paths:
        columns, told = _read(path, joint, wanted)
        stamps = stamps.and_then(told)
        if columns[0].size > 1:
            columns[1] += begun - columns[1][0]
            begun = int(columns[1][-1]) + 1
            bags.append(columns)
    if not bags:
        nothing = np.zeros(0)
        return _Samples(nothing, np.zeros(0, np.int64), nothing, nothing, nothing, None, None, stamps)
    columns = bags[0] if len(bags) == 1 else [np.concatenate(parts) for parts in zip(*bags, strict=True)]
    stamp, stretch, given, own, torque, speed, warm = columns
    told_speed = speed if np.isfinite(speed).any() else None
    warmth = warm if warm.size == stamp.size else None
    return _Samples(_seconds(stamp, stamp[0]), stretch, given, own, torque, told_speed, warmth, stamps)


def _read(path: str | Path, joint: JointConfig, wanted: Callable[[Aligned], Any]) -> tuple[list[Any], Stamps]:
    """Columns of one bag as `_Samples` has them, with stamps [ns], by these in each stretch."""
    streams = Alignment([Names(joint.input_joint, joint.output_joint)], _REMEMBERED)
    nothing = np.zeros(0, np.int64)
    times, heat, size = [nothing], [np.zeros(0)], 0
    with BagReader(path) as reader:
        room = max(1, min(reader.message_count, _ROOM))
        columns: list[Any] = [np.empty(room, np.int64) for _ in _STAMPS]
        columns += [np.empty(room) for _ in _VALUES]
        topics = joint_state_topics(reader) + _temperature_topics(reader, joint)
        for mixed in reader.mixed(topics, lambda topic: topic.type_name == JOINT_STATE):
            _, batch = mixed.batches[0]
            if batch.topic.type_name == TEMPERATURE:
                times.append(mixed.log_time)
                heat.append(np.array([read_temperature(bytes(data)) for data in batch.messages()]))
            else:
                found = streams.take(mixed.log_time, *layouts(reader, mixed))
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
    stamp, torque_stamp, stretch, given, own, torque, speed = columns
    torque = torque_between(stamp, stretch, torque, torque_stamp)
    warm = _temperature(np.concatenate(times), np.concatenate(heat), stamp)
    seen = streams.joints[0]
    unpaired = int(seen["unpaired"] + seen["waiting"])  # no input came for those that still wait
    told = Stamps(int(seen["rejected"]), streams.last_rejection(0), unpaired, int(seen["clock_jumps"]))
    return [stamp, stretch, given, own, torque, speed, warm], told


def _temperature_topics(reader: BagReader, joint: JointConfig) -> list[str]:
    end = f"{joint.name}/temperature"
    return [t.name for t in reader.topics if t.type_name == TEMPERATURE and t.name.endswith(end)]


def _temperature(time: Times, value: Floats, at: Times) -> Floats:
    """Temperature at some times [ns]; none where fewer than two are known."""
    time, first = np.unique(time[np.isfinite(value)], return_index=True)
    if time.size < 2:
        return np.empty(0)
    return np.interp(_seconds(at, time[0]), _seconds(time, time[0]), value[np.isfinite(value)][first])


def _seconds(stamp: Times, origin: int) -> Floats:
    """Times after an origin [s]: since 1970 a double would tell them to a quarter of a microsecond only."""
    return (stamp - origin).astype(np.float64) * 1e-9


def read_tables(
    paths: Sequence[str | Path], columns: dict[str, str], joint: JointConfig, divided: bool
) -> Record:
    """A record from CSV files with named columns, each of which is a recording.

    `columns` says which is what: keys of `COLUMNS`, values the names in the files' first rows;
    `divided` whether the input angle is already divided by the ratio.

    Raises
    ------
    RecordError
        Where a file lacks a column, or a value is no number.
    """
    missing = [name for name in COLUMNS[:3] if name not in columns]
    unknown = [name for name in columns if name not in (*COLUMNS, "record")]
    if missing or unknown:
        what = f"needs {', '.join(missing)}" if missing else f"does not know {unknown[0]!r}"
        raise RecordError(f"--columns {what}; it takes {', '.join(COLUMNS)} and record")
    tables = [_read_csv(Path(path), columns) for path in paths]
    file = np.repeat(np.arange(len(tables)), [table["time"].size for table in tables])
    table = {name: np.concatenate([one[name] for one in tables]) for name in tables[0]}
    ratio = joint.drive.kinematics.ratio
    angle = table["input"] * (ratio if divided else 1.0)
    recording = np.stack((file, table.get("record", np.zeros(angle.size))), axis=1)
    run = np.unique(recording, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    torque, warm = table.get("torque"), table.get("temperature")
    return prepare(table["time"], angle, table["output"], torque, warm, run, ratio, joint.torque)


def _read_csv(path: Path, columns: dict[str, str]) -> dict[str, Floats]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.DictReader(file)
            header = rows.fieldnames or []
            absent = [name for name in columns.values() if name not in header]
            if absent:
                raise RecordError(f"{path}: has no column {absent[0]!r}; it has {', '.join(header)}")
            values = {key: array("d") for key in columns}
            for row in rows:
                for key, name in columns.items():
                    values[key].append(_number(path, rows.line_num, row[name] or ""))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from error
    return {key: np.frombuffer(column) for key, column in values.items()}


def _number(path: Path, line: int, text: str) -> float:
    try:
        return float(text.strip() or "nan")
    except ValueError:
        raise RecordError(f"{path}, line {line}: {text.strip()!r} is no number") from None
