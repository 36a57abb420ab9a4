"""Where things are in an MCAP file: chunks and messages outside of them, topics, counts; nothing is trusted.

The file is walked record by record, so that the summary and the indexes may be missing, wrong or cut off.
Only the heads of chunks are read, which takes microseconds for each.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from hd_diag.bag.block import Topic
from hd_diag.bag.errors import BagError
from hd_diag.messages.schemas import Definition

MAGIC = MCAP0_MAGIC
MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time and publish time [ns]."""
RECORD = struct.Struct("<BQ")
"""Head of any record: opcode and length."""
_CHUNK = struct.Struct("<QQQII")
MAX_CHUNK = 256 << 20
"""A chunk, or a message outside of one, above this is refused: recorders close a chunk after some megabytes,
and what is made of a chunk takes up to five times its memory [byte]."""
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


@dataclass
class Scan:
    """What a walk over an MCAP file found.

    `end` is where the last whole record ends [byte], `problem` why that is not the end of the file; schemas
    and channels that stand in chunks are known only where the summary repeats them.
    """

    size: int
    end: int = len(MAGIC)
    sections: list[Section] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    statistics: Statistics | None = None
    profile: str = ""
    problem: str = ""

    def keep(self, opcode: int, content: bytes) -> None:
        """Remember what a record says; raises several kinds of errors where it is damaged."""
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            self.channels[channel.id] = channel
        elif opcode == Opcode.STATISTICS:
            self.statistics = Statistics.read(stream)
        elif opcode == Opcode.HEADER:
            self.profile = Header.read(stream).profile

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


def scan(path: Path, file: BufferedReader) -> Scan:
    """Walk over the records of an open MCAP file, which `path` names in messages.

    Raises
    ------
    BagError
        Where it is not an MCAP file of ROS 2.
    """
    result = Scan(os.fstat(file.fileno()).st_size)
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise BagError(path, "is not an MCAP file" if result.size else "is empty")
    walk(file, result)
    if result.profile not in ("", "ros2"):
        raise BagError(path, f"has profile {result.profile!r}, not ros2")
    return result


def walk(file: BufferedReader, result: Scan) -> None:
    """Walk on from ``result.end``; what is found is added to `result`."""
    result.problem, opcode = "", 0
    try:
        while opcode != Opcode.FOOTER:
            file.seek(result.end)
            head = file.read(RECORD.size)
            if len(head) < RECORD.size:
                result.problem = "has no end: it was cut off, or is still being written"
                return
            opcode, length = RECORD.unpack(head)
            stop = result.end + RECORD.size + length
            if opcode == 0 or stop > result.size:
                result.problem = f"is cut off or damaged at byte {result.end} of {result.size}"
                return
            _take(file, result, opcode, length)
            result.end = stop
        file.seek(result.end)
        if file.read(len(MAGIC)) == MAGIC:
            result.end += len(MAGIC)
        else:
            result.problem = "has no end: the closing magic is missing"
    except (struct.error, ValueError, McapError) as exc:
        result.problem = f"damaged record at byte {result.end}: {exc}"


def _take(file: BufferedReader, result: Scan, opcode: int, length: int) -> None:
    if opcode == Opcode.CHUNK:
        result.sections.append(chunk_at(file, result.end, length))
    elif opcode == Opcode.MESSAGE:
        check_claim(length, length)
        _add_message(file, result, length)
    elif opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
        if length > _MAX_RECORD:
            raise ValueError(f"{length} bytes are too many for such a record")
        result.keep(opcode, file.read(length))


def chunk_at(file: BufferedReader, offset: int, length: int) -> Section:
    """The chunk record at `offset` of `length` bytes behind its head; ValueError where it is damaged."""
    file.seek(offset + RECORD.size)
    head = file.read(_CHUNK.size + 24)
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


def _add_message(file: BufferedReader, result: Scan, length: int) -> None:
    """Add the message outside of chunks that stands at ``result.end`` to those right before it."""
    file.seek(result.end)
    log_time = MESSAGE.unpack(file.read(MESSAGE.size))[4]
    last = result.sections[-1] if result.sections else None
    if last is None or last.is_chunk or last.offset + last.size != result.end or last.size > _RUN:
        last = Section(result.end, 0, log_time, log_time, is_chunk=False)
        result.sections.append(last)
    last.size = last.content_size = last.size + RECORD.size + length
    last.start, last.end = min(last.start, log_time), max(last.end, log_time)
