"""Storage files of rosbag2 in SQLite (``.db3``) that are whole, read only, in the order of time."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from hd_diag.bag.block import Block
from hd_diag.bag.errors import BagError
from hd_diag.bag.sqlite_database import (
    ADVICE,
    DAMAGE,
    ROWS,
    Database,
    block_of,
    check_tables,
    read_definitions,
    read_topics,
)


class SqliteFile:
    """A ``.db3`` file that is whole.

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
        self._database = Database(path)
        try:
            with closing(self._database.open()) as db:
                check_tables(db)
                self.topics = read_topics(db, read_definitions(db))
                found = _extent(db)
        except BaseException as exc:
            self.close()
            if isinstance(exc, DAMAGE):
                raise BagError(path, _cause(exc)) from exc
            raise
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
            with closing(self._database.open()) as db:
                cursor = db.execute(query, (*numbers, low, high))
                while rows := cursor.fetchmany(ROWS):
                    block = block_of(rows)
                    read += len(block.data) + len(block)
                    if read > self._database.size:
                        raise ValueError("holds more data than the file is large" + ADVICE)
                    yield block
        except DAMAGE as exc:
            raise BagError(self.path, _cause(exc)) from exc

    def close(self) -> None:
        """Delete the copy that was read."""
        self._database.close()


def _extent(db: sqlite3.Connection) -> list[tuple[int, int, int, int]]:
    """Number, count, least and greatest time [ns] of each topic."""
    rows = db.execute(
        "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp), SUM(typeof(timestamp) <> 'integer')"
        " FROM messages GROUP BY 1"
    ).fetchall()
    for number, _, start, _, unfit in rows:
        if unfit or not isinstance(number, int) or start < 0:
            raise ValueError("holds messages whose topic or time is no number" + ADVICE)
    return [row[:4] for row in rows]


def _cause(exc: Exception) -> str:
    """Words for people, with advice where the database is damaged."""
    if isinstance(exc, ValueError):
        return str(exc)
    if isinstance(exc, (TypeError, OverflowError)):
        return f"holds values of a wrong kind{ADVICE}"
    # Subclasses stand for what is no damage: no right to read, a query that takes too long.
    return f"SQLite: {exc}" + (ADVICE if type(exc) is sqlite3.DatabaseError else "")
