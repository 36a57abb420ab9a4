"""Results on disk as they come: what a crash or Ctrl-C interrupts is gone on with by the next run."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path

from hd_diag.fleet import FleetError
from hd_diag.fleet.rows import Row

JOURNAL_SUFFIX = ".journal.jsonl"


class Journal:
    """Results by their keys, one line of JSON each, appended and synchronised as they come.

    A line that a crash cut off is left out when the journal is read; a fresh one forgets what it holds. Only
    one run at a time can have it. Raises FleetError where it cannot be read or written, or another run has
    it.
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

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *reason: object) -> None:
        self._file.close()


def _entry(line: bytes) -> tuple[str, Row] | None:
    try:
        entry = json.loads(line)
        key, row = entry["key"], entry["row"]
    except (ValueError, KeyError, TypeError):
        return None
    return (key, row) if isinstance(key, str) and isinstance(row, dict) else None
