"""Scan of an untrusted MCAP file: chunks and messages outside of them, topics, counts.

The scan walks the file record by record, so the summary and the indexes may be missing, wrong or cut off.
It reads only the heads of chunks. Their content is decompressed within limits and checked when it is
needed.
"""

from __future__ import annotations

import os
import re
import struct
import tempfile
import threading
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from io import BufferedReader, BytesIO
from pathlib import Path

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from hd_diag.bag.block import NO_SCHEMA, Block, LongMessage, Topic
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_chunk import (
    AT_ONCE,
    COMPRESSIONS,
    LARGE,
    MAX_CHUNK,
    MESSAGE,
    RECORD,
    Content,
    OnDisk,
    Section,
    believable,
    check_claim,
    check_end,
    check_whole,
    decompressed,
    head_of,
    parse,
    pieces,
)
from hd_diag.bag.other_files import PEEKED, told
from hd_diag.messages.schemas import Definition

MAGIC = MCAP0_MAGIC
_CHUNK, _FOOTER = struct.Struct("<QQQII"), struct.Struct("<QQI")
# Opcode of a chunk, and a length below 2**48, as in every real file.
_MAYBE_CHUNK = re.compile(rb"(?=\x06[\s\S]{6}\0\0)")
_WINDOW, _PEEKED = 16 << 20, 1 << 14
_MAX_RECORD = 16 << 20  # largest record except for chunks and messages [byte]
_RUN = 1 << 20  # messages outside of chunks form sections of about this size [byte]
_MOST_OPEN = 4  # large chunks open at once, because chunks overlap in time


# Errors that the libraries raise on damaged content.
_DAMAGE = (ValueError, struct.error, zstandard.ZstdError, RuntimeError, McapError, EOFError, MemoryError)


class DamagedChunk(BagError):
    """A chunk cannot be used; data before and after it can be recovered."""


