"""The text of a table, as spreadsheets, loggers and scopes write it: encoding, header, rows of cells.

Remarks, the names of the columns and a line with their units may precede the rows. Each may be missing, and
all may be repeated if files were appended to each other. Without names, columns are called by their numbers.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import islice
from math import nan
from pathlib import Path
from typing import TextIO

from hd_diag.diagnosis.record import RecordError
from hd_diag.streams.signals import is_unit

WHITE = " "
"""Delimiter that stands for white space of any width between columns."""

_DELIMITERS = (";", "\t", "|", ",", WHITE)  # comma after delimiters with which it may be a decimal comma
_LONGEST_LINE = 1 << 20
_LOOKED_AT = 500  # lines within which the rows must begin
_HEAD = 4096  # first bytes, which decide the encoding
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_REMARK = ("#", "%", "//")
_NAMES = (".csv", ".tsv", ".txt", ".dat", ".asc")
_MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"}
_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d|\d{8})[T ](\d\d):?(\d\d):?(\d\d)?(?:[.,](\d+))?\s*(Z|[+-]\d\d(?::?\d\d)?)?"
)
_OF_DAY = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)")
_MINUTE, _HOUR = 60.0, 3600.0  # [s]


# Bytes that are not UTF-8 come from Windows: degree signs and umlauts in names of columns.
def _of_windows(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("cp1252", "replace"), error.end


codecs.register_error("cp1252", _of_windows)


@dataclass(frozen=True)
class TextTable:
    """Layout of a file.

    `header` has the names of the columns, followed by units, or numbers if the file has no names. `has_rows`
    says whether there is any row, `before` is the number of lines before the first row. `repeated` has the
    cells of lines that name the columns, or their units, if they are repeated.
    """

    path: Path
    encoding: str
    delimiter: str
    header: tuple[str, ...]
    has_rows: bool
    before: int
    repeated: tuple[tuple[str, ...], ...]

    def rows(self) -> Iterator[tuple[int, int, list[str]]]:
        """Yield each row's line number, part number and cells; a repeated header begins a new part."""
        line, part, ended = self.before, 0, False

        def lines() -> Iterator[str]:
            nonlocal line
            with _opened(self.path, self.encoding) as file:
                for text in islice(_lines(file), self.before, None):
                    line += 1
                    yield text

        for cells in _split(lines(), self.delimiter):
            if not any(cells) or cells[0].startswith(_REMARK):
                ended |= bool(cells) and tuple(_bare(cells)) in self.repeated
            elif tuple(cells) in self.repeated:
                ended = True
            elif len(cells) == len(self.header) or quantity(cells[0]) is not None:
                part, ended = part + ended, False
                yield line, part, cells


def is_table(path: Path) -> bool:
    """Whether a file is taken for a table by its name."""
    return path.suffix.lower() in _NAMES


def text_table(path: Path, delimiter: str = "") -> TextTable:
    """Layout of a file, with a given or detected delimiter; RecordError if it is not text."""
    if path.exists() and not path.is_file():
        raise RecordError(f"{path}: is no file but a pipe, a device or a folder: save the table as a file")
    encoding = _encoding(path)
    with _opened(path, encoding) as file:
        looked = list(islice(_lines(file), _LOOKED_AT))
    if not any(line.strip() for line in looked):
        raise RecordError(f"{path}: is empty")
    for each in (delimiter,) if delimiter else _DELIMITERS:
        split = [next(_split(iter([line]), each), []) for line in looked]
        if (first := _first_row(split)) is not None:
            header, repeated = _header(split, first)
            return TextTable(path, encoding, each, header, True, first, repeated)
    first_line = next(line for line in looked if line.strip())
    known = delimiter or max(_DELIMITERS[:-1], key=first_line.count)
    return TextTable(path, encoding, known, tuple(next(_split(iter([first_line]), known))), False, 1, ())


def quantity(text: str) -> float | None:
    """A cell's number, or its time [s]; nan if the cell is empty or marked as missing, else None."""
    text = text.strip()
    if text.lower() in _MISSING:
        return nan
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return seconds(text)


