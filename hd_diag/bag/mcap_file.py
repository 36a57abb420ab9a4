"""One MCAP file being written: small chunks that reach the operating system whole, and a summary at the end.

A file that is cut off anywhere holds every chunk that was closed before; records are laid out as in the MCAP
specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import fcntl
import os
import struct
import time
import zlib
from array import array
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from hd_diag.bag.errors import BagError
from hd_diag.bag.rows import Rows
from hd_diag.bag.worker import AtOnce
from hd_diag.messages.schemas import Definition

MAGIC = b"\x89MCAP0\r\n"
COMPRESSIONS = ("zstd", "lz4", "none")
# opcode, record length, channel, sequence, log time [ns], publish time [ns]
MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQI")
_INDEX = struct.Struct("<BQHI")
HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""`MESSAGE` as a type of numpy."""
# Level 1: floats hardly compress better at higher levels, and the node writes while it works.
_ZSTD_LEVEL = 1


class McapFile:
    """An MCAP file with profile ``ros2``.

    Parameters
    ----------
    path : Path
        File to write.
    compression : {'zstd', 'lz4', 'none'}
        Compression of the chunks.
    chunk_size : int
        Uncompressed size at which a chunk is closed [byte].
    overwrite : bool
        Replace an existing file; else it is an error.
    worker : AtOnce
        Compresses and writes the chunks.
    """

    def __init__(
        self, path: Path, compression: str, chunk_size: int, *, overwrite: bool, worker: AtOnce
    ) -> None:
        self.path = path
        self.size = 0
        self.channels: dict[tuple[str, str], int] = {}
        self.start: int | None = None
        self._compress = _Compressor(compression)
        self._chunk_size = chunk_size
        self._chunk = _Chunk()
        self._lost: list[_Chunk] = []
        self._worker = worker
        # Packed at once: a log of days has a million of them.
        self._indexes, self._chunk_count = bytearray(), 0
        self._metadata: list[MetadataIndex] = []
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._first, self._last = 2**64 - 1, 0
        self._fd = _create(path, overwrite)
        try:
            self._put(MAGIC + _packed(Header("ros2", "hd_diag")))
        except BaseException:
            os.close(self._fd)
            raise

    @property
    def count(self) -> int:
        """Messages added so far."""
        return sum(self._counts.values())

    @property
    def times(self) -> tuple[int, int]:
        """Least and greatest log time so far [ns]; (2**64 - 1, 0) before the first message."""
        return min(self._first, self._chunk.first), max(self._last, self._chunk.last)

    @property
    def pending(self) -> float | None:
        """When the open chunk got its first message (``time.monotonic``) [s]; None if it has none."""
        return self._chunk.opened

    def add_channel(self, topic: str, definition: Definition, metadata: Mapping[str, str]) -> int:
        """Register a topic, and its schema where this is the first topic of the type."""
        name = definition.type_name
        if name not in self._schemas:
            text = definition.text.encode()
            self._schemas[name] = Schema(len(self._schemas) + 1, text, definition.encoding, name)
            self._chunk.add_record(_packed(self._schemas[name]))
        number = len(self._channels) + 1
        channel = Channel(number, topic, "cdr", dict(metadata), self._schemas[name].id)
        self._chunk.add_record(_packed(channel))
        self._channels.append(channel)
        self.channels[topic, name] = number
        self._counts[number] = 0
        return number

    def add(self, channel: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Append a message; the chunk is closed when it is full."""
        sequence = self._counts[channel] & 0xFFFFFFFF
        head = MESSAGE.pack(Opcode.MESSAGE, 22 + len(data), channel, sequence, log_time, publish_time)
        self._chunk.add_message(channel, log_time, head, data)
        self._counts[channel] += 1
        if self.start is None:
            self.start = log_time
        if self._chunk.size >= self._chunk_size:
            self.close_chunk()

    def room(self, rows: Rows) -> int:
        """How many of these messages fill the open chunk, at least 1."""
        return rows.room(self._chunk_size - self._chunk.size, MESSAGE.size)

    def add_rows(
        self,
        channel: int,
        times: npt.NDArray[np.int64],
        publish_times: npt.NDArray[np.int64],
        rows: Rows,
    ) -> None:
        """Append messages of one channel at once; the chunk is closed when it is full."""
        before, count = self._counts[channel], len(times)
        records = rows.behind(
            HEAD,
            {
                "opcode": Opcode.MESSAGE,
                "length": 22 + rows.sizes,
                "channel": channel,
                "sequence": np.arange(before, before + count) & 0xFFFFFFFF,
                "log_time": times,
                "publish_time": publish_times,
            },
        )
        self._chunk.add_block(channel, times, records, rows.places(MESSAGE.size))
        self._counts[channel] += count
        if self.start is None:
            self.start = int(times[0])
        if self._chunk.size >= self._chunk_size:
            self.close_chunk()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record, after what was added before it."""
        self.close_chunk()
        self.wait()
        record = _packed(Metadata(name, dict(values)))
        self._metadata.append(MetadataIndex(self.size, len(record), name))
        self._put(record)

    def close_chunk(self) -> None:
        """Hand everything added so far to the operating system."""
        chunk = self._chunk
        if chunk.size:
            self._chunk = _Chunk()
            self._worker.do(lambda: self._store(chunk))

    def wait(self) -> None:
        """Until every closed chunk is with the operating system."""
        self._worker.wait()

    def drop_chunk(self) -> None:
        """Forget the messages that were not handed over yet."""
        with suppress(Exception):  # known already
            self._worker.wait()
        for chunk in (*self._lost, self._chunk):
            for channel, entries in chunk.index.items():
                self._counts[channel] -= len(entries) // 2
        self._chunk, self._lost = _Chunk(), []

    def count_of(self, topic: str, type_name: str) -> int:
        """Messages of a topic added so far."""
        return self._counts.get(self.channels.get((topic, type_name), 0), 0)

    def finish(self) -> None:
        """Close the open chunk and write the summary."""
        self.close_chunk()
        self.wait()
        end = _packed(DataEnd(0))
        start = self.size + len(end)
        groups = (
            (Opcode.SCHEMA, b"".join(map(_packed, self._schemas.values()))),
            (Opcode.CHANNEL, b"".join(map(_packed, self._channels))),
            (Opcode.STATISTICS, _packed(self._statistics())),
            (Opcode.CHUNK_INDEX, bytes(self._indexes)),
            (Opcode.METADATA_INDEX, b"".join(map(_packed, self._metadata))),
        )
        summary, offsets = _summary(groups, start)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, start + len(summary))
        checksum = zlib.crc32(summary + offsets + footer)
        self._put(end + summary + offsets + _packed(Footer(start, start + len(summary), checksum)) + MAGIC)

    def release(self) -> None:
        """Close the file as it is."""
        self._worker.close()
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            os.close(fd)

    def _store(self, chunk: _Chunk) -> None:
        """Write a chunk; after one that could not be written none is, until what was lost is forgotten."""
        if self._lost:
            self._lost.append(chunk)
            return
        try:
            self._write(chunk)
        except KeyboardInterrupt:
            self._chunk = chunk  # nothing is wrong with the file
            raise
        except BaseException:
            self._lost.append(chunk)
            raise

    def _write(self, chunk: _Chunk) -> None:
        data = b"".join(chunk.parts)
        name, stored = self._compress(data)
        first = 0 if chunk.opened is None else chunk.first
        tail = struct.pack("<I", len(name)) + name.encode() + struct.pack("<Q", len(stored))
        length = _CHUNK.size - 9 + len(tail) + len(stored)
        head = _CHUNK.pack(Opcode.CHUNK, length, first, chunk.last, len(data), zlib.crc32(data)) + tail
        start, end = self.size, self.size + len(head) + len(stored)
        places, index = _message_indexes(chunk.index, end)
        self._put(b"".join((head, stored, *index)))
        self._first, self._last = min(self._first, chunk.first), max(self._last, chunk.last)
        written = (len(stored), chunk.last, self.size - end, places, first, len(data))
        self._indexes += _packed(ChunkIndex(end - start, start, name, *written))
        self._chunk_count += 1

    def _statistics(self) -> Statistics:
        first, last = self.times
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count,
            message_count=self.count,
            message_end_time=last,
            message_start_time=min(first, last),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put(self, data: bytes) -> None:
        """Write all of `data`, or nothing: a record that does not fit is cut off again."""
        view, done = memoryview(data), 0
        try:
            while done < len(view):
                done += os.write(self._fd, view[done:])
        except BaseException:
            os.ftruncate(self._fd, self.size)
            os.lseek(self._fd, self.size, os.SEEK_SET)
            raise
        self.size += len(data)


