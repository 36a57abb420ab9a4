"""Writes bags like rosbag2 (MCAP); a crash at any moment costs less than a second."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Qos

from hd_diag.arrays import Bytes, Times
from hd_diag.bag.block import LongMessage
from hd_diag.bag.errors import BagError, taken
from hd_diag.bag.mcap_file import COMPRESSIONS, McapFile, Stream, Written
from hd_diag.bag.place import Disk, Place
from hd_diag.bag.rosbag2 import dump_yaml, metadata, written
from hd_diag.bag.streams import Streams
from hd_diag.messages.schemas import Definition

_LAST_TIME = 2**63 - 1


class BagWriter(AbstractContextManager["BagWriter"]):
    """Writer of a bag: one MCAP file if `path` ends in ``.mcap``, otherwise a rosbag2 folder.

    Parameters
    ----------
    path : str or path-like
        File or folder to make. Files after the first are ``<stem>_1.mcap`` ... or ``<folder>_1.mcap`` ...
    compression : {'zstd', 'lz4', 'none'}, optional
        Compression of the chunks.
    chunk_size : int, optional
        Uncompressed size at which a chunk is closed [byte].
    flush_period : float, optional
        Age at which a chunk is closed [s]; needs calls of `flush_if_due` when no messages come.
    max_size : int, optional
        Size at which the next file is begun [byte]; 0 for one file. Files exceed it by at most one chunk.
    max_duration : float, optional
        Log time after which the next file is begun [s]; 0 for one file.
    sync_period : float, optional
        Period of syncing written data to the disk itself [s], in calls of `flush_if_due`; 0 for never.
    overwrite : bool, optional
        Replace an existing file, or an existing bag in the folder.

    Attributes
    ----------
    error : BagError or None
        Error that ended the writing.

    Raises
    ------
    BagError
        If the bag cannot be made.

    Notes
    -----
    Not safe for use by several threads at once. A thread compresses and writes chunks, a few behind the
    caller. So errors are raised some calls late, at the latest by `flush`, `flush_if_due` or `close`. After
    an error the file is cut back to whole records, and every further write raises the same error. `close`
    then finishes the file if possible and does not raise; `resume` continues in another file. If somebody
    deletes, moves or truncates the file, the next chunk raises an error. See `Place` for locks and links.
    A ``with`` statement also finishes the file. If an error other than Ctrl-C ends the statement, the file
    is left without its end, so that no reader takes it for whole. Without splits the summary of a log grows
    by about 50 MB a day, in memory too, at four chunks a second.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        compression: str = "zstd",
        chunk_size: int = 1 << 20,
        flush_period: float = 0.25,
        max_size: int = 0,
        max_duration: float = 0.0,
        sync_period: float = 0.0,
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self.error: BagError | None = None
        if compression not in COMPRESSIONS:
            what = f"compression must be one of {', '.join(COMPRESSIONS)}, not {compression!r}"
            raise BagError(self.path, what)
        if not all(n >= 0 for n in (max_size, flush_period, max_duration, sync_period, chunk_size - 1)):
            raise BagError(self.path, "sizes and times must not be negative, and a chunk must have a size")
        self._compression, self._flush_period = compression, flush_period
        self._max_size, self._max_duration = max_size, max_duration
        self._chunk_size, self._overwrite = chunk_size, overwrite
        self._files: list[Written] = []  # the last one belongs to `_file`
        self._taken_away: Counter[int] = Counter()  # messages by channel in deleted files
        self._streams = Streams()
        self._closed = False
        self._place, self._disk = Place(self.path), Disk(sync_period)
        with self._guarded():
            self._place.take(exist_ok=overwrite)
            self._place.clear()
            self._begin(0)

    @property
    def paths(self) -> list[Path]:
        """Files begun so far."""
        return [file.path for file in self._files]

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages written of each topic; after an error only those that have reached a file."""
        counts: Counter[str] = Counter()
        for stream in self._streams.values():
            counts[stream.channel.topic] += self._reached(stream) if self.error else stream.count
        return dict(counts)

    def has_reached(self, size: int, duration: float, log_time: int) -> bool:
        """Whether the open file has a size [byte] or, at a log time [ns], a length [s]; 0 means no limit."""
        return self._file.has_reached(size, duration, log_time)

    def split(self) -> None:
        """Finish the file and continue in the next one; raises BagError if that fails."""
        self._check_open()
        with self._guarded():
            file = self._file
            self.flush()
            self._finish()
            self._begin(self._number + 1)
            file.release()

    def take_away(self, paths: Collection[Path]) -> None:
        """Remove finished files from the metadata; call it before they are deleted."""
        self._check_open()
        gone = [file for file in self._files[:-1] if file.path in paths]
        for file in gone:
            self._taken_away.update(file.statistics.channel_message_counts)
        self._files = [file for file in self._files if file not in gone]
        with self._guarded():
            self._place.save(metadata(self._files, self._streams.values()))

    def add_topic(
        self, topic: str, type_name: str, qos: Qos | str | None = None, known: Definition | None = None
    ) -> None:
        """Declare a topic before its first message; needed only for types that ROS 2 Jazzy does not have.

        `qos` is the offered profile, or the YAML text of another bag's ``offered_qos_profiles``. `known` is
        the type's definition, by default that of ROS 2 Jazzy. A type without a name is written as no schema.

        Raises
        ------
        BagError
            If the type is not known, or the bag is closed or failed.
        """
        self._check_open()
        self._streams.add(self.path, topic, type_name, qos, known)

    def write(
        self,
        topic: str,
        type_name: str,
        data: bytes | memoryview | LongMessage,
        log_time: int,
        publish_time: int | None = None,
        qos: Qos | None = None,
        known: Definition | None = None,
    ) -> None:
        """Append one message: CDR with its 4-byte header, as a raw subscription gives it.

        Times [ns] are 0 or more; the publish time defaults to the log time. A new topic is declared with
        `qos` and `known`, as by `add_topic`.

        Raises
        ------
        BagError
            If the message cannot be written (disk full, closed, unknown type, time out of range).
        """
        stream = self._stream(topic, type_name, qos, known)
        publish = log_time if publish_time is None else publish_time
        if not (0 <= log_time <= _LAST_TIME and 0 <= publish <= _LAST_TIME):
            what = f"{topic}: time {log_time} ns, published {publish} ns, is out of range"
            raise BagError(self.path, what)
        try:  # a context manager would take as long as the write
            self._split_if_due(log_time)
            plain = bytes(data) if isinstance(data, np.ndarray) else data  # a row of an array may have gaps
            self._file.add(stream, log_time, publish, plain)
            self._file.close_old_chunk(time.monotonic(), self._flush_period)
        except (BagError, OSError) as exc:
            raise self._failure(exc) from exc

    def write_some(
        self,
        topic: str,
        type_name: str,
        rows: Sequence[bytes],
        log_times: Sequence[int],
        qos: Qos | None = None,
        known: Definition | None = None,
    ) -> None:
        """Append a few messages of one topic as `write` does, but do their common work once.

        If one of the times is out of range, no message is written.
        """
        stream = self._stream(topic, type_name, qos, known)
        if rows and not 0 <= min(log_times) <= max(log_times) <= _LAST_TIME:
            what = f"{topic}: times from {min(log_times)} to {max(log_times)} ns are out of range"
            raise BagError(self.path, what)
        if self._max_size or self._max_duration:  # each message may begin a file
            for data, log_time in zip(rows, log_times, strict=True):
                self.write(topic, type_name, data, log_time)
            return
        try:
            self._file.add_some(stream, log_times, rows)
            self._file.close_old_chunk(time.monotonic(), self._flush_period)
        except (BagError, OSError) as exc:
            raise self._failure(exc) from exc

    def _stream(self, topic: str, type_name: str, qos: Qos | None, known: Definition | None) -> Stream:
        """The topic's stream, declared if it is new; BagError if the writer is closed or failed."""
        if self.error is not None or self._closed or (topic, type_name) not in self._streams:
            self.add_topic(topic, type_name, qos, known)
        return self._streams[topic, type_name]

    def write_many(
        self,
        topic: str,
        type_name: str,
        rows: Bytes | Sequence[bytes | memoryview],
        log_times: npt.ArrayLike,
        publish_times: npt.ArrayLike | None = None,
    ) -> None:
        """Append n messages of one topic, as `write`; fast for an array of shape (n, size)."""
        stream = self._stream(topic, type_name, None, None)
        times = np.asarray(log_times, np.int64)
        published = times if publish_times is None else np.asarray(publish_times, np.int64)
        every = (times,) if published is times else (times, published)
        if any(t.shape != (len(rows),) or (len(t) and t.min() < 0) for t in every):
            raise BagError(self.path, f"{topic}: times >= 0 are needed for each of {len(rows)} messages")
        if not isinstance(rows, np.ndarray) or rows.size <= rows.shape[1]:  # one message, or without content
            for data, log_time, publish in zip(rows, times.tolist(), published.tolist(), strict=True):
                self.write(topic, type_name, data, log_time, publish)
            return
        done = 0
        with self._guarded():
            while done < len(times):
                self._split_if_due(int(times[done]))
                part = slice(done, self._until_split(times, done))
                done += self._file.add_rows(stream, times[part], published[part], rows[part])
            self._file.close_old_chunk(time.monotonic(), self._flush_period)

    def flush_if_due(self, now: float | None = None) -> bool:
        """Hand messages older than the flush period to the operating system; call it from a timer.

        `now` is ``time.monotonic()`` [s]. Returns whether a chunk was closed. Raises BagError if writing
        fails, but not again for an error that was raised before.
        """
        if self.error is not None or self._closed:
            return False
        now = time.monotonic() if now is None else now
        with self._guarded():
            is_due = self._file.close_old_chunk(now, self._flush_period)
            self._file.wait()
            self._disk.sync_if_due(self._file, now)
        return is_due

    def flush(self) -> None:
        """Hand every message to the operating system now; raises BagError if that fails."""
        self._check_open()
        with self._guarded():
            self._file.close_chunk()
            self._file.wait()

    def resume(self) -> None:
        """Finish the file if possible and continue in a new one; BagError if no new file can be made."""
        before = self._file
        with suppress(BagError):
            if self.error is None:
                self.flush()
            with self._guarded():
                self._finish()
        with self._guarded():
            self._place.take(exist_ok=True)
            self._begin(self._place.free(self._number + 1))
        before.release()
        for stream in self._streams.values():
            stream.count = self._reached(stream)
        self.error = None

    def close(self, *, whole: bool = True) -> None:
        """Finish the bag; if not `whole`, leave it without its end, so that every reader notices.

        Raises BagError if the end cannot be written; messages written before stay recoverable. A second call,
        or a call after an error, does not raise.
        """
        if self._closed:
            return
        failed = self.error is not None
        try:
            if not failed:
                self.flush()
            if whole:
                with self._guarded():
                    self._finish()
                    self._disk.close()
        except BagError:
            if not failed:
                raise
        finally:
            self._closed = True
            self._file.release()
            self._place.release()

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        try:
            self.close(whole=self.error is None and (kind is None or issubclass(kind, KeyboardInterrupt)))
        except BagError:
            if kind is None:
                raise

    def _check_open(self) -> None:
        if self.error is not None:
            raise BagError(self.error.path, self.error.cause)
        if self._closed:
            raise BagError(self.path, "the writer is closed")

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except (BagError, OSError) as exc:
            raise self._failure(exc) from exc

    def _failure(self, exc: BagError | OSError) -> BagError:
        """The error as BagError; stores it, which ends the writing."""
        if not isinstance(exc, BagError):
            path = exc.filename or (self.paths or [self.path])[-1]
            exc = taken(Path(path)) if isinstance(exc, FileExistsError) else BagError(path, exc)
        self.error = self.error or exc
        if not self._files:
            self._place.release()
        return exc

    def _split_if_due(self, log_time: int) -> None:
        """Begin the next file if the open one has reached a limit."""
        if self.has_reached(self._max_size, self._max_duration, log_time):
            self.split()

    def _until_split(self, times: Times, first: int) -> int:
        """Index after the last message, from `first` on, that goes into the open file."""
        if not self._max_duration:
            return len(times)
        start = int(times[first]) if self._file.start is None else self._file.start
        late = np.flatnonzero(times[first:] - start >= int(self._max_duration * 1e9))
        return first + int(late[0]) if len(late) else len(times)

    def _reached(self, stream: Stream) -> int:
        """Number of a topic's messages that have reached a file."""
        return written(self._files, stream) + self._taken_away[stream.channel.id]

    def _begin(self, number: int) -> None:
        """Open a file and list it in the metadata, so that it is found after a crash."""
        size = min(self._chunk_size, self._max_size or self._chunk_size)
        file = McapFile(self._place.name(number), self._compression, size, self._overwrite)
        self._files.append(file.written)
        try:
            self._place.save(metadata(self._files, self._streams.values()))
            self._place.began(file)
        except BaseException:
            self._files.pop()
            file.discard()
            raise
        self._file, self._number = file, number

    def _finish(self) -> None:
        """Write the end of the file after its last message, and the metadata."""
        self._file.stop()
        found = metadata(self._files, self._streams.values())
        if not self._file.is_whole:
            self._file.finish({"serialized_metadata": dump_yaml(found)})
        self._place.save(found)
        self._disk.sync(self._file)
