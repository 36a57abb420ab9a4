"""Measured records of joints from bags and tables: columns of time, angles, torque, temperature."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Times
from hd_diag.bag import BagError
from hd_diag.bag.reader import BagReader
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.blocks import unwrapped
from hd_diag.diagnosis.record import Record, RecordError, prepare
from hd_diag.messages.publications import JOINT_STATE, OWN_OUTPUTS, TEMPERATURE, read_temperature
from hd_diag.streams.columns import JointStates

_PAIRING_GAP = 0.05  # an input angle is interpolated over at most this time [s]
COLUMNS = ("time", "input", "output", "torque", "temperature")
"""Columns of a table that `read_table` knows."""


class _Table:
    """Columns that arrive together, part by part: the times once, however many values they have.

    Parameters
    ----------
    width : int
        Number of columns.
    rows : int
        As many as are expected: parts kept one by one would leave holes in the memory.
    """

    def __init__(self, width: int, rows: int) -> None:
        self._columns = np.empty((width, max(rows, 1)))
        self._size = 0

    def add(self, *columns: Floats) -> None:
        end, room = self._size + columns[0].size, self._columns.shape[1]
        if end > room:
            grown = np.empty((len(columns), max(end, room + room // 2)))
            grown[:, : self._size] = self._columns[:, : self._size]
            self._columns = grown
        for own, column in zip(self._columns, columns, strict=True):
            own[self._size : end] = column
        self._size = end

    @property
    def columns(self) -> list[Floats]:
        """All of them; the times are the first."""
        return [column[: self._size] for column in self._columns]


class _Streams:
    """Values of one joint by their kinds, in the order of the bag."""

    def __init__(self) -> None:
        self._tables: dict[tuple[str, ...], _Table] = {}
        self._joined: dict[tuple[str, ...], list[Floats]] = {}

    def add(self, time: Floats, values: dict[str, Floats], rows: int) -> None:
        """Take a part; `rows` are expected in all."""
        kinds = tuple(values)
        if kinds and kinds not in self._tables:
            self._tables[kinds] = _Table(1 + len(kinds), rows)
        if kinds:
            self._tables[kinds].add(time, *values.values())

    def sorted(self, kind: str) -> tuple[Floats, Floats]:
        """Times and values, rising, each time once; nan values left out.

        Kinds that always come together and are in order have the very same array of times.
        """
        self._joined = self._joined or {kinds: table.columns for kinds, table in self._tables.items()}
        known = [(kinds.index(kind) + 1, table) for kinds, table in self._joined.items() if kind in kinds]
        columns = [(table[0], table[index]) for index, table in known]
        if not columns:
            return np.empty(0), np.empty(0)
        time, value = columns[0] if len(columns) == 1 else map(np.concatenate, zip(*columns, strict=True))
        finite = np.isfinite(value)
        if not finite.all():
            time, value = time[finite], value[finite]
        if not (np.diff(time) > 0.0).all():
            time, first = np.unique(time, return_index=True)
            value = value[first]
        return time, value


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
    parts: list[tuple[Floats | None, ...]] = []
    numbers, origin = [], None
    for number, path in enumerate(paths):
        streams, origin = _collect(path, joint, origin)
        columns = _aligned(streams)
        del streams
        if columns is not None:
            parts.append(columns)
            numbers.append(number)
    if not parts:
        raise RecordError(
            f"no input angle ({joint.input_joint!r}) with output angle ({joint.output_joint!r}) "
            f"in {', '.join(map(str, paths))}"
        )
    bag = np.repeat(numbers, [part[0].size for part in parts if part[0] is not None]).astype(np.int64)
    time, angle, output, torque, temperature, speed = map(_joined, zip(*parts, strict=True))
    del parts, columns
    assert time is not None
    assert angle is not None
    assert output is not None
    ratio = joint.drive.kinematics.ratio
    return prepare(time, angle, output, torque, temperature, bag, ratio, joint.torque, speed)


def _joined(parts: Sequence[Floats | None]) -> Floats | None:
    """One column of all bags; None where one of them has none."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    return known[0] if len(known) == 1 else np.concatenate(known)


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
    streams = _Streams()
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
                streams.add(_seconds(batch.log_time, origin), {"temperature": values}, batch.topic.count)
                continue
            columns, _ = reader.joint_states(batch)
            for states in columns:
                origin = int(states.stamp[0]) if origin is None else origin
                streams.add(_seconds(states.stamp, origin), _values(states, joint), batch.topic.count)
    return streams, origin


