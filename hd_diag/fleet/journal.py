"""Results on disk as they come: what a crash or Ctrl-C interrupts is gone on with by the next run."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path
from zlib import crc32

from hd_diag.fleet import FleetError
from hd_diag.fleet.rows import Row

JOURNAL_SUFFIX = ".journal.jsonl"


class Journal:
    """Results by their keys, one line of JSON each with a checksum, appended and synchronised as they come.

    A line that is cut off or has changed counts as `lost`: its result is not there. A fresh journal forgets
    what it holds. Only one run at a time can have it. Raises FleetError where it cannot be read or written,
    or another run has it.
    """

    def __init__(self, path: Path, fresh: bool = False) -> None:
        self.path = path
        try:
            self._file = path.open("a+b", buffering=0)
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
        lines = [line for line in content.split(b"\n") if line]
        entries = [entry for entry in map(_entry, lines) if entry]
        self.results, self.lost = dict(entries), len(lines) - len(entries)
        self._cut = bool(content) and not content.endswith(b"\n")

    def add(self, key: str, row: Row) -> None:
        """Keep a result for good."""
        text = json.dumps({"key": key, "row": row}, allow_nan=False).encode()
        rest = b"\n" * self._cut + text[:-1] + _checksum(text[:-1]) + b"\n"
        self._cut = True
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
            os.fsync(self._file.fileno())
        except OSError as error:
            raise FleetError(f"{self.path}: cannot be written: {error.strerror}") from error
        self._cut = False
        self.results[key] = row

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *reason: object) -> None:
        self._file.close()


def _checksum(text: bytes) -> bytes:
    """The end of a line whose beginning this is."""
    return b', "crc32": %d}' % crc32(text)


def _entry(line: bytes) -> tuple[str, Row] | None:
    """Key and row of a line that is as it was written."""
    text = line[: max(line.rfind(b", "), 0)]
    if line != text + _checksum(text):
        return None
    entry = json.loads(line)
    return entry["key"], entry["row"]
