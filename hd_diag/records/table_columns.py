"""Columns of a table as numbers like those of a bag, with names for `--columns`."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.bag.block import Topic
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.stamps import doubtful_clock
from hd_diag.records.contents import NumericField, field_of
from hd_diag.records.tables import IN_HEADER
from hd_diag.records.text_table import quantity, seconds, text_table
from hd_diag.streams.signals import unit

_MOST_ROWS = 50_000  # rows that are examined
_TIME = re.compile(r"(?<![a-z])(t|time|times|zeit|secs?|seconds?)(?![a-z])|stamp|time")
_LARGEST = 1e300  # differences of larger numbers may overflow
_RECORD = re.compile(r"record(ing)?|run|trial|bag")
_RISING = 0.9  # share of rising steps of a time; appended files step back
_AMBIGUOUS = set(",=*[]")  # characters that a name in --columns cannot hold


class TableColumns(NamedTuple):
    """Columns of a table by names for `--columns`: numbers; time and recording, empty if none; time [s]."""

    fields: list[NumericField]
    time_name: str
    record_name: str
    time: Floats


def table_columns(path: Path) -> TableColumns:
    """Columns of a file's first rows; RecordError if it is not a table."""
    try:
        text = text_table(path)
        rows = [cells for _, _, cells in islice(text.rows(), _MOST_ROWS)]
    except (OSError, UnicodeError, csv.Error) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from error
    if not rows:
        raise RecordError(f"{path}: has no rows of numbers: is it a table?")
    values = _values(len(text.header), rows)
    number = _time_column(text.header, values)
    names = _names(text.header)
    shown, time = "", np.arange(len(rows), dtype=np.float64)
    if number is not None:
        given = _unit_of("time", text.header[number])
        likely = "" if given or seconds(rows[0][number]) is not None else _likely_unit(values[number])
        likely = likely or (given if not IN_HEADER.fullmatch(text.header[number]) and given != "s" else "")
        shown = names[number] + (f"[{likely}]" if likely else "")
        time = values[number] * unit("time", given or likely or "s").factor
    topic = Topic("", "table", len(rows))
    tags = _tags(text.header)
    apart = [k for k, name in enumerate(text.header) if _RECORD.fullmatch(name.lower())]
    fields = [
        _field(topic, text.header[k], names[k], time, values[k], tags[k])
        for k in range(len(names))
        if k not in (number, *apart)
    ]
    return TableColumns(fields, shown, names[apart[0]] if apart else "", time)


def _values(width: int, rows: list[list[str]]) -> Floats:
    """Numbers of all columns, (columns, n); nan for cells without a possible number."""
    found = np.full((len(rows), width), np.nan)
    for row, cells in enumerate(rows):
        for column, cell in enumerate(cells[:width]):
            value = quantity(cell)
            found[row, column] = np.nan if value is None or abs(value) > _LARGEST else value
    return found.T


def _time_column(header: Sequence[str], values: Floats) -> int | None:
    """Index of the time column: rising and named so, otherwise the first without a name that rises evenly."""
    step = np.diff(values, axis=1)
    if not step.shape[1]:
        return None
    rising = (step >= 0.0).mean(axis=1) > _RISING
    middle = np.median(step, axis=1, keepdims=True)
    even = np.all((step > 0.0) & (np.abs(step - middle) < middle), axis=1).tolist()
    named = [k for k, name in enumerate(header) if rising[k] and _TIME.search(name.lower())]
    nameless = [k for k, name in enumerate(header) if even[k] and name == str(k + 1)]
    return next(iter([*named, *nameless]), None)


def _likely_unit(time: Floats) -> str:
    """Likely unit of a time, for a plausible rate of recording; empty for s."""
    question = doubtful_clock(time, np.zeros(time.size, np.int64), np.zeros(time.size))
    return question[1] if question else ""


def _unit_of(role: str, name: str) -> str:
    """Unit in a column's name, in brackets or after an underscore; empty if no unit is known."""
    given = IN_HEADER.fullmatch(name)
    text = given["unit"] if given else name.rpartition("_")[2]
    with suppress(ValueError):
        unit(role, text)
        return text
    return ""


def _names(header: Sequence[str]) -> list[str]:
    """Names of columns for `--columns`: without units; a column's number if its name is not plain."""
    given = map(IN_HEADER.fullmatch, header)
    names = [found["name"] if found else name for found, name in zip(given, header, strict=True)]
    counts = Counter(names)
    plain = (counts[name] == 1 and _is_plain(name) for name in names)
    return [name if is_so else str(k) for k, (name, is_so) in enumerate(zip(names, plain, strict=True), 1)]


def _is_plain(name: str) -> bool:
    """Whether a name is valid in `--columns`, where a number means a column's number."""
    return name.strip() == name != "" and not _AMBIGUOUS & set(name) and not name.isdecimal()


def _field(topic: Topic, name: str, shown: str, time: Floats, values: Floats, tag: str) -> NumericField:
    """A column as a number of a bag; taken as an angle if its name does not state a kind."""
    words = "q" if name.isdecimal() else name
    if torque := _unit_of("torque", name):
        words = "current" if unit("torque", torque).is_current else "torque"
    found = field_of(topic, shown, tag, words, "f8", time, values)
    if not found.kind:
        found = field_of(topic, shown, tag, f"{words} angle", "f8", time, values)
    role = {"angle": "output", "velocity": "input", "current": "torque"}.get(found.kind, found.kind)
    stated = _unit_of(role, name)
    if IN_HEADER.fullmatch(name) and not stated:
        shown = f"{shown}[{found.unit}]"  # the brackets in the name hold no unit
    return replace(found, field=shown, unit=stated or found.unit)


def _tags(header: Sequence[str]) -> list[str]:
    """Numbers in names that distinguish joints; empty if no other name has the same number."""
    numbers = ["" if name.isdecimal() else "".join(re.findall(r"\d+", name)[:1]) for name in header]
    counts = Counter(numbers)
    return [number if counts[number] > 1 else "" for number in numbers]
