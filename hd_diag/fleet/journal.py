"""Results and pages of joints, saved at once, so that an interrupted run can continue from them."""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Iterable
from pathlib import Path
from zlib import crc32

from hd_diag.fleet import FleetError
from hd_diag.fleet.rows import Row, Task
from hd_diag.whole_file import whole_file

JOURNAL_SUFFIX = ".journal.jsonl"

_PAGE_NAME = re.compile(r"[\w.-]+_[0-9a-f]{16}\.html", re.ASCII)


class Journal:
    """Results by key: one line of JSON with a checksum each, appended and synchronised at once.

    A cut or changed line counts as `lost`, and its result is ignored. `fresh` empties the file first. Only
    one run at a time can open it. Raises FleetError if the file cannot be opened or written, or another run
    has it.
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
        texts = [(line, line[: max(line.rfind(b", "), 0)]) for line in lines]
        entries = [json.loads(line) for line, text in texts if line == text + _checksum(text)]
        self.results: dict[str, Row] = {entry["key"]: entry["row"] for entry in entries}
        self.lost = len(lines) - len(entries)
        self._cut = bool(content) and not content.endswith(b"\n")

    def add(self, key: str, row: Row) -> None:
        """Save a result and synchronise the file."""
        text = json.dumps({"key": key, "row": row}, allow_nan=False).encode()[:-1]
        rest = b"\n" * self._cut + text + _checksum(text) + b"\n"
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
    """End of a line that begins with `text`."""
    return b', "crc32": %d}' % crc32(text)


class BagPages:
    """Pages of single recordings, in the folder ``<name>_joints`` beside the fleet's page ``<name>.html``."""

    def __init__(self, report: Path) -> None:
        self.folder = report.with_name(f"{report.stem}_joints")

    def place(self, task: Task) -> Path:
        """Where a task's page is, or will be; named by joint and key."""
        return self.folder / f"{re.sub(r'[^A-Za-z0-9.-]', '_', task.joint.name)}_{task.key[:16]}.html"

    def link(self, task: Task) -> str | None:
        """Path of a task's page from the fleet's page; None if it has no page."""
        place = self.place(task)
        return f"{self.folder.name}/{place.name}" if place.exists() else None

    def write(self, task: Task, html: str) -> None:
        """Write a page, which is put in place only when complete. FleetError if it cannot be written."""
        place = self.place(task)
        try:
            self.folder.mkdir(exist_ok=True)
            with whole_file(place) as draft:
                draft.write_text(html, encoding="utf-8")
        except OSError as error:
            raise FleetError(f"{place}: cannot be written: {error.strerror or error}") from error

    def keep(self, links: Iterable[str | None]) -> None:
        """Delete the pages in this folder that the fleet's page no longer links to."""
        kept = {Path(link).name for link in links if link}
        for path in self.folder.iterdir() if self.folder.is_dir() else ():
            if _PAGE_NAME.fullmatch(path.name) and path.name not in kept:
                path.unlink(missing_ok=True)
