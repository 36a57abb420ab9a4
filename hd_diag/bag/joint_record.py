"""Measured records of joints from bags and tables: columns of time, angles, torque, temperature."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers, Times
from hd_diag.bag import BagError
from hd_diag.bag.reader import BagReader, Mixed
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.blocks import unwrapped
from hd_diag.diagnosis.record import Record, RecordError, prepare
from hd_diag.messages.publications import JOINT_STATE, OWN_OUTPUTS, TEMPERATURE, read_temperature
from hd_diag.streams.alignment import Aligned, Alignment, Names, torque_between
from hd_diag.streams.columns import JointStates

COLUMNS = ("time", "input", "output", "torque", "temperature")
"""Columns of a table that `read_table` knows."""

_REMEMBERED = 1 << 14  # samples over which topics of one bag may lag behind each other
_TURN = 2.0 * np.pi + 1e-6  # of an encoder that wraps [rad]


class _Samples(NamedTuple):
    """Aligned samples of a bag; times and temperatures [ns], [degree Celsius]; rows that were refused."""

    aligned: Aligned
    heat_time: Times
    heat: Floats
    refused: int


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

    Parameters
    ----------
    paths : sequence of path
    joint : JointConfig

    Returns
    -------
    Record
        At the output angle's stamps, by the rules of `hd_diag.streams.alignment`.

    Raises
    ------
    BagError
        Where a bag cannot be read.
    RecordError
        Where the joint has no input or output angle in them, or too little of them.
    """
    bags = [_read(path, joint, lambda found: np.isfinite(found.output_angle)) for path in paths]
    bags = [bag for bag in bags if bag.aligned.stamp.size > 1]
    if not bags:
        raise RecordError(
            f"no input angle ({joint.input_joint!r}) with output angle ({joint.output_joint!r}) "
            f"in {', '.join(map(str, paths))}"
        )
    every = _one_after_the_other(bags)
    torque = np.concatenate([torque_between(bag.aligned) for bag in bags])
    speed = every.speed if np.isfinite(every.speed).any() else None
    record = prepare(
        _seconds(every.stamp, int(bags[0].aligned.stamp[0])),
        every.input_angle,
        every.output_angle,
        torque,
        _temperature(bags),
        every.stretch,
        joint.drive.kinematics.ratio,
        joint.torque,
        speed,
    )
    return replace(record, dropped=record.dropped + sum(bag.refused for bag in bags))


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

    Parameters
    ----------
    paths : sequence of path
    joint : JointConfig

    Returns
    -------
    InputRecord or None

    Raises
    ------
    BagError
        Where a bag cannot be read.
    """
    bags = [_read(path, joint, lambda found: found.paired == 0) for path in paths]
    bags = [bag for bag in bags if bag.aligned.stamp.size > 1]
    if not bags:
        return None
    every = _one_after_the_other(bags)
    angles = [bag.aligned.input_angle for bag in bags]
    turned = [unwrapped(a) if np.abs(a).max() <= _TURN else a for a in angles]
    torque = np.concatenate([torque_between(bag.aligned) for bag in bags])
    return InputRecord(
        _seconds(every.stamp, int(every.stamp[0])),
        np.concatenate(turned),
        torque if np.isfinite(torque).all() else None,
        every.stretch,
    )


def _read(path: str | Path, joint: JointConfig, wanted: Callable[[Aligned], Any]) -> _Samples:
    """Samples of a bag that are wanted, by stamps in each stretch."""
    streams = Alignment([Names(joint.input_joint, joint.output_joint)], _REMEMBERED)
    nothing = np.zeros(0, np.int64)
    parts, heat = [streams.take(nothing, ())], [(nothing, np.zeros(0))]
    with BagReader(path) as reader:
        topics = [*joint_state_topics(reader), *_temperature_topics(reader, joint)]
        for mixed in reader.mixed(topics, lambda topic: topic.type_name == JOINT_STATE):
            _, batch = mixed.batches[0]
            if batch.topic.type_name == TEMPERATURE:
                values = np.array([read_temperature(bytes(data)) for data in batch.messages()])
                heat.append((mixed.log_time, values))
            else:
                found = streams.take(mixed.log_time, *layouts(reader, mixed))
                parts.append(found.part(wanted(found)))
    aligned = Aligned(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    time, value = (np.concatenate(column) for column in zip(*heat, strict=True))
    time, first = np.unique(time[np.isfinite(value)], return_index=True)
    order = np.lexsort((aligned.stamp, aligned.stretch))
    refused = int(streams.joints["rejected"][0])
    return _Samples(aligned.part(order), time, value[np.isfinite(value)][first], refused)


def _temperature_topics(reader: BagReader, joint: JointConfig) -> list[str]:
    end = f"{joint.name}/temperature"
    return [t.name for t in reader.topics if t.type_name == TEMPERATURE and t.name.endswith(end)]


def _one_after_the_other(bags: Sequence[_Samples]) -> Aligned:
    """Samples of all bags; `stretch` numbers the recordings that bags and clocks set back begin."""
    every = Aligned(*(np.concatenate(column) for column in zip(*(b.aligned for b in bags), strict=True)))
    bag = np.repeat(np.arange(len(bags)), [b.aligned.stamp.size for b in bags])
    begins = (np.diff(bag, prepend=bag[0]) != 0) | (np.diff(every.stretch, prepend=every.stretch[0]) != 0)
    return every._replace(stretch=np.cumsum(begins))


def _temperature(bags: Sequence[_Samples]) -> Floats | None:
    """Temperature at the samples; None where a bag does not tell it."""
    if any(bag.heat.size < 2 for bag in bags):
        return None
    found = []
    for bag in bags:
        at, known = (_seconds(time, int(bag.heat_time[0])) for time in (bag.aligned.stamp, bag.heat_time))
        found.append(np.interp(at, known, bag.heat))
    return np.concatenate(found)


def _seconds(stamp: Times, origin: int) -> Floats:
    """Times after an origin [s]: since 1970 a double would tell them to a quarter of a microsecond only."""
    return (stamp - origin).astype(np.float64) * 1e-9


def read_table(path: str | Path, columns: dict[str, str], joint: JointConfig, divided: bool) -> Record:
    """A record from a CSV file with named columns.

    Parameters
    ----------
    path : path
    columns : dict
        Which column is what: keys of `COLUMNS`, values the names in the file's first row.
    joint : JointConfig
    divided : bool
        Whether the input angle is already divided by the ratio.

    Returns
    -------
    Record

    Raises
    ------
    RecordError
        Where the file lacks a column, or a value is no number.
    """
    missing = [name for name in COLUMNS[:3] if name not in columns]
    unknown = [name for name in columns if name not in (*COLUMNS, "record")]
    if missing or unknown:
        what = f"needs {', '.join(missing)}" if missing else f"does not know {unknown[0]!r}"
        raise RecordError(f"--columns {what}; it takes {', '.join(COLUMNS)} and record")
    table = _read_csv(Path(path), columns)
    ratio = joint.drive.kinematics.ratio
    angle = table["input"] * (ratio if divided else 1.0)
    bag = table.get("record", np.zeros(angle.size))
    return prepare(
        table["time"],
        angle,
        table["output"],
        table.get("torque"),
        table.get("temperature"),
        np.unique(bag, return_inverse=True)[1].astype(np.int64),
        ratio,
        joint.torque,
    )


def _read_csv(path: Path, columns: dict[str, str]) -> dict[str, Floats]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.reader(file)
            header = next(rows, [])
            absent = [name for name in columns.values() if name not in header]
            if absent:
                raise RecordError(f"{path}: has no column {absent[0]!r}; it has {', '.join(header)}")
            places = {key: header.index(name) for key, name in columns.items()}
            values = {key: array("d") for key in columns}
            for number, row in enumerate(rows, start=2):
                for key, place in places.items():
                    values[key].append(_number(path, number, row, place))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from error
    return {key: np.frombuffer(column) for key, column in values.items()}


def _number(path: Path, line: int, row: list[str], place: int) -> float:
    text = row[place].strip() if place < len(row) else ""
    try:
        return float(text) if text else float("nan")
    except ValueError:
        raise RecordError(f"{path}, line {line}: {text!r} is no number") from None
