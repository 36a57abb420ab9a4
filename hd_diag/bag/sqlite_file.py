"""Storage files of rosbag2 in SQLite (``.db3``), read only."""

from __future__ import annotations

import itertools
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from .block import Block
from .errors import BagError
from .schemas import Definition

_ROWS = 4096
# A damaged or hostile database can keep a query busy for ever; an honest row takes less than 200 steps.
_STEPS_PER_BYTE = 100
_STEPS_PER_TURN = 10_000


def is_sqlite(path: Path) -> bool:
    """Whether a file begins as SQLite databases do."""
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


class SqliteFile:
    """A ``.db3`` file.

    Attributes
    ----------
    topics : dict
        Number: (topic, type, offered QoS profiles as YAML, definition or None).
    counts : dict
        Messages of each topic number.
    start, end : int
        Least and greatest time [ns]; 0 for an empty file.
    problem : str
        Empty: a database is whole or cannot be opened.
    """

    problem = ""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = path.stat().st_size
        try:
            with closing(self._open()) as db:
                self._check_tables(db)
                self.topics = _topics(db)
                rows = db.execute(
                    "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY 1"
                )
                found = [(int(a), int(b), int(c), int(d)) for a, b, c, d in rows]
        except (sqlite3.Error, UnicodeDecodeError, TypeError, ValueError, OverflowError) as exc:
            raise BagError(path, _cause(exc)) from exc
        self.counts = {number: count for number, count, _, _ in found}
        self.start = min((row[2] for row in found), default=0)
        self.end = max((row[3] for row in found), default=0)

    def blocks(self, numbers: list[int], start: int | None = None, end: int | None = None) -> Iterator[Block]:
        """Messages of some topics in the order of time [ns].

        Raises
        ------
        BagError
            Where the database is damaged.
        """
        marks = ",".join("?" * len(numbers))
        query = (
            f"SELECT topic_id, timestamp, CAST(data AS BLOB) FROM messages WHERE topic_id IN ({marks}) "
            "AND timestamp >= ? AND timestamp < ? ORDER BY timestamp, id"
        )
        low, high = start if start is not None else 0, end if end is not None else 2**63 - 1
        read = 0
        try:
            with closing(self._open()) as db:
                cursor = db.execute(query, (*numbers, low, high))
                while rows := cursor.fetchmany(_ROWS):
                    block = _block(rows)
                    read += len(block.data) + len(block)
                    if read > self.size:
                        raise ValueError("holds more data than the file is large")
                    yield block
        except (sqlite3.Error, TypeError, ValueError, OverflowError) as exc:
            raise BagError(self.path, _cause(exc)) from exc

    def _open(self) -> sqlite3.Connection:
        db = sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True)
        db.execute("PRAGMA trusted_schema=OFF")
        db.execute("PRAGMA query_only=ON")
        turns = itertools.count()
        most = 1000 + self.size * _STEPS_PER_BYTE // _STEPS_PER_TURN
        db.set_progress_handler(lambda: next(turns) > most, _STEPS_PER_TURN)
        return db

    def _check_tables(self, db: sqlite3.Connection) -> None:
        """Views could be endless queries: what is read must be plain tables."""
        kinds = dict(db.execute("SELECT name, type FROM sqlite_master WHERE name IN ('messages', 'topics')"))
        if kinds != {"messages": "table", "topics": "table"}:
            raise ValueError("is not a rosbag2 database: the tables messages and topics are missing")


def _topics(db: sqlite3.Connection) -> dict[int, tuple[str, str, str, Definition | None]]:
    columns = {row[1] for row in db.execute("PRAGMA table_info(topics)")}
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    rows = db.execute(f"SELECT id, name, type, serialization_format, {qos} FROM topics").fetchall()
    definitions = _definitions(db)
    return {
        int(number): (str(name), str(kind), str(offers), definitions.get(kind))
        for number, name, kind, form, offers in rows
        if form == "cdr"
    }


def _definitions(db: sqlite3.Connection) -> dict[str, Definition]:
    kind = db.execute("SELECT type FROM sqlite_master WHERE name = 'message_definitions'").fetchone()
    if kind != ("table",):
        return {}
    rows = db.execute(
        "SELECT topic_type, encoded_message_definition, encoding, type_description_hash"
        " FROM message_definitions"
    )
    return {str(row[0]): Definition(*(str(value) for value in row)) for row in rows if row[1]}


def _block(rows: list[tuple[int, int, bytes]]) -> Block:
    sizes = np.array([len(row[2]) for row in rows], np.int64)
    times = np.array([row[1] for row in rows], np.int64)
    data = np.frombuffer(b"".join(row[2] for row in rows), np.uint8)
    channels = np.array([row[0] for row in rows], np.int64)
    return Block(data, np.cumsum(sizes) - sizes, sizes, channels, times, times)


def _cause(exc: Exception) -> str:
    return str(exc) if isinstance(exc, ValueError) else f"SQLite: {exc}"
