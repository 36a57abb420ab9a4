"""Storage files of rosbag2 in SQLite (``.db3``), read only: whole ones in order, damaged ones row by row."""

from __future__ import annotations

import itertools
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .block import Block
from .errors import BagError
from .folder import workspace
from .schemas import Definition

_ROWS = 4096
# Content that is collected at most, but for one message [byte].
_BLOCK = 16 << 20
# A damaged or hostile database can keep a query busy for ever; an honest row takes less than 200 steps.
_STEPS_PER_BYTE = 100
_STEPS_PER_TURN = 10_000
# Places where reading is taken up again behind a damage.
_MOST_PLACES = 20_000
_ADVICE = "; hd-diag recover saves what can be read"
_DAMAGE = (sqlite3.Error, TypeError, ValueError, OverflowError)
# Values of a wrong kind, as damage makes them, are NULL.
_FROM = """
    SELECT rowid,
        CASE typeof(topic_id) WHEN 'integer' THEN topic_id END,
        CASE typeof(timestamp) WHEN 'integer' THEN timestamp END,
        CASE WHEN typeof(data) IN ('blob', 'text') THEN CAST(data AS BLOB) END
    FROM messages NOT INDEXED WHERE rowid >= ? ORDER BY rowid
"""

Topics = dict[int, tuple[str, str, str, Definition | None]]


def is_sqlite(path: Path) -> bool:
    """Whether a file begins as SQLite databases do."""
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


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
        self._database = _Database(path)
        try:
            with closing(self._database.open()) as db:
                _check_tables(db)
                self.topics = _topics(db, _definitions(db))
                found = _extent(db)
        except BaseException as exc:
            self.close()
            if isinstance(exc, _DAMAGE):
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
                while rows := cursor.fetchmany(_ROWS):
                    block = _block(rows)
                    read += len(block.data) + len(block)
                    if read > self._database.size:
                        raise ValueError("holds more data than the file is large" + _ADVICE)
                    yield block
        except _DAMAGE as exc:
            raise BagError(self.path, _cause(exc)) from exc

    def close(self) -> None:
        """Delete the copy that was read."""
        self._database.close()


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
        self._database = _Database(path)
        # One bit for each number that a row may honestly have: it takes 8 bytes at least.
        self._seen = bytearray(self._database.size // 64 + 1)
        try:
            self._db = self._database.open()
            # Lets SQLite read a file that is too short, or with a table that is of no interest damaged.
            self._db.execute("PRAGMA writable_schema=ON")
            _check_tables(self._db)
            self._read_topics()
        except BaseException as exc:
            self.close()
            if isinstance(exc, _DAMAGE):
                raise BagError(path, f"SQLite: {exc}" if isinstance(exc, sqlite3.Error) else exc) from exc
            raise

    def blocks(self) -> Iterator[Block]:
        """Messages that can be read."""
        rows: list[tuple[int, int, bytes]] = []
        size = 0
        for row in self._fit_rows():
            rows.append(row[1:])
            size += len(row.data)
            if len(rows) == _ROWS or size > _BLOCK:
                yield _block(rows)
                rows, size = [], 0
        if rows:
            yield _block(rows)
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
            known = _definitions(self._db)
        except _DAMAGE as exc:
            self.problems.append(f"message definitions cannot be read: {exc}")
        try:
            self.topics = _topics(self._db, known)
        except _DAMAGE as exc:
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


class _Database:
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


def _check_tables(db: sqlite3.Connection) -> None:
    """Views could be endless queries: what is read must be plain tables."""
    kinds = dict(db.execute("SELECT name, type FROM sqlite_master WHERE name IN ('messages', 'topics')"))
    if kinds != {"messages": "table", "topics": "table"}:
        raise ValueError("is not a rosbag2 database: the tables messages and topics are missing")


def _extent(db: sqlite3.Connection) -> list[tuple[int, int, int, int]]:
    """Number, count, least and greatest time [ns] of each topic."""
    rows = db.execute(
        "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp), SUM(typeof(timestamp) <> 'integer')"
        " FROM messages GROUP BY 1"
    ).fetchall()
    for number, _, start, _, unfit in rows:
        if unfit or not isinstance(number, int) or start < 0:
            raise ValueError("holds messages whose topic or time is no number" + _ADVICE)
    return [row[:4] for row in rows]


def _topics(db: sqlite3.Connection, definitions: dict[str, Definition]) -> Topics:
    columns = {row[1] for row in db.execute("PRAGMA table_info(topics)")}
    qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
    rows = db.execute(f"SELECT coalesce(id, rowid), name, type, serialization_format, {qos} FROM topics")
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
    """Words for people, with advice where the database is damaged."""
    if isinstance(exc, ValueError):
        return str(exc)
    if isinstance(exc, (TypeError, OverflowError)):
        return f"holds values of a wrong kind{_ADVICE}"
    # Subclasses stand for what is no damage: no right to read, a query that takes too long.
    return f"SQLite: {exc}" + (_ADVICE if type(exc) is sqlite3.DatabaseError else "")