def seconds(text: str) -> float | None:
    """A date with its time (ISO 8601), or a time of the day, in s; None if it is neither."""
    if found := _OF_DAY.fullmatch(text):
        return float(found[1]) * _HOUR + float(found[2]) * _MINUTE + float(found[3].replace(",", "."))
    if not (found := _DATE.fullmatch(text)):
        return None
    day, hour, minute, second, fraction, zone = found.groups()
    try:
        whole = datetime.strptime(day.replace("-", "") + hour + minute + (second or "00"), "%Y%m%d%H%M%S")
    except ValueError:
        return None
    offset = 0.0
    if zone and zone != "Z":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        offset = float(zone[0] + "1") * (int(digits[:2]) * _HOUR + int(digits[2:]) * _MINUTE)
    return whole.replace(tzinfo=timezone.utc).timestamp() + float(f"0.{fraction or 0}") - offset


def _encoding(path: Path) -> str:
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from error
    for mark, encoding in _MARKS.items():
        if head.startswith(mark):
            return encoding
    for begin, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if head[begin::2] and head[begin::2].count(0) > 0.8 * len(head[begin::2]):
            return encoding
    if 0 in head:
        what = "a spreadsheet or an archive" if head.startswith(b"PK") else "no text"
        raise RecordError(f"{path}: is {what}: save the table as CSV; a bag takes no columns")
    return "utf-8"


def _opened(path: Path, encoding: str) -> TextIO:
    errors = "cp1252" if encoding == "utf-8" else "replace"
    return path.open(newline="", encoding=encoding, errors=errors)


def _lines(file: TextIO) -> Iterator[str]:
    """Lines of a file; csv.Error for a line of implausible length."""
    while line := file.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise csv.Error(f"a line is longer than {_LONGEST_LINE} characters")
        yield line


def _split(lines: Iterator[str], delimiter: str) -> Iterator[list[str]]:
    """Cells of lines, without the white space around them."""
    if delimiter == WHITE:
        return (line.split() for line in lines)
    return ([cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter))


def _bare(cells: list[str]) -> list[str]:
    """Cells of a line without the mark of a remark, because a header may follow the mark."""
    first = cells[0].lstrip("#%/").strip() if cells else ""
    return [first, *cells[1:]] if first else cells[1:]


def _first_row(split: list[list[str]]) -> int | None:
    """Index of the first row of numbers; None if the lines are no table with this delimiter."""
    count = [_numbers(cells) for cells in split]
    widths = Counter(
        len(cells) for cells, n in zip(split, count, strict=True) if n > 1 or len(cells) == n > 0
    )
    if not widths:
        return None
    width, lines = max(widths.items(), key=lambda item: (item[1], item[0]))
    wanted = min(n for cells, n in zip(split, count, strict=True) if len(cells) == width and n > 0)
    first = next(i for i, cells in enumerate(split) if len(cells) == width and count[i] >= max(wanted, 1))
    rest = sum(map(any, split[first:]))
    alone = width == 1 and any(len(cell.split()) > 1 for cells in split for cell in cells)
    return None if alone or 2 * lines < rest else first


def _numbers(cells: list[str]) -> int:
    """How many cells hold a number or a time; 0 if a cell holds several, as the delimiter is then wrong."""
    inner = any(len(parts := cell.split()) > 1 and all(map(_is_number, parts)) for cell in cells)
    return 0 if inner else sum(map(_is_number, cells))


def _is_number(cell: str) -> bool:
    return cell != "" and quantity(cell) is not None


def _header(split: list[list[str]], first: int) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Names of the columns, with the units of a line of units, and the lines that give them."""
    width = len(split[first])
    above = [_bare(cells) for cells in split[:first] if any(cells)][-2:]
    named = [cells for cells in above if abs(len(cells) - width) <= 1 and not _numbers(cells)]
    if not named or named[-1] is not above[-1]:
        return tuple(str(k + 1) for k in range(width)), ()
    names = named[-1]
    if len(named) > 1 and all(is_unit(cell.strip("[]()")) or cell.strip("[]() -") == "" for cell in names):
        units = [cell.strip("[]() -") for cell in names]
        names = [f"{name} [{unit}]" if unit else name for name, unit in zip(named[0], units, strict=False)]
    names = [*names, *(str(k + 1) for k in range(len(names), width))]
    return tuple(names), tuple(map(tuple, named if names[: len(named[-1])] != named[-1] else named[-1:]))
