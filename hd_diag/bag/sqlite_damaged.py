"""Storage files of rosbag2 in SQLite (``.db3``), damaged or not: saved row by row."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hd_diag.bag.block import Block
from hd_diag.bag.errors import BagError
from hd_diag.bag.sqlite_database import (
    DAMAGE,
    ROWS,
    Database,
    Topics,
    block_of,
    check_tables,
    read_definitions,
    read_topics,
)
from hd_diag.messages.schemas import Definition

# Content that is collected at most, but for one message [byte].
_BLOCK = 16 << 20
# Places where reading is taken up again behind a damage.
_MOST_PLACES = 20_000
# Values of a wrong kind, as damage makes them, are NULL.
_FROM = """
    SELECT rowid,
        CASE typeof(topic_id) WHEN 'integer' THEN topic_id END,
        CASE typeof(timestamp) WHEN 'integer' THEN timestamp END,
        CASE WHEN typeof(data) IN ('blob', 'text') THEN CAST(data AS BLOB) END
    FROM messages NOT INDEXED WHERE rowid >= ? ORDER BY rowid
"""


class _Row(NamedTuple):
    """A message as it is stored."""

    number: int
    topic: int
    time: int
    data: bytes


class DamagedSqlite:
    """Everything that can be read of a ``.db3`` file, damaged or not, in the order in which it was written.

    Attributes
    ----------
    topics : dict
        As those of `SqliteFile`; those that can be read.
    read : int
        Bytes of the messages given so far.
    lost : int
        Messages that could not be read, as far as their number is known.
    problems : list of str
        What is wrong with the file; complete after the last block.

    Raises
    ------
    BagError
        Where it is no database of rosbag2, or nothing of it can be read.
    """

    def __init__(self, path: Path) -> None:
        self.problems: list[str] = []
        self.topics: Topics = {}
        self.read = self.lost = 0
        self._fit = self._places = self._unfit = 0
        self._numbers = (2**63, -(2**63))
        self._damage, self._open_end = "", False
        self._database = Database(path)
        # One bit for each number that a row may honestly have: it takes 8 bytes at least.
        self._seen = bytearray(self._database.size // 64 + 1)
        try:
            self._db = self._database.open()
            # Lets SQLite read a file that is too short, or with a table that is of no interest damaged.
            self._db.execute("PRAGMA writable_schema=ON")
            check_tables(self._db)
            self._read_topics()
        except BaseException as exc:
            self.close()
            if isinstance(exc, DAMAGE):
                raise BagError(path, f"SQLite: {exc}" if isinstance(exc, sqlite3.Error) else exc) from exc
            raise

    def blocks(self) -> Iterator[Block]:
        """Messages that can be read."""
        rows: list[tuple[int, int, bytes]] = []
        size = 0
        for row in self._fit_rows():
            rows.append(row[1:])
            size += len(row.data)
            if len(rows) == ROWS or size > _BLOCK:
                yield block_of(rows)
                rows, size = [], 0
        if rows:
            yield block_of(rows)
        self._account()

    def close(self) -> None:
        """Close the database and delete the copy that was read."""
        if hasattr(self, "_db"):
            self._db.close()
        self._database.close()

    def _read_topics(self) -> None:
        """Topics without their definitions are better than none."""
        known: dict[str, Definition] = {}
        try:
            known = read_definitions(self._db)
        except DAMAGE as exc:
            self.problems.append(f"message definitions cannot be read: {exc}")
        try:
            self.topics = read_topics(self._db, known)
        except DAMAGE as exc:
            self.problems.append(f"topics cannot be read: {exc}")

    def _fit_rows(self) -> Iterator[_Row]:
        """Rows with a topic, a time and a content, each once."""
        last, strays, unfit = -1, set[int](), set[int]()
        for row in self._all_rows():
            self.read += len(row.data or b"") + 1
            if self.read > self._database.size:
                self.problems.append("holds more data than the file is large: the rest is not read")
                self._open_end = True
                return
            if None in row or row.time < 0:
                unfit.add(hash(row))
                self._unfit = len(unfit)
            elif not self._was_seen(row.number) or not (
                hash(row) in strays or self._first(row.number) == (True, row)
            ):
                self._fit += 1
                yield row
            if row.number != last + 1:
                strays.add(hash(row))
            last = row.number

    def _all_rows(self) -> Iterator[_Row]:
        """Rows by number; behind each damage reading is taken up again. Some come twice."""
        self._position = self._last = -(2**63)
        found: _Row | None = None
        for _ in range(_MOST_PLACES):
            try:
                yield from self._stretch()
                if self._first(self._position) in ((True, None), (True, found)):
                    return
                self._damage = self._damage or "messages are not in order"
            except sqlite3.Error as exc:
                self._damage = str(exc)
            self._places += 1
            self._position = max(self._position, 0)
            found = None if self._damage == "interrupted" else self._resume(self._position)
            if found is None:
                break
            self._position = max(self._behind(found), self._position + 1)
            yield found
        self._open_end = True

    def _stretch(self) -> Iterator[_Row]:
        """Rows from the position on, until one that is not the next: a damaged page can lead past others."""
        for values in self._db.execute(_FROM, (self._position,)):
            row = _Row(*values)
            leaps = row.number > self._position and self._first(self._position) != (True, row)
            self._position = self._position if leaps else self._behind(row)
            yield row
            if leaps:
                return

    def _behind(self, row: _Row) -> int:
        """Where to go on behind a row: its number, if it follows the one before or leads to the row."""
        last, self._last = self._last, row.number
        if row.number < self._position:
            return self._position
        if row.number not in (self._position, last + 1) and self._first(row.number) != (True, row):
            return self._position
        self._numbers = min(row.number, self._numbers[0]), max(row.number, self._numbers[1])
        return row.number + 1

    def _resume(self, position: int) -> _Row | None:
        """First row that can be read from a position on; None where there is none."""
        bad, good = position - 1, position
        readable, row = self._first(good)
        while not readable:
            # Steps that grow by an eighth find whatever is longer than that.
            bad, good = good, good + 1 + (good - position) // 8
            if good >= 2**63:
                return None
            readable, row = self._first(good)
        while good - bad > 1:
            middle = (bad + good) // 2
            readable, found = self._first(middle)
            bad, good, row = (bad, middle, found) if readable else (middle, good, row)
        return row

    def _first(self, position: int) -> tuple[bool, _Row | None]:
        """Whether reading from a position on works, and the row that it gives."""
        try:
            values = self._db.execute(f"{_FROM} LIMIT 1", (position,)).fetchone()
        except sqlite3.Error:
            return False, None
        return True, None if values is None else _Row(*values)

    def _was_seen(self, number: int) -> bool:
        """Whether a number comes again, as where a damaged page leads to a wrong one."""
        place, bit = divmod(number, 8)
        if not 0 <= place < len(self._seen):
            return False
        before = bool(self._seen[place] >> bit & 1)
        self._seen[place] |= 1 << bit
        return before

    def _account(self) -> None:
        """What was lost: an index of times tells how many rows there are, else their numbers do."""
        try:
            (total,) = self._db.execute("SELECT COUNT(*) FROM messages").fetchone()
            self.lost, known = max(total - self._fit, self._unfit), True
        except sqlite3.Error:
            first, last = self._numbers
            self.lost, known = max(last + 1 - first - self._fit, self._unfit), not self._open_end
        if self._damage:
            self.problems.append(f"SQLite: {self._damage}, in {self._places} places")
            self.problems.append("has no checksums: messages that were saved may be damaged as well")
        elif self.lost > self._unfit:
            self.problems.append("holds fewer messages than its index says")
        if not known:
            self.problems.append("how many messages it held is not known")
        if self._unfit:
            self.problems.append(f"{self._unfit} messages have no number as topic or time, or no content")
