"""An MCAP file open for reading: its topics and its messages in the order of log time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from hd_diag.bag.block import Block, joined, mapped
from hd_diag.bag.errors import BagError, is_locked
from hd_diag.bag.mcap_chunk import PIECE, Section
from hd_diag.bag.mcap_scan import DamagedChunk, Scan

# More than this is never held back for sorting [byte]; on the disk so many times that.
_MAX_HELD, _DISK = 32 << 20, 32


class McapStorage:
    """An MCAP file: topics by channel number, least and greatest log time [ns], 0 and 0 for an empty file.

    The stack closes the file; `problem` says why it is not finished. Raises BagError where it is not an MCAP
    file of ROS 2, or holds what cannot be read.
    """

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.path = path
        self._file = stack.enter_context(path.open("rb"))
        self._scan = Scan(path, self._file)
        self.problem = self._scan.problem
        if self.problem and is_locked(self._file.fileno()):
            self.problem = "is being written by another process"
        counts, error = self._count()
        self.topics = self._scan.topics()
        if error is not None and not any(counts.values()):
            raise error
        for number, channel in self._scan.channels.items():
            if number not in self.topics:
                raise BagError(path, f"topic {channel.topic} has no schema, or is not CDR")
            self.topics[number].count = counts.pop(number, 0)
        self._check_declared([number for number, count in counts.items() if count])

    def blocks(self, numbers: Sequence[int]) -> Iterator[Block]:
        """Messages of some channels in the order of log time; BagError where a chunk is damaged."""

        def chosen(sections: list[Section]) -> Block:
            block = self._scan.load(sections)
            return block if len(numbers) == len(self.topics) else block[np.isin(block.channel, numbers)]

        try:
            for block in _ordered(_stretches_of(self._scan.sections), chosen):
                self._check_declared(set(np.unique(block.channel).tolist()) - self.topics.keys())
                if int(block.log_time[0]) < 0 or int(block.publish_time.min()) < 0:
                    raise ValueError("a message has a time beyond the year 2262")
                yield from block.slices()
        except ValueError as exc:
            if self._file.closed:
                raise BagError(self.path, "the bag was closed") from exc
            raise exc if isinstance(exc, BagError) else BagError(self.path, exc) from exc

    def _check_declared(self, unknown: Sequence[int] | set[int]) -> None:
        if unknown:
            raise BagError(self.path, f"holds messages of channel {min(unknown)}, which is not declared")

    def _count(self) -> tuple[dict[int, int], DamagedChunk | None]:
        """Messages by channel as the statistics say; where a file has none its chunks are opened.

        A damaged chunk is an error when it is its turn to be read.
        """
        found, known = self._scan, self._scan.statistics
        if known is not None and not found.problem and found.channels:
            self.start, self.end = known.message_start_time, known.message_end_time
            return dict(known.channel_message_counts), None
        counts: Counter[int] = Counter()
        error: DamagedChunk | None = None
        for section in found.sections:
            try:
                block = found.load([section])
            except DamagedChunk as exc:
                error = error or exc
                continue
            counts.update(block.channel.tolist())
            if len(block):
                section.start, section.end = int(block.log_time.min()), int(block.log_time.max())
        self.start = min((s.start for s in found.sections), default=0)
        self.end = max((s.end for s in found.sections), default=0)
        return counts, error


def _stretches_of(sections: Sequence[Section]) -> list[list[Section]]:
    """Sections in the order of the file, small ones taken together: a log flushed often has many."""
    stretches: list[list[Section]] = []
    size = 0
    for section in sections:
        own = max(section.content_size, section.size)
        size += own
        if not stretches or size > PIECE:
            stretches.append([])
            size = own
        stretches[-1].append(section)
    return stretches


def _ordered(
    stretches: Sequence[list[Section]], load_one: Callable[[list[Section]], Block]
) -> Iterator[Block]:
    """Blocks whose log times never decrease; messages of equal time keep the order of the file.

    Raises ValueError where times are so disordered that sorting takes more than 32 MiB, or where a chunk
    holds messages from before the time that it declares.
    """
    starts = [min(section.start for section in stretch) for stretch in stretches]
    turns = sorted(range(len(stretches)), key=lambda number: (starts[number], number))
    held: dict[int, Block] = {}
    released = -(2**63)
    for turn, number in enumerate(turns, start=1):
        loaded = load_one(stretches[number])
        if len(loaded) and int(loaded.log_time.min()) < released:
            raise ValueError(
                "a chunk holds messages from before its declared start; hd-diag recover mends it"
            )
        held[number], early = loaded, []
        for number, block in sorted(held.items()):
            late = block.log_time >= starts[turns[turn]] if turn < len(turns) else np.zeros(len(block), bool)
            early.append(block[~late].compact() if late.any() else block)
            held[number] = block[late].compact()
        held = {number: block for number, block in held.items() if len(block)}
        if sum(len(b.data) // (_DISK if mapped(b.data) else 1) for b in held.values()) > _MAX_HELD:
            raise ValueError(
                "log times are too disordered: sorting takes more than 32 MiB; fewer topics (--topic), "
                "smaller chunks (hd-diag recover) or `mcap sort` make it less"
            )
        ready = joined([block for block in early if len(block)] or early)
        if len(ready):
            released = int(ready.log_time[-1])
            yield ready
