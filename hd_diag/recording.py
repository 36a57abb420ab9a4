"""Measured records of joints from bags and tables: columns of time, angles, torque, temperature."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hd_diag.bag import BagError
from hd_diag.bag.reader import BagReader
from hd_diag.config import JointConfig
from hd_diag.criticism.record import Record, RecordError, prepare
from hd_diag.messages import JOINT_STATE, OWN_OUTPUTS, TEMPERATURE, read_temperature
from hd_diag.samples import Times

Floats = npt.NDArray[np.float64]

_PAIRING_GAP = 0.05  # an input angle is interpolated over at most this time [s]
COLUMNS = ("time", "input", "output", "torque", "temperature")
"""Columns of a table that `read_table` knows."""


@dataclass
class _Stream:
    """Values of one joint of one kind, in the order of the bag."""

    time: list[Floats] = field(default_factory=list)
    value: list[Floats] = field(default_factory=list)

    def add(self, time: npt.ArrayLike, value: npt.ArrayLike) -> None:
        self.time.append(np.asarray(time, dtype=np.float64))
        self.value.append(np.asarray(value, dtype=np.float64))

    def sorted(self) -> tuple[Floats, Floats]:
        """Times and values, rising, each time once; nan values left out."""
        if not self.time:
            return np.empty(0), np.empty(0)
        time, value = np.concatenate(self.time), np.concatenate(self.value)
        finite = np.isfinite(value)
        time, first = np.unique(time[finite], return_index=True)
        return time, value[finite][first]


@dataclass
class _Streams:
    input: _Stream = field(default_factory=_Stream)
    output: _Stream = field(default_factory=_Stream)
    torque: _Stream = field(default_factory=_Stream)
    temperature: _Stream = field(default_factory=_Stream)
    speed: _Stream = field(default_factory=_Stream)


def read_bags(paths: Sequence[str | Path], joint: JointConfig) -> Record:
    """A joint's record from one bag or several, each of which begins a new run.

    Parameters
    ----------
    paths : sequence of path
    joint : JointConfig

    Returns
    -------
    Record
        At the output angle's stamps, the input angle interpolated to them.

    Raises
    ------
    BagError
        Where a bag cannot be read.
    RecordError
        Where the joint has no input or output angle in them, or too little of them.
    """
    parts, origin = [], None
    for number, path in enumerate(paths):
        streams, origin = _collect(path, joint, origin)
        columns = _aligned(streams, joint)
        if columns is not None:
            parts.append((*columns, np.full(columns[0].size, number)))
    if not parts:
        raise RecordError(
            f"no input angle ({joint.input_joint!r}) with output angle ({joint.output_joint!r}) "
            f"in {', '.join(map(str, paths))}"
        )
    has_torque = all(part[3] is not None for part in parts)
    has_temperature = all(part[4] is not None for part in parts)
    has_speed = all(part[5] is not None for part in parts)
    joined = [np.concatenate([part[i] for part in parts]) for i in (0, 1, 2, 6)]
    torque = np.concatenate([part[3] for part in parts]) if has_torque else None
    temperature = np.concatenate([part[4] for part in parts]) if has_temperature else None
    speed = np.concatenate([part[5] for part in parts]) if has_speed else None
    return prepare(
        joined[0],
        joined[1],
        joined[2],
        torque,
        temperature,
        joined[3].astype(np.int64),
        joint.drive.kinematics.ratio,
        joint.torque,
        speed,
    )


def joints_in(paths: Sequence[str | Path]) -> set[str]:
    """Names that the joint states of bags hold."""
    names: set[str] = set()
    for path in paths:
        with BagReader(path) as reader:
            for batch in reader.batches(_joint_topics(reader)):
                columns, _ = reader.joint_states(batch)
                for states in columns:
                    names.update(states.names)
    return names


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
            values: dict[str, list[float]] = {key: [] for key in columns}
            for number, row in enumerate(rows, start=2):
                for key, place in places.items():
                    values[key].append(_number(path, number, row, place))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from error
    return {key: np.array(column) for key, column in values.items()}


def _number(path: Path, line: int, row: list[str], place: int) -> float:
    text = row[place].strip() if place < len(row) else ""
    try:
        return float(text) if text else float("nan")
    except ValueError:
        raise RecordError(f"{path}, line {line}: {text!r} is no number") from None


def _joint_topics(reader: BagReader) -> list[str]:
    found = [
        topic.name
        for topic in reader.topics
        if topic.type_name == JOINT_STATE and not topic.name.endswith(OWN_OUTPUTS)
    ]
    if not found:
        raise BagError(reader.path, "has no topic with sensor_msgs/msg/JointState")
    return found


def _collect(path: str | Path, joint: JointConfig, origin: int | None) -> tuple[_Streams, int | None]:
    """Streams of a bag, their times from an origin [ns] on: the first stamp where none is given."""
    streams, both = _Streams(), {joint.input_joint, joint.output_joint}
    with BagReader(path) as reader:
        topics = _joint_topics(reader)
        heat = [
            t.name
            for t in reader.topics
            if t.type_name == TEMPERATURE and t.name.endswith(f"{joint.name}/temperature")
        ]
        for batch in reader.batches([*topics, *heat], grouped=True):
            if batch.topic.type_name == TEMPERATURE:
                values = np.array([read_temperature(bytes(data)) for data in batch.messages()])
                origin = int(batch.log_time[0]) if origin is None else origin
                streams.temperature.add(_seconds(batch.log_time, origin), values)
                continue
            columns, _ = reader.joint_states(batch)
            for states in columns:
                origin = int(states.stamp[0]) if origin is None else origin
                time = _seconds(states.stamp, origin)
                if states.velocity is not None and both <= set(states.names):
                    own = states.names.index(joint.input_joint)
                    streams.speed.add(time, states.velocity[:, own])
                for column, name in enumerate(states.names):
                    if name == joint.input_joint and states.position is not None:
                        streams.input.add(time, states.position[:, column])
                    if name == joint.output_joint and states.position is not None:
                        streams.output.add(time, states.position[:, column])
                    if name == joint.output_joint and states.effort is not None:
                        streams.torque.add(time, states.effort[:, column])
    return streams, origin


def _seconds(stamp: Times, origin: int) -> Floats:
    """Times after an origin [s]: since 1970 a double would tell them to a quarter of a microsecond only."""
    return (stamp - origin).astype(np.float64) * 1e-9


def _aligned(
    streams: _Streams, joint: JointConfig
) -> tuple[Floats, Floats, Floats, Floats | None, Floats | None, Floats | None] | None:
    """Columns at the output's stamps; None where an angle is missing."""
    input_time, angle = streams.input.sorted()
    time, output = streams.output.sorted()
    if input_time.size < 2 or time.size < 2:
        return None
    wrapped = float(np.max(np.abs(angle))) <= 2.0 * np.pi + 1e-6
    angle = np.unwrap(angle) if wrapped else angle
    after = np.clip(np.searchsorted(input_time, time), 1, input_time.size - 1)
    exact = (input_time[after] == time) | (input_time[after - 1] == time)
    near = (
        (input_time[after] - input_time[after - 1] <= _PAIRING_GAP)
        & (time >= input_time[0])
        & (time <= input_time[-1])
    )
    kept = exact | near
    time, output = time[kept], output[kept]
    angle = np.interp(time, input_time, angle)
    return (
        time,
        np.mod(angle, 2.0 * np.pi) if wrapped else angle,  # so that the record knows
        output,
        _interpolated(streams.torque, time),
        _interpolated(streams.temperature, time),
        _reported(streams.speed, time),
    )


