"""The last messages of a log, compressed, before it is decided whether they are written."""

from __future__ import annotations

import pickle
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import zstandard
from rosbags.interfaces import Qos

_BLOCK = 1 << 18  # of contents that are compressed together [byte]
_PARTS = 10  # of the time to keep: the oldest goes as a whole

OBJECTS = 300
"""What Python takes for a message that waits, beside its contents [byte]."""


class Received(NamedTuple):
    """A message as `BagWriter.write` takes it, at a log time [ns]."""

    topic: str
    type_name: str
    data: bytes
    time: int
    qos: Qos | None


@dataclass
class _Part:
    """Messages from a place where a replay can begin."""

    start: int
    count: int = 0
    blocks: deque[bytes] = field(default_factory=deque)


class Memory:
    """Messages of the last seconds [s], in at most some bytes, in the order in which they came.

    It consists of parts; each begins where a replay can begin. The oldest part is dropped as a whole.
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
        """What it takes [byte]."""
        return self._stored + self._open_size

    @property
    def seconds(self) -> float:
        """Length of what it holds [s]."""
        return (self._last - self._parts[0].start) * 1e-9 if self._parts else 0.0

    def is_due(self, now: int) -> bool:
        """Whether a part should begin at a log time [ns]."""
        return not self._parts or now - self._parts[-1].start >= self._length // _PARTS

    def begin_part(self, now: int) -> None:
        """Begin a part at a log time [ns]; parts that are too old go."""
        self._close()
        self._parts.append(_Part(now))
        while len(self._parts) > 1 and now - self._parts[1].start >= self._length:
            self.drop()

    def put(self, message: Received) -> int:
        """Append a message to the last part; beyond the size the oldest parts are dropped, in the end all.

        Returns how many messages were dropped.
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
        """Remove and return the oldest messages; none if there are no more."""
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
        """Forget the oldest part; how many messages it held."""
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