def _values(states: JointStates, joint: JointConfig) -> dict[str, Floats]:
    """What joint states say of a joint, by its kinds; its speed only beside the output."""
    found = {}
    own, out = (
        states.names.index(name) if name in states.names else None
        for name in (joint.input_joint, joint.output_joint)
    )
    for kind, column, values in (
        ("input", own, states.position),
        ("output", out, states.position),
        ("torque", out, states.effort),
        ("speed", None if out is None else own, states.velocity),
    ):
        if column is not None and values is not None:
            found[kind] = values[:, column]
    return found


def _seconds(stamp: Times, origin: int) -> Floats:
    """Times after an origin [s]: since 1970 a double would tell them to a quarter of a microsecond only."""
    return (stamp - origin).astype(np.float64) * 1e-9


def _aligned(streams: _Streams) -> tuple[Floats | None, ...] | None:
    """Time, input, output, torque, temperature and speed at the output's stamps; None without an angle."""
    input_time, angle = streams.sorted("input")
    time, output = streams.sorted("output")
    if input_time.size < 2 or time.size < 2:
        return None
    if input_time is not time:
        kept = _near(input_time, time)
        time, output = time[kept], output[kept]
        wrapped = _is_wrapped(angle)
        angle = np.interp(time, input_time, unwrapped(angle) if wrapped else angle)
        angle = np.mod(angle, 2.0 * np.pi) if wrapped else angle  # so that the record knows
    return (
        time,
        angle,
        output,
        _interpolated(streams, "torque", time),
        _interpolated(streams, "temperature", time),
        _reported(streams, time),
    )


def _is_wrapped(angle: Floats) -> bool:
    """Whether angles stay within a turn about zero [rad]."""
    return max(float(angle.max()), -float(angle.min())) <= 2.0 * np.pi + 1e-6


def _near(input_time: Floats, time: Floats) -> npt.NDArray[np.bool_]:
    """Times that are the input's own, or between two of them that are not far from each other."""
    after = np.clip(np.searchsorted(input_time, time), 1, input_time.size - 1)
    exact = (input_time[after] == time) | (input_time[after - 1] == time)
    near = (
        (input_time[after] - input_time[after - 1] <= _PAIRING_GAP)
        & (time >= input_time[0])
        & (time <= input_time[-1])
    )
    return np.asarray(exact | near)


def _interpolated(streams: _Streams, kind: str, time: Floats) -> Floats | None:
    known, value = streams.sorted(kind)
    if known is time:
        return value
    return np.interp(time, known, value) if known.size > 1 else None


def _reported(streams: _Streams, time: Floats) -> Floats | None:
    """Speeds that were reported at these very times, nan at the others; None where there are none."""
    known, value = streams.sorted("speed")
    if known is time or not known.size:
        return value if known.size else None
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
        time, angle = streams.sorted("input")
        if time.size > 1:
            torque = _interpolated(streams, "torque", time)
            turned = unwrapped(angle) if _is_wrapped(angle) else angle
            parts.append((time, turned, torque, np.full(time.size, number)))
    if not parts:
        return None
    times, angles, torques, bags = zip(*parts, strict=True)
    known = [torque for torque in torques if torque is not None]
    whole = np.concatenate(known) if len(known) == len(parts) else None
    return Motion(np.concatenate(times), np.concatenate(angles), whole, np.concatenate(bags).astype(np.int64))
