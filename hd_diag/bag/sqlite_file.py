"""Storage files of rosbag2 in SQLite (``.db3``): read in order of time, never changed."""

from __future__ import annotations

import itertools
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from hd_diag.bag.block import Block, LongMessage, Topic
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_chunk import AT_ONCE, LARGE
from hd_diag.bag.recorder_clock import RecorderClock
from hd_diag.messages.schemas import MAX_READ, Definition, too_long

# Limits of steps, because a damaged or hostile database can keep a query busy for ever; a regular row takes
# less than 200 steps.
_STEPS_PER_BYTE = 100
_STEPS_PER_TURN = 10_000
_ROWS, _BYTES = 4096, 4 << 20  # rows, and bytes, read at a time
_HEADS = 1 << 16  # rows checked for steps of the clock at a time
_DAMAGE = (sqlite3.Error, TypeError, ValueError, OverflowError)
# SQLite knows the length without reading the data only for a BLOB.
_AS_READ = f"""
    CASE WHEN typeof(data) <> 'blob' THEN x'' WHEN LENGTH(data) <= {MAX_READ} THEN data ELSE LENGTH(data) END
"""
_AS_COPIED = f"""
    CASE typeof(data) WHEN 'blob' THEN CASE WHEN LENGTH(data) <= {LARGE} THEN data END
        WHEN 'text' THEN NULL ELSE x'' END
"""
_COUNT = """
    SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp),
        SUM(typeof(timestamp) <> 'integer' OR timestamp < 0) + (typeof(topic_id) <> 'integer')
    FROM messages GROUP BY 1
"""


def is_sqlite(path: Path) -> bool:
    """Whether a file begins with the magic bytes of SQLite."""
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


class SqliteFile:
    """A ``.db3`` file with the interface of `McapStorage`; read and never changed.

    A crash leaves unfinished writes in a file beside the database, ``-wal`` or ``-journal``. SQLite would
    clean that file up, or refuse to open a file that it may not write. So such a database is read in a copy,
    which `stack` deletes. `problem` has the result of SQLite's integrity check, because damage may hide rows.
    Raises BagError if the file is no database of rosbag2, or so damaged that it cannot be read.
    """

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self._path = path
        beside = [Path(os.path.realpath(path) + end) for end in ("-wal", "-journal")]
        beside = [file for file in beside if file.is_file() and file.stat().st_size]
        self._size = sum(file.stat().st_size for file in (path, *beside))
        with path.open("rb") as file:
            in_wal_mode = file.read(20)[18:] == b"\2\2"
        # Without `immutable`, SQLite in WAL mode makes files beside the database even to read it.
        self._uri = f"{path.absolute().as_uri()}?mode=ro" + ("&immutable=1" if in_wal_mode else "")
        try:
            if beside:
                self._copy(beside, Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hd_diag-"))))
            with closing(self._open()) as db:
                self.topics = _topics(db)
                found = db.execute(_COUNT).fetchall()
                checked = " ".join(str(db.execute("PRAGMA integrity_check(1)").fetchone()[0]).split())
            if any(wrong for *_, wrong in found):
                raise TypeError("a topic or time is not a number")
        except _DAMAGE as exc:
            raise self._error(exc) from exc
        self.problem = "" if checked == "ok" else f"is damaged: {checked}; {self._advice}"
        self.start = min((start for _, _, start, _, _ in found), default=0)
        self.end = max((end for _, _, _, end, _ in found), default=0)
        for number, count, *_ in found:
            if number in self.topics:
                self.topics[number].count = count

    def blocks(self, numbers: Sequence[int] | None) -> Iterator[Block]:
        """Messages of some topics in order of time, or of all (None) in stored order; BagError if damaged.

        If the recorder's clock was set back, messages recorded after that follow those recorded before. With
        None, content above `LARGE` is read on demand, if Python can read it piece by piece (3.11 and later).
        With topics, a message above `MAX_READ` becomes `too_long`, which no decoder takes, and data that are
        not a BLOB become empty.
        """
        which, content, read, order = "true", "CAST(data AS BLOB)", 0, "id"
        if numbers is not None:
            which, order = f"topic_id IN ({','.join(map(str, numbers))})", "timestamp, id"
            content = _AS_READ
        elif hasattr(sqlite3.Connection, "blobopen"):
            content = _AS_COPIED
        query = f"SELECT topic_id, timestamp, {content}, id FROM messages WHERE {which} {{}} ORDER BY {order}"
        try:
            with closing(self._open()) as db:
                parts = [""] if numbers is None else _clock_stretches(db, which)
                cursors = (db.execute(query.format(part)) for part in parts)
                for block in itertools.chain.from_iterable(map(self._some, cursors)):
                    read += int(block.size.sum()) + len(block)
                    if read > self._size:
                        raise TypeError("more data than the file is large")
                    yield block
        except _DAMAGE as exc:
            raise self._error(exc) from exc

    def _some(self, cursor: sqlite3.Cursor) -> Iterator[Block]:
        """Yield the rows of a query as blocks of a few megabytes; a long message has its own block."""
        rows, size = list[tuple[int, int, bytes]](), 0
        for number, time, found, row in cursor:
            content = too_long(found) if isinstance(found, int) else found
            if content is not None:
                rows.append((number, time, content))
                size += len(content)
            if rows and (content is None or len(rows) == _ROWS or size > _BYTES):
                yield _block_of(rows)
                rows, size = [], 0
            if content is None:
                yield self._long_message(number, time, row)
        if rows:
            yield _block_of(rows)

    def _long_message(self, number: int, time: int, row: int) -> Block:
        """A message whose content is read on demand."""

        def read() -> Iterator[bytes]:
            with closing(self._open()) as db, db.blobopen("messages", "data", row, readonly=True) as content:
                while part := content.read(AT_ONCE):
                    yield part

        with closing(self._open()) as db, db.blobopen("messages", "data", row, readonly=True) as content:
            size = len(content)
        head = _block_of([(number, time, b"")])
        return replace(head, size=np.array([size]), long=LongMessage(size, read))

    def _copy(self, beside: Sequence[Path], folder: Path) -> None:
        """Copy the database and the files beside it; again if a writer changed it, at most three times."""
        copy = folder / "copy.db3"
        self._uri = f"{copy.as_uri()}?mode=rw"
        for _ in range(3):
            before = self._path.stat()
            shutil.copyfile(self._path, copy)
            for file in beside:
                shutil.copyfile(file, f"{copy}-{file.name.rpartition('-')[2]}")
            after = self._path.stat()
            if (before.st_mtime_ns, before.st_size) == (after.st_mtime_ns, after.st_size):
                return
        raise BagError(self._path, "is being written by another process")

    def _open(self) -> sqlite3.Connection:
        """Open a connection that writes nothing, with a limit of steps in proportion to the file's size."""
        db = sqlite3.connect(self._uri, uri=True)
        db.text_factory = lambda text: text.decode(errors="replace")
        if hasattr(db, "setlimit"):  # Python 3.11 and later
            db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_READ)  # limits names and definitions too
        db.execute("PRAGMA trusted_schema=OFF")
        db.execute("PRAGMA query_only=ON")
        turns, most = itertools.count(), 1000 + self._size * _STEPS_PER_BYTE // _STEPS_PER_TURN
        db.set_progress_handler(lambda: next(turns) > most, _STEPS_PER_TURN)
        return db

    @property
    def _advice(self) -> str:
        return f"`sqlite3 {self._path.name} .recover | sqlite3 new.db3` saves what can be read"

    def _error(self, exc: Exception) -> BagError:
        """The error as BagError, with advice if the database is damaged."""
        if isinstance(exc, ValueError):
            return exc if isinstance(exc, BagError) else BagError(self._path, exc)
        what = f"SQLite: {exc}" if isinstance(exc, sqlite3.Error) else f"is damaged: {exc}"
        # Subclasses do not mean damage: no right to read, a query that takes too long.
        if not isinstance(exc, sqlite3.Error) or type(exc) is sqlite3.DatabaseError:
            what += f"; {self._advice}"
        return BagError(self._path, what)