class _Chunk:
    """Records of the chunk that is being filled."""

    def __init__(self) -> None:
        self.parts: list[bytes | memoryview] = []
        self.size = 0
        self.opened: float | None = None
        self.first, self.last = 2**64 - 1, 0
        self.index: dict[int, array[int]] = {}

    def add_record(self, record: bytes) -> None:
        self.parts.append(record)
        self.size += len(record)

    def add_message(self, channel: int, log_time: int, head: bytes, data: bytes) -> None:
        if self.opened is None:
            self.opened = time.monotonic()
        self.first, self.last = min(self.first, log_time), max(self.last, log_time)
        entries = self.index.get(channel)
        if entries is None:
            entries = self.index[channel] = array("Q")
        entries.append(log_time)
        entries.append(self.size)
        self.parts.append(head)
        self.parts.append(data)
        self.size += len(head) + len(data)

    def add_block(
        self,
        channel: int,
        times: npt.NDArray[np.int64],
        block: memoryview,
        places: npt.NDArray[np.int64],
    ) -> None:
        if self.opened is None:
            self.opened = time.monotonic()
        self.first, self.last = min(self.first, int(times.min())), max(self.last, int(times.max()))
        entries = np.empty((len(times), 2), np.uint64)
        entries[:, 0] = times
        entries[:, 1] = self.size + places
        self.index.setdefault(channel, array("Q")).frombytes(entries.tobytes())
        self.parts.append(block)
        self.size += len(block)


