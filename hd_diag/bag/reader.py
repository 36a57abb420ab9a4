"""Reading bags: MCAP files and rosbag2 folders (MCAP or SQLite), finished or not, as batches of messages."""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys.store import Typestore

from hd_diag.arrays import Integers, Times
from hd_diag.bag.block import Block, Payload, Topic
from hd_diag.bag.errors import BagError
from hd_diag.bag.folder import find_files, natural, unpack, unpacked
from hd_diag.bag.mcap_storage import McapStorage
from hd_diag.bag.recorder_clock import SET_BACK
from hd_diag.bag.sqlite_file import SqliteFile, is_sqlite
from hd_diag.bag.typestore import standard_joint_state, store_of
from hd_diag.messages.joint_states import JOINT_STATE, Rejection, decode_joint_states
from hd_diag.messages.schemas import deserialize, jazzy
from hd_diag.streams.columns import JointStates

_AT_ONCE = 1 << 14  # messages in a batch


@dataclass(frozen=True)
class Batch:
    """n messages of one topic: times [ns] (n,), sorted by log time, and CDR with its 4-byte header.

    The payload is an array of uint8, shape (n, size), if all messages have one size, otherwise a list.
    """

    topic: Topic
    log_time: Times
    publish_time: Times
    payload: Payload

    def __len__(self) -> int:
        return len(self.log_time)

    def messages(self) -> Iterator[memoryview]:
        """The messages one by one, each contiguous."""
        for row in self.payload:
            yield row if isinstance(row, memoryview) else memoryview(np.ascontiguousarray(row))


class Mixed(NamedTuple):
    """n consecutive messages: log times [ns] (n,); per topic the positions of its messages, and a batch."""

    log_time: Times
    batches: list[tuple[Integers, Batch]]


