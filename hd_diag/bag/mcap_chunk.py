"""Content of MCAP chunks: decompressed within bounds, checked, and taken apart into messages."""

from __future__ import annotations

import os
import re
import struct
import zlib
from array import array
from collections.abc import Sequence
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from hd_diag.bag.block import Block, messages_at
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_file import MESSAGE
from hd_diag.bag.mcap_scan import (
    CHUNK_HEAD,
    LENGTH,
    MAX_CHUNK,
    Scan,
    Section,
    believable,
    check_claim,
    chunk_at,
    heads_at,
    keep,
)

# Opcode of a chunk, and a length below 2**48, as all lengths are.
_MAYBE_CHUNK = re.compile(rb"(?=\x06[\s\S]{6}\0\0)")
# Times from here on do not fit into 64 bits with a sign [ns].
_NO_TIME = np.uint64(1 << 63)
# More records in a chunk that are no messages are refused: an honest one has a few for each topic.
_MAX_OTHERS = 1_000_000
# What the libraries raise on damaged content.
_DAMAGE = (ValueError, struct.error, zstandard.ZstdError, RuntimeError, McapError, EOFError, MemoryError)


class DamagedChunk(BagError):
    """A chunk cannot be used; what is before and behind it can be recovered."""


class Content(NamedTuple):
    """Records of some sections, and where the message indexes say that messages begin among them (n,)."""

    records: bytes
    places: npt.NDArray[np.int64]


def load(path: Path, file: BufferedReader, sections: Sequence[Section], result: Scan) -> Block:
    """Messages of some sections; schemas and channels found on the way are added to `result`.

    Raises
    ------
    BagError
        Where a section is damaged.
    """
    return messages_of(path, sections, read(path, file, sections), result)


def read(path: Path, file: BufferedReader, sections: Sequence[Section]) -> Content:
    """Decompressed and checked content of some sections; safe beside other readers of the same file.

    Raises
    ------
    BagError
        Where a section is damaged.
    """
    contents, places, before = [], [], 0
    zstd = zstandard.ZstdDecompressor()  # one for all: small chunks take as long as making it
    for section in sections:
        try:
            contents.append(_content(file, section, zstd))
        except _DAMAGE as exc:
            raise DamagedChunk(path, f"chunk at byte {section.offset} is damaged: {exc}") from exc
        places.append(before + indexed_places(file, section))
        before += section.content_size
    try:
        return Content(contents[0] if len(contents) == 1 else b"".join(contents), np.concatenate(places))
    except _DAMAGE as exc:
        raise _damaged(path, sections, exc) from exc


def messages_of(path: Path, sections: Sequence[Section], content: Content, result: Scan) -> Block:
    """Messages in what was read of some sections; schemas and channels among them are added to `result`.

    Raises
    ------
    BagError
        Where the records do not fit together.
    """
    try:
        return _parse_at(content.records, content.places, result) or parse(content.records, result)
    except _DAMAGE as exc:
        raise _damaged(path, sections, exc) from exc


def load_storable(path: Path, file: BufferedReader, section: Section, result: Scan) -> tuple[Block, int]:
    """Messages of a section whose times can be written, and the number of the others.

    Raises
    ------
    BagError
        Where the section is damaged.
    """
    try:
        content = _content(file, section, zstandard.ZstdDecompressor())
        places = _places(content, result)
        heads = heads_at(content, places)
        storable = np.maximum(heads["log_time"], heads["publish_time"]) < _NO_TIME
        return messages_at(content, places[storable]), int((~storable).sum())
    except _DAMAGE as exc:
        raise _damaged(path, [section], exc) from exc


def _damaged(path: Path, sections: Sequence[Section], exc: Exception) -> DamagedChunk:
    return DamagedChunk(path, f"chunk at or after byte {sections[0].offset} is damaged: {exc}")


def _at(file: BufferedReader, offset: int, size: int) -> bytes:
    """Bytes at a place, without moving the file's own."""
    return os.pread(file.fileno(), size, offset)


def _content(file: BufferedReader, section: Section, zstd: zstandard.ZstdDecompressor) -> bytes:
    check_claim(section.content_size, section.size)
    stored = _at(file, section.offset, section.size)
    content = _decompress(section.compression, stored, section.content_size, zstd)
    if len(content) != section.content_size:
        raise ValueError(f"it holds {len(content)} bytes instead of {section.content_size}")
    if section.checksum and zlib.crc32(content) != section.checksum:
        raise ValueError("its checksum is wrong")
    return content


