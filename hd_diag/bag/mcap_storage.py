"""An MCAP file open for reading: its topics and its messages in the order of log time."""

from __future__ import annotations

import itertools
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from hd_diag.bag.block import Block, joined
from hd_diag.bag.errors import BagError, is_locked
from hd_diag.bag.mcap_chunk import MESSAGE, PIECE, Section
from hd_diag.bag.mcap_scan import DamagedChunk, Scan
from hd_diag.bag.recorder_clock import SET_BACK, RecorderClock

# Most memory for data that are read ahead [byte].
_AHEAD = 6 << 20
# Most memory for messages that wait for sorting [byte].
_MAX_HELD = 32 << 20


class McapStorage:
    """An MCAP file: `topics` by channel number; least and greatest log time [ns], 0 and 0 if it is empty.

    `stack` closes the file. `problem` says why the file is not finished. Raises BagError if it is not MCAP,
    has no messages but damaged chunks, or has messages of undeclared channels.
    """

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.path = path
        self._file = stack.enter_context(path.open("rb"))
        self._scan, self._is_split = Scan(path, self._file), False
        self.problem = self._scan.problem
        if self.problem and is_locked(self._file.fileno()):
            self.problem = "is being written by another process"
        counts, error = self._count()
        self.topics = self._scan.topics()
        if error is not None and not any(counts.values()):
            raise error
        for number, topic in self.topics.items():
            topic.count = counts.get(number, 0)
        self._check_declared({number for number, count in counts.items() if count})

    def blocks(self, numbers: Sequence[int]) -> Iterator[Block]:
        """Messages of some channels in order of log time; BagError if a chunk is damaged.

        If the recorder's clock was set back, messages recorded after that follow those recorded before.
        """

        def chosen(sections: list[Section]) -> Block:
            block = self._scan.load(sections)
            self._check_declared(set(np.unique(block.channel).tolist()))
            return block if len(numbers) == len(self.topics) else block[np.isin(block.channel, numbers)]

        try:
            unneeded = self.topics.keys() - set(numbers)
            sections = [section for section in self._sections() if section.channel not in unneeded]
            following = self._clock_stretches(sections, chosen)
            for block in itertools.chain.from_iterable(_ordered(_stretches_of(s), chosen) for s in following):
                if int(block.log_time[0]) < 0 or int(block.publish_time.min()) < 0:
                    raise ValueError("a message has a time beyond the year 2262")
                yield block
        except ValueError as exc:
            if self._file.closed:
                raise BagError(self.path, "the bag was closed") from exc
            raise exc if isinstance(exc, BagError) else BagError(self.path, exc) from exc

    def _clock_stretches(
        self, sections: Sequence[Section], load: Callable[[list[Section]], Block]
    ) -> Iterator[list[Section]]:
        """Split sections at each step back of the recorder's clock; yields the sections of each stretch.

        A section is loaded for this only if it declares an earlier time than those before it.
        """
        following: list[Section] = []
        reach = -(2**63)
        for section in sections:
            if following and section.start < reach - SET_BACK:
                clock = RecorderClock()
                before, block = load(_last_of(following)), load([section])
                clock.set_back(before.channel, before.log_time)
                if rows := clock.set_back(block.channel, block.log_time):
                    head, section = _parted(section, block, rows[0])
                    yield following + head
                    following, reach = [], -(2**63)
            following.append(section)
            reach = max(reach, section.end)
        yield following

    def _sections(self) -> list[Section]:
        """Sections, large ones split into parts; a damaged one stays and raises its error when it is read."""
        if not self._is_split:
            found: list[Section] = []
            for section in self._scan.sections:
                try:
                    found += self._scan.parts(section)
                except DamagedChunk:
                    found.append(section)
            self._scan.sections, self._is_split = found, True
        return self._scan.sections

    def _check_declared(self, numbers: set[int]) -> None:
        if unknown := numbers - self.topics.keys():
            raise BagError(self.path, f"holds messages of channel {min(unknown)}, which is not declared")

    def _count(self) -> tuple[dict[int, int], DamagedChunk | None]:
        """Count messages by channel from the statistics, otherwise from the chunks; also the first damage.

        A damaged chunk raises its error only when it is read. Sets `start` and `end`.
        """
        found, known = self._scan, self._scan.statistics
        if known is not None and not found.problem and found.channels:
            self.start, self.end = known.message_start_time, known.message_end_time
            return dict(known.channel_message_counts), None
        counts: Counter[int] = Counter()
        error: DamagedChunk | None = None
        for section in self._sections():
            if section.channel is not None:
                counts[section.channel] += 1
                continue
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