class BagReader(AbstractContextManager["BagReader"]):
    """Reader of a bag: an MCAP file, a ``.db3`` file or a rosbag2 folder, compressed by rosbag2 or not.

    Use it in a ``with`` statement: databases with unfinished writes and compressed files are read in a
    temporary folder, which `close` deletes. If a bag defines JointState differently from ROS 2 Jazzy, its
    JointState messages are converted to Jazzy's.

    Attributes
    ----------
    start, end : int
        Least and greatest log time [ns]; 0 and 0 for an empty bag.
    problems : list of str
        One line for each file that is not finished: it was cut off, is damaged, or is still being written.
        Messages before the damage are read. One line for each topic whose number of messages differs from
        the metadata's count or, after reading, from a file's count. Empty for a whole bag.
    paths : list of Path
        Storage files in order.

    Raises
    ------
    BagError
        If it is not a bag, or is damaged.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._topics: dict[tuple[str, str, str], Topic] = {}
        self._sources: list[tuple[Path, McapStorage | SqliteFile, dict[int, Topic], dict[int, int]]] = []
        self._stack = ExitStack()
        try:
            found = find_files(self.path)
            self.paths, self.problems = found.paths, found.problems
            self._message_compression = found.message_compression
            for file in self.paths:
                self._add(file)
            self._put_in_order()
        except BaseException as exc:
            self.close()
            if isinstance(exc, OSError):
                raise BagError(getattr(exc, "filename", None) or self.path, exc) from exc
            raise
        if not self.problems:
            self._compare("metadata.yaml", found.counted, _by_name((t, t.count) for t in self.topics))
        full = [storage for _, storage, *_ in self._sources if any(t.count for t in storage.topics.values())]
        self.start = min((storage.start for storage in full), default=0)
        self.end = max((storage.end for storage in full), default=0)

    @property
    def topics(self) -> list[Topic]:
        """Topics in CDR in the order of their first appearance."""
        return [topic for topic in self._topics.values() if not topic.foreign]

    @property
    def foreign(self) -> list[Topic]:
        """Topics that are not in CDR or have no schema; their messages are not read."""
        return [topic for topic in self._topics.values() if topic.foreign]

    @property
    def message_count(self) -> int:
        """Number of messages of all `topics`."""
        return sum(t.count for t in self.topics)

    @property
    def duration(self) -> float:
        """Time between the first and the last message [s]."""
        return (self.end - self.start) * 1e-9

    def batches(self, topics: Iterable[str] | None = None, *, grouped: bool = False) -> Iterator[Batch]:
        """Messages in order of log time, those of equal time in order of the file; files one after another.

        If a recorder's clock was set back, messages recorded after that follow those recorded before.

        The default is all topics. A batch ends where the topic changes. `grouped` keeps the order only within
        each topic, and separates alternating topics over stretches of a few megabytes.

        Raises
        ------
        BagError
            If a chunk is damaged or cannot be sorted.
        """
        for mixed in self.mixed(topics, lambda topic: grouped):
            for _, batch in mixed.batches:
                yield batch

    def mixed(self, topics: Iterable[str] | None, together: Callable[[Topic], bool]) -> Iterator[Mixed]:
        """As `batches`, but in longer runs: topics for which `together` is true may alternate in a run."""
        names = None if topics is None else set(topics)
        for path, storage, known, counted in self._sources:
            numbers = [
                n
                for n, topic in known.items()
                if not topic.foreign and (names is None or topic.name in names)
            ]
            alternating, read = [n for n in numbers if together(known[n])], Counter[int]()
            try:
                for block in storage.blocks(numbers) if numbers else ():
                    read.update(dict(zip(*np.unique(block.channel, return_counts=True), strict=True)))
                    for plain in unpacked(path, block, self._message_compression):
                        for part in _runs(plain, alternating):
                            yield self._mixed(known, part)
            except BagError as exc:
                raise type(exc)(path, exc.cause) from exc
            if not storage.problem:
                stated, there = (
                    _by_name((known[n], int(each[n])) for n in numbers) for each in (counted, read)
                )
                self._compare(path.name, stated, there)

    def _compare(self, what: str, counted: Mapping[str, int], found: Mapping[str, int]) -> None:
        """Note topics whose number of messages differs from `counted`; `what` is the file that counted."""
        for name, count in counted.items():
            line = str(BagError(what, f"counts {count} messages of {name}, there are {found.get(name, 0)}"))
            if found.get(name, 0) != count and line not in self.problems:
                self.problems.append(line)

    def given_types(self, topic: Topic) -> Typestore:
        """Type store for a topic's messages as `batches` yields them: Jazzy's for joint states."""
        return jazzy() if topic.type_name == JOINT_STATE else self.types(topic)

    def deserialize(self, batch: Batch) -> tuple[list[tuple[int, Any]], list[Rejection]]:
        """Message objects with their positions, and rejected messages; BagError for unknown types."""
        store = self.given_types(batch.topic)
        messages, rejected = [], []
        for index, data in enumerate(batch.messages()):
            try:
                messages.append((index, deserialize(store, data, batch.topic.type_name)))
            except ValueError as exc:
                rejected.append(Rejection(index, str(exc)))
        return messages, rejected

    def joint_states(self, batch: Batch) -> tuple[list[JointStates], list[Rejection]]:
        """Columns of a batch, as `decode_joint_states`; BagError for any type except for JointState."""
        if batch.topic.type_name != JOINT_STATE:
            what = f"{batch.topic.name} has type {batch.topic.type_name}, not {JOINT_STATE}"
            raise BagError(self.path, what)
        return decode_joint_states(batch.payload)

    def close(self) -> None:
        """Close the files."""
        self._sources = []
        self._stack.close()

    def __exit__(self, *error: object) -> None:
        self.close()

    def _add(self, path: Path) -> None:
        """Open a storage file; a damaged database is left out if there are other files."""
        try:
            file, broken = unpack(path, self._stack, len(self.paths))
            storage = (SqliteFile if is_sqlite(file) else McapStorage)(file, self._stack)
        except BagError as exc:
            if ".db3" not in path.suffixes or (path == self.paths[-1] and not self._sources):
                raise BagError(path, exc.cause) from exc
            self.problems.append(str(BagError(path.name, f"is left out: {exc.cause}")))
            return
        self.problems += [str(BagError(path.name, p)) for p in (broken, storage.problem) if p]
        counted = {number: topic.count for number, topic in storage.topics.items()}
        self._sources.append((path, storage, {}, counted))
        for number, topic in storage.topics.items():
            known = self._topics.setdefault((topic.name, topic.type_name, topic.foreign), topic)
            known.count += topic.count if known is not topic else 0
            self._sources[-1][2][number] = known

    def _put_in_order(self) -> None:
        """Sort files that are not listed by number into the order of their times.

        If the times of two files overlap by more than `SET_BACK`, a clock was set back: all stay as listed.
        """
        listed = [path for path, *_ in self._sources]
        if listed == sorted(listed, key=natural):
            return
        ordered = sorted(self._sources, key=lambda source: source[1].start)
        pairs = itertools.pairwise(source[1] for source in ordered)
        if all(one.end - other.start <= SET_BACK for one, other in pairs):
            self._sources = ordered
            place = {path: i for i, (path, *_) in enumerate(ordered)}
            self.paths.sort(key=lambda path: place.get(path, len(place)))

    def types(self, topic: Topic) -> Typestore:
        """Type store of a topic as the bag defines it; BagError if there is no usable definition."""
        try:
            return store_of(topic.type_name, topic.definition)
        except ValueError as exc:
            raise BagError(self.path, f"{topic.name}: {exc}") from exc

    def _mixed(self, topics: dict[int, Topic], part: Block) -> Mixed:
        channels, first, counts = np.unique(part.channel, return_index=True, return_counts=True)
        each = np.split(np.argsort(part.channel, kind="stable"), np.cumsum(counts)[:-1])
        batches = []
        for number in np.argsort(first):
            rows, topic = each[number], topics[int(channels[number])]
            own = part[rows] if len(channels) > 1 else part
            payload = own.payload()
            if topic.type_name == JOINT_STATE and self.types(topic) is not jazzy():
                payload = [standard_joint_state(data, self.types(topic)) for data in payload]
            batches.append((rows, Batch(topic, own.log_time, own.publish_time, payload)))
        return Mixed(part.log_time, batches)


def _by_name(counts: Iterable[tuple[Topic, int]]) -> dict[str, int]:
    """Sums of message counts by topic name."""
    found = Counter[str]()
    for topic, count in counts:
        found[topic.name] += count
    return found


def _runs(block: Block, alternating: list[int]) -> Iterator[Block]:
    """Runs of messages of one channel, or of any `alternating` channels; at most `_AT_ONCE` each."""
    key = np.where(np.isin(block.channel, alternating), -1, block.channel)
    bounds = (np.flatnonzero(np.diff(key)) + 1).tolist()
    for first, last in zip([0, *bounds], [*bounds, len(block)], strict=True):
        for begin in range(first, last, _AT_ONCE):
            yield block[begin : min(begin + _AT_ONCE, last)]