def _decompress(compression: str, stored: bytes, size: int, zstd: zstandard.ZstdDecompressor) -> bytes:
    """Decompressed bytes, never more than `size` + 1."""
    if compression == "":
        return stored
    if size == 0:
        return b""
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1))
    if compression != "zstd":
        raise ValueError(f"compression {compression!r} is not known")
    return unzstd(stored, size, zstd)


def load_part(path: Path, file: BufferedReader, offset: int, end: int, result: Scan) -> Block:
    """Messages at the beginning of a chunk of which the file has the bytes from `offset` to `end`.

    Compression works in blocks, so that the blocks before a cut can be read.

    Raises
    ------
    BagError
        Where even that is damaged.
    """
    try:
        return parse(_readable_part(file, offset, end), result)
    except _DAMAGE as exc:
        raise BagError(path, f"chunk at byte {offset} is damaged: {exc}") from exc


def _readable_part(file: BufferedReader, offset: int, end: int) -> bytes:
    """Whole records that can be read; none where this is no chunk."""
    try:
        file.seek(offset)
        if file.read(1)[0] != Opcode.CHUNK:
            return b""
        section = chunk_at(file, offset, (1 << 64) - 1)
        file.seek(section.offset)
        stored = file.read(min(section.size, max(0, end - section.offset), MAX_CHUNK))
        limit = min(section.content_size, believable(len(stored)))
        content = _decompress_part(section.compression, stored, limit)
    except (struct.error, IndexError, ValueError, RuntimeError, MemoryError):
        return b""
    stop = 0
    while stop + 9 <= len(content):
        (length,) = LENGTH.unpack_from(content, stop + 1)
        if content[stop] == 0 or stop + 9 + length > len(content):
            break
        stop += 9 + length
    return content[:stop]


def _decompress_part(compression: str, stored: bytes, limit: int) -> bytes:
    if compression == "":
        return stored
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=limit))
    parts: list[bytes] = []
    reader = zstandard.ZstdDecompressor().stream_reader(stored)
    with suppress(zstandard.ZstdError):
        while part := reader.read(min(limit, 1 << 17)):
            parts.append(part)
            limit -= len(part)
    return b"".join(parts)


def find_chunk(file: BufferedReader, start: int, size: int) -> int | None:
    """Place of the next chunk record from `start` on whose sizes agree; None where there is none."""
    window = 16 << 20
    while start < size:
        file.seek(start)
        content = file.read(window + 64)
        for match in _MAYBE_CHUNK.finditer(content, 0, window + 9):
            place = start + match.start()
            (length,) = LENGTH.unpack_from(content, match.start() + 1)
            if place + 9 + length <= size and _is_chunk(
                content[match.start() + 9 : match.start() + 64], length
            ):
                return place
        start += window
    return None


def _is_chunk(head: bytes, length: int) -> bool:
    if len(head) < CHUNK_HEAD.size + 8:
        return False
    start, end, content_size, _, name_length = CHUNK_HEAD.unpack_from(head)
    name = head[CHUNK_HEAD.size : CHUNK_HEAD.size + name_length]
    if name not in (b"", b"lz4", b"zstd") or name_length > 4 or start > end or content_size > MAX_CHUNK:
        return False
    (stored,) = LENGTH.unpack_from(head, CHUNK_HEAD.size + name_length)
    return bool(length == CHUNK_HEAD.size + name_length + 8 + stored)


def unzstd(stored: bytes, limit: int, zstd: zstandard.ZstdDecompressor) -> bytes:
    """Zstd frame of no more than `limit` bytes, decompressed."""
    limit = min(limit, believable(len(stored)))
    declared = zstandard.get_frame_parameters(stored).content_size
    if declared != zstandard.CONTENTSIZE_UNKNOWN and declared > limit:
        raise ValueError(f"it unpacks to {declared} bytes, more than {limit}")
    return zstd.decompress(stored, max_output_size=limit)


