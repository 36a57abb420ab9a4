"""Compressed memory of the last messages of a log, for a later decision whether to write them."""

from __future__ import annotations

import pickle
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import zstandard
from rosbags.interfaces import Qos

_BLOCK = 1 << 18  # messages that are compressed together [byte]
_PARTS = 10  # parts of the kept time; the oldest is dropped as a whole

OBJECTS = 300
"""Memory of a waiting message's Python objects, without its content [byte]."""


class Received(NamedTuple):
    """A message as `BagWriter.write` takes it; `time` is its log time [ns]."""

    topic: str
    type_name: str
    data: bytes
    time: int
    qos: Qos | None


@dataclass
class _Part:
    """Messages from a log time `start` [ns] on, where a replay can begin."""

    start: int
    count: int = 0
    blocks: deque[bytes] = field(default_factory=deque)


class Memory:
    """Messages of the last `seconds`, in order of arrival, in at most `most_bytes`.

    The memory consists of parts. Each begins where a replay can begin; the oldest is dropped as a whole.
    """

    def __init__(self, seconds: float, most_bytes: int) -> None:
        self._length, self._most = int(seconds * 1e9), most_bytes
        self._parts: deque[_Part] = deque()
        self._open: list[Received] = []
        self._open_size = self._stored = self._last = 0
        self._compress = zstandard.ZstdCompressor(level=1).compress

    def __bool__(self) -> bool:
        return bool(self._parts)

    @property
    def size(self) -> int:
        """Memory in use [byte]."""
        return self._stored + self._open_size

    @property
    def seconds(self) -> float:
        """Time span of the messages [s]."""
        return (self._last - self._parts[0].start) * 1e-9 if self._parts else 0.0

    def is_due(self, now: int) -> bool:
        """Whether a part should begin at a log time [ns]."""
        return not self._parts or now - self._parts[-1].start >= self._length // _PARTS

    def begin_part(self, now: int) -> None:
        """Begin a part at a log time [ns] and drop parts that are too old."""
        self._close()
        self._parts.append(_Part(now))
        while len(self._parts) > 1 and now - self._parts[1].start >= self._length:
            self.drop()

    def put(self, message: Received) -> int:
        """Append a message to the last part; above the size limit drop the oldest parts, if need be all.

        Returns the number of dropped messages.
        """
        if not self._parts:
            return 0
        self._parts[-1].count += 1
        self._open.append(message)
        self._open_size += len(message.data) + OBJECTS
        self._last = message.time
        if self._open_size >= _BLOCK:
            self._close()
        gone = 0
        while self.size > self._most and self._parts:
            gone += self.drop()
        return gone

    def take(self) -> list[Received]:
        """Remove and return the oldest messages; empty if there are none."""
        while self._parts and not self._parts[0].blocks:
            if len(self._parts) == 1:
                self._parts.clear()
                found, self._open, self._open_size = self._open, [], 0
                return found
            self._parts.popleft()
        if not self._parts:
            return []
        block = self._parts[0].blocks.popleft()
        self._stored -= len(block)
        found = list(pickle.loads(zstandard.decompress(block)))
        self._parts[0].count -= len(found)
        return found

    def drop(self) -> int:
        """Drop the oldest part and return its number of messages."""
        part = self._parts.popleft()
        self._stored -= sum(map(len, part.blocks))
        if not self._parts:
            self._open, self._open_size = [], 0
        return part.count

    def _close(self) -> None:
        if self._open and self._parts:
            block = self._compress(pickle.dumps(self._open, pickle.HIGHEST_PROTOCOL))
            self._parts[-1].blocks.append(block)
            self._stored += len(block)
        self._open, self._open_size = [], 0
