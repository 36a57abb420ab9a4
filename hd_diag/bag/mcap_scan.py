"""What is in an MCAP file: chunks and messages outside of them, topics, counts; nothing is trusted.

The file is walked record by record, so that the summary and the indexes may be missing, wrong or cut off.
Of chunks only the heads are read then; their content is decompressed within bounds and checked when needed.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BufferedReader, BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from hd_diag.arrays import Integers
from hd_diag.bag.block import Block, Topic, gather
from hd_diag.bag.errors import BagError
from hd_diag.messages.schemas import Definition

MAGIC = MCAP0_MAGIC
MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time and publish time [ns]."""
RECORD = struct.Struct("<BQ")
"""Head of any record: opcode and length."""
MAX_CHUNK = 256 << 20
"""A chunk, or a message outside of one, above this is refused: recorders close a chunk after some megabytes,
and what is made of a chunk takes up to five times its memory [byte]."""
COMPRESSIONS = ("", "lz4", "zstd")
_CHUNK = struct.Struct("<QQQII")
# Opcode of a chunk, and a length below 2**48, as all lengths are.
_MAYBE_CHUNK = re.compile(rb"(?=\x06[\s\S]{6}\0\0)")
_WINDOW = 16 << 20
# A chunk that claims both more than this [byte] and more than so many times what is stored of it is refused
# unread: recordings seldom reach 100, and a file of some kilobytes could keep the reader busy for minutes.
_MAX_UNASKED, _MAX_RATIO = 64 << 20, 1000
_MAX_RECORD = 16 << 20  # of other kinds [byte]
_RUN = 1 << 20  # messages outside of chunks are taken together up to about this size [byte]


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


_HEAD = np.dtype("u1, <u8, <u2, <u4, <u8, <u8")
_HEAD.names = ("opcode", "length", "channel", "sequence", "log_time", "publish_time")
# More records in a chunk that are no messages are refused: an honest one has a few for each topic.
_MAX_OTHERS = 1_000_000
_AT_ONCE = 1 << 17  # size that is decompressed at a time [byte]
# What the libraries raise on damaged content.
_DAMAGE = (ValueError, struct.error, zstandard.ZstdError, RuntimeError, McapError, EOFError, MemoryError)


class DamagedChunk(BagError):
    """A chunk cannot be used; what is before and behind it can be recovered."""


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


