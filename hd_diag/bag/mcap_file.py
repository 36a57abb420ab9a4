"""Writing of one MCAP file: small chunks that reach the operating system whole, then a summary.

A truncated file holds every chunk that was closed before the cut. `mcap` packs the records, except for
messages and their many indexes, which are packed here (https://mcap.dev/spec).
"""

from __future__ import annotations

import functools
import itertools
import os
import struct
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from hd_diag.arrays import Bytes, Times
from hd_diag.bag.block import LongMessage
from hd_diag.bag.errors import BagError, new_file
from hd_diag.bag.mcap_chunk import LARGE, MESSAGE, RECORD
from hd_diag.bag.mcap_scan import MAGIC
from hd_diag.bag.open_chunk import ROOM, UNKNOWN, OpenChunk, bits

# Each file has its own compressor, because one may not serve two threads, and a node writes a log and a
# snapshot. Floats hardly compress better at higher levels, and the node compresses while it works: level -1
# takes a quarter less time than 1, and its files are 2 % larger.
_COMPRESSORS: dict[str, Callable[[], Callable[[Any], Any]]] = {
    "zstd": lambda: zstandard.ZstdCompressor(level=-1).compress,
    "lz4": lambda: lz4.frame.compress,
    "none": lambda: memoryview,
}
COMPRESSIONS = tuple(_COMPRESSORS)
WRITTEN_BY = "hd_diag"
"""Name of the writing program in the head of a file."""
# Most chunks that wait to be written. This limits the memory and the loss in a crash. A replay makes several
# chunks at once: with a limit of 4 it waited for the thread.
_MOST_WAITING = 16
_LARGE = 4 << 20  # a caller waits until a chunk above this is written [byte]
_FIXED = MESSAGE.size - RECORD.size  # fixed part of a message record's length [byte]
_HEAD, _INDEX, _ENTRY = struct.Struct("<BQH"), struct.Struct("<BQHI"), struct.Struct("<QQ")
_LENGTH = struct.Struct("<Q")
_CHUNK_HEAD = 49  # head of a chunk record without the compression's name [byte]


@dataclass
class Stream:
    """A topic being written: its schema and channel records, and the number of messages added so far."""

    schema: records.Schema
    channel: records.Channel
    count: int = 0


class Written(NamedTuple):
    """Path of a file, and statistics of its records in the operating system; kept after the file's end."""

    path: Path
    statistics: records.Statistics


