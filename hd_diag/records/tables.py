"""Measured records of joints from CSV files, as spreadsheets, loggers and scopes write them."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from math import inf
from pathlib import Path

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.blocks import unwrapped
from hd_diag.diagnosis.noise import bounds, numbered
from hd_diag.diagnosis.outliers import torque_outliers
from hd_diag.diagnosis.record import Record, RecordError, measured_torque, prepare
from hd_diag.diagnosis.stamps import Stamps, doubtful_clock
from hd_diag.formatting import listed
from hd_diag.records.joint_record import InputRecord
from hd_diag.records.text_table import TextTable, quantity, seconds, text_table
from hd_diag.streams.alignment import ELSEWHERE, Alignment, Names
from hd_diag.streams.columns import LARGEST_ANGLE, LARGEST_TEMPERATURE, LARGEST_TORQUE, JointStates
from hd_diag.streams.rules import LONGEST_HOLD, PAIRING_GAP, unseen
from hd_diag.streams.second_publisher import other_rows
from hd_diag.streams.signals import Unit, unit

COLUMNS = ("time", "input", "output", "torque", "temperature")
"""Columns that `read_tables` knows; in addition, ``record`` distinguishes recordings in one file."""

_KEYS = ELSEWHERE, "output", "", "input"  # keys of signals if the input is a velocity
_USUAL = dict(zip(COLUMNS, ("s", "rad", "rad", "N m", "degC"), strict=True))
_GIVEN = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<unit>[^\[\]]+)\])?\s*(?:\*\s*(?P<scale>[-+.\deE]+))?")
IN_HEADER = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>(?!\d+[\])])[^\[\]()]+)[\])]")
"""A column's name followed by a unit in brackets; a number in brackets is an index."""

_STATED = re.compile(r"\[[^\[\]]+\]\s*(\*.*)?$")
_TURN = 2.0 * np.pi + 1e-6
_LARGEST = {
    "time": (9e9, "s"),  # in nanoseconds an integer of 64 bits
    "input": (LARGEST_ANGLE, "rad"),
    "output": (LARGEST_ANGLE, "rad"),
    "torque": (LARGEST_TORQUE, "N m"),
    "temperature": (LARGEST_TEMPERATURE, "degC"),
}
_MOST_ROWS = 50_000_000  # half a day at 1 kHz
_TOGETHER = 4096  # rows converted to numbers at once
_PART = "part"  # column: number of the part of a file; a repeated header begins a part


@dataclass(frozen=True)
class Table:
    """How to read CSV files.

    `columns` maps keys of `COLUMNS` and ``record`` to names in the files' headers or numbers of columns, each
    followed by ``[unit]`` and ``*scale`` if needed; a unit in the header counts too. `divided`: the input
    angle is already divided by the ratio. `rate` is the sample rate of files without a time column [Hz],
    otherwise 0. An empty delimiter is found from the rows.
    """

    columns: Mapping[str, str]
    divided: bool = False
    rate: float = 0.0
    delimiter: str = ""


def read_tables(paths: Sequence[str | Path], table: Table, joint: JointConfig) -> Record:
    """A record from CSV files; each file is a recording.

    Raises RecordError if a file lacks a column, or a value is not a number.
    """
    _check_both(table)
    found, units, stamps = columns_of(paths, table, joint, ("time", "input", "output"))
    ratio, run = joint.drive.kinematics.ratio, found["record"].astype(np.int64)
    empty, own = np.isnan(found["input"]), np.isfinite(found["output"])
    found["input"] = _input_between(found, run)
    for name, longest in (("torque", LONGEST_HOLD), ("temperature", inf)):
        if name in found:
            found[name] = _between(found["time"], found[name], run, longest)
    # Where the input has stamps of its own, samples are at those of the output.
    rows = own if np.any(empty & own) else np.ones(own.size, np.bool_)
    found = {name: column[rows] for name, column in found.items()}
    columns = found["time"], found["input"], found["output"], found.get("torque"), found.get("temperature")
    by_current, by_velocity = "torque" in units and units["torque"].is_current, units["input"].is_rate
    more = found.get("speed"), by_current, by_velocity, stamps
    return prepare(*columns, run[rows], ratio, joint.torque, *more)


