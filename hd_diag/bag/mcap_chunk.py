"""Content of MCAP chunks: decompressed within bounds, checked, and taken apart into messages."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Sequence
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from hd_diag.arrays import Integers
from hd_diag.bag.block import Block, gather
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_scan import (
    COMPRESSIONS,
    MAX_CHUNK,
    MESSAGE,
    RECORD,
    Scan,
    Section,
    believable,
    check_claim,
)

_HEAD = np.dtype("u1, <u8, <u2, <u4, <u8, <u8")
_HEAD.names = ("opcode", "length", "channel", "sequence", "log_time", "publish_time")
# More records in a chunk that are no messages are refused: an honest one has a few for each topic.
_MAX_OTHERS = 1_000_000
_AT_ONCE = 1 << 17  # size that is decompressed at a time [byte]
# What the libraries raise on damaged content.
_DAMAGE = (ValueError, struct.error, zstandard.ZstdError, RuntimeError, McapError, EOFError, MemoryError)


class DamagedChunk(BagError):
    """A chunk cannot be used; what is before and behind it can be recovered."""


def load(path: Path, found: Scan, sections: Sequence[Section]) -> Block:
    """Messages of some sections; schemas and channels among them are added to `found`.

    Safe beside other readers of the same file; BagError where a section is damaged, or the file was closed.
    """
    try:
        contents = []
        for section in sections:
            where = f"chunk at byte {section.offset}"
            check_claim(section.content_size, section.size)
            stored = found.read(section.offset, section.size)
            content = _decompressed(section.compression, stored, section.content_size + 1)
            if len(content) != section.content_size:
                raise ValueError(f"it holds {len(content)} bytes instead of {section.content_size}")
            if section.checksum and zlib.crc32(content) != section.checksum:
                raise ValueError("its checksum is wrong")
            contents.append(content)
        where = f"chunk at or after byte {sections[0].offset}"
        return _parse(contents[0] if len(contents) == 1 else b"".join(contents), found)
    except _DAMAGE as exc:
        raise DamagedChunk(path, f"{where} is damaged: {exc}") from exc


def load_part(found: Scan, offset: int, end: int) -> Block | None:
    """Messages at the beginning of a chunk of which the file has the bytes from `offset` to `end`.

    Compression works in blocks, so that the blocks before a cut can be read. None where nothing can.
    """
    try:
        if found.read(offset, 1)[0] != Opcode.CHUNK:
            return None
        section = found.chunk_at(offset, (1 << 64) - 1)
        stored = found.read(section.offset, min(section.size, max(0, end - section.offset), MAX_CHUNK))
        limit = min(section.content_size, believable(len(stored)))
        content = _decompressed(section.compression, stored, limit, lenient=True)
        stop = following = 0
        while following <= len(content):
            stop = following
            if stop + RECORD.size > len(content) or not content[stop]:
                break
            following += RECORD.size + RECORD.unpack_from(content, stop)[1]
        block = _parse(content[:stop], found)
        return block if len(block) else None
    except (*_DAMAGE, IndexError):
        return None


def _decompressed(compression: str, stored: bytes, limit: int, *, lenient: bool = False) -> bytes:
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


def _parse(content: bytes, found: Scan) -> Block:
    """Messages among the records in `content`; schemas and channels are added to `found`.

    Raises ValueError where the records do not fit together.
    """
    first, more, position, ignored = np.empty(0, np.int64), array("q"), 0, 0
    end, head_at, message = len(content), RECORD.unpack_from, int(Opcode.MESSAGE)
    while position < end:
        opcode, length = head_at(content, position)
        stop = position + 9 + length
        if opcode != message:
            ignored += 1
            if opcode == 0 or ignored > _MAX_OTHERS:
                raise ValueError("it holds records that are none")
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                found.keep(content[position:stop])
        elif more or len(first) or stop > end:
            more.append(position)
        else:
            first = _equal_records(content, position, stop - position)
            stop += int(first[-1]) - position
        position = stop
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
