"""Content of a chunk: decompression within size limits, and messages as columns."""

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
"""Largest accepted chunk, or message outside of a chunk [byte]; recorders close chunks after some
megabytes."""
MAX_MESSAGE = MAX_CHUNK - MESSAGE.size
"""Largest content of a message that fits into such a chunk [byte]."""
PIECE = 2 << 20
"""Content processed at once [byte]; small chunks are combined, large ones split, but messages are not."""
LARGE = 10 << 20
"""Size above which a chunk is read twice, first to check it and then in parts, and a message is loaded only
if its topic is needed [byte]. Chunks with one image are smaller."""
AT_ONCE = 1 << 18
"""Portion in which data are decompressed and long messages are copied [byte]."""
COMPRESSIONS = ("", "lz4", "zstd")
# A chunk is refused unread if its claimed size exceeds both this [byte] and this multiple of its stored size.
# Recordings seldom reach 100; without limits a file of some kilobytes keeps the reader busy for minutes.
_MAX_UNASKED, _MAX_RATIO = 64 << 20, 1000
_HEAD = np.dtype("u1, <u8, <u2, <u4, <u8, <u8")
_HEAD.names = ("opcode", "length", "channel", "sequence", "log_time", "publish_time")
# Most records that are parsed at once; a regular chunk of some megabytes has a hundredth of them.
_MAX_RECORDS = 1_000_000


@dataclass
class Section:
    """A chunk, or consecutive messages outside of chunks: offset in the file [byte] and log times [ns].

    Sizes, times and checksum (0 for none) are those that the chunk declares. `part` selects part of a large
    chunk by offset in the content and size [byte]; the times are then those of its messages. A message above
    `LARGE` has its own part or section, and only then `channel` is set.
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
    """Largest plausible unpacked size of `stored` bytes [byte]."""
    return min(MAX_CHUNK, max(_MAX_UNASKED, _MAX_RATIO * stored))


def check_claim(claimed: int, stored: int) -> None:
    """Raise ValueError if a size [byte] exceeds `MAX_CHUNK`, or `claimed` exceeds the `believable` size."""
    if max(claimed, stored) > MAX_CHUNK:
        raise ValueError(f"it claims {max(claimed, stored)} bytes, more than {MAX_CHUNK}")
    if claimed > believable(stored):
        most = f"{_MAX_UNASKED} and {_MAX_RATIO} times the {stored} stored"
        raise ValueError(f"it claims {claimed} bytes, more than {most}")


def decompressed(compression: str, stored: Any) -> Iterator[bytes]:
    """Decompress the file-like object `stored` piece by piece."""
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
    """Content of a chunk up to a limit [byte], read forwards.

    `place` is the number of bytes taken. `checksum` is the CRC32 of the bytes read, or None to skip it.
    """

    def __init__(self, parts: Iterator[bytes], limit: int, checksum: int | None = 0) -> None:
        self.place, self.checksum = 0, checksum
        self._parts, self._limit, self._rest = parts, limit, b""

    def take(self, size: int) -> bytes:
        """The next `size` bytes, or fewer at the end."""
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
        """Skip forwards to an offset [byte]."""
        while self.place < place and self.take(min(AT_ONCE, place - self.place)):
            pass


def check_whole(section: Section, content: Content) -> None:
    """Raise ValueError if a chunk's size or checksum is not as declared; call it when all is taken."""
    if content.place != section.content_size:
        raise ValueError(f"it holds {content.place} bytes instead of {section.content_size}")
    if section.checksum and content.checksum != section.checksum:
        raise ValueError("its checksum is wrong")


class OnDisk:
    """Content of a chunk in a temporary file, for access at any offset."""

    place = 0

    def __init__(self, content: Content) -> None:
        self._file, self._next = TemporaryFile(prefix="hd_diag-"), 0  # noqa: SIM115 (open as long as this is)
        while part := content.take(AT_ONCE):
            self._file.write(part)
        self._file.flush()

    def skip(self, place: int) -> None:
        """Set the offset of `take` [byte]."""
        self._next = place

    def take(self, size: int) -> bytes:
        """The next `size` bytes from the offset that `skip` set, or fewer at the end."""
        found = os.pread(self._file.fileno(), size, self._next)
        self._next += len(found)
        return found


def pieces(content: Content, keep: Callable[[bytes], None]) -> Iterator[tuple[int, int, Block]]:
    """Yield consecutive pieces of whole records: offset and size in the content [byte], and their messages.

    A message above `LARGE` is its own piece, and the block has only its head. Raises ValueError as `parse`,
    and if the last record is incomplete.
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
    """Messages in the whole records at the beginning of `content`, and the offset where these end.

    Passes schema and channel records to `keep`. Raises ValueError for an impossible or too many records.
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
    """Block of the message at the beginning of `content`, which need only have its head."""
    return _messages_at(content[: MESSAGE.size], np.zeros(1, np.int64))


def check_end(content: bytes, stop: int) -> None:
    """Raise ValueError if the whole records end before the end of `content`."""
    if stop != len(content):
        longer = "a record is longer than the chunk"
        raise ValueError(longer if content[stop] else "it holds bytes that are not records")


def _equal_records(content: bytes, start: int, step: int) -> Integers:
    """Offsets of consecutive messages of size `step` from `start` on; at least one."""
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