class _Compressor:
    """Compression of chunks; gives the name that the chunk carries and the bytes."""

    def __init__(self, name: str) -> None:
        if name not in COMPRESSIONS:
            raise ValueError(f"compression: one of {', '.join(COMPRESSIONS)} expected, got {name!r}")
        self._name = "" if name == "none" else name
        self._zstd = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)

    def __call__(self, data: bytes) -> tuple[str, bytes]:
        if self._name == "zstd":
            return self._name, self._zstd.compress(data)
        return self._name, lz4.frame.compress(data) if self._name == "lz4" else data


def _create(path: Path, overwrite: bool) -> int:
    """File descriptor of a new file, locked for as long as it is written."""
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | (0 if overwrite else os.O_EXCL)
    fd = os.open(path, flags, 0o666)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(fd, 0)
    except BlockingIOError as exc:
        os.close(fd)
        raise BagError(path, "is being written by another process") from exc
    except BaseException:
        os.close(fd)
        raise
    return fd


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _message_indexes(index: dict[int, array[int]], start: int) -> tuple[dict[int, int], list[bytes]]:
    """Places of the message index records of a chunk that ends at `start`, and the records."""
    places, parts = {}, []
    for channel, entries in index.items():
        places[channel] = start
        size = len(entries) * 8
        parts += [_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size), entries.tobytes()]
        start += _INDEX.size + size
    return places, parts


def _summary(groups: Iterable[tuple[Opcode, bytes]], start: int) -> tuple[bytes, bytes]:
    """Summary section that begins at `start`, and its summary offset section."""
    summary, offsets = b"", b""
    for opcode, group in groups:
        if group:
            offsets += _packed(SummaryOffset(opcode, start + len(summary), len(group)))
        summary += group
    return summary, offsets
