"""Bags as rosbag2 writes them (MCAP), such that a crash at any moment costs less than a second."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_file import COMPRESSIONS, McapFile
from hd_diag.bag.mcap_storage import is_locked
from hd_diag.bag.rosbag2 import (
    NO_START,
    FileInformation,
    Metadata,
    Qos,
    TopicInformation,
    dump_offers,
    parse_offers,
)
from hd_diag.bag.rows import Rows
from hd_diag.bag.worker import AtOnce, Beside
from hd_diag.messages.schemas import Definition, definition

_T = TypeVar("_T")
# Channel numbers have 16 bits, and begin at 1.
_MAX_TOPICS = 65535
_Buffer = bytes | bytearray | memoryview


@dataclass
class _Topic:
    definition: Definition
    offers: tuple[Qos, ...]
    # Messages in the files before the one that is being written.
    before: int = 0


class BagWriter:
    """Writer of a bag: one MCAP file where `path` ends in ``.mcap``, else a rosbag2 folder.

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
        Size at which the next file is begun [byte]; 0 for one file. It is overshot by one chunk at most.
    max_duration : float, optional
        Log time after which the next file is begun [s]; 0 for one file.
    overwrite : bool, optional
        Replace the file, or the bag in the folder, where there is one.
    custom_data : mapping of str to str, optional
        Kept in the bag's metadata.
    beside : bool, optional
        Compress and write in a thread beside the caller's, a few chunks behind it: errors come a few calls
        late, and what `flush` and `close` did not wait for is not on the disk yet.

    Raises
    ------
    BagError
        Where the bag cannot be made.

    Notes
    -----
    Not safe for use by several threads at once. After an error the file is cut back to whole records, and
    every further write raises the same error; `close` finishes the file if it still can, and does not raise.
    A ``with`` statement finishes it too, unless an error ends it, Ctrl-C excepted: then it is left without
    its end, so that no reader takes it for whole.

    Without splits the summary of a log grows by about 50 MB a day, in memory too, at four chunks a second.
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
        overwrite: bool = False,
        custom_data: Mapping[str, str] | None = None,
        beside: bool = False,
    ) -> None:
        self.path = Path(path)
        self._beside = beside
        self.error: BagError | None = None
        if chunk_size < 1:
            raise BagError(self.path, "a chunk must have a size")
        self._folder = None if self.path.suffix == ".mcap" else self.path
        self._chunk_size = chunk_size
        self.change(
            compression=compression, flush_period=flush_period, max_size=max_size, max_duration=max_duration
        )
        self._overwrite = overwrite
        self._topics: dict[tuple[str, str], _Topic] = {}
        self._metadata = Metadata(custom_data=dict(custom_data or {}))
        self._closed = False
        self._file = self._guard(self._begin)

    @property
    def paths(self) -> list[Path]:
        """Files begun so far."""
        return [self._file_path(i) for i in range(len(self._metadata.files))]

    @property
    def counts(self) -> dict[str, int]:
        """Messages written of each topic."""
        counts: dict[str, int] = {}
        for name, kind in self._topics:
            counts[name] = counts.get(name, 0) + self._count(name, kind)
        return counts

    @property
    def message_count(self) -> int:
        """Messages written."""
        return sum(self.counts.values())

    def change(self, *, compression: str, flush_period: float, max_size: int, max_duration: float) -> None:
        """Go on with other options: periods and sizes act at once, the compression from the next file on.

        Parameters
        ----------
        compression, flush_period, max_size, max_duration
            As for the class.

        Raises
        ------
        BagError
            Where a value cannot be.
        """
        if compression not in COMPRESSIONS:
            raise BagError(
                self.path, f"compression must be one of {', '.join(COMPRESSIONS)}, not {compression!r}"
            )
        if max_size < 0 or not flush_period >= 0 or not max_duration >= 0:
            raise BagError(self.path, "sizes and times must not be negative")
        self._options = (compression, min(self._chunk_size, max_size or self._chunk_size))
        self._flush_period, self._max_size = flush_period, max_size
        self._max_duration = int(max_duration * 1e9)

    def add_topic(
        self,
        topic: str,
        type_name: str,
        qos: Qos | str | None = None,
        message_definition: Definition | None = None,
    ) -> None:
        """Declare a topic before its first message; needed only for types that ROS 2 Jazzy does not have.

        Parameters
        ----------
        topic : str
        type_name : str
            As ``sensor_msgs/msg/JointState``.
        qos : Qos or str, optional
            Offered profile, or the YAML text of another bag's ``offered_qos_profiles``.
        message_definition : Definition, optional
            Definition to carry; by default that of ROS 2 Jazzy.

        Raises
        ------
        BagError
            Where the type is not known, or the file cannot be written.
        """
        self._check_open()
        if (topic, type_name) in self._topics:
            return
        if len(self._topics) >= _MAX_TOPICS:
            raise BagError(self.path, f"{topic}: a bag holds no more than {_MAX_TOPICS} topics")
        if message_definition is None:
            try:
                message_definition = definition(type_name)
            except KeyError as exc:
                raise BagError(
                    self.path, f"type {type_name} of topic {topic} has no known definition"
                ) from exc
        offers = parse_offers(qos) if isinstance(qos, str) else (Qos() if qos is None else qos,)
        self._topics[topic, type_name] = _Topic(message_definition, tuple(offers))

    def write(
        self,
        topic: str,
        type_name: str,
        data: _Buffer,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        qos: Qos | str | None = None,
    ) -> None:
        """Append one message.

        Parameters
        ----------
        topic, type_name : str
            Topic and its type, as ``sensor_msgs/msg/JointState``.
        data : bytes
            CDR with its 4-byte header, as a raw subscription gives it.
        log_time_ns, publish_time_ns : int
            Times [ns], 0 or more; publish time defaults to log time.
        qos : Qos, optional
            Offered profile; matters with the first message of a topic.

        Raises
        ------
        BagError
            Where the message cannot be written (disk full, closed, unknown type, time out of range).
        """
        if (topic, type_name) not in self._topics or self.error is not None or self._closed:
            self.add_topic(topic, type_name, qos)
        publish = log_time_ns if publish_time_ns is None else publish_time_ns
        if not (0 <= log_time_ns <= NO_START and 0 <= publish <= NO_START):
            raise BagError(
                self.path, f"{topic}: time {log_time_ns} ns, published {publish} ns, is out of range"
            )
        self._guard(lambda: self._write(topic, type_name, bytes(data), log_time_ns, publish))

    def write_many(
        self,
        topic: str,
        type_name: str,
        rows: npt.NDArray[np.uint8] | Sequence[_Buffer],
        log_times: npt.NDArray[np.int64] | Sequence[int],
        publish_times: npt.NDArray[np.int64] | Sequence[int] | None = None,
        qos: Qos | str | None = None,
    ) -> None:
        """Append messages of one topic; fast where they have one size.

        Parameters
        ----------
        topic, type_name : str
        rows : ndarray of uint8, shape (n, size), or sequence of bytes
            The messages.
        log_times, publish_times : ndarray of int64, shape (n,)
            Times [ns]; publish times default to log times.
        qos : Qos, optional

        Raises
        ------
        BagError
            As `write`.
        """
        if len(rows) == len(log_times) == 1:
            publish_time = None if publish_times is None else int(publish_times[0])
            self.write(topic, type_name, bytes(rows[0]), int(log_times[0]), publish_time, qos)
            return
        self.add_topic(topic, type_name, qos)
        times = np.asarray(log_times, np.int64)
        published = times if publish_times is None else np.asarray(publish_times, np.int64)
        if any(t.shape != (len(rows),) or (len(t) and t.min() < 0) for t in (times, published)):
            raise BagError(self.path, f"{topic}: times >= 0 are needed for each of {len(rows)} messages")
        self._guard(lambda: self._write_rows(topic, type_name, Rows.of(rows), times, published))

    def flush_if_due(self, now_monotonic: float | None = None) -> bool:
        """Hand messages older than the flush period to the operating system; call it from a timer.

        Parameters
        ----------
        now_monotonic : float, optional
            ``time.monotonic()`` [s].

        Returns
        -------
        bool
            True where something was written.

        Raises
        ------
        BagError
            Where it cannot be written; not again for an error that was raised before.
        """
        if self.error is not None or self._closed:
            return False
        now = time.monotonic() if now_monotonic is None else now_monotonic
        pending = self._file.pending
        due = pending is not None and now - pending >= self._flush_period
        if due:
            self._guard(self._file.close_chunk)
        return due

    def flush(self) -> None:
        """Hand every message to the operating system now.

        Raises
        ------
        BagError
            Where it cannot be written.
        """
        self._check_open()
        self._guard(self._flush)

    def close(self) -> None:
        """Finish the bag. A second call, or one after an error, does nothing that can raise.

        Raises
        ------
        BagError
            Where the end of the bag cannot be written; what was written before stays recoverable.
        """
        if self._closed:
            return
        self._closed = True
        failed = self.error is not None
        if failed:
            self._file.drop_chunk()
        try:
            self._guard(self._finish)
        except BagError:
            if not failed:
                raise
        finally:
            with suppress(OSError):
                self._file.release()

    def abandon(self) -> None:
        """Leave the bag without its end: every reader sees that it is not whole, and it can be recovered."""
        if self._closed:
            return
        with suppress(BagError):
            if self.error is None:
                self._guard(self._flush)
        self._closed = True
        with suppress(OSError):
            self._file.release()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self.error is None and (kind is None or issubclass(kind, KeyboardInterrupt)):
                self.close()
        except BagError:
            if exc is None:
                raise
        finally:
            self.abandon()

    def _count(self, topic: str, type_name: str) -> int:
        return self._topics[topic, type_name].before + self._file.count_of(topic, type_name)

    def _check_open(self) -> None:
        if self.error is not None:
            raise BagError(self.error.path, self.error.cause)
        if self._closed:
            raise BagError(self.path, "the writer is closed")

    def _guard(self, action: Callable[[], _T]) -> _T:
        """Run `action`; its errors become BagError and end the writing."""
        try:
            return action()
        except BagError as exc:
            self.error = self.error or exc
            raise
        except OSError as exc:
            error = BagError(self.paths[-1] if self._metadata.files else self.path, exc)
            self.error = self.error or error
            raise error from exc

    def _write(self, topic: str, type_name: str, data: bytes, log_time: int, publish_time: int) -> None:
        if self._split_due(log_time):
            self._next()
        self._file.add(self._channel(topic, type_name), log_time, publish_time, data)
        pending = self._file.pending
        if pending is not None and time.monotonic() - pending >= self._flush_period:
            self._file.close_chunk()

    def _write_rows(
        self,
        topic: str,
        type_name: str,
        rows: Rows,
        times: npt.NDArray[np.int64],
        published: npt.NDArray[np.int64],
    ) -> None:
        done = 0
        while done < len(times):
            if self._split_due(int(times[done])):
                self._next()
            channel = self._channel(topic, type_name)
            stop = done + self._file.room(rows.part(done, len(times)))
            if self._max_duration:
                start = int(times[done]) if self._file.start is None else self._file.start
                late = np.flatnonzero(times[done:stop] - start >= self._max_duration)
                stop = done + int(late[0]) if len(late) else stop
            self._file.add_rows(channel, times[done:stop], published[done:stop], rows.part(done, stop))
            done = min(stop, len(times))
        self.flush_if_due()

    def _channel(self, topic: str, type_name: str) -> int:
        channel = self._file.channels.get((topic, type_name))
        if channel is None:
            known = self._topics[topic, type_name]
            extra = {
                "offered_qos_profiles": dump_offers(known.offers),
                "topic_type_hash": known.definition.type_hash,
            }
            channel = self._file.add_channel(topic, known.definition, extra)
        return channel

    def _split_due(self, log_time: int) -> bool:
        file = self._file
        if self._max_size:
            file.wait()  # its size decides
        late = self._max_duration and file.start is not None and log_time - file.start >= self._max_duration
        return bool(late) or bool(self._max_size and file.size >= self._max_size and file.count)

    def _file_path(self, number: int) -> Path:
        if self._folder is not None:
            return self._folder / f"{self._folder.resolve().name}_{number}.mcap"
        return self.path if number == 0 else self.path.with_name(f"{self.path.stem}_{number}.mcap")

    def _begin(self) -> McapFile:
        """Open the next file and name it in the metadata, so that a crash leaves it findable."""
        number = len(self._metadata.files)
        if number == 0 and self._folder is not None:
            _prepare(self._folder, self._overwrite)
        path = self._file_path(number)
        try:
            worker = Beside() if self._beside else AtOnce()
            file = McapFile(path, *self._options, overwrite=self._overwrite, worker=worker)
        except FileExistsError as exc:
            raise BagError(path, "exists already") from exc
        except OSError as exc:
            raise BagError(path, exc) from exc
        self._metadata.files.append(FileInformation(path.name))
        try:
            file.add_metadata("rosbag2", {"serialized_metadata": self._metadata.text()})
            self._save()
        except BaseException:
            file.release()
            raise
        return file

    def _flush(self) -> None:
        self._file.close_chunk()
        self._file.wait()

    def _next(self) -> None:
        self._finish()
        self._file.release()
        for (name, kind), topic in self._topics.items():
            topic.before = self._count(name, kind)
        self._file = self._begin()

    def _finish(self) -> None:
        self._flush()
        entry = self._metadata.files[-1]
        entry.start, entry.end = (min(t, NO_START) for t in self._file.times)
        entry.count = self._file.count
        self._metadata.topics = [
            TopicInformation(name, kind, t.offers, t.definition.type_hash, self._count(name, kind))
            for (name, kind), t in self._topics.items()
        ]
        self._file.add_metadata("rosbag2", {"serialized_metadata": self._metadata.text()})
        self._file.finish()
        self._save()

    def _save(self) -> None:
        if self._folder is not None:
            self._metadata.save(self._folder)


