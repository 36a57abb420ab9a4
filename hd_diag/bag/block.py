"""What every storage gives: topics, and messages side by side in one buffer, their heads as columns."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from mmap import ACCESS_READ, MADV_DONTNEED, mmap
from tempfile import TemporaryFile
from typing import Any

import numpy as np

from hd_diag.arrays import Bytes, Integers, Times
from hd_diag.messages.schemas import Definition

Payload = Bytes | list[memoryview]
LARGE = 10 << 20
"""More than this is not held in memory [byte]; an image's chunk is."""
# What is handed on at a time, and what a message weighs there beside its content [byte].
_SLICE, _WEIGHT = 4 << 20, 256


@dataclass
class Topic:
    """A topic of a bag: its messages, the type as the bag defines it, offered QoS profiles (YAML)."""

    name: str
    type_name: str
    count: int = 0
    definition: Definition | None = None
    offers: str = ""


@dataclass(frozen=True)
class Block:
    """Messages in one buffer `data`: place and size of each content there [byte], channel, times [ns], (n,).

    Times that do not fit into 63 bits are negative.
    """

    data: Bytes
    offset: Integers
    size: Integers
    channel: Integers
    log_time: Times
    publish_time: Times

    def __len__(self) -> int:
        return len(self.offset)

    def __getitem__(self, rows: Any) -> Block:
        return Block(self.data, *(column[rows] for column in self._columns()))

    def payload(self) -> Payload:
        """Contents of the messages: an array of shape (n, size) where they have one size."""
        if len(self) and (self.size == self.size[0]).all():
            return gather(self.data, self.offset, int(self.size[0]))
        return [*self.messages()]

    def messages(self) -> Iterator[memoryview]:
        """Contents of the messages one by one."""
        view = memoryview(self.data)
        for offset, size in zip(self.offset.tolist(), self.size.tolist(), strict=True):
            yield view[offset : offset + size]

    def slices(self) -> Iterator[Block]:
        """The messages in order, a few megabytes and some thousands at a time."""
        turn = np.cumsum(self.size + _WEIGHT) // _SLICE
        ends = (np.flatnonzero(np.diff(turn)) + 1).tolist()
        for first, last in itertools.pairwise([0, *ends, len(self)]):
            yield self[first:last]
            forget(self.data)

    def compact(self) -> Block:
        """The same messages without the rest of their buffer, where that is most of it."""
        return self if 4 * int(self.size.sum()) > len(self.data) else self.holding([*self.messages()])

    def holding(self, contents: Sequence[bytes | memoryview]) -> Block:
        """The messages with other contents."""
        size = np.array([len(content) for content in contents], np.int64)
        data, _ = collected(contents, int(size.sum()))
        return Block(data, np.cumsum(size) - size, size, *self._columns()[2:])

    def _columns(self) -> tuple[Integers, ...]:
        return self.offset, self.size, self.channel, self.log_time, self.publish_time


def joined(blocks: Sequence[Block]) -> Block:
    """All messages of the blocks, at least one, in one buffer and in the order of log time."""
    block = blocks[0]
    if len(blocks) > 1:
        starts = np.cumsum([0, *(len(b.data) for b in blocks[:-1])])
        moved = [
            Block(b.data, b.offset + start, *b._columns()[1:])
            for b, start in zip(blocks, starts, strict=True)
        ]
        columns = map(np.concatenate, zip(*(b._columns() for b in moved), strict=True))
        data, _ = collected([memoryview(b.data) for b in blocks], sum(len(b.data) for b in blocks))
        block = Block(data, *columns)
    if (np.diff(block.log_time) < 0).any():
        block = block[np.argsort(block.log_time, kind="stable")]
    return block


def collected(parts: Iterable[bytes | memoryview], most: int) -> tuple[Bytes, int]:
    """Parts side by side, up to so many bytes, and their checksum; above `LARGE` in a file that is mapped."""
    size = checksum = 0
    with TemporaryFile(prefix="hd_diag-") if most > LARGE else BytesIO() as file:
        for whole in parts:
            part = whole[: most - size]
            file.write(part)
            size, checksum = size + len(part), zlib.crc32(part, checksum)
            if size == most:
                break
        file.flush()
        if isinstance(file, BytesIO):
            return np.frombuffer(file.getvalue(), np.uint8), checksum
        kept = mmap(file.fileno(), size, access=ACCESS_READ) if size else b""
    return np.frombuffer(kept, np.uint8), checksum


def mapped(data: Bytes) -> mmap | None:
    """The file on the disk that a buffer is, if it is one."""
    owner = getattr(data.base, "obj", data.base)
    return owner if isinstance(owner, mmap) else None


def forget(data: Bytes) -> None:
    """Take no memory for what was read of a buffer that is a file on the disk."""
    if (file := mapped(data)) is not None:
        file.madvise(MADV_DONTNEED)


def gather(data: Bytes, offset: Integers, size: int) -> Bytes:
    """Rows of `size` bytes that begin at the offsets, shape (n, size); a view where evenly spaced."""
    if size == 0 or len(offset) == 0:
        return np.empty((len(offset), size), np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(data, size)
    step = int(offset[1] - offset[0]) if len(offset) > 1 else 1
    if step > 0 and (np.diff(offset) == step).all():
        return windows[offset[0] : offset[-1] + 1 : step]
    return np.asarray(windows[offset])
