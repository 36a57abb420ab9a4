"""Measured records of joints from CSV files, as spreadsheets, loggers and scopes write them."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.bag.joint_record import InputRecord
from hd_diag.config.configuration import JointConfig
from hd_diag.diagnosis.blocks import unwrapped
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record, RecordError, prepare
from hd_diag.streams.signals import Unit, unit

COLUMNS = ("time", "input", "output", "torque", "temperature")
"""Columns that `read_tables` knows; beside them ``record`` tells recordings in one file apart."""

_USUAL = dict(zip(COLUMNS, ("s", "rad", "rad", "N m", "degC"), strict=True))
_DELIMITERS = ",;\t|"
_GIVEN = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<unit>[^\[\]]+)\])?\s*(?:\*\s*(?P<scale>[-+.\deE]+))?")
_IN_HEADER = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]+)[\])]")
_COUNTERS = (2.0**16, 2.0**32)  # of encoders, that run over
_TURN = 2.0 * np.pi + 1e-6


@dataclass(frozen=True)
class Table:
    """How CSV files are read.

    Attributes
    ----------
    columns : mapping of str to str
        For keys of `COLUMNS` and ``record`` names in the files' first rows, each with ``[unit]`` and
        ``*scale`` behind it where they are needed. A unit in the first row, ``angle [deg]``, counts too.
    divided : bool
        Whether the input angle is already divided by the ratio.
    rate : float
        Of files without a column of time [Hz]; 0 where they have one.
    delimiter : str
        Empty: found from the first row.
    """

    columns: Mapping[str, str]
    divided: bool = False
    rate: float = 0.0
    delimiter: str = ""


def read_tables(paths: Sequence[str | Path], table: Table, joint: JointConfig) -> Record:
    """A record from CSV files, each of which is a recording.

    Raises
    ------
    RecordError
        Where a file lacks a column, or a value is no number.
    """
    found, by_current = columns_of(paths, table, joint, ("time", "input", "output"))
    ratio, run = joint.drive.kinematics.ratio, found["record"].astype(np.int64)
    torque, warm = found.get("torque"), found.get("temperature")
    columns = found["time"], found["input"], found["output"], torque, warm, run
    return prepare(*columns, ratio, joint.torque, by_current=by_current)


def read_table_motion(paths: Sequence[str | Path], table: Table, joint: JointConfig) -> InputRecord:
    """A joint's motion and torque from CSV files: of the input's angle, else of the output's times the ratio.

    RecordError as of :func:`read_tables`; the torque is needed.
    """
    angle = "input" if "input" in table.columns else "output"
    found, _ = columns_of(paths, table, joint, ("time", angle, "torque"))
    record, values = found["record"].astype(np.int64), found[angle]
    _follow(values, record)
    if angle == "output":
        values = values * joint.drive.kinematics.ratio
    usable = np.isfinite(found["time"]) & np.isfinite(values) & np.isfinite(found["torque"])
    return InputRecord(found["time"][usable], values[usable], found["torque"][usable], record[usable])


def columns_of(
    paths: Sequence[str | Path], table: Table, joint: JointConfig, needed: Sequence[str]
) -> tuple[dict[str, Floats], bool]:
    """Columns of CSV files, and whether the torque is a current's.

    Given are those of `COLUMNS` that the table names, of shape (n,): time [s], angles [rad] (the input's is
    the wave generator's, and continuous where it was divided), torque [N m], temperature [degree Celsius];
    and ``record``, the number of the recording. RecordError where one that is needed is not there.
    """
    given = dict(table.columns)
    missing = [name for name in needed if name not in given and not (name == "time" and table.rate)]
    unknown = [name for name in given if name not in (*COLUMNS, "record")]
    if missing or unknown:
        what = f"needs {', '.join(missing)}" if missing else f"does not know {unknown[0]!r}"
        rate = " (or --rate)" if "time" in missing else ""
        raise RecordError(f"--columns {what}{rate}; it takes {', '.join(COLUMNS)} and record")
    files = [_file(Path(path), table) for path in paths]
    number = np.repeat(np.arange(len(files)), [len(next(iter(columns.values()))) for columns, _ in files])
    found = {name: np.concatenate([columns[name] for columns, _ in files]) for name in files[0][0]}
    recording = np.stack((number, found.get("record", np.zeros(number.size))), axis=1)
    found["record"] = np.unique(recording, axis=0, return_inverse=True)[1].reshape(-1)
    if (table.divided or joint.input_divided) and "input" in found:
        _follow(found["input"], found["record"].astype(np.int64))
        found["input"] *= joint.drive.kinematics.ratio
    return found, files[0][1]


def _follow(angle: Floats, record: Integers) -> None:
    """Make angles that stay within a turn continuous, in place, recording by recording."""
    for begin, end in bounds(record):
        if begin < end and np.ptp(angle[begin:end]) <= _TURN:
            angle[begin:end] = unwrapped(angle[begin:end])


def _file(path: Path, table: Table) -> tuple[dict[str, Floats], bool]:
    """Columns of a file in SI, and whether the torque is a current's."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            first = file.readline()
            delimiter = table.delimiter or max(_DELIMITERS, key=first.count)
            header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter), [])]
            wanted = {key: _column(path, key, text, header) for key, text in table.columns.items()}
            values = {key: array("d") for key in wanted}
            rows = csv.reader(file, delimiter=delimiter)
            for row in rows:
                for key, (place, _) in wanted.items():
                    values[key].append(
                        _number(path, rows.line_num + 1, row[place] if place < len(row) else "")
                    )
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from error
    columns = {key: _in_si(np.frombuffer(column), wanted[key][1]) for key, column in values.items()}
    if table.rate and "time" not in columns:
        columns["time"] = np.arange(len(next(iter(columns.values())))) / table.rate
    return columns, "torque" in wanted and wanted["torque"][1].is_current


def _column(path: Path, key: str, text: str, header: list[str]) -> tuple[int, Unit]:
    """Place of a column in the rows, and its unit."""
    given = _GIVEN.fullmatch(text)
    name = text if text in header or given is None else given["name"]
    plain = [found["name"] if (found := _IN_HEADER.fullmatch(each)) else each for each in header]
    if name not in header and name not in plain:
        raise RecordError(f"{path}: has no column {name!r}; it has {', '.join(header)}")
    place = header.index(name) if name in header else plain.index(name)
    if key == "record":
        return place, Unit(1.0)
    stated, scale = (given["unit"], given["scale"]) if given and name != text else (None, None)
    told = _IN_HEADER.fullmatch(header[place])
    try:
        known = unit(key, stated or (told["unit"] if told else _USUAL[key]))
        factor = known.factor * float(scale or 1.0)
    except ValueError as error:
        raise RecordError(f"{path}: column {header[place]!r}: {error}") from error
    if known.is_rate:
        raise RecordError(f"{path}: column {header[place]!r}: an angle is needed, not a velocity")
    return place, known._replace(factor=factor)


def _in_si(values: Floats, known: Unit) -> Floats:
    if known.is_counts:
        for size in _COUNTERS:
            if np.nanmax(np.abs(values), initial=0.0) < size and np.isfinite(values).all():
                values = np.unwrap(values, period=size)
                break
    return values * known.factor + known.offset


def _number(path: Path, line: int, text: str) -> float:
    try:
        return float(text.strip().replace(",", ".") or "nan")
    except ValueError:
        raise RecordError(f"{path}, line {line}: {text.strip()!r} is no number") from None
