"""Content of a chunk: decompressed within bounds, its messages as columns."""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

from hd_diag.arrays import Integers
from hd_diag.bag.block import Block, gather

MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time and publish time [ns]."""
RECORD = struct.Struct("<BQ")
"""Head of any record: opcode and length."""
MAX_CHUNK = 256 << 20
"""A chunk, or a message outside of one, above this is refused: recorders close a chunk after some megabytes
[byte]."""
MAX_MESSAGE = MAX_CHUNK - MESSAGE.size
"""Content of a message that fits into such a chunk [byte]."""
PIECE = 2 << 20
"""How much content is taken at once [byte]: small chunks together, large ones in parts, any message whole."""
LARGE = 10 << 20
"""Above this a chunk is read twice, to check it and then in parts, and a message is not held where nobody
needs it [byte]; an image's chunk is not."""
AT_ONCE = 1 << 18
"""Size that is decompressed, or copied of what is long, at a time [byte]."""
COMPRESSIONS = ("", "lz4", "zstd")
# A chunk that claims both more than this [byte] and more than so many times what is stored of it is refused
# unread: recordings seldom reach 100, and a file of some kilobytes could keep the reader busy for minutes.
_MAX_UNASKED, _MAX_RATIO = 64 << 20, 1000
_HEAD = np.dtype("u1, <u8, <u2, <u4, <u8, <u8")
_HEAD.names = ("opcode", "length", "channel", "sequence", "log_time", "publish_time")
# A chunk with more records is refused: an honest one of some megabytes has a hundredth of them.
_MAX_RECORDS = 1_000_000


@dataclass
class Section:
    """A chunk, or messages outside of chunks that follow one another: place [byte] and log times [ns].

    Sizes, times and checksum (0 for none) are those that the chunk declares. For a part of a large chunk,
    `part` is its place in the content and its size [byte], and the times are those of its messages. A message
    above `LARGE` is a part or section of its own, with its `channel`.
    """

    offset: int
    size: int
    start: int
    end: int
    compression: str = ""
    content_size: int = 0
    checksum: int = 0
    is_chunk: bool = True
    part: tuple[int, int] | None = None
    channel: int | None = None


def believable(stored: int) -> int:
    """Size that so many stored bytes may unpack to [byte]."""
    return min(MAX_CHUNK, max(_MAX_UNASKED, _MAX_RATIO * stored))


def check_claim(claimed: int, stored: int) -> None:
    """Raise ValueError for content [byte] that is too large, or more than `believable` of what is stored."""
    if max(claimed, stored) > MAX_CHUNK:
        raise ValueError(f"it claims {max(claimed, stored)} bytes, more than {MAX_CHUNK}")
    if claimed > believable(stored):
        most = f"{_MAX_UNASKED} and {_MAX_RATIO} times the {stored} stored"
        raise ValueError(f"it claims {claimed} bytes, more than {most}")


def decompressed(compression: str, stored: Any) -> Iterator[bytes]:
    """Decompress piece by piece what the ``read`` of `stored` gives."""
    if compression not in COMPRESSIONS:
        raise ValueError(f"compression {compression!r} is not known")
    if compression == "zstd":
        yield from zstandard.ZstdDecompressor().read_to_iter(stored, AT_ONCE, AT_ONCE)
        return
    lz4_frame = lz4.frame.LZ4FrameDecompressor()
    while not lz4_frame.eof and (part := stored.read(AT_ONCE)):
        yield lz4_frame.decompress(part, AT_ONCE) if compression else part
        while compression and not (lz4_frame.needs_input or lz4_frame.eof):
            yield lz4_frame.decompress(b"", AT_ONCE)


class Content:
    """Content of a chunk up to a limit [byte], read from its beginning on.

    `place` is how much was taken [byte]. `checksum` is that of the bytes read, or None if nobody needs it.
    """

    def __init__(self, parts: Iterator[bytes], limit: int, checksum: int | None = 0) -> None:
        self.place, self.checksum = 0, checksum
        self._parts, self._limit, self._rest = parts, limit, b""

    def take(self, size: int) -> bytes:
        """The next bytes, fewer at the end."""
        size, read = min(size, self._limit - self.place), [self._rest]
        left = size - len(self._rest)
        while left > 0 and (part := next(self._parts, None)) is not None:
            if self.checksum is not None:
                self.checksum = zlib.crc32(part, self.checksum)
            left -= len(part)
            read.append(part)
        both = b"".join(read)
        self._rest = both[size:]
        self.place += min(size, len(both))
        return both[:size]

    def skip(self, place: int) -> None:
        """Go on to a place."""
        while self.place < place and self.take(min(AT_ONCE, place - self.place)):
            pass


