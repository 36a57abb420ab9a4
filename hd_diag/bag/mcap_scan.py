"""Where things are in an MCAP file: chunks and runs of messages, topics, counts; nothing in it is trusted.

The file is walked record by record, so that the summary and the indexes may be missing, wrong or cut off.
Only the heads of chunks are read, which takes microseconds for each.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema, Statistics

from hd_diag.bag.block import gather
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_file import HEAD, MAGIC, MESSAGE

# A chunk, or a message outside of one, above this is refused: recorders close a chunk after some megabytes,
# and what is made of a chunk takes up to five times its memory [byte].
MAX_CHUNK = 256 << 20
# A chunk that claims both more than this [byte] and more than so many times what is stored of it is refused
# unread: recordings seldom reach 100, and a file of some kilobytes could keep the reader busy for minutes.
_MAX_UNASKED, _MAX_RATIO = 64 << 20, 1000
# Schemas, channels and metadata above this are refused.
_MAX_RECORD = 16 << 20
# Messages outside of chunks are taken together in runs of about this size [byte].
_RUN = 1 << 20
_HEAD, _INDEX = struct.Struct("<BQ"), struct.Struct("<HI")
CHUNK_HEAD = struct.Struct("<QQQII")
LENGTH = struct.Struct("<Q")


def check_claim(claimed: int, stored: int) -> None:
    """Refuse content [byte] that is too large, or beyond what is `believable` of so little stored.

    Raises
    ------
    ValueError
        Where it is.
    """
    if max(claimed, stored) > MAX_CHUNK:
        raise ValueError(f"it claims {max(claimed, stored)} bytes, more than {MAX_CHUNK}")
    if claimed > believable(stored):
        raise ValueError(
            f"it claims {claimed} bytes, more than {_MAX_UNASKED} and {_MAX_RATIO} times the {stored} stored"
        )


def believable(stored: int) -> int:
    """How much may unpack from so many bytes [byte]."""
    return min(MAX_CHUNK, max(_MAX_UNASKED, _MAX_RATIO * stored))


@dataclass
class Section:
    """A chunk, or a run of messages outside of chunks.

    Attributes
    ----------
    offset, size : int
        Place of the (compressed) content in the file [byte].
    start, end : int
        Range of the log times [ns]; from the chunk's head and its message indexes, hence not certain.
    compression : str
        ``zstd``, ``lz4`` or empty.
    content_size : int
        Size of the content as declared [byte].
    checksum : int
        CRC-32 of the content; 0 where there is none.
    counts : dict or None
        Messages of each channel, from the message indexes; None where there are none.
    indexes : (int, int) or None
        Where the message indexes begin and end in the file [byte].
    """

    offset: int
    size: int
    start: int
    end: int
    compression: str = ""
    content_size: int = 0
    checksum: int = 0
    counts: dict[int, int] | None = None
    indexes: tuple[int, int] | None = None


@dataclass
class Scan:
    """What a walk over an MCAP file found.

    Attributes
    ----------
    sections : list of Section
        In the order of the file.
    schemas, channels : dict
        By number; those inside of chunks only where the summary repeats them.
    counts : dict or None
        Messages of each channel, from the statistics.
    metadata : dict
        Metadata records by name.
    size, end : int
        Size of the file, and where the last whole record ends [byte].
    problem : str
        Why the walk ended before the end of the file; empty for a finished file.
    """

    size: int
    sections: list[Section] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] | None = None
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    end: int = 0
    problem: str = ""


def scan(path: Path, file: BufferedReader) -> Scan:
    """Walk over the records of an MCAP file.

    Parameters
    ----------
    path : Path
        For messages.
    file : BufferedReader
        The open file.

    Raises
    ------
    BagError
        Where it is not an MCAP file of ROS 2.
    """
    result = Scan(os.fstat(file.fileno()).st_size)
    file.seek(0)
    if file.read(8) != MAGIC:
        raise BagError(path, "is not an MCAP file" if result.size else "is empty")
    result.end = 8
    walk(path, file, result)
    return result


def walk(path: Path, file: BufferedReader, result: Scan) -> None:
    """Walk on from ``result.end``; what is found is added to `result`."""
    result.problem = ""
    try:
        for opcode, length in _records(file, result):
            if opcode == Opcode.FOOTER:
                _check_footer(file, result, length)
                break
            _take(path, file, result, opcode, length)
    except BagError:
        raise
    except (struct.error, ValueError, McapError) as exc:
        result.problem = f"damaged record at byte {result.end}: {exc}"


def _records(file: BufferedReader, result: Scan) -> Iterator[tuple[int, int]]:
    """Opcode and length of each whole record; the file stands at the record's content."""
    while True:
        file.seek(result.end)
        head = file.read(9)
        if len(head) < 9:
            result.problem = "has no end: it was cut off, or is still being written"
            return
        opcode, length = _HEAD.unpack(head)
        if opcode == 0 or result.end + 9 + length > result.size:
            result.problem = f"is cut off or damaged at byte {result.end} of {result.size}"
            return
        before = result.end
        yield opcode, length
        if result.end == before:
            result.end = before + 9 + length


