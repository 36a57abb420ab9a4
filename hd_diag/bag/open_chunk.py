"""The chunk of an MCAP file that is being filled."""

from __future__ import annotations

from collections.abc import Iterator

from hd_diag.bag.block import LongMessage
from hd_diag.bag.mcap_chunk import AT_ONCE

ROOM = 1 << 20
"""Largest initial buffer of a chunk [byte]."""
UNKNOWN = 2**64 - 1
"""Least time of a chunk without messages [ns]."""


class OpenChunk:
    """Records of the chunk being filled, their times [ns], and the index entries of each channel."""

    def __init__(self, room: bytearray) -> None:
        self.data, self.size = room, 0
        self.opened: float | None = None
        self.first, self.last = UNKNOWN, 0
        self.index: dict[int, bytearray] = {}
        self.long: LongMessage | None = None  # content of the last message, if it is too long to hold

    def grow(self, count: int) -> None:
        """Make room for `count` more bytes; the caller sets them."""
        self.size += count
        if self.size > len(self.data):
            self.data += bytes(self.size - len(self.data))

    def append(self, record: bytes | memoryview) -> None:
        """Append bytes."""
        begin, self.size = self.size, self.size + len(record)
        self.data[begin : self.size] = record


def bits(data: memoryview) -> Iterator[memoryview]:
    """Slices of `data` of at most `AT_ONCE` bytes."""
    return (data[place : place + AT_ONCE] for place in range(0, len(data), AT_ONCE))
