"""Reading bags: MCAP files and rosbag2 folders (MCAP or SQLite), finished or not, as batches of messages."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.bag.block import Block, gather
from hd_diag.bag.errors import BagError
from hd_diag.bag.folder import Unpacked, find_files, unpacked
from hd_diag.bag.mcap_storage import McapStorage
from hd_diag.bag.ordering import chosen, mixed_runs, ordered, runs, turns
from hd_diag.bag.sqlite_database import is_sqlite
from hd_diag.bag.sqlite_file import SqliteFile
from hd_diag.bag.typestore import BagTypes
from hd_diag.messages.joint_states import Rejection, decode_joint_states, joint_states_from_messages
from hd_diag.messages.schemas import Definition
from hd_diag.streams.columns import JointStates

Payload = npt.NDArray[np.uint8] | list[memoryview]
JOINT_STATE = "sensor_msgs/msg/JointState"


@dataclass
class Topic:
    """A topic of a bag.

    Attributes
    ----------
    name, type_name : str
        As ``/joint_states`` and ``sensor_msgs/msg/JointState``.
    count : int
        Messages.
    definition : Definition or None
        The type as the bag defines it.
    offers : str
        Offered QoS profiles, YAML.
    """

    name: str
    type_name: str
    count: int = 0
    definition: Definition | None = None
    offers: str = ""


@dataclass(frozen=True)
class Batch:
    """Messages of one topic.

    Attributes
    ----------
    topic : Topic
    log_time, publish_time : ndarray of int64, shape (n,)
        Times [ns]; log times do not decrease.
    payload : ndarray of uint8, shape (n, size), or list of memoryview
        CDR with its 4-byte header; an array where all messages have one size.
    """

    topic: Topic
    log_time: npt.NDArray[np.int64]
    publish_time: npt.NDArray[np.int64]
    payload: Payload

    def __len__(self) -> int:
        return len(self.log_time)

    def messages(self) -> Iterator[memoryview]:
        """The messages one by one, each contiguous."""
        for row in self.payload:
            yield row if isinstance(row, memoryview) else memoryview(np.ascontiguousarray(row))


class Mixed(NamedTuple):
    """Consecutive messages: log times [ns] (n,); each topic's batch with the positions of its messages."""

    log_time: npt.NDArray[np.int64]
    batches: list[tuple[npt.NDArray[np.int64], Batch]]


@dataclass
class _Source:
    """One storage file with the topics of its channel numbers."""

    path: Path
    storage: Any
    topics: dict[int, Topic] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)


