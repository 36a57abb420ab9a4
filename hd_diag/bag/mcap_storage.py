"""An MCAP file open for reading: its topics, counts and sections."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hd_diag.bag.block import Block
from hd_diag.bag.errors import BagError
from hd_diag.bag.folder import custom_data
from hd_diag.bag.mcap_chunk import Content, load, messages_of, read
from hd_diag.bag.mcap_scan import Scan, Section, scan
from hd_diag.bag.prefetch import Ahead
from hd_diag.messages.schemas import Definition

# Size of content that is loaded at once: a log flushed often has many small chunks [byte].
_STRETCH = 4 << 20
# Topic, type, offered QoS profiles as YAML, and definition, by channel number.
Topics = dict[int, tuple[str, str, str, Definition | None]]


@dataclass
class Stretch:
    """Sections that follow one another in the file, and the least of their start times [ns]."""

    sections: list[Section]
    start: int


class McapStorage:
    """An MCAP file with everything that reading needs.

    Attributes
    ----------
    scan : Scan
    topics : dict
        As `declared`.
    counts : dict
        Messages of each channel.
    custom_data : dict
        From the metadata that rosbag2 keeps inside the file.
    problem : str
        Why the file is not finished; empty where it is.

    Raises
    ------
    BagError
        Where it is not an MCAP file of ROS 2, or a chunk that must be opened is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.file = path.open("rb")
        self._ahead: list[Ahead[Stretch, Content]] = []
        try:
            self.scan = scan(path, self.file)
            self.problem = self.scan.problem
            if self.problem and is_locked(self.file.fileno()):
                self.problem = "is being written by another process"
            self.counts = self._counts()
            self.topics = self._declared()
            self.custom_data = kept_custom_data(self.scan)
        except BaseException:
            self.file.close()
            raise

    @contextmanager
    def loading(self, stretches: Sequence[Stretch]) -> Iterator[Callable[[Stretch], Block]]:
        """What gives the messages of stretches that are asked for in this order, each once; read ahead.

        It raises BagError where a stretch is damaged, and ValueError where the file was closed meanwhile.
        """
        ahead = Ahead(stretches, lambda stretch: read(self.path, self.file, stretch.sections), _memory)
        self._ahead.append(ahead)
        try:
            yield lambda stretch: messages_of(self.path, stretch.sections, ahead.take(), self.scan)
        finally:
            ahead.close()
            self._ahead.remove(ahead)

    def close(self) -> None:
        """Close the file; nothing reads it any more when this returns."""
        for ahead in self._ahead:
            ahead.close()
        self.file.close()

    def stretches(self, numbers: list[int], start: int | None, end: int | None) -> list[Stretch]:
        """Sections that may hold messages of the topics in the range of time, small ones taken together."""
        wanted = [
            s
            for s in self.scan.sections
            if (end is None or s.start < end)
            and (start is None or s.end >= start)
            and (s.counts is None or not s.counts.keys().isdisjoint(numbers))
        ]
        stretches: list[Stretch] = []
        size = _STRETCH
        for section in wanted:
            if size >= _STRETCH:
                stretches.append(Stretch([], section.start))
                size = 0
            stretches[-1].sections.append(section)
            stretches[-1].start = min(stretches[-1].start, section.start)
            size += section.content_size
        return stretches

    def _counts(self) -> dict[int, int]:
        """Messages of each channel; the chunks are opened only where nothing else tells."""
        found = self.scan
        if found.counts is not None and not found.problem and found.channels:
            return found.counts
        counts: dict[int, int] = {}
        for section in found.sections:
            if section.counts is None or not section.counts.keys() <= found.channels.keys():
                block = load(self.path, self.file, [section], self.scan)
                channels, number = np.unique(block.channel, return_counts=True)
                section.counts = dict(zip(channels.tolist(), number.tolist(), strict=True))
                if len(block):
                    section.start, section.end = int(block.log_time.min()), int(block.log_time.max())
            for channel, count in section.counts.items():
                counts[channel] = counts.get(channel, 0) + count
        return counts

    def _declared(self) -> Topics:
        topics = declared(self.scan)
        for number, count in self.counts.items():
            if count and number not in self.scan.channels:
                raise BagError(self.path, f"holds messages of channel {number}, which is not declared")
        for number, channel in self.scan.channels.items():
            if number not in topics:
                raise BagError(self.path, f"topic {channel.topic} has no schema, or is not CDR")
        return topics


def _memory(stretch: Stretch) -> int:
    """What the content of a stretch takes at most, joined and in parts [byte]."""
    indexes = sum(end - begin for begin, end in (s.indexes or (0, 0) for s in stretch.sections))
    return indexes + sum(max(s.content_size, s.size) for s in stretch.sections)


def kept_custom_data(found: Scan) -> dict[str, str]:
    """Custom data in the file's own metadata."""
    return custom_data(found.metadata.get("rosbag2", {}).get("serialized_metadata", ""))


def declared(found: Scan) -> Topics:
    """Topics of the channels that have a schema and are in CDR."""
    topics: Topics = {}
    for number, channel in found.channels.items():
        schema = found.schemas.get(channel.schema_id)
        if schema is not None and channel.message_encoding in ("cdr", ""):
            text, type_hash = (
                schema.data.decode(errors="replace"),
                channel.metadata.get("topic_type_hash", ""),
            )
            known = Definition(schema.name, text, schema.encoding, type_hash)
            topics[number] = (
                channel.topic,
                schema.name,
                channel.metadata.get("offered_qos_profiles", ""),
                known,
            )
    return topics


def is_locked(fd: int) -> bool:
    """Whether a writer of this package holds the file."""
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    with suppress(OSError):
        fcntl.flock(fd, fcntl.LOCK_UN)
    return False