def _interpolated(stream: _Stream, time: Floats) -> Floats | None:
    known, value = stream.sorted()
    return np.interp(time, known, value) if known.size > 1 else None


def _reported(stream: _Stream, time: Floats) -> Floats | None:
    """Values that were reported at these very times, nan at the others; None where there are none."""
    known, value = stream.sorted()
    if not known.size:
        return None
    at = np.clip(np.searchsorted(known, time), 0, known.size - 1)
    return np.where(known[at] == time, value[at], np.nan)


@dataclass(frozen=True)
class Motion:
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
    bag: npt.NDArray[np.int64]


def read_motion(paths: Sequence[str | Path], joint: JointConfig) -> Motion | None:
    """A joint's motion from one bag or several, at the input angle's stamps; None where there is none.

    Parameters
    ----------
    paths : sequence of path
    joint : JointConfig

    Returns
    -------
    Motion or None

    Raises
    ------
    BagError
        Where a bag cannot be read.
    """
    parts, origin = [], None
    for number, path in enumerate(paths):
        streams, origin = _collect(path, joint, origin)
        time, angle = streams.input.sorted()
        if time.size > 1:
            wrapped = float(np.max(np.abs(angle))) <= 2.0 * np.pi + 1e-6
            torque = _interpolated(streams.torque, time)
            parts.append((time, np.unwrap(angle) if wrapped else angle, torque, np.full(time.size, number)))
    if not parts:
        return None
    times, angles, torques, bags = zip(*parts, strict=True)
    known = [torque for torque in torques if torque is not None]
    whole = np.concatenate(known) if len(known) == len(parts) else None
    return Motion(np.concatenate(times), np.concatenate(angles), whole, np.concatenate(bags).astype(np.int64))