class McapFile:
    """An MCAP file with profile ``ros2``, locked while it is written.

    A chunk is closed at an uncompressed `chunk_size` [byte]. A thread compresses and writes it; one of the
    next calls raises the thread's errors.

    `size` is the size of the file [byte], `start` the log time of the first message [ns]. `is_whole` says
    whether the end of the file is written.
    """

    def __init__(self, path: Path, compression: str, chunk_size: int, overwrite: bool) -> None:
        self.path, self.size = path, 0
        self.start: int | None = None
        self.written = Written(path, records.Statistics(0, 0, {}, 0, 0, 0, UNKNOWN, 1, 0))
        self._compression, self._chunk_size = compression, chunk_size
        self._compress = _COMPRESSORS[compression]()
        self._rooms: deque[bytearray] = deque()  # buffers of written chunks, for reuse
        self._chunk = self._begun()
        self._failed = self.is_whole = False
        self._waiting: deque[Future[None]] = deque()
        self._indexes = bytearray()  # stored packed, because a log of days has a million
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._fd = new_file(path, overwrite)
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="bag writer")
        try:
            self._pool.submit(self._put, MAGIC + _packed(records.Header("ros2", WRITTEN_BY))).result()
        except BaseException:
            self.discard()
            raise

    @property
    def opened(self) -> float | None:
        """When the open chunk got its first message (``time.monotonic``) [s]; None if it is empty."""
        return self._chunk.opened

    def declare(self, stream: Stream) -> None:
        """Add a topic's schema and channel records, unless the file has them."""
        if stream.channel.id not in self._channels:
            if stream.schema.id and stream.schema.id not in self._schemas:
                self._schemas[stream.schema.id] = stream.schema
                self._chunk.append(_packed(stream.schema))
            self._channels[stream.channel.id] = stream.channel
            self._chunk.append(_packed(stream.channel))

    def add(
        self, stream: Stream, log_time: int, publish_time: int, data: bytes | memoryview | LongMessage
    ) -> None:
        """Append a message; closes the chunk when it is full, and before and after a long message."""
        self.declare(stream)
        if len(data) > LARGE:
            self.close_chunk()
        chunk = self._chunk
        entry = _ENTRY.pack(log_time, chunk.size)
        chunk.append(_head(stream, stream.count, len(data), log_time, publish_time))
        if isinstance(data, LongMessage):
            chunk.long = data
        elif len(data) > LARGE:
            chunk.long = LongMessage(len(data), functools.partial(bits, memoryview(data)))
        else:
            chunk.append(data)
        self._added(stream, 1, log_time, log_time, entry)

    def add_some(self, stream: Stream, times: Sequence[int], rows: Sequence[bytes]) -> None:
        """Append a few messages as `add` does, all at once if the open chunk has room."""
        self.declare(stream)
        place, size = self._chunk.size, len(rows) * MESSAGE.size + sum(map(len, rows))
        if not rows or place + size > min(self._chunk_size, LARGE):
            for time_, data in zip(times, rows, strict=True):
                self.add(stream, time_, time_, data)
            return
        parts: list[bytes] = []
        entries: list[bytes] = []
        for sequence, (time_, data) in enumerate(zip(times, rows, strict=True), stream.count):
            parts += (_head(stream, sequence, len(data), time_, time_), data)
            entries.append(_ENTRY.pack(time_, place))
            place += MESSAGE.size + len(data)
        self._chunk.append(b"".join(parts))
        self._added(stream, len(rows), min(times), max(times), b"".join(entries))

    def add_rows(self, stream: Stream, times: Times, publish_times: Times, rows: Bytes) -> int:
        """Append messages of one size, shape (n, size), until the open chunk is full; returns how many."""
        self.declare(stream)
        kind, size = _record_of(rows.shape[1]), self._chunk.size
        count = min(len(rows), max(1, -(-(self._chunk_size - size) // kind.itemsize)))
        times = times[:count]
        self._chunk.grow(count * kind.itemsize)
        table = np.frombuffer(self._chunk.data, kind, count, size)
        table["head"] = np.void(_HEAD.pack(Opcode.MESSAGE, _FIXED + rows.shape[1], stream.channel.id))
        table["sequence"] = np.arange(stream.count, stream.count + count)
        table["log_time"], table["publish_time"] = times, publish_times[:count]
        rows = rows if rows.strides[1] == 1 else np.ascontiguousarray(rows)
        table["data"] = rows[:count].view(kind["data"])[:, 0]
        entries = np.empty((count, 2), "<u8")
        entries[:, 0], entries[:, 1] = times, size + kind.itemsize * np.arange(count)
        del table  # a bytearray cannot grow while an array views it
        self._added(stream, count, int(times.min()), int(times.max()), entries.tobytes())
        return count

    def _added(self, stream: Stream, count: int, first: int, last: int, entries: bytes) -> None:
        """Account for added messages: least and greatest time [ns], index entries; closes a full chunk."""
        stream.count += count
        self.start, chunk = first if self.start is None else self.start, self._chunk
        chunk.opened = time.monotonic() if chunk.opened is None else chunk.opened
        chunk.first, chunk.last = min(chunk.first, first), max(chunk.last, last)
        chunk.index.setdefault(stream.channel.id, bytearray()).extend(entries)
        if chunk.size >= self._chunk_size or chunk.long is not None:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Hand the open chunk to the writing thread."""
        if self._chunk.size:
            chunk, self._chunk = self._chunk, self._begun()
            self._waiting.append(self._pool.submit(self._store, chunk))
            self.wait(_MOST_WAITING if chunk.size <= _LARGE and chunk.long is None else 0)

    def close_old_chunk(self, now: float, age: float) -> bool:
        """Close the chunk if its first message has reached an age [s]; return whether it was closed."""
        is_due = self.opened is not None and now - self.opened >= age
        if is_due:
            self.close_chunk()
        return is_due

    def has_reached(self, size: int, duration: float, log_time: int) -> bool:
        """Whether the file has a size [byte] or, at a log time [ns], a length [s]; 0 means no limit."""
        if self.start is None:
            return False
        if size:
            self.wait()  # the written size decides
        is_late = duration and log_time - self.start >= int(duration * 1e9)
        return bool(is_late or (size and self.size >= size))

    def wait(self, most: int = 0) -> None:
        """Wait until at most `most` chunks are unwritten; raises the thread's first error."""
        while self._waiting and (len(self._waiting) > most or self._waiting[0].done()):
            self._waiting[0].result()
            self._waiting.popleft()

    def stop(self) -> None:
        """Wait until the thread has written its chunks, and end it."""
        self._pool.shutdown()

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write rosbag2's metadata and the summary after the chunks; the thread must have stopped."""
        written = self.written.statistics
        written.message_start_time = min(written.message_start_time, written.message_end_time)
        written.schema_count, written.channel_count = len(self._schemas), len(self._channels)
        kept = _packed(records.Metadata("rosbag2", dict(metadata)))
        end = kept + _packed(records.DataEnd(0))
        start, summary, offsets = self.size + len(end), b"", b""
        for opcode, group in (
            (Opcode.SCHEMA, _packed(*self._schemas.values())),
            (Opcode.CHANNEL, _packed(*self._channels.values())),
            (Opcode.STATISTICS, _packed(written)),
            (Opcode.CHUNK_INDEX, bytes(self._indexes)),
            (Opcode.METADATA_INDEX, _packed(records.MetadataIndex(self.size, len(kept), "rosbag2"))),
        ):
            if group:
                offsets += _packed(records.SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        places = start, start + len(summary)
        checksum = zlib.crc32(summary + offsets + struct.pack("<BQQQ", Opcode.FOOTER, 20, *places))
        self._put(end + summary + offsets + _packed(records.Footer(*places, checksum)) + MAGIC)
        self._indexes.clear()
        self.is_whole = True

    def release(self) -> None:
        """Close the file as it is."""
        self.stop()
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            with suppress(OSError):
                os.close(fd)

    def discard(self) -> None:
        """Close and delete a file without messages."""
        self.release()
        self.path.unlink(missing_ok=True)

    def held(self) -> int:
        """A second descriptor of the file; the lock lasts until both are closed."""
        return os.dup(self._fd)

    def _begun(self) -> OpenChunk:
        """An empty chunk in a reused buffer if there is one; fresh memory takes twice as long to fill."""
        return OpenChunk(self._rooms.popleft() if self._rooms else bytearray(min(self._chunk_size, ROOM)))

    def _store(self, chunk: OpenChunk) -> None:
        """Write a chunk, unless an earlier one could not be written."""
        if self._failed:
            return
        data, start = memoryview(chunk.data)[: chunk.size], self.size
        first, name = (0 if chunk.opened is None else chunk.first), self._compression.replace("none", "")
        size, stored = len(data), b""
        try:
            if chunk.long is None:
                stored = self._compress(data)
                length, checksum = len(stored), zlib.crc32(data)
            else:
                size, name = size + chunk.long.size, name and "lz4"
                length, checksum = self._put_long(name, data, chunk.long)
            record = bytearray(_packed(records.Chunk(name, b"", chunk.last, first, checksum, size)))
            _LENGTH.pack_into(record, 1, len(record) - RECORD.size + length)
            _LENGTH.pack_into(record, len(record) - _LENGTH.size, length)  # the data are not in the record
            places, index = {}, b""
            for channel, entries in chunk.index.items():
                places[channel] = start + len(record) + length + len(index)
                index += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries
            if chunk.long is None:
                self._put(record, stored, index)
            else:
                self._put(index)
                os.pwrite(self._fd, record, start)
        except BaseException:
            self._failed = True
            if chunk.long is not None and os.fstat(self._fd).st_size > start:
                self._cut(start)
            raise
        sizes = length, chunk.last, len(index), places, first, size
        self._indexes += _packed(records.ChunkIndex(len(record) + length, start, name, *sizes))
        written = self.written.statistics
        written.chunk_count += 1
        written.message_start_time = min(written.message_start_time, chunk.first)
        written.message_end_time = max(written.message_end_time, chunk.last)
        for channel, entries in chunk.index.items():
            count = len(entries) // _ENTRY.size
            written.message_count += count
            counts = written.channel_message_counts
            counts[channel] = counts.get(channel, 0) + count
        data.release()
        if len(chunk.data) <= 2 * self._chunk_size:
            self._rooms.append(chunk.data)

    def _put_long(self, name: str, data: memoryview, long: LongMessage) -> tuple[int, int]:
        """Write the content of a chunk with a long message after room for its head; size and checksum.

        Compresses by lz4, because zstd may shrink it by more than a reader accepts of an unknown file.
        """
        start, found, checksum = self.size, 0, 0
        lz4_frame = lz4.frame.LZ4FrameCompressor()
        self._put(bytes(_CHUNK_HEAD + len(name)), lz4_frame.begin() if name else b"")
        for part in itertools.chain([data], long.read()):
            found, checksum = found + len(part), zlib.crc32(part, checksum)
            self._put(lz4_frame.compress(part) if name else part)
        if found != len(data) + long.size:
            raise BagError(self.path, f"a message has {found - len(data)} bytes instead of {long.size}")
        self._put(lz4_frame.flush() if name else b"")
        return self.size - start - _CHUNK_HEAD - len(name), checksum

    def _check(self) -> None:
        """Raise BagError if another program deleted, moved or resized the file: writing would go on."""
        own = os.fstat(self._fd)
        if own.st_size != self.size:
            what = f"was changed by another program: {own.st_size} bytes, of {self.size} that were written"
            raise BagError(self.path, what)
        try:
            is_there = os.path.samestat(own, os.lstat(self.path))
        except FileNotFoundError:
            is_there = False
        if not is_there:
            raise BagError(self.path, "was deleted or moved while it was written")

    def _put(self, *parts: bytes | bytearray | memoryview) -> None:
        """Write all parts or none: after an error the file is cut back to its previous size."""
        self._check()
        size = sum(map(len, parts))
        try:
            for part in parts if size > _LARGE else [b"".join(parts)]:
                view = memoryview(part)
                while len(view):
                    view = view[os.write(self._fd, view) :]
        except BaseException:
            self._cut(self.size)
            raise
        self.size += size

    def _cut(self, size: int) -> None:
        """Truncate the file to a size [byte]."""
        self.size = size
        os.ftruncate(self._fd, size)
        os.lseek(self._fd, size, os.SEEK_SET)


@functools.lru_cache(maxsize=256)
def _record_of(size: int) -> np.dtype[Any]:
    """Data type of a message record: `MESSAGE` and a content of `size` bytes."""
    names = ["head", "sequence", "log_time", "publish_time", "data"]
    return np.dtype({"names": names, "formats": ["V11", "<u4", "<u8", "<u8", f"V{size}"]})


def _head(stream: Stream, number: int, size: int, log_time: int, publish_time: int) -> bytes:
    """Head of a message record, given the message's number in its topic and its content's size [byte]."""
    number &= 0xFFFFFFFF
    return MESSAGE.pack(Opcode.MESSAGE, _FIXED + size, stream.channel.id, number, log_time, publish_time)


def _packed(*parts: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    for part in parts:
        part.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