def _clock_stretches(db: sqlite3.Connection, which: str) -> list[str]:
    """SQL conditions, in order, that split the rows at each step back of the recorder's clock."""
    clock, found = RecorderClock(), list[int]()
    cursor = db.execute(f"SELECT id, topic_id, timestamp FROM messages WHERE {which} ORDER BY id")
    while rows := cursor.fetchmany(_HEADS):
        number, channel, time = np.array(rows, np.int64).T
        found += number[clock.set_back(channel, time)].tolist()
    # The plus keeps SQLite from using the order of `id`, so that the index of times gives the order.
    begins, ends = [f"AND +id >= {row} " for row in found], [f"AND +id < {row}" for row in found]
    return [begin + end for begin, end in zip(["", *begins], [*ends, ""], strict=True)]


def _topics(db: sqlite3.Connection) -> dict[int, Topic]:
    """Topics by number."""
    # Only plain tables are read, because a view could be an endless query.
    tables = {name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"messages", "topics"} <= tables:
        raise ValueError("is not a rosbag2 database: the tables messages and topics are missing")
    known = {}
    if "message_definitions" in tables:
        columns = "topic_type, encoded_message_definition, encoding, type_description_hash"
        rows = db.execute(f"SELECT {columns} FROM message_definitions")
        known = {str(row[0]): Definition(*map(str, row)) for row in rows if row[1]}
    has_offers = "offered_qos_profiles" in {row[1] for row in db.execute("PRAGMA table_info(topics)")}
    offers = "offered_qos_profiles" if has_offers else "''"
    topics = db.execute(f"SELECT id, name, type, serialization_format, {offers} FROM topics")
    found = {}
    for number, name, kind, form, profiles in topics:
        own, foreign = known.get(kind), "" if form == "cdr" else str(form)
        if foreign:
            own = replace(own or Definition(str(kind), "", ""), messages=foreign)
        found[int(number)] = Topic(str(name), str(kind), 0, own, str(profiles), foreign)
    return found


def _block_of(rows: list[tuple[int, int, bytes]]) -> Block:
    """Block of rows of (topic number, time [ns], content)."""
    channels, times, contents = zip(*rows, strict=True)
    sizes, time = np.array([len(content) for content in contents], np.int64), np.array(times, np.int64)
    data = np.frombuffer(b"".join(contents), np.uint8)
    return Block(data, np.cumsum(sizes) - sizes, sizes, np.array(channels, np.int64), time, time)
