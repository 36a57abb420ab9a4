"""Content of a chunk: decompressed within bounds, its messages as columns."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode

from hd_diag.arrays import Bytes, Integers
from hd_diag.bag.block import Block, forget, gather

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
"""How much content is taken at once where chunks are smaller [byte]."""
AT_ONCE = 1 << 18
"""Size that is decompressed, or copied of what is long, at a time [byte]."""
COMPRESSIONS = ("", "lz4", "zstd")
# A chunk that claims both more than this [byte] and more than so many times what is stored of it is refused
# unread: recordings seldom reach 100, and a file of some kilobytes could keep the reader busy for minutes.
_MAX_UNASKED, _MAX_RATIO = 64 << 20, 1000
_HEAD = np.dtype("u1, <u8, <u2, <u4, <u8, <u8")
_HEAD.names = ("opcode", "length", "channel", "sequence", "log_time", "publish_time")
# A chunk with more records is refused, where they are so many for its size: an honest one of some megabytes
# has a hundredth of them, and the shortest messages with joint states are longer [byte].
_MAX_RECORDS, _LEAST_RECORD = 1_000_000, 64


@dataclass
class Section:
    """A chunk, or messages outside of chunks that follow one another: place [byte] and log times [ns].

    Sizes, times and checksum (0 for none) are those that the chunk declares.
    """

    offset: int
    size: int
    start: int
    end: int
    compression: str = ""
    content_size: int = 0
    checksum: int = 0
    is_chunk: bool = True


def believable(stored: int) -> int:
    """How much may unpack from so many bytes [byte]."""
    return min(MAX_CHUNK, max(_MAX_UNASKED, _MAX_RATIO * stored))


def check_claim(claimed: int, stored: int) -> None:
    """Raise ValueError for content [byte] that is too large, or more than `believable` of what is stored."""
    if max(claimed, stored) > MAX_CHUNK:
        raise ValueError(f"it claims {max(claimed, stored)} bytes, more than {MAX_CHUNK}")
    if claimed > believable(stored):
        most = f"{_MAX_UNASKED} and {_MAX_RATIO} times the {stored} stored"
        raise ValueError(f"it claims {claimed} bytes, more than {most}")


def decompressed(compression: str, stored: Any) -> Iterator[bytes]:
    """What the ``read`` of `stored` gives, decompressed bit by bit."""
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


def parse(content: Bytes, keep: Callable[[bytes], None]) -> tuple[Block, int]:
    """Messages among the whole records at the beginning of `content`, and where these end.

    Schemas and channels are handed to `keep`. Raises ValueError where a record cannot be.
    """
    most, records = max(_MAX_RECORDS, len(content) // _LEAST_RECORD), 0
    place, size, found = 0, PIECE, [np.empty((5, 0), np.int64)]
    while True:
        window = content[place : place + size]
        offset, stop, count = _messages_in(window, keep)
        records += count
        if records > most:
            raise ValueError(f"it holds more than {most} records")
        columns = _columns_at(window, offset)
        columns[0] += place
        found.append(columns)
        forget(content)
        place += stop
        opcode, length = RECORD.unpack_from(content, place) if place + RECORD.size <= len(content) else (0, 0)
        if opcode == 0 or place + RECORD.size + length > len(content):
            return Block(content, *np.concatenate(found, axis=1)), place
        size = max(PIECE, RECORD.size + length)


def _messages_in(content: Bytes, keep: Callable[[bytes], None]) -> tuple[Integers, int, int]:
    """Places of the messages among the whole records here, where these end, and how many they are."""
    first, more, position, ignored = np.empty(0, np.int64), array("q"), 0, 0
    end, view, head_at, message = len(content), memoryview(content), RECORD.unpack_from, int(Opcode.MESSAGE)
    while position + RECORD.size <= end:
        opcode, length = head_at(view, position)
        stop = position + RECORD.size + length
        if stop > end or opcode == 0:
            break
        if opcode != message:
            ignored += 1
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                keep(bytes(view[position:stop]))
        elif more or len(first):
            more.append(position)
        else:
            first = _equal_records(content, position, stop - position)
            stop += int(first[-1]) - position
        position = stop
    places = np.concatenate([first, np.array(more, np.int64)])
    return places, position, len(places) + ignored


def check_end(content: Bytes, stop: int) -> None:
    """Raise ValueError where whole records do not reach the end."""
    if stop != len(content):
        longer = "a record is longer than the chunk"
        raise ValueError(longer if content[stop] else "it holds bytes that are not records")


def _equal_records(content: Bytes, start: int, step: int) -> Integers:
    """Places of the messages of one size that follow one another from `start`; at least one."""
    count = (len(content) - start) // step
    heads = content[start : start + count * step].reshape(count, step)[:, :9]
    same = (heads == heads[0]).all(axis=1)
    count = count if same.all() else int(same.argmin())
    return start + step * np.arange(count, dtype=np.int64)


def _columns_at(data: Bytes, offset: Integers) -> Integers:
    """Place and size of the contents of messages [byte], channel and times [ns], shape (5, n)."""
    if len(offset) and offset[-1] + MESSAGE.size > len(data):
        raise ValueError("a message has no room for its times")
    heads = np.ascontiguousarray(gather(data, offset, MESSAGE.size)).view(_HEAD)[:, 0]
    size = heads["length"].astype(np.int64) + RECORD.size - MESSAGE.size
    if len(size) and int(size.min()) < 0:
        raise ValueError("a message is too short for its times")
    columns = (heads[name].astype(np.int64) for name in ("channel", "log_time", "publish_time"))
    return np.stack([offset + MESSAGE.size, size, *columns])