class Scan:
    """Sections, schemas, channels and statistics of an open MCAP file, found by a walk over its records.

    `end` is where the last whole record ends [byte]; `problem` says why that is not the file's end. Until
    a chunk is loaded, its schemas and channels are known only if the summary repeats them. Raises BagError,
    which names `path`, if the file is not MCAP.
    """

    def __init__(self, path: Path, file: BufferedReader) -> None:
        self.size, self.end = os.fstat(file.fileno()).st_size, len(MAGIC)
        self.sections: list[Section] = []
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._kept: dict[bytes, bytes] = {}  # records of schemas and channels by kind and number
        self._topics: dict[int, Topic] = {}
        self.statistics: Statistics | None = None
        self.profile = self.problem = ""
        self._path, self._file = path, file
        self._begin, self._ahead, self._is_summary = 0, b"", False
        self._open: dict[int, Content | OnDisk] = {}
        self._lock = threading.Lock()
        if self.read(0, len(MAGIC)) != MAGIC:
            raise BagError(path, told(self.read(0, PEEKED)))
        self.walk()

    def read(self, offset: int, size: int) -> bytes:
        """Bytes at an offset; safe with concurrent readers; ValueError if the file was closed."""
        return os.pread(self._file.fileno(), size, offset)

    def _peek(self, size: int) -> bytes:
        """Bytes at `end` from a buffer that is read ahead, because records outside of chunks are small."""
        start = self.end - self._begin
        if not 0 <= start <= len(self._ahead) - size:
            start, self._begin, self._ahead = 0, self.end, self.read(self.end, _PEEKED)
        return self._ahead[start : start + size]

    def walk(self) -> None:
        """Walk over the records from `end` on; sets `end` and `problem`."""
        self.problem, opcode = "", 0
        try:
            while opcode != Opcode.FOOTER:
                head = self._peek(RECORD.size)
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
                self._check_summary()
            else:
                self.problem = "has no end: the closing magic is missing"
        except (struct.error, ValueError, McapError) as exc:
            self.problem = f"damaged record at byte {self.end}: {exc}"

    def _check_summary(self) -> None:
        """Check the summary against its checksum, if the footer has both."""
        end = self.end - len(MAGIC) - 4
        start, _, checksum = _FOOTER.unpack(self.read(end - _FOOTER.size + 4, _FOOTER.size))
        if not start or not checksum:
            return
        found = 0
        for place in range(start, end, _WINDOW):
            found = zlib.crc32(self.read(place, min(_WINDOW, end - place)), found)
        if start > end or found != checksum:
            self.problem, self.statistics = "is damaged: the checksum of its summary is wrong", None

    def keep(self, record: bytes, repeats: bool = False) -> None:
        """Store the schema, channel, statistics or profile in a record; a damaged one raises various errors.

        Known records are skipped, because every chunk and the summary may repeat thousands of channels. The
        summary `repeats`: as it may be damaged, its records do not replace earlier ones.
        """
        key = record[:1] + record[RECORD.size : RECORD.size + 2]
        if self._kept.get(key) == record or (repeats and key in self._kept):
            return
        for found in StreamReader(BytesIO(record), skip_magic=True).records:
            match found:
                case Schema():
                    self.schemas[found.id], self._kept[key] = found, record
                    self._topics.clear()
                case Channel():
                    self.channels[found.id], self._kept[key] = found, record
                    self._topics.pop(found.id, None)
                case Statistics():
                    self.statistics = found
                case Header():
                    self.profile = found.profile
            return

    def topics(self) -> dict[int, Topic]:
        """Topics by channel number."""
        for number in self.channels.keys() - self._topics.keys():
            self._topics[number] = self._topic(self.channels[number])
        return {number: self._topics[number] for number in self.channels}

    def _topic(self, channel: Channel) -> Topic:
        schema, encoding = self.schemas.get(channel.schema_id), channel.message_encoding
        foreign = "" if encoding in ("cdr", "") else encoding
        if schema is None:
            schema, foreign = Schema(0, b"", "", ""), foreign or NO_SCHEMA
        text, more = schema.data.decode(errors="surrogateescape"), channel.metadata
        own = text, schema.encoding, more.get("topic_type_hash", ""), encoding or "cdr"
        known, offers = Definition(schema.name, *own), more.get("offered_qos_profiles", "")
        return Topic(channel.topic, schema.name, 0, known, offers, foreign)

    def chunk_at(self, offset: int, length: int) -> Section:
        """The chunk record at `offset` with `length` bytes after its head; ValueError if it is damaged."""
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
        """Offset of the next chunk record with consistent sizes from `start` on; None if there is none."""
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

    def parts(self, section: Section) -> list[Section]:
        """The section itself, or the parts of a large chunk, to save memory; DamagedChunk as `load`."""
        if not section.is_chunk or section.content_size <= LARGE or section.part is not None:
            return [section]
        found = []
        with self._damage(f"chunk at byte {section.offset}"):
            content = self._unpacked(section)
            for place, size, block in pieces(content, self.keep):
                if len(block):
                    channel = int(block.channel[0]) if size > LARGE else None
                    part = replace(section, part=(place, size), channel=channel)
                    part.start, part.end = int(block.log_time.min()), int(block.log_time.max())
                    found.append(part)
            check_whole(section, content)
        return found

    def load(self, sections: Sequence[Section]) -> Block:
        """Messages of one or more sections; stores their schemas and channels.

        Safe with concurrent readers of the same file. Raises DamagedChunk if a section cannot be used.
        """
        contents = []
        for section in sections:
            with self._damage(f"chunk at byte {section.offset}"):
                contents.append(self._content(section))
        with self._damage(f"chunk at or after byte {sections[0].offset}"):
            content = contents[0] if len(contents) == 1 else b"".join(contents)
            block, stop = parse(content, self.keep)
            check_end(content, stop)
            return block

    def long_message(self, section: Section) -> Block:
        """The message of a section with a `channel`, its content read on demand; DamagedChunk as `load`."""
        assert section.part is not None
        place, size = section.part
        size -= MESSAGE.size

        def read() -> Iterator[bytes]:
            with self._opened(section, place + MESSAGE.size) as content:
                for done in range(0, size, AT_ONCE):
                    yield content.take(min(AT_ONCE, size - done))

        with self._damage(f"chunk at byte {section.offset}"), self._opened(section, place) as content:
            return replace(head_of(content.take(MESSAGE.size)), long=LongMessage(size, read))

    def load_part(self, offset: int, end: int) -> Iterator[Block]:
        """Messages at the beginning of a truncated chunk; the file has its bytes from `offset` to `end`.

        Compression works in blocks, so the blocks before the cut can be read.
        """
        with suppress(*_DAMAGE, IndexError):
            if self.read(offset, 1)[0] == Opcode.CHUNK:
                section = self.chunk_at(offset, (1 << 64) - 1)
                section.size = min(section.size, max(0, end - section.offset), MAX_CHUNK)
                section.content_size = min(section.content_size, believable(section.size))
                for place, size, block in pieces(self._unpacked(section), self.keep):
                    if len(block):
                        is_long = size > LARGE
                        yield self.long_message(replace(section, part=(place, size))) if is_long else block

    @contextmanager
    def _damage(self, where: str) -> Iterator[None]:
        try:
            yield
        except _DAMAGE as exc:
            raise DamagedChunk(self._path, f"{where} is damaged: {exc}") from exc

    def _unpacked(self, section: Section, checksum: int | None = 0) -> Content:
        """Content of a chunk, limited to one byte above the claimed size, to notice excess content."""
        check_claim(section.content_size, section.size)
        stored = _Stored(self, section.offset, section.offset + section.size)
        return Content(decompressed(section.compression, stored), section.content_size + 1, checksum)

    def _content(self, section: Section) -> bytes:
        """Uncompressed bytes of a section or a part."""
        if section.part is not None:
            with self._opened(section, section.part[0]) as part:
                return part.take(section.part[1])
        content = self._unpacked(section)
        found = content.take(section.content_size + 1)
        check_whole(section, content)
        return found

    @contextmanager
    def _opened(self, section: Section, place: int) -> Iterator[Content | OnDisk]:
        """The content of a section from an offset on; it stays open, because parts are usually read in order.

        If `place` lies before the current offset, as with disordered times, the content is copied to disk.
        """
        with self._lock:
            known: Content | OnDisk | None = self._open.pop(section.offset, None)
            if known is None:
                known = self._unpacked(section, None)
            elif known.place > place:
                known = self._on_disk(section)
            known.skip(place)
            yield known
            if known.place < section.content_size:
                self._open[section.offset] = known
            if len(self._open) > _MOST_OPEN:
                del self._open[next(iter(self._open))]

    def _on_disk(self, section: Section) -> OnDisk:
        try:
            return OnDisk(self._unpacked(section, None))
        except OSError as exc:
            where = f"{tempfile.gettempdir()} (TMPDIR)"
            raise BagError(self._path, f"cannot be sorted in {where}: {exc.strerror or exc}") from exc

    def _take(self, opcode: int, length: int) -> None:
        """Register the record at `end`: a chunk or message as section, others with `keep`."""
        if opcode == Opcode.CHUNK:
            self.sections.append(self.chunk_at(self.end, length))
        elif opcode == Opcode.MESSAGE:
            check_claim(length, length)
            self._add_message(length)
        elif opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
            if length > _MAX_RECORD:
                raise ValueError(f"{length} bytes are too many for such a record")
            self.keep(self.read(self.end, RECORD.size + length), self._is_summary)
        elif opcode == Opcode.DATA_END:
            self._is_summary = True

    def _add_message(self, length: int) -> None:
        """Add the message at `end`, outside of chunks, to the section directly before it or to a new one."""
        _, _, channel, _, log_time, _ = MESSAGE.unpack(self._peek(MESSAGE.size))
        if length > LARGE:
            size = RECORD.size + length
            own = Section(self.end, size, log_time, log_time, "", size, is_chunk=False, part=(0, size))
            self.sections.append(replace(own, channel=channel))
            return
        last = self.sections[-1] if self.sections else None
        if last is None or last.is_chunk or last.offset + last.size != self.end or last.size > _RUN:
            last = Section(self.end, 0, log_time, log_time, is_chunk=False)
            self.sections.append(last)
        last.size = last.content_size = last.size + RECORD.size + length
        last.start, last.end = min(last.start, log_time), max(last.end, log_time)


class _Stored:
    """File-like view of the bytes from an offset to an end [byte]."""

    def __init__(self, scan: Scan, place: int, end: int) -> None:
        self._scan, self._place, self._end = scan, place, end

    def read(self, size: int = -1, /) -> bytes:
        left = self._end - self._place
        found = self._scan.read(self._place, min(size, left) if size >= 0 else left)
        self._place += len(found)
        return found
