"""Common output of all storages: topics, and blocks of messages in one buffer with their heads as columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hd_diag.arrays import Bytes, Integers, Times
from hd_diag.messages.schemas import Definition

Payload = Bytes | list[memoryview]

NO_SCHEMA = "no schema"
"""Value of `Topic.foreign` for a topic without a schema."""


@dataclass
class Topic:
    """A topic of a bag: number of messages, type as the bag defines it, offered QoS profiles (YAML).

    `foreign` says why the messages cannot be read: an encoding other than CDR, or no schema. It is empty for
    topics that can be read.
    """

    name: str
    type_name: str
    count: int = 0
    definition: Definition | None = None
    offers: str = ""
    foreign: str = ""

    @property
    def content(self) -> str:
        """Readable text: the type of the messages, or why they cannot be read."""
        return f"{self.foreign}: not read" if self.foreign else self.type_name


@dataclass(frozen=True)
class LongMessage:
    """A message too long for memory: its size [byte], and a function that reads its content in pieces."""

    size: int
    read: Callable[[], Iterator[bytes | memoryview]]

    def __len__(self) -> int:
        return self.size


@dataclass(frozen=True)
class Block:
    """n messages in one buffer `data`; offsets and sizes [byte], channels and times [ns] have shape (n,).

    Times that do not fit into 63 bits are negative. The content of a `long` message is not in the buffer.
    """

    data: Bytes
    offset: Integers
    size: Integers
    channel: Integers
    log_time: Times
    publish_time: Times
    long: LongMessage | None = field(default=None, kw_only=True)

    def __len__(self) -> int:
        return len(self.offset)

    def __getitem__(self, rows: Any) -> Block:
        return Block(self.data, *(column[rows] for column in self._columns()), long=self.long)

    def payload(self) -> Payload:
        """Contents of the messages: an array of shape (n, size) if all have one size, otherwise a list."""
        if len(self) and (self.size == self.size[0]).all():
            return gather(self.data, self.offset, int(self.size[0]))
        return [*self.messages()]

    def messages(self) -> Iterator[memoryview]:
        """Contents of the messages one by one."""
        view = memoryview(self.data)
        for offset, size in zip(self.offset.tolist(), self.size.tolist(), strict=True):
            yield view[offset : offset + size]

    def compact(self) -> Block:
        """The block, copied to its own buffer if its messages fill at most a quarter of this one."""
        return self if 4 * int(self.size.sum()) > len(self.data) else self.holding([*self.messages()])

    def holding(self, contents: Sequence[bytes | memoryview]) -> Block:
        """The same messages with new contents, in a new buffer."""
        size = np.array([len(content) for content in contents], np.int64)
        data = np.frombuffer(b"".join(contents), np.uint8)
        return Block(data, np.cumsum(size) - size, size, *self._columns()[2:])

    def _columns(self) -> tuple[Integers, ...]:
        return self.offset, self.size, self.channel, self.log_time, self.publish_time


def joined(blocks: Sequence[Block]) -> Block:
    """All messages of one or more blocks in one buffer, sorted by log time."""
    block = blocks[0]
    if len(blocks) > 1:
        starts = np.cumsum([0, *(len(b.data) for b in blocks[:-1])])
        moved = [
            Block(b.data, b.offset + start, *b._columns()[1:])
            for b, start in zip(blocks, starts, strict=True)
        ]
        columns = map(np.concatenate, zip(*(b._columns() for b in moved), strict=True))
        block = Block(np.concatenate([b.data for b in blocks]), *columns)
    if (np.diff(block.log_time) < 0).any():
        block = block[np.argsort(block.log_time, kind="stable")]
    return block


def gather(data: Bytes, offset: Integers, size: int) -> Bytes:
    """Rows of `size` bytes that begin at the offsets, shape (n, size); a view if they are evenly spaced."""
    if size == 0 or len(offset) == 0:
        return np.empty((len(offset), size), np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(data, size)
    step = int(offset[1] - offset[0]) if len(offset) > 1 else 1
    if step > 0 and (np.diff(offset) == step).all():
        return windows[offset[0] : offset[-1] + 1 : step]
    return np.asarray(windows[offset])
