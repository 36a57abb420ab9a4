"""The chunk of an MCAP file that is being filled."""

from __future__ import annotations

from collections.abc import Iterator

from hd_diag.bag.block import LongMessage
from hd_diag.bag.mcap_chunk import AT_ONCE

ROOM = 1 << 20
"""That a chunk has from the beginning [byte]."""
UNKNOWN = 2**64 - 1
"""Least time of no messages [ns]."""


class OpenChunk:
    """Records of the chunk that is being filled, their times, and where the messages of each channel are."""

    def __init__(self, room: bytearray) -> None:
        self.data, self.size = room, 0
        self.opened: float | None = None
        self.first, self.last = UNKNOWN, 0
        self.index: dict[int, bytearray] = {}
        self.long: LongMessage | None = None  # content of the last message

    def grow(self, count: int) -> None:
        """Make room for so many more bytes; the caller sets them."""
        self.size += count
        if self.size > len(self.data):
            self.data += bytes(self.size - len(self.data))

    def append(self, record: bytes | memoryview) -> None:
        """Add bytes."""
        begin, self.size = self.size, self.size + len(record)
        self.data[begin : self.size] = record


def bits(data: memoryview) -> Iterator[memoryview]:
    """What is held, a little at a time."""
    return (data[place : place + AT_ONCE] for place in range(0, len(data), AT_ONCE))