class Scan:
    """What a walk over an open MCAP file finds: sections, schemas, channels, statistics.

    `end` is where the last whole record ends [byte], `problem` why that is not the end of the file; schemas
    and channels that stand in chunks are known only where the summary repeats them. Raises BagError, which
    names `path`, where it is not an MCAP file of ROS 2.
    """

    def __init__(self, path: Path, file: BufferedReader) -> None:
        self.size, self.end = os.fstat(file.fileno()).st_size, len(MAGIC)
        self.sections: list[Section] = []
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.statistics: Statistics | None = None
        self.profile = self.problem = ""
        self._path, self._file = path, file
        if self.read(0, len(MAGIC)) != MAGIC:
            raise BagError(path, "is not an MCAP file" if self.size else "is empty")
        self.walk()
        if self.profile not in ("", "ros2"):
            raise BagError(path, f"has profile {self.profile!r}, not ros2")

    def read(self, offset: int, size: int) -> bytes:
        """What stands at a place, also beside other readers; ValueError where the file was closed."""
        return os.pread(self._file.fileno(), size, offset)

    def walk(self) -> None:
        """Walk on from `end`."""
        self.problem, opcode = "", 0
        try:
            while opcode != Opcode.FOOTER:
                head = self.read(self.end, RECORD.size)
                if len(head) < RECORD.size:
                    self.problem = "has no end: it was cut off, or is still being written"
                    return
                opcode, length = RECORD.unpack(head)
                stop = self.end + RECORD.size + length
                if opcode == 0 or stop > self.size:
                    self.problem = f"is cut off or damaged at byte {self.end} of {self.size}"
                    return
                self._take(opcode, length)
                self.end = stop
            if self.read(self.end, len(MAGIC)) == MAGIC:
                self.end += len(MAGIC)
            else:
                self.problem = "has no end: the closing magic is missing"
        except (struct.error, ValueError, McapError) as exc:
            self.problem = f"damaged record at byte {self.end}: {exc}"

    def keep(self, record: bytes) -> None:
        """Remember what a record says; raises several kinds of errors where it is damaged."""
        for found in StreamReader(BytesIO(record), skip_magic=True).records:
            match found:
                case Schema():
                    self.schemas[found.id] = found
                case Channel():
                    self.channels[found.id] = found
                case Statistics():
                    self.statistics = found
                case Header():
                    self.profile = found.profile
            return

    def topics(self) -> dict[int, Topic]:
        """Topics, by number, of the channels that have a schema and are in CDR."""
        topics = {}
        for number, channel in self.channels.items():
            schema = self.schemas.get(channel.schema_id)
            if schema is not None and channel.message_encoding in ("cdr", ""):
                text, more = schema.data.decode(errors="replace"), channel.metadata
                known = Definition(schema.name, text, schema.encoding, more.get("topic_type_hash", ""))
                offers = more.get("offered_qos_profiles", "")
                topics[number] = Topic(channel.topic, schema.name, 0, known, offers)
        return topics

    def chunk_at(self, offset: int, length: int) -> Section:
        """The chunk record at `offset` of `length` bytes behind its head; ValueError where it is damaged."""
        head = self.read(offset + RECORD.size, _CHUNK.size + 24)
        try:
            start, end, content_size, checksum, name_length = _CHUNK.unpack_from(head)
            (size,) = struct.unpack_from("<Q", head, _CHUNK.size + name_length)
            name = head[_CHUNK.size : _CHUNK.size + name_length].decode()
        except struct.error as exc:
            raise ValueError("the chunk's compression is not known") from exc
        before = _CHUNK.size + name_length + 8
        if before + size > length:
            raise ValueError("the chunk is larger than its record")
        return Section(offset + RECORD.size + before, size, start, end, name, content_size, checksum)

    def find_chunk(self, start: int) -> int | None:
        """Place of the next chunk record from `start` on whose sizes agree; None where there is none."""
        for window in range(start, self.size, _WINDOW):
            content = self.read(window, _WINDOW + 16)
            for match in _MAYBE_CHUNK.finditer(content, 0, _WINDOW + 9):
                place = window + match.start()
                length = RECORD.unpack_from(content, match.start())[1]
                with suppress(ValueError):
                    found = self.chunk_at(place, length)
                    is_whole = found.offset + found.size == place + RECORD.size + length <= self.size
                    is_known = found.compression in COMPRESSIONS and found.content_size <= MAX_CHUNK
                    if is_whole and is_known and found.start <= found.end:
                        return place
        return None

    def load(self, sections: Sequence[Section]) -> Block:
        """Messages of some sections; schemas and channels among them are kept.

        Safe beside other readers of the same file; DamagedChunk where a section cannot be used.
        """
        try:
            contents = []
            for section in sections:
                where = f"chunk at byte {section.offset}"
                check_claim(section.content_size, section.size)
                stored = self.read(section.offset, section.size)
                content = _decompressed(section.compression, stored, section.content_size + 1)
                if len(content) != section.content_size:
                    raise ValueError(f"it holds {len(content)} bytes instead of {section.content_size}")
                if section.checksum and zlib.crc32(content) != section.checksum:
                    raise ValueError("its checksum is wrong")
                contents.append(content)
            where = f"chunk at or after byte {sections[0].offset}"
            return _parse(contents[0] if len(contents) == 1 else b"".join(contents), self.keep)
        except _DAMAGE as exc:
            raise DamagedChunk(self._path, f"{where} is damaged: {exc}") from exc

    def load_part(self, offset: int, end: int) -> Block | None:
        """Messages at the beginning of a chunk of which the file has the bytes from `offset` to `end`.

        Compression works in blocks, so that the blocks before a cut can be read. None where nothing can.
        """
        try:
            if self.read(offset, 1)[0] != Opcode.CHUNK:
                return None
            section = self.chunk_at(offset, (1 << 64) - 1)
            stored = self.read(section.offset, min(section.size, max(0, end - section.offset), MAX_CHUNK))
            limit = min(section.content_size, believable(len(stored)))
            content = _decompressed(section.compression, stored, limit, lenient=True)
            stop = following = 0
            while following <= len(content):
                stop = following
                if stop + RECORD.size > len(content) or not content[stop]:
                    break
                following += RECORD.size + RECORD.unpack_from(content, stop)[1]
            block = _parse(content[:stop], self.keep)
            return block if len(block) else None
        except (*_DAMAGE, IndexError):
            return None

    def _take(self, opcode: int, length: int) -> None:
        """Take the record at `end`."""
        if opcode == Opcode.CHUNK:
            self.sections.append(self.chunk_at(self.end, length))
        elif opcode == Opcode.MESSAGE:
            check_claim(length, length)
            self._add_message(length)
        elif opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
            if length > _MAX_RECORD:
                raise ValueError(f"{length} bytes are too many for such a record")
            self.keep(self.read(self.end, RECORD.size + length))

    def _add_message(self, length: int) -> None:
        """Add the message outside of chunks that stands at `end` to those right before it."""
        log_time = MESSAGE.unpack(self.read(self.end, MESSAGE.size))[4]
        last = self.sections[-1] if self.sections else None
        if last is None or last.is_chunk or last.offset + last.size != self.end or last.size > _RUN:
            last = Section(self.end, 0, log_time, log_time, is_chunk=False)
            self.sections.append(last)
        last.size = last.content_size = last.size + RECORD.size + length
        last.start, last.end = min(last.start, log_time), max(last.end, log_time)


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


def _parse(content: bytes, keep: Callable[[bytes], None]) -> Block:
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
            if opcode == 0 or ignored > _MAX_OTHERS:
                raise ValueError("it holds bytes that are not records")
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                keep(content[position:stop])
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