def indexed_places(file: BufferedReader, section: Section) -> npt.NDArray[np.int64]:
    """Where in a chunk its message indexes say that messages begin; they may be wrong or missing."""
    begin, end = section.indexes or (0, 0)
    records, position, found = _at(file, begin, min(end - begin, MAX_CHUNK)), 0, [np.empty(0, np.int64)]
    while position + 15 <= len(records) and records[position] == Opcode.MESSAGE_INDEX:
        (length,) = LENGTH.unpack_from(records, position + 1)
        stop = position + 9 + length
        if stop > len(records) or (length - 6) % 16:
            break
        found.append(np.frombuffer(records, "<i8", (length - 6) // 8, position + 15)[1::2])
        position = stop
    places = np.concatenate(found)
    places.sort()
    return places


def _parse_at(content: bytes, places: npt.NDArray[np.int64], result: Scan) -> Block | None:
    """As `parse`, by places where messages should begin; None unless these are all there are."""
    if not len(places) or places[0] < 0 or places[-1] > len(content) - MESSAGE.size:
        return None
    if (np.diff(places) <= 0).any():  # a chunk's may lie in the next one's
        return None
    if (np.frombuffer(content, np.uint8)[places] != Opcode.MESSAGE).any():
        return None
    try:
        block = messages_at(content, places)
        others = _between(content, places, block.offset + block.size)
    except ValueError:
        return None
    if others is not None:
        _keep_definitions(content, others, result)
    return None if others is None else block


def _between(content: bytes, begins: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]) -> list[int] | None:
    """Places of the records between messages; None where messages overlap or are among them.

    Raises
    ------
    ValueError
        Where there are no whole records.
    """
    after, before = np.append(0, ends), np.append(begins, len(content))
    if (ends < begins + MESSAGE.size).any() or (after > before).any():
        return None
    others: list[int] = []
    for gap in np.flatnonzero(after < before):  # few, and small: definitions before their first message
        run, offsets, found = _walk(content[after[gap] : before[gap]])
        if len(run) or offsets:
            return None
        others += [int(after[gap]) + place for place in found]
    return others


def parse(content: bytes, result: Scan) -> Block:
    """Messages among the records in `content`; schemas and channels are added to `result`.

    Raises
    ------
    ValueError
        Where the records do not fit together.
    """
    return messages_at(content, _places(content, result))


def _places(content: bytes, result: Scan) -> npt.NDArray[np.int64]:
    """Places of the messages among the records in `content`; schemas and channels are added to `result`."""
    run, offsets, others = _walk(content)
    _keep_definitions(content, others, result)
    return np.concatenate([run, np.array(offsets, np.int64)])


def _keep_definitions(content: bytes, places: list[int], result: Scan) -> None:
    for place in places:
        (length,) = LENGTH.unpack_from(content, place + 1)
        keep(result, content[place], content[place + 9 : place + 9 + length])


def _walk(content: bytes) -> tuple[npt.NDArray[np.int64], array[int], list[int]]:
    """Places of the first messages, which have one size; of the other messages; of schemas and channels."""
    run = np.empty(0, np.int64)
    offsets = array("q")
    others: list[int] = []
    ignored = 0
    position, end, length_at, message = 0, len(content), LENGTH.unpack_from, int(Opcode.MESSAGE)
    while position < end:
        if content[position] != message:
            if content[position] in (Opcode.SCHEMA, Opcode.CHANNEL):
                others.append(position)
            ignored += 1
            if not content[position] or ignored > _MAX_OTHERS:
                raise ValueError("it holds records that are none")
        elif offsets or len(run):
            offsets.append(position)
        else:
            step = 9 + length_at(content, position + 1)[0]
            if position + step > end:
                break
            run = _equal_records(content, position, step)
            position = int(run[-1])
        position += 9 + length_at(content, position + 1)[0]
    if position != end:
        raise ValueError("a record is longer than the chunk")
    return run, offsets, others


def _equal_records(content: bytes, start: int, step: int) -> npt.NDArray[np.int64]:
    """Places of the messages of one size that follow one another from `start`; at least one."""
    count = (len(content) - start) // step
    heads = np.frombuffer(content, np.uint8, count * step, start).reshape(count, step)[:, :9]
    same = (heads == heads[0]).all(axis=1)
    count = count if same.all() else int(same.argmin())
    return start + step * np.arange(count, dtype=np.int64)