def _last_of(sections: Sequence[Section]) -> list[Section]:
    """The last sections, together about `PIECE`."""
    count = 1
    while count < len(sections) and _size(sections[-count:]) < PIECE:
        count += 1
    return list(sections[-count:])


def _parted(section: Section, block: Block, row: int) -> tuple[list[Section], Section]:
    """Split a section at a row of its block: the part before, if any, and the rest."""
    place, size = section.part or (0, section.content_size)
    at = int(block.offset[row]) - MESSAGE.size
    if at == 0:
        return [], section
    times = block.log_time
    before, after = (replace(section, part=part) for part in ((place, at), (place + at, size - at)))
    if row:
        before.start, before.end = int(times[:row].min()), int(times[:row].max())
    after.start, after.end = int(times[row:].min()), int(times[row:].max())
    return [before] if row else [], after


def _size(sections: Sequence[Section]) -> int:
    """Memory that sections need [byte]."""
    return sum(s.part[1] if s.part else max(s.content_size, s.size) for s in sections)


def _stretches_of(sections: Sequence[Section]) -> list[list[Section]]:
    """Sections in file order; small ones are combined, because a log that is flushed often has many."""
    stretches: list[list[Section]] = []
    size = 0
    for section in sections:
        size += _size([section])
        if not stretches or size > PIECE:
            stretches.append([])
            size = _size([section])
        stretches[-1].append(section)
    return stretches


def _ordered(
    stretches: Sequence[list[Section]], load_one: Callable[[list[Section]], Block]
) -> Iterator[Block]:
    """Yield blocks in order of log time; messages of equal time keep the order of the file.

    If the clock was set back within a stretch, messages recorded after that follow those recorded before.
    Raises ValueError if times are so disordered that sorting takes more than 32 MiB, or if a chunk holds
    messages from before its declared start.
    """
    starts = [min(section.start for section in stretch) for stretch in stretches]
    turns = sorted(range(len(stretches)), key=lambda number: (starts[number], number))
    blocks = _ahead([stretches[number] for number in turns], load_one)
    held: dict[int, Block] = {}
    released, clock, last = -(2**63), RecorderClock(), -1
    for turn, (number, whole) in enumerate(zip(turns, blocks, strict=True), start=1):
        clock, last = clock if number == last + 1 else RecorderClock(), number
        *before, loaded = clock.stretches(whole)
        for part in before:
            yield joined([*(block for _, block in sorted(held.items())), part])
            held, released = {}, -(2**63)
        if len(loaded) and int(loaded.log_time.min()) < released:
            raise ValueError(
                "a chunk holds messages from before its declared start; hd-diag recover mends it"
            )
        held[number], early = loaded, []
        for number, block in sorted(held.items()):
            late = block.log_time >= starts[turns[turn]] if turn < len(turns) else np.zeros(len(block), bool)
            early.append(block[~late] if late.any() else block)
            held[number] = block[late].compact()
        held = {number: block for number, block in held.items() if len(block)}
        if sum(len(block.data) for block in held.values()) > _MAX_HELD:
            raise ValueError(
                "log times are too disordered: sorting takes more than 32 MiB; fewer topics (--topic), "
                "smaller chunks (hd-diag recover) or `mcap sort` make it less"
            )
        ready = joined([block for block in early if len(block)] or early)
        if len(ready):
            released = int(ready.log_time[-1])
            yield ready


def _ahead(stretches: Sequence[list[Section]], load_one: Callable[[list[Section]], Block]) -> Iterator[Block]:
    """Yield the block of each stretch in order; threads load as many as fit into `_AHEAD` in advance."""
    left, held = deque(stretches), 0
    waiting: deque[tuple[int, Future[Block]]] = deque()
    pool = ThreadPoolExecutor(2, thread_name_prefix="bag reader")
    try:
        while left or waiting:
            while left and (not waiting or held + _size(left[0]) <= _AHEAD):
                held += _size(left[0])
                waiting.append((_size(left[0]), pool.submit(load_one, left.popleft())))
            held -= waiting[0][0]
            yield waiting.popleft()[1].result()
    finally:
        pool.shutdown(cancel_futures=True)
