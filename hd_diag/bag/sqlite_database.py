"""The database of a rosbag2 storage file in SQLite (``.db3``): opened unchanged, its tables read."""

from __future__ import annotations

import itertools
import os
import shutil
import sqlite3
import tempfile
from pathlib import Path

import numpy as np

from hd_diag.bag.block import Block
from hd_diag.bag.errors import BagError
from hd_diag.bag.folder import workspace
from hd_diag.messages.schemas import Definition

# A damaged or hostile database can keep a query busy for ever; an honest row takes less than 200 steps.
_STEPS_PER_BYTE = 100
_STEPS_PER_TURN = 10_000

ROWS = 4096
"""Rows that are read at a time."""

ADVICE = "; hd-diag recover saves what can be read"

DAMAGE = (sqlite3.Error, TypeError, ValueError, OverflowError)
"""What comes of a damaged database."""

Topics = dict[int, tuple[str, str, str, Definition | None]]
"""By number: topic, type, offered QoS profiles as YAML, definition or None."""


def is_sqlite(path: Path) -> bool:
    """Whether a file begins as SQLite databases do."""
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


class Database:
    """A database that is read and never changed.

    What a crash left unfinished stands in a file beside it, ``-wal`` or ``-journal``. SQLite would clear up
    there, and without the right to write would not open it: such a database is read in a temporary copy.

    Attributes
    ----------
    size : int
        Bytes of the database and of what stands beside it.
    """

    def __init__(self, path: Path) -> None:
        real = os.path.realpath(path)
        beside = [Path(f"{real}{end}") for end in ("-wal", "-journal")]
        files = [path, *(p for p in beside if p.is_file() and p.stat().st_size)]
        self.size = sum(p.stat().st_size for p in files)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        # Immutable: in WAL mode SQLite makes files beside the database even to read it.
        self._uri = f"{path.absolute().as_uri()}?mode=ro" + ("&immutable=1" if _is_wal(path) else "")
        if len(files) > 1:
            self._folder = workspace(path, self.size)
            try:
                self._copy(path, files[1:])
            except BaseException:
                self.close()
                raise

    def open(self) -> sqlite3.Connection:
        """A connection that writes nothing and takes no longer than its size allows."""
        db = sqlite3.connect(self._uri, uri=True)
        db.text_factory = lambda text: text.decode(errors="replace")
        db.execute("PRAGMA trusted_schema=OFF")
        db.execute("PRAGMA query_only=ON")
        turns = itertools.count()
        most = 1000 + self.size * _STEPS_PER_BYTE // _STEPS_PER_TURN
        db.set_progress_handler(lambda: next(turns) > most, _STEPS_PER_TURN)
        return db

    def close(self) -> None:
        """Delete the copy that was read."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _copy(self, path: Path, beside: list[Path]) -> None:
        """Files that belong together: a writer may be at work."""
        assert self._folder is not None
        copy = Path(self._folder.name, "copy.db3")
        for _ in range(3):
            before = path.stat()
            shutil.copyfile(path, copy)
            for file in beside:
                shutil.copyfile(file, f"{copy}-{file.name.rpartition('-')[2]}")
            after = path.stat()
            if (before.st_mtime_ns, before.st_size) == (after.st_mtime_ns, after.st_size):
                self._uri = f"{copy.as_uri()}?mode=rw"
                return
        raise BagError(path, "is being written by another process")


def _is_wal(path: Path) -> bool:
    """Whether the database says that its changes go to a file beside it first."""
    with path.open("rb") as file:
        return file.read(20)[18:] == b"\2\2"


def check_tables(db: sqlite3.Connection) -> None:
    """Views could be endless queries: what is read must be plain tables."""
    kinds = dict(db.execute("SELECT name, type FROM sqlite_master WHERE name IN ('messages', 'topics')"))
    if kinds != {"messages": "table", "topics": "table"}:
        raise ValueError("is not a rosbag2 database: the tables messages and topics are missing")


def read_topics(db: sqlite3.Connection, definitions: dict[str, Definition]) -> Topics:
    """Topics with messages in CDR."""
    columns = {row[1] for row in db.execute("PRAGMA table_info(topics)")}
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    rows = db.execute(f"SELECT coalesce(id, rowid), name, type, serialization_format, {qos} FROM topics")
    return {
        int(number): (str(name), str(kind), str(offers), definitions.get(kind))
        for number, name, kind, form, offers in rows
        if form == "cdr"
    }


def read_definitions(db: sqlite3.Connection) -> dict[str, Definition]:
    """Definitions of message types, where the database holds them."""
    kind = db.execute("SELECT type FROM sqlite_master WHERE name = 'message_definitions'").fetchone()
    if kind != ("table",):
        return {}
    rows = db.execute(
        "SELECT topic_type, encoded_message_definition, encoding, type_description_hash"
        " FROM message_definitions"
    )
    return {str(row[0]): Definition(*(str(value) for value in row)) for row in rows if row[1]}


def block_of(rows: list[tuple[int, int, bytes]]) -> Block:
    """Rows of (number of the topic, time [ns], content) as columns."""
    sizes = np.array([len(row[2]) for row in rows], np.int64)
    times = np.array([row[1] for row in rows], np.int64)
    data = np.frombuffer(b"".join(row[2] for row in rows), np.uint8)
    channels = np.array([row[0] for row in rows], np.int64)
    return Block(data, np.cumsum(sizes) - sizes, sizes, channels, times, times)