@contextmanager
def replaced(path: str | os.PathLike[str], *, overwrite: bool) -> Iterator[Path]:
    """Where to write a bag, so that one that it replaces stays until the new one is whole.

    Parameters
    ----------
    path : str or path-like
        Place of the bag, as for `BagWriter`.
    overwrite : bool
        Whether a bag that is there shall be replaced.

    Yields
    ------
    Path
        `path`, or a place beside the bag that it replaces. After an exception, Ctrl-C included, that bag is
        as it was.

    Raises
    ------
    BagError
        Where the old bag is being written, or cannot be replaced; what the body raises of the new one, with
        its own name.
    """
    place = Path(path)
    if not (overwrite and (place.is_dir() or (place.suffix == ".mcap" and place.is_file()))):
        yield place
        return
    try:
        old = place.resolve()
        _check_free([old] if old.is_file() else _own_files(old))
        with TemporaryDirectory(prefix=f".{old.name}.", dir=old.parent) as folder:
            # The name decides between file and folder, and a folder's names its files.
            draft = Path(folder) / (place.name if old.is_file() else old.name)
            with _named(place, draft):
                yield draft
            _put_in_place(draft, old)
    except OSError as exc:
        raise BagError(place, exc) from exc


@contextmanager
def _named(place: Path, draft: Path) -> Iterator[None]:
    """What goes wrong with a draft, told of the place that it is for."""
    try:
        yield
    except BagError as exc:
        if draft not in (exc.path, *exc.path.parents):
            raise
        raise BagError(place, f"{exc.cause}; what was there before is kept") from exc


