"""Content of MCAP chunks: decompressed within bounds, checked, and taken apart into messages."""

from __future__ import annotations

import re
import struct
import zlib
from contextlib import suppress
from io import BufferedReader
from pathlib import Path

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from .block import Block, messages_at
from .errors import BagError
from .mcap_scan import CHUNK_HEAD, LENGTH, MAX_CHUNK, Scan, Section, chunk_at, keep

# Opcode of a chunk, and a length below 2**48, as all lengths are.
_MAYBE_CHUNK = re.compile(rb"(?=\x06[\s\S]{6}\0\0)")


def load(path: Path, file: BufferedReader, section: Section, result: Scan) -> Block:
    """Messages of a section; schemas and channels found on the way are added to `result`.

    Raises
    ------
    BagError
        Where the section is damaged.
    """
    try:
        return parse(_content(file, section), result)
    except (
        ValueError,
        struct.error,
        zstandard.ZstdError,
        RuntimeError,
        McapError,
        EOFError,
        MemoryError,
    ) as exc:
        raise BagError(path, f"chunk at byte {section.offset} is damaged: {exc}") from exc


def _content(file: BufferedReader, section: Section) -> bytes:
    if section.content_size > MAX_CHUNK:
        raise ValueError(f"it claims {section.content_size} bytes, more than {MAX_CHUNK}")
    file.seek(section.offset)
    stored = file.read(section.size)
    content = _decompress(section.compression, stored, section.content_size)
    if len(content) != section.content_size:
        raise ValueError(f"it holds {len(content)} bytes instead of {section.content_size}")
    if section.checksum and zlib.crc32(content) != section.checksum:
        raise ValueError("its checksum is wrong")
    return content


def _decompress(compression: str, stored: bytes, size: int) -> bytes:
    """Decompressed bytes, never more than `size` + 1."""
    if compression == "":
        return stored
    if size == 0:
        return b""
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1))
    if compression != "zstd":
        raise ValueError(f"compression {compression!r} is not known")
    return unzstd(stored, size)


def readable_part(file: BufferedReader, offset: int, end: int) -> bytes:
    """Whole records at the beginning of a chunk, of which the file has the bytes from `offset` to `end`.

    Compression works in blocks, so that the blocks before a cut can be read.
    """
    try:
        file.seek(offset)
        if file.read(1)[0] != Opcode.CHUNK:
            return b""
        section = chunk_at(file, offset, (1 << 64) - 1)
        file.seek(section.offset)
        stored = file.read(min(section.size, max(0, end - section.offset)))
        content = _decompress_part(section.compression, stored, min(section.content_size, MAX_CHUNK))
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


def unzstd(stored: bytes, limit: int) -> bytes:
    """Decompressed zstd frame of no more than `limit` bytes."""
    declared = zstandard.get_frame_parameters(stored).content_size
    if declared != zstandard.CONTENTSIZE_UNKNOWN and declared > limit:
        raise ValueError(f"it unpacks to {declared} bytes instead of {limit}")
    return zstandard.ZstdDecompressor().decompress(stored, max_output_size=limit)


def parse(content: bytes, result: Scan) -> Block:
    """Messages among the records in `content`; schemas and channels are added to `result`.

    Raises
    ------
    ValueError
        Where the records do not fit together.
    """
    offsets: list[npt.NDArray[np.int64]] = []
    position, end, tried = 0, len(content), False
    single: list[int] = []
    while position < end:
        if position + 9 > end:
            raise ValueError("a record is cut off")
        opcode = content[position]
        (length,) = LENGTH.unpack_from(content, position + 1)
        after = position + 9 + length
        if after > end:
            raise ValueError("a record is longer than the chunk")
        if opcode == Opcode.MESSAGE:
            if not tried and length < end:
                tried = True
                run = _equal_records(content, position, 9 + length)
                offsets.append(run)
                position = int(run[-1]) + 9 + length
                continue
            single.append(position)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            keep(result, opcode, content[position + 9 : after])
        position = after
    offsets.append(np.array(single, np.int64))
    return messages_at(content, np.concatenate(offsets))


def _equal_records(content: bytes, start: int, step: int) -> npt.NDArray[np.int64]:
    """Places of the messages of one size that follow one another from `start`; at least one."""
    count = (len(content) - start) // step
    heads = np.frombuffer(content, np.uint8, count * step, start).reshape(count, step)[:, :9]
    same = (heads == heads[0]).all(axis=1)
    count = count if same.all() else int(same.argmin())
    return start + step * np.arange(count, dtype=np.int64)