def check_whole(section: Section, content: Content) -> None:
    """Raise ValueError if a chunk does not hold what it declares; call it when all is taken."""
    if content.place != section.content_size:
        raise ValueError(f"it holds {content.place} bytes instead of {section.content_size}")
    if section.checksum and content.checksum != section.checksum:
        raise ValueError("its checksum is wrong")


class OnDisk:
    """Content of a chunk in a temporary file, taken from any place."""

    place = 0

    def __init__(self, content: Content) -> None:
        self._file, self._next = TemporaryFile(prefix="hd_diag-"), 0  # noqa: SIM115 (open as long as this is)
        while part := content.take(AT_ONCE):
            self._file.write(part)
        self._file.flush()

    def skip(self, place: int) -> None:
        """Go on to a place."""
        self._next = place

    def take(self, size: int) -> bytes:
        """The bytes there."""
        return os.pread(self._file.fileno(), size, self._next)


def pieces(content: Content, keep: Callable[[bytes], None]) -> Iterator[tuple[int, int, Block]]:
    """Place and size [byte] of pieces of whole records, one after the other, and the messages in them.

    A message above `LARGE` is a piece of its own; the block has only its head. Raises ValueError as
    `parse`, and where a record at the end is not whole.
    """
    place, size, rest = 0, PIECE, b""
    while more := content.take(size - len(rest)):
        rest += more
        block, stop = parse(rest, keep)
        if stop:
            yield place, stop, block
        place, rest = place + stop, rest[stop:]
        opcode, length = RECORD.unpack_from(rest) if len(rest) >= RECORD.size else (0, 0)
        if length > LARGE:
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                raise ValueError(f"{length} bytes are too many for such a record")
            head = rest if len(rest) >= MESSAGE.size else rest + content.take(MESSAGE.size - len(rest))
            end = place + RECORD.size + length
            content.skip(end)
            if content.place < end:
                break
            if opcode == Opcode.MESSAGE:
                yield place, end - place, head_of(head)
            place, length, rest = end, 0, b""
        size = max(PIECE, RECORD.size + length)
    check_end(rest, 0)


def parse(content: bytes, keep: Callable[[bytes], None]) -> tuple[Block, int]:
    """Messages among the whole records at the beginning of `content`, and where these end.

    Schemas and channels are handed to `keep`. Raises ValueError where a record cannot be.
    """
    first, more, position, ignored = np.empty(0, np.int64), array("q"), 0, 0
    end, head_at, message = len(content), RECORD.unpack_from, int(Opcode.MESSAGE)
    while position + RECORD.size <= end:
        opcode, length = head_at(content, position)
        stop = position + RECORD.size + length
        if stop > end or opcode == 0:
            break
        if opcode != message:
            ignored += 1
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                keep(content[position:stop])
        elif more or len(first):
            more.append(position)
        else:
            first = _equal_records(content, position, stop - position)
            stop += int(first[-1]) - position
        position = stop
        if len(first) + len(more) + ignored > _MAX_RECORDS:
            raise ValueError(f"it holds more than {_MAX_RECORDS} records")
    return _messages_at(content, np.concatenate([first, np.array(more, np.int64)])), position


def head_of(content: bytes) -> Block:
    """The message that begins here; only its head is needed."""
    return _messages_at(content[: MESSAGE.size], np.zeros(1, np.int64))


def check_end(content: bytes, stop: int) -> None:
    """Raise ValueError where whole records do not reach the end."""
    if stop != len(content):
        longer = "a record is longer than the chunk"
        raise ValueError(longer if content[stop] else "it holds bytes that are not records")


def _equal_records(content: bytes, start: int, step: int) -> Integers:
    """Places of the messages of one size that follow one another from `start`; at least one."""
    count = (len(content) - start) // step
    heads = np.frombuffer(content, np.uint8, count * step, start).reshape(count, step)[:, :9]
    same = (heads == heads[0]).all(axis=1)
    count = count if same.all() else int(same.argmin())
    return start + step * np.arange(count, dtype=np.int64)


def _messages_at(content: bytes, offset: Integers) -> Block:
    data = np.frombuffer(content, np.uint8)
    if len(offset) and offset[-1] + MESSAGE.size > len(data):
        raise ValueError("a message has no room for its times")
    heads = np.ascontiguousarray(gather(data, offset, MESSAGE.size)).view(_HEAD)[:, 0]
    size = heads["length"].astype(np.int64) + RECORD.size - MESSAGE.size
    if len(size) and int(size.min()) < 0:
        raise ValueError("a message is too short for its times")
    columns = (heads[name].astype(np.int64) for name in ("channel", "log_time", "publish_time"))
    return Block(data, offset + MESSAGE.size, size, *columns)