def _check_free(files: Iterable[Path]) -> None:
    for path in files:
        with path.open("rb") as file:
            if is_locked(file.fileno()):
                raise BagError(path, "is being written by another process")


def _put_in_place(draft: Path, old: Path) -> None:
    """Move a new bag, where there is one, over the old one; a folder's metadata come last."""
    if draft.is_file():
        os.replace(draft, old)
    elif draft.is_dir():
        new = sorted(draft.iterdir(), key=lambda file: file.name == "metadata.yaml")
        for file in new:
            os.replace(file, old / file.name)
        for file in _own_files(old):
            if file.name not in {entry.name for entry in new}:
                file.unlink()


def _prepare(folder: Path, overwrite: bool) -> None:
    """Make the folder; with `overwrite` remove the bag that is in it, and nothing else."""
    if folder.exists() and not overwrite:
        raise BagError(folder, "exists already")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for entry in _own_files(folder):
            entry.unlink()
    except OSError as exc:
        raise BagError(folder, exc) from exc


def _own_files(folder: Path) -> list[Path]:
    """Files of the bag in a folder, and nothing else that lies there."""
    own = re.compile(re.escape(folder.resolve().name) + r"_\d+\.(mcap|db3)|metadata\.yaml")
    return [entry for entry in folder.iterdir() if own.fullmatch(entry.name)]
