"""Results on disk: a journal that keeps each as it comes, and the table, written as a whole or not at all."""

from __future__ import annotations

import fcntl
import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hd_diag.fleet.errors import FleetError
from hd_diag.fleet.rows import COLUMNS, SCHEMA, Row

JOURNAL_SUFFIX = ".journal.jsonl"


class Journal:
    """Results by their keys, one line of JSON each, appended and synchronised as they come.

    A line that a crash cut off is left out when the journal is read. Only one run at a time can have it.

    Parameters
    ----------
    path : Path
    fresh : bool
        Forget what it holds.

    Attributes
    ----------
    results : dict
        Rows by key.

    Raises
    ------
    FleetError
        Where it cannot be read or written, or another run has it.
    """

    def __init__(self, path: Path, fresh: bool = False) -> None:
        self.path = path
        try:
            self._file = path.open("a+b")
        except OSError as error:
            raise FleetError(f"{path}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise FleetError(f"{path}: another run is writing it") from error
        if fresh:
            self._file.truncate(0)
        self._file.seek(0)
        content = self._file.read()
        self.results = dict(filter(None, map(_entry, content.splitlines())))
        self._cut = bool(content) and not content.endswith(b"\n")

    def add(self, key: str, row: Row) -> None:
        """Keep a result for good."""
        line = json.dumps({"key": key, "row": row}, allow_nan=False).encode() + b"\n"
        try:
            self._file.write(b"\n" * self._cut + line)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise FleetError(f"{self.path}: cannot be written: {error.strerror}") from error
        self._cut = False
        self.results[key] = row

    def close(self) -> None:
        """Let another run have it."""
        self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()


def _entry(line: bytes) -> tuple[str, Row] | None:
    try:
        entry = json.loads(line)
        key, row = entry["key"], entry["row"]
    except (ValueError, KeyError, TypeError):
        return None
    return (key, row) if isinstance(key, str) and isinstance(row, dict) else None


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows as Parquet; what was there before stays until the new file is complete.

    Parameters
    ----------
    path : Path
    rows : sequence of dict

    Raises
    ------
    FleetError
        Where it cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pylist([_storable(row) for row in rows], schema=arrow_schema())
    try:
        handle, partial = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                pq.write_table(table, file, compression="zstd")
                file.flush()
                os.fsync(file.fileno())
            os.chmod(partial, 0o666 & ~_umask())
            os.replace(partial, path)
        except BaseException:
            os.unlink(partial)
            raise
    except OSError as error:
        raise FleetError(f"{path}: cannot be written: {error.strerror or error}") from error


def arrow_schema() -> Any:
    """Schema of the table, every column with unit and meaning in its metadata."""
    import pyarrow as pa

    strings = pa.list_(pa.string())
    kinds = {
        "string": pa.string(),
        "double": pa.float64(),
        "int64": pa.int64(),
        "bool": pa.bool_(),
        "time": pa.timestamp("us", tz="UTC"),
        "strings": strings,
        "doubles": pa.list_(pa.float64()),
        "stringss": pa.list_(strings),
    }
    fields = [pa.field(c.name, kinds[c.kind], metadata={"unit": c.unit, "about": c.about}) for c in COLUMNS]
    return pa.schema(fields, metadata={"schema": SCHEMA})


def _storable(row: Row) -> Row:
    start = row.get("start")
    stored = {name: readable(value) for name, value in row.items()}
    return {**stored, "start": None if start is None else start // 1000}


def readable(value: Any) -> Any:
    r"""A value whose texts are Unicode: bytes of a file name that are none become ``\udcXX``."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    return [readable(item) for item in value] if isinstance(value, list) else value


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