def _between(time: Floats, values: Floats, record: Integers, longest: float) -> Floats:
    """A column (n,), also in rows where its cell is empty: interpolated between values that are near in time.

    `longest` is the largest distance in time of these values [ns]. If it is infinite, the first and the last
    value hold beyond them. A stamp that goes back ends an interpolation.
    """
    found, rows = values.copy(), np.flatnonzero(np.isfinite(time))
    rising = numbered((np.diff(record[rows]) != 0) | (np.diff(time[rows]) < 0.0))
    for begin, end in bounds(rising):
        is_empty = np.isnan(values[rows[begin:end]])
        known, empty = rows[begin:end][~is_empty], rows[begin:end][is_empty]
        if known.size and empty.size:
            gap = np.diff(time[known], prepend=-inf, append=inf)
            empty = empty[1e9 * gap[known.searchsorted(empty)] <= longest]
            found[empty] = np.interp(time[empty], time[known], values[known])
    return found


def _input_between(found: Mapping[str, Floats], record: Integers) -> Floats:
    """The input angle, also in rows with an empty cell: its samples may have stamps of their own."""
    angle = found["input"]
    known = np.flatnonzero(np.isfinite(angle))
    if known.size in (0, angle.size):
        return angle
    wraps = float(np.ptp(angle[known])) <= _TURN
    if wraps:
        angle = angle.copy()
        angle[known] = np.unwrap(angle[known])
    whole = _between(found["time"], angle, record, PAIRING_GAP)
    return np.remainder(whole + np.pi, 2.0 * np.pi) - np.pi if wraps else whole


def _check_both(table: Table) -> None:
    """Raise RecordError for unknown columns, and for a single angle, with advice on what to do."""
    given = table.columns
    _check_known(given)
    if ("input" in given) == ("output" in given):
        return
    missing = "output" if "input" in given else "input"
    publish = "the motor encoder's angle, or its velocity (input=v[rad/s])"
    ripple = (
        "what the torque shows: hd-diag ripple"
        if "torque" in given
        else "for hd-diag ripple a torque or a current"
    )
    raise RecordError(
        f"columns need {missing}: one angle has no transmission error; the robot's driver would have to "
        f"publish {publish if missing == 'input' else 'the angle of the link'}; {ripple}"
    )


def _check_known(given: Mapping[str, str]) -> None:
    if unknown := [name for name in given if name not in (*COLUMNS, "record")]:
        raise RecordError(f"columns cannot be {unknown[0]!r}; they can be {', '.join(COLUMNS)} and record")


def read_table_motion(paths: Sequence[str | Path], table: Table, joint: JointConfig) -> InputRecord:
    """A joint's motion and torque from CSV files: the input angle, or else the output angle times the ratio.

    The torque is needed. Raises RecordError as :func:`read_tables`.
    """
    angle = "input" if "input" in table.columns else "output"
    found, _, stamps = columns_of(paths, table, joint, ("time", angle, "torque"))
    record, values = found["record"].astype(np.int64), found[angle]
    _follow(values, record)
    if angle == "output":
        values = values * joint.drive.kinematics.ratio
    torque, no_torque = measured_torque(found["torque"])
    usable = np.isfinite(found["time"]) & np.isfinite(values)
    if torque is not None:
        torque[torque_outliers(torque, record)] = inf
        usable &= np.isfinite(torque)
    known = torque if torque is None else torque[usable]
    return InputRecord(found["time"][usable], values[usable], known, record[usable], stamps, no_torque)


def columns_of(
    paths: Sequence[str | Path], table: Table, joint: JointConfig, needed: Sequence[str]
) -> tuple[dict[str, Floats], dict[str, Unit], Stamps]:
    """Columns of CSV files, the units that they had, and a report on rows with impossible numbers.

    Returns those of `COLUMNS` that the table names, of shape (n,): time [s], angles [rad], torque [N m],
    temperature [degree Celsius]. The input angle is the wave generator's, and continuous if it was divided,
    counted or integrated. Also ``record``, the number of the recording, and the input's ``speed`` [rad/s] if
    it was given. Raises RecordError if a `needed` column is missing.
    """
    given = dict(table.columns)
    _check_known(given)
    if missing := [name for name in needed if name not in given and not (name == "time" and table.rate)]:
        names = ["time (or a rate)" if name == "time" else name for name in missing]
        raise RecordError(f"columns need {', '.join(names)}; they can be {', '.join(COLUMNS)} and record")
    usual = _USUAL | ({"input": "rad/s"} if joint.signals.is_velocity else {})
    files, stamps = [], Stamps()
    for path in paths:
        columns, units = _file(Path(path), table, usual)
        columns, checked = _possible(columns)
        stamps = stamps.and_then(checked)
        files.append((columns, units))
    number = np.repeat(np.arange(len(files)), [len(next(iter(columns.values()))) for columns, _ in files])
    found = {name: np.concatenate([columns[name] for columns, _ in files]) for name in files[0][0]}
    recording = np.stack((number, found.pop(_PART), found.get("record", np.zeros(number.size))), axis=1)
    found["record"] = np.unique(recording, axis=0, return_inverse=True)[1].reshape(-1)
    stamps = _own_rows(found, stamps)
    _make_angles(found, files[0][1], joint, table.divided)
    _check_clock(table, found, joint.drive.kinematics.ratio)
    return found, files[0][1], stamps


