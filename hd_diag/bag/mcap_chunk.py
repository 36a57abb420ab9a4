"""Content of a chunk: decompressed within bounds, its messages as columns."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable

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
"""A chunk, or a message outside of one, above this is refused: recorders close a chunk after some megabytes,
and what is made of a chunk takes up to five times its memory [byte]."""
COMPRESSIONS = ("", "lz4", "zstd")
# A chunk that claims both more than this [byte] and more than so many times what is stored of it is refused
# unread: recordings seldom reach 100, and a file of some kilobytes could keep the reader busy for minutes.
_MAX_UNASKED, _MAX_RATIO = 64 << 20, 1000
_HEAD = np.dtype("u1, <u8, <u2, <u4, <u8, <u8")
_HEAD.names = ("opcode", "length", "channel", "sequence", "log_time", "publish_time")
# A chunk with more records is refused: an honest one of some megabytes has a hundredth of them.
_MAX_RECORDS = 1_000_000
_AT_ONCE = 1 << 17  # size that is decompressed at a time [byte]


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


def decompressed(compression: str, stored: bytes, limit: int, *, lenient: bool = False) -> bytes:
    """No more than `limit` bytes of what is stored, decompressed; with `lenient` those before a damage."""
    if compression not in COMPRESSIONS:
        raise ValueError(f"compression {compression!r} is not known")
    if not compression:
        return stored
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=limit))
    parts = []
    reader = zstandard.ZstdDecompressor().stream_reader(stored)
    try:
        while part := reader.read(min(limit, _AT_ONCE)):
            parts.append(part)
            limit -= len(part)
    except zstandard.ZstdError:
        if not lenient:
            raise
    return b"".join(parts)


def parse(content: bytes, keep: Callable[[bytes], None]) -> Block:
    """Messages among the records in `content`; schemas and channels are handed to `keep`.

    Raises ValueError where the records do not fit together.
    """
    first, more, position, ignored = np.empty(0, np.int64), array("q"), 0, 0
    end, head_at, message = len(content), RECORD.unpack_from, int(Opcode.MESSAGE)
    while position < end:
        opcode, length = head_at(content, position)
        stop = position + 9 + length
        if opcode != message:
            ignored += 1
            if opcode == 0:
                raise ValueError("it holds bytes that are not records")
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                keep(content[position:stop])
        elif more or len(first) or stop > end:
            more.append(position)
        else:
            first = _equal_records(content, position, stop - position)
            stop += int(first[-1]) - position
        position = stop
        if len(first) + len(more) + ignored > _MAX_RECORDS:
            raise ValueError(f"it holds more than {_MAX_RECORDS} records")
    if position != end:
        raise ValueError("a record is longer than the chunk")
    return _messages_at(content, np.concatenate([first, np.array(more, np.int64)]))


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
