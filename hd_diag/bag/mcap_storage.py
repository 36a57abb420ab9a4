"""An MCAP file open for reading: its topics and its messages in the order of log time."""

from __future__ import annotations

import fcntl
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hd_diag.bag.block import Block, joined
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_chunk import DamagedChunk, load
from hd_diag.bag.mcap_scan import Section, scan

# Size of content that is loaded at once: a log flushed often has many small chunks [byte].
_AT_ONCE = 4 << 20
# What is read ahead takes no more memory than this [byte].
_AHEAD = 12 << 20
# More than this is never held back for sorting [byte].
_MAX_HELD = 1 << 30


class McapStorage:
    """An MCAP file: topics by channel number, least and greatest log time [ns], 0 and 0 for an empty file.

    `problem` says why the file is not finished. Raises BagError where it is not an MCAP file of ROS 2, or
    holds what cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("rb")
        try:
            self._scan = scan(path, self._file)
            self.problem = self._scan.problem
            if self.problem and is_locked(self._file.fileno()):
                self.problem = "is being written by another process"
            counts, error = self._count()
            self.topics = self._scan.topics()
            if error is not None and not any(counts.values()):
                raise error
            for number, count in counts.items():
                if count and number not in self._scan.channels:
                    raise BagError(path, f"holds messages of channel {number}, which is not declared")
            for number, channel in self._scan.channels.items():
                if number not in self.topics:
                    raise BagError(path, f"topic {channel.topic} has no schema, or is not CDR")
                self.topics[number].count = counts.get(number, 0)
        except BaseException:
            self._file.close()
            raise

    def blocks(self, numbers: Sequence[int]) -> Iterator[Block]:
        """Messages of some channels in the order of log time; BagError where a chunk is damaged."""

        def chosen(stretch: _Stretch) -> Block:
            block = load(self.path, self._file, stretch.sections, self._scan)
            return block if len(numbers) == len(self.topics) else block[np.isin(block.channel, numbers)]

        try:
            for block in _ordered(_stretches_of(self._scan.sections), chosen):
                unknown = set(np.unique(block.channel).tolist()) - self.topics.keys()
                if unknown:
                    raise ValueError(f"messages of channel {min(unknown)}, which is not declared")
                if int(block.log_time[0]) < 0 or int(block.publish_time.min()) < 0:
                    raise ValueError("a message has a time beyond the year 2262")
                yield block
        except ValueError as exc:
            raise exc if isinstance(exc, BagError) else BagError(self.path, exc) from exc

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _count(self) -> tuple[dict[int, int], DamagedChunk | None]:
        """Messages by channel as the statistics say; where a file has none its chunks are opened.

        A damaged chunk is an error when it is its turn to be read.
        """
        found, known = self._scan, self._scan.statistics
        if known is not None and not found.problem and found.channels:
            self.start, self.end = known.message_start_time, known.message_end_time
            return known.channel_message_counts, None
        counts: Counter[int] = Counter()
        error: DamagedChunk | None = None
        for section in found.sections:
            try:
                block = load(self.path, self._file, [section], found)
                channels, numbers = np.unique(block.channel, return_counts=True)
                counts.update(dict(zip(channels.tolist(), numbers.tolist(), strict=True)))
                if len(block):
                    section.start, section.end = int(block.log_time.min()), int(block.log_time.max())
            except DamagedChunk as exc:
                error = error or exc
        self.start = min((s.start for s in found.sections), default=0)
        self.end = max((s.end for s in found.sections), default=0)
        return counts, error


@dataclass
class _Stretch:
    """Sections that follow one another in the file, the least of their times [ns], size in memory [byte]."""

    sections: list[Section]
    start: int
    size: int


def _stretches_of(sections: Sequence[Section]) -> list[_Stretch]:
    """Sections in the order of the file, small ones taken together."""
    stretches: list[_Stretch] = []
    for section in sections:
        size = max(section.content_size, section.size)
        if not stretches or stretches[-1].size + size > _AT_ONCE:
            stretches.append(_Stretch([], section.start, 0))
        last = stretches[-1]
        last.sections.append(section)
        last.start, last.size = min(last.start, section.start), last.size + size
    return stretches


def _ordered(stretches: Sequence[_Stretch], load_one: Callable[[_Stretch], Block]) -> Iterator[Block]:
    """Blocks whose log times never decrease; messages of equal time keep the order of the file.

    Raises ValueError where times are so disordered that sorting takes more than 1 GiB, or where a chunk holds
    messages from before the time that it declares.
    """
    turns = sorted(range(len(stretches)), key=lambda number: (stretches[number].start, number))
    limits = [stretches[number].start for number in (*turns[1:], *turns[-1:])]  # the last has none
    blocks = _ahead([stretches[number] for number in turns], load_one)
    held: list[tuple[int, Block]] = []
    released = -(2**63)
    for turn, (number, limit, block) in enumerate(zip(turns, limits, blocks, strict=True), start=1):
        if len(block) and int(block.log_time.min()) < released:
            raise ValueError(
                "a chunk holds messages from before its declared start; hd-diag recover mends it"
            )
        held = sorted([*held, (number, block)], key=lambda entry: entry[0])
        masks = [b.log_time < limit if turn < len(turns) else np.ones(len(b), bool) for _, b in held]
        early = [b[mask] for (_, b), mask in zip(held, masks, strict=True) if mask.any()]
        held = [(n, b[~mask].compact()) for (n, b), mask in zip(held, masks, strict=True) if not mask.all()]
        if sum(len(b.data) for _, b in held) > _MAX_HELD:
            raise ValueError("log times are too disordered: sorting them takes more than 1 GiB")
        if early:
            ready = joined(early)
            released = int(ready.log_time[-1])
            yield ready


def _ahead(stretches: Sequence[_Stretch], load_one: Callable[[_Stretch], Block]) -> Iterator[Block]:
    """What the stretches hold, in their order; what fits into `_AHEAD` is loaded before its turn."""
    left, held = deque(stretches), 0
    waiting: deque[tuple[int, Future[Block]]] = deque()
    pool = ThreadPoolExecutor(2, thread_name_prefix="bag reader")
    try:
        while left or waiting:
            while left and (not waiting or held + left[0].size <= _AHEAD):
                held += left[0].size
                waiting.append((left[0].size, pool.submit(load_one, left.popleft())))
            held -= waiting[0][0]
            yield waiting.popleft()[1].result()
    finally:
        pool.shutdown(cancel_futures=True)


def is_locked(fd: int) -> bool:
    """Whether a writer of this package holds the file."""
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    with suppress(OSError):
        fcntl.flock(fd, fcntl.LOCK_UN)
    return False