def _own_rows(found: dict[str, Floats], stamps: Stamps) -> Stamps:
    """Remove the rows of a second publisher in place; returns `stamps` with a text about them."""
    roles = [name for name in _USUAL if name in found and name not in ("time", "temperature")]
    measured = {name: found[name] for name in roles if np.isfinite(found[name]).any()}
    within = [
        n for n in ("input", "output") if n in measured and np.nanmax(found[n]) - np.nanmin(found[n]) <= _TURN
    ]
    rows, said = other_rows(
        found["time"], found["record"].astype(np.int64), measured, dict.fromkeys(within, 2.0 * np.pi)
    )
    if said:
        for name, column in found.items():
            found[name] = column[~rows]
        stamps = stamps.and_then(Stamps(others=(f"{said}; they are left out",)))
    return stamps


def _check_clock(table: Table, found: Mapping[str, Floats], ratio: float) -> None:
    """Raise RecordError to ask for the unit of time, if it is not given and no joint moves like this."""
    name = table.columns.get("time", "")
    if not name or _STATED.search(name):
        return
    angle = found["output"] if "output" in found else found["input"] / ratio
    if question := doubtful_clock(found["time"], found["record"].astype(np.int64), angle):
        text, likely = question
        raise RecordError(
            f"{text}: give the column as time={name}[{likely}], or as time={name}[s] if it is right"
        )


def _make_angles(
    found: dict[str, Floats], units: Mapping[str, Unit], joint: JointConfig, divided: bool
) -> None:
    """Unwrap counters that overflow, and turn the input into the wave generator's angle, in place."""
    record, ratio = found["record"].astype(np.int64), joint.drive.kinematics.ratio
    for name in {"input", "output"} & units.keys():
        _count(found[name], units[name].counter, record)
    if "input" not in found:
        return
    is_rate = units["input"].is_rate
    divided |= joint.input_divided and is_rate == joint.signals.is_velocity
    if is_rate:
        names = Names("", "", keys=_KEYS, input_factor=ratio if divided else 1.0, velocity_ratio=ratio)
        _integrate(found, record, names)
    elif divided:
        _follow(found["input"], record)
        found["input"] *= ratio


def _integrate(found: dict[str, Floats], record: Integers, names: Names) -> None:
    """Replace the input's velocity by its integral, as streams integrate it; nan for unusable rows."""
    if "output" not in found:
        raise RecordError("a velocity as input needs the output's angle to begin its integral from")
    columns = np.stack((found["output"], found["input"]), axis=1)
    good = np.isfinite(columns).all(axis=1) & np.isfinite(found["time"])
    found["input"], found["speed"] = np.full((2, record.size), np.nan)
    for begin, end in bounds(record):
        rows = begin + np.flatnonzero(good[begin:end])
        if not rows.size:
            continue
        stamp = np.rint(1e9 * (found["time"][rows] - found["time"][rows[0]])).astype(np.int64)
        states = JointStates(
            np.arange(rows.size), stamp, (), "", None, None, None, columns[rows], _KEYS[1::2]
        )
        samples = Alignment([names]).take(stamp, [states])
        found["input"][rows[samples.row]] = samples.input_angle
        found["speed"][rows[samples.row]] = samples.speed


def _count(angle: Floats, counter: float, record: Integers) -> None:
    """Unwrap a counter that overflows, in place; one that restarts each turn is left as a wrapping angle."""
    if not counter:
        return
    from hd_diag.streams.kernel_encoder import continued  # late: it imports numba

    for begin, end in bounds(record):
        own = angle[begin:end]
        if own.size and np.nanmax(own) - np.nanmin(own) > _TURN:
            angle[begin:end] = continued(own, counter, unseen())