def _take(path: Path, file: BufferedReader, result: Scan, opcode: int, length: int) -> None:
    if opcode == Opcode.CHUNK:
        result.sections.append(chunk_at(file, result.end, length))
    elif opcode == Opcode.MESSAGE:
        check_claim(length, length)
        _run(file, result, length)
    elif opcode == Opcode.MESSAGE_INDEX:
        _message_index(file, result, length)
    elif opcode == Opcode.METADATA:
        record = Metadata.read(_stream(file, length))
        result.metadata[record.name] = record.metadata
    elif opcode == Opcode.STATISTICS:
        result.counts = Statistics.read(_stream(file, length)).channel_message_counts
    elif opcode == Opcode.HEADER:
        profile = Header.read(_stream(file, length)).profile
        if profile not in ("", "ros2"):
            raise BagError(path, f"has profile {profile!r}, not ros2")
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        keep(result, opcode, file.read(length) if length <= _MAX_RECORD else b"")


def keep(result: Scan, opcode: int, content: bytes) -> None:
    """Remember a schema or channel record."""
    stream = ReadDataStream(BytesIO(content))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        result.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        result.channels[channel.id] = channel


def _stream(file: BufferedReader, length: int) -> ReadDataStream:
    if length > _MAX_RECORD:
        raise struct.error(f"{length} bytes are too many for such a record")
    return ReadDataStream(BytesIO(file.read(length)))


def chunk_at(file: BufferedReader, offset: int, length: int) -> Section:
    """The chunk record at `offset`, whose content has `length` bytes."""
    file.seek(offset + 9)
    start, end, content_size, checksum, name_length = CHUNK_HEAD.unpack(file.read(CHUNK_HEAD.size))
    if name_length > 16:
        raise struct.error("the chunk's compression is not known")
    name = file.read(name_length).decode()
    (size,) = LENGTH.unpack(file.read(8))
    head = CHUNK_HEAD.size + name_length + 8
    if head + size > length:
        raise struct.error("the chunk is larger than its record")
    return Section(offset + 9 + head, size, start, end, name, content_size, checksum)


def _run(file: BufferedReader, result: Scan, length: int) -> None:
    """Take the messages that follow one another here as one section."""
    file.seek(result.end)
    content = file.read(max(_RUN, 9 + length))
    offsets, stop = [], 0
    while stop + 9 <= len(content) and content[stop] == Opcode.MESSAGE:
        (size,) = LENGTH.unpack_from(content, stop + 1)
        if stop + 9 + size > len(content):
            break
        offsets.append(stop)
        stop += 9 + size
    times = heads_at(content[:stop], np.array(offsets, np.int64))["log_time"]
    result.sections.append(Section(result.end, stop, int(times.min()), int(times.max()), "", stop))
    result.end += stop


def heads_at(content: bytes, places: npt.NDArray[np.int64]) -> npt.NDArray[np.void]:
    """Heads of the messages whose records begin at the places, as they are, whatever their times.

    Raises
    ------
    ValueError
        Where a record is too short for a message.
    """
    if len(places) and places[-1] + MESSAGE.size > len(content):
        raise ValueError("a message has no room for its times")
    rows = gather(np.frombuffer(content, np.uint8), places, MESSAGE.size)
    heads: npt.NDArray[np.void] = np.ascontiguousarray(rows).view(HEAD)[:, 0]
    if len(heads) and int(heads["length"].min()) < MESSAGE.size - 9:
        raise ValueError("a message is too short for its times")
    return heads


def _message_index(file: BufferedReader, result: Scan, length: int) -> None:
    """Take counts and times from an index.

    Some writers give a chunk the times of its first and last message, not the least and greatest.
    """
    if not result.sections or length > MAX_CHUNK:
        return
    section = result.sections[-1]
    content = file.read(length)
    channel, size = _INDEX.unpack_from(content)
    if size % 16 or size > length - 6:
        raise struct.error("the message index has a wrong size")
    times = np.frombuffer(content, "<u8", size // 8, 6)[::2]
    if section.counts is None:
        section.counts = {}
    section.counts[channel] = section.counts.get(channel, 0) + len(times)
    first, _ = section.indexes or (result.end, 0)
    section.indexes = first, result.end + 9 + length
    if len(times):
        section.start, section.end = min(section.start, int(times.min())), max(section.end, int(times.max()))


def _check_footer(file: BufferedReader, result: Scan, length: int) -> None:
    file.seek(result.end + 9 + length)
    if file.read(8) == MAGIC:
        result.end += 9 + length + 8
    else:
        result.problem = "has no end: the closing magic is missing"