class BagReader:
    """Reader of a bag: an MCAP file, a ``.db3`` file or a rosbag2 folder, or one that rosbag2 compressed.

    Use it in a ``with`` statement: databases with unfinished writes and compressed files are read in a
    temporary folder, which `close` deletes.

    Parameters
    ----------
    path : str or path-like
        The bag.

    Attributes
    ----------
    topics : list of Topic
    start, end : int
        Least and greatest log time [ns]; 0 and 0 for an empty bag.
    problems : list of str
        One line for each file that is not finished: it was cut off, is damaged, or is still being written.
        What precedes the damage is read. Empty for a whole bag.
    paths : list of Path
        Storage files in order.
    custom_data : dict
        From the metadata.

    Raises
    ------
    BagError
        Where it is not a bag, or is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._topics: dict[tuple[str, str], Topic] = {}
        self._types = BagTypes()
        self._sources: list[_Source] = []
        self._unpacked = Unpacked()
        try:
            found = find_files(self.path)
            self.paths, self.problems = found.paths, found.problems
            self.custom_data = found.custom_data
            self._message_compression = found.message_compression
            self._unpacked = Unpacked(self.paths)
            for file in self.paths:
                self._add(file)
        except OSError as exc:
            self.close()
            raise BagError(getattr(exc, "filename", None) or self.path, exc) from exc
        except BaseException:
            self.close()
            raise
        ranges = [r for r in map(_time_range, self._sources) if r is not None]
        self.start = min((r[0] for r in ranges), default=0)
        self.end = max((r[1] for r in ranges), default=0)

    @property
    def topics(self) -> list[Topic]:
        """Topics in the order of their first appearance."""
        return list(self._topics.values())

    @property
    def message_count(self) -> int:
        """Messages of all topics."""
        return sum(t.count for t in self.topics)

    @property
    def duration(self) -> float:
        """Time between the first and the last message [s]."""
        return (self.end - self.start) * 1e-9

    @property
    def unfinished(self) -> bool:
        """Whether a file of the bag is cut off, damaged near its end, or still being written."""
        return bool(self.problems)

    def batches(
        self,
        topics: Iterable[str] | None = None,
        *,
        start: int | None = None,
        end: int | None = None,
        grouped: bool = False,
    ) -> Iterator[Batch]:
        """Messages in the order of log time; those of equal time in the order of the file; files in sequence.

        Parameters
        ----------
        topics : iterable of str, optional
            Names of topics; all by default.
        start, end : int, optional
            From this log time until before that [ns].
        grouped : bool, optional
            Give long batches: order is kept within each topic, but topics that alternate are taken apart over
            stretches of a few megabytes. By default a batch ends where the topic changes.

        Raises
        ------
        BagError
            Where a chunk is damaged or cannot be sorted.
        """
        for source, numbers in self._numbers(topics):
            for block in self._blocks(source, numbers, start, end):
                for part in runs(block, grouped=grouped):
                    yield self._batch(source, part)

    def mixed(self, topics: Iterable[str], together: Callable[[Topic], bool]) -> Iterator[Mixed]:
        """Messages in the order of log time, long runs of them: some topics are not taken apart.

        Parameters
        ----------
        topics : iterable of str
            Names of topics.
        together : callable
            Says of a topic whether it may alternate with others of its kind within a run.

        Raises
        ------
        BagError
            As `batches`.
        """
        for source, numbers in self._numbers(topics):
            alternating = {n for n in numbers if together(source.topics[n])}
            for block in self._blocks(source, numbers, None, None):
                for part in mixed_runs(block, alternating):
                    channels = np.unique(part.channel)
                    rows = [np.flatnonzero(part.channel == channel) for channel in channels]
                    batches = [self._batch(source, part[at] if len(rows) > 1 else part) for at in rows]
                    yield Mixed(part.log_time, list(zip(rows, batches, strict=True)))

    def deserialize(self, batch: Batch) -> tuple[list[tuple[int, Any]], list[Rejection]]:
        """Message objects of a batch of any type, with their positions, and what could not be decoded.

        Raises
        ------
        BagError
            Where the type is not known.
        """
        store = self._store(batch.topic)
        messages, rejected = [], []
        for index, data in enumerate(batch.messages()):
            try:
                messages.append((index, store.deserialize_cdr(data, batch.topic.type_name)))
            except Exception as exc:  # rosbags raises several kinds on hostile data
                rejected.append(Rejection(index, f"cannot be decoded: {exc}"))
        return messages, rejected

    def joint_states(self, batch: Batch) -> tuple[list[JointStates], list[Rejection]]:
        """Columns of a batch of JointState, as `columns.decode_joint_states`.

        Raises
        ------
        BagError
            Where the bag defines the type in a way that cannot be used.
        """
        if batch.topic.type_name != JOINT_STATE:
            raise BagError(
                self.path, f"{batch.topic.name} has type {batch.topic.type_name}, not {JOINT_STATE}"
            )
        if self.is_standard(batch.topic):
            return decode_joint_states(batch.payload)
        messages, rejected = self.deserialize(batch)
        columns, more = joint_states_from_messages(messages)
        return columns, sorted(rejected + more)

    def is_standard(self, topic: Topic) -> bool:
        """Whether the bag means the same by a topic's type as ROS 2 Jazzy does.

        Raises
        ------
        BagError
            Where the type is not known.
        """
        try:
            return self._types.is_standard(topic.type_name, topic.definition)
        except ValueError as exc:
            raise BagError(self.path, f"{topic.name}: {exc}") from exc

    def close(self) -> None:
        """Close the files."""
        for source in self._sources:
            source.storage.close()
        self._sources = []
        self._unpacked.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _numbers(self, topics: Iterable[str] | None) -> Iterator[tuple[_Source, list[int]]]:
        """Files with the channel numbers that some topics, or all, have in them; those that have none not."""
        names = None if topics is None else set(topics)
        for source in self._sources:
            numbers = [n for n, t in source.topics.items() if names is None or t.name in names]
            if numbers:
                yield source, numbers

    def _store(self, topic: Topic) -> Any:
        try:
            return self._types.store(topic.type_name, topic.definition)
        except ValueError as exc:
            raise BagError(self.path, f"{topic.name}: {exc}") from exc

    def _add(self, path: Path) -> None:
        """Open a storage file; a database cannot be read up to a damage, so that it costs one of several."""
        try:
            self._sources.append(self._open(path))
        except BagError as exc:
            damaged = BagError(path, exc.cause)
            if ".db3" not in path.suffixes or (path == self.paths[-1] and not self._sources):
                raise damaged from exc
            self.problems.append(BagError(path.name, f"is left out: {exc.cause}").args[0])

    def _open(self, path: Path) -> _Source:
        file, broken = self._unpacked.file(path)
        storage = SqliteFile(file) if is_sqlite(file) else McapStorage(file)
        for problem in filter(None, (broken, storage.problem)):
            self.problems.append(BagError(path.name, problem).args[0])
        if isinstance(storage, McapStorage):
            self.custom_data = storage.custom_data | self.custom_data
        source = _Source(path, storage, counts=storage.counts)
        for number, (name, kind, offers, known) in storage.topics.items():
            topic = self._topics.setdefault((name, kind), Topic(name, kind, 0, known, offers))
            topic.count += storage.counts.get(number, 0)
            source.topics[number] = topic
        return source

    def _blocks(
        self, source: _Source, numbers: list[int], start: int | None, end: int | None
    ) -> Iterator[Block]:
        storage = source.storage
        if isinstance(storage, SqliteFile):
            try:
                yield from storage.blocks(numbers, start, end)
            except BagError as exc:
                raise BagError(source.path, exc.cause) from exc
            return
        wanted = None if len(numbers) == len(source.topics) else numbers
        stretches = storage.stretches(numbers, start, end)
        try:
            with storage.loading([stretches[number] for number in turns(stretches)]) as load:
                for block in ordered(stretches, lambda stretch: chosen(load(stretch), wanted, start, end)):
                    unknown = set(np.unique(block.channel).tolist()) - source.topics.keys()
                    if unknown:
                        raise ValueError(f"messages of channel {min(unknown)}, which is not declared")
                    yield block
        except BagError as exc:
            raise BagError(source.path, exc.cause) from exc
        except ValueError as exc:
            raise BagError(source.path, exc) from exc

    def _batch(self, source: _Source, part: Block) -> Batch:
        topic = source.topics[int(part.channel[0])]
        payload = payload_of(part)
        if self._message_compression:
            payload = unpacked(source.path, payload)
        return Batch(topic, part.log_time, part.publish_time, payload)


def payload_of(part: Block) -> Payload:
    """Contents of messages: an array where they have one size."""
    sizes = part.size
    if (sizes == sizes[0]).all():
        return gather(part.data, part.offset, int(sizes[0]))
    view = memoryview(part.data)
    return [view[o : o + s] for o, s in zip(part.offset.tolist(), sizes.tolist(), strict=True)]


def _time_range(source: _Source) -> tuple[int, int] | None:
    storage = source.storage
    if isinstance(storage, SqliteFile):
        return (storage.start, storage.end) if storage.counts else None
    full = [s for s in storage.scan.sections if s.counts is None or sum(s.counts.values())]
    return (min(s.start for s in full), max(s.end for s in full)) if full else None