def _follow(angle: Floats, record: Integers) -> None:
    """Unwrap angles that stay within a turn, in place and for each recording."""
    for begin, end in bounds(record):
        if begin < end and np.ptp(angle[begin:end]) <= _TURN:
            angle[begin:end] = unwrapped(angle[begin:end])


def _file(path: Path, table: Table, usual: Mapping[str, str]) -> tuple[dict[str, Floats], dict[str, Unit]]:
    """Columns of a file in SI, and the units that they had; the usual unit if none is given."""
    try:
        text = text_table(path, table.delimiter)
        wanted = {key: _column(text, key, given, usual) for key, given in table.columns.items()}
        values, parts = {key: array("d") for key in wanted}, array("d")
        rows = text.rows()
        while block := list(islice(rows, _TOGETHER)):
            lines, part, cells = zip(*block, strict=True)
            if len(parts) + len(lines) > _MOST_ROWS:
                raise RecordError(f"{path}: has more than {_MOST_ROWS} rows: split it")
            if not parts and "time" in wanted and seconds(cells[0][place := wanted["time"][0]]) is not None:
                wanted["time"] = place, Unit(1.0)
            parts.extend(part)
            for key, (place, _) in wanted.items():
                column = [row[place] if place < len(row) else "" for row in cells]
                values[key].extend(_numbers(path, lines, column))
    except (OSError, UnicodeError, csv.Error) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from error
    units = {key: known for key, (_, known) in wanted.items()}
    with np.errstate(over="ignore"):
        columns = {
            key: np.frombuffer(column) * units[key].factor + units[key].offset
            for key, column in values.items()
        }
    columns[_PART] = np.frombuffer(parts)
    if table.rate and "time" not in columns:
        columns["time"] = np.arange(len(parts)) / table.rate
    return columns, units


def _possible(columns: dict[str, Floats]) -> tuple[dict[str, Floats], Stamps]:
    """Drop rows with numbers that no joint can have, and say how many."""
    stamps = Stamps()
    for name, (largest, unit_name) in _LARGEST.items():
        wrong = np.flatnonzero(np.abs(columns.get(name, np.zeros(0))) > largest)
        if wrong.size:
            reason = f"{name} is {columns[name][wrong[-1]]:g} {unit_name}, beyond {largest:g}"
            stamps = stamps.and_then(Stamps(wrong.size, reason))
            columns = {key: np.delete(column, wrong) for key, column in columns.items()}
    return columns, stamps


def _column(text: TextTable, key: str, given: str, usual: Mapping[str, str]) -> tuple[int, Unit]:
    """Index of a column in the rows, and its unit."""
    place, name, stated, scale = place_of(text, given)
    if key == "record":
        return place, Unit(1.0)
    matched = IN_HEADER.fullmatch(name)
    try:
        known = unit(key, stated or (matched["unit"] if matched else usual[key]))
        factor = known.factor * float(scale or 1.0)
    except ValueError as error:
        raise RecordError(f"{text.path}: column {name!r}: {error}") from error
    return place, known._replace(factor=factor)


def place_of(text: TextTable, given: str) -> tuple[int, str, str, str]:
    """Index of a column given by its name or number, its name, and the unit and scale that were given."""
    header = list(text.header)
    name, stated, scale = given, "", ""
    if given not in header and (parts := _GIVEN.fullmatch(given)):
        name, stated, scale = (each or "" for each in parts.groups())
    plain = [found["name"] if (found := IN_HEADER.fullmatch(each)) else each for each in header]
    if name in header or name in plain:
        place = header.index(name) if name in header else plain.index(name)
    elif name.isdecimal() and 0 < int(name) <= len(header):
        place = int(name) - 1
    else:
        held = ", ".join(header) if text.has_rows else f"{listed(header, 6)} and no rows of numbers"
        raise RecordError(f"{text.path}: has no column {name!r}; it has {held}")
    return place, header[place], stated, scale


def _numbers(path: Path, lines: Sequence[int], cells: Sequence[str]) -> list[float]:
    """Numbers in the cells of one column; `lines` are for the error."""
    try:
        return list(map(float, cells))  # fast path for most cells
    except ValueError:
        return [_number(path, line, cell) for line, cell in zip(lines, cells, strict=True)]


def _number(path: Path, line: int, cell: str) -> float:
    found = quantity(cell)
    if found is None:
        raise RecordError(f"{path}, line {line}: {cell!r} is not a number")
    return found
