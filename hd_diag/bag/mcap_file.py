"""One MCAP file being written: small chunks that reach the operating system whole, and a summary at the end.

A file that is cut off anywhere holds every chunk that was closed before. Records are those of `mcap`; only
messages and their indexes, of which there are many, are laid out here, https://mcap.dev/spec.
"""

from __future__ import annotations

import fcntl
import os
import struct
import time
import zlib
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
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

from hd_diag.arrays import Bytes, Times
from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_chunk import HEAD
from hd_diag.bag.mcap_scan import MAGIC, MESSAGE, RECORD
from hd_diag.bag.rosbag2 import Offered, dump_offers

# Level 1: floats hardly compress better at higher levels, and the node writes while it works.
_COMPRESS = {
    "zstd": zstandard.ZstdCompressor(level=1).compress,
    "lz4": lz4.frame.compress,
    "none": lambda data: data,
}
COMPRESSIONS = tuple(_COMPRESS)
# Chunks that may wait to be written: they bound the memory, and what a crash costs.
_MOST_WAITING = 4
_HEAD = MESSAGE.size - RECORD.size  # of a message, in the length of its record [byte]
_INDEX, _ENTRY = struct.Struct("<BQHI"), struct.Struct("<QQ")


class McapFile:
    """An MCAP file with profile ``ros2``, locked for as long as it is written.

    Chunks are closed at an uncompressed `chunk_size` [byte]. With `in_thread` they are compressed and written
    in a thread; what goes wrong there is raised by one of the next calls.

    `written` are the statistics of what has reached the operating system, `size` is that of the file [byte],
    `start` the log time of the first message [ns].
    """

    def __init__(
        self, path: Path, compression: str, chunk_size: int, overwrite: bool, in_thread: bool
    ) -> None:
        self.size = 0
        self._channels: dict[int, int] = {}  # number of a topic by its identity
        self._counts: dict[int, int] = {}  # messages added, by number
        self.start: int | None = None
        self.written = Statistics(0, 0, {}, 0, 0, 0, 2**64 - 1, 1, 0)
        self._compression, self._chunk_size = compression, chunk_size
        self._chunk = _Chunk()
        self._failed = False
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="bag writer") if in_thread else None
        self._waiting: deque[Future[None]] = deque()
        self._indexes = bytearray()  # packed at once: a log of days has a million of them
        self._schemas: dict[str, Schema] = {}
        self._declared: list[Channel] = []
        self._fd = _create(path, overwrite)
        try:
            self._put(MAGIC + _packed(Header("ros2", "hd_diag")))
        except BaseException:
            os.close(self._fd)
            raise

    @property
    def opened(self) -> float | None:
        """When the open chunk got its first message (``time.monotonic``) [s]; None if it has none."""
        return self._chunk.opened

    def count_of(self, topic: Offered) -> int:
        """Messages of a topic added."""
        return self._counts.get(self._channels.get(id(topic), 0), 0)

    def _channel(self, topic: Offered) -> int:
        """Number of a topic, which is declared with its schema where it is new."""
        number = self._channels.get(id(topic))
        if number is not None:
            return number
        known, number = topic.definition, len(self._declared) + 1
        name = known.type_name
        if name not in self._schemas:
            self._schemas[name] = Schema(len(self._schemas) + 1, known.text.encode(), known.encoding, name)
            self._chunk.add(_packed(self._schemas[name]))
        extra = {"offered_qos_profiles": dump_offers(topic.offers), "topic_type_hash": known.type_hash}
        self._declared.append(Channel(number, topic.name, "cdr", extra, self._schemas[name].id))
        self._chunk.add(_packed(self._declared[-1]))
        self._channels[id(topic)] = number
        self._counts[number] = self.written.channel_message_counts[number] = 0
        return number

    def add(self, topic: Offered, log_time: int, publish_time: int, data: bytes) -> None:
        """Append a message; the chunk is closed when it is full."""
        channel = self._channel(topic)
        entry, count = _ENTRY.pack(log_time, self._chunk.size), self._counts[channel] & 0xFFFFFFFF
        head = MESSAGE.pack(Opcode.MESSAGE, _HEAD + len(data), channel, count, log_time, publish_time)
        self._chunk.add(head + data)
        self._added(channel, 1, log_time, log_time, entry)

    def room(self, topic: Offered, size: int) -> int:
        """How many messages of a topic and size [byte] fill the open chunk, at least 1."""
        self._channel(topic)
        return max(1, -(-(self._chunk_size - self._chunk.size) // (size + MESSAGE.size)))

    def add_rows(self, topic: Offered, times: Times, publish_times: Times, rows: Bytes) -> None:
        """Append messages of one channel and one size, shape (n, size); the chunk is closed when full."""
        channel, (count, size) = self._channel(topic), rows.shape
        before = self._counts[channel]
        records = np.empty(count, np.dtype([*HEAD.descr, ("data", "u1", (size,))]))
        records["opcode"], records["length"], records["channel"] = Opcode.MESSAGE, _HEAD + size, channel
        records["sequence"] = np.arange(before, before + count) & 0xFFFFFFFF
        records["log_time"], records["publish_time"], records["data"] = times, publish_times, rows
        places = self._chunk.size + records.itemsize * np.arange(count)
        if self.start is None:
            self.start = int(times[0])
        self._chunk.add(memoryview(records.view(np.uint8)))
        entries = np.stack((times, places), axis=1).tobytes()
        self._added(channel, count, int(times.min()), int(times.max()), entries)

    def _added(self, channel: int, count: int, first: int, last: int, entries: bytes) -> None:
        """Account for messages that were added: least and greatest time [ns], entries of the index."""
        self._counts[channel] += count
        if self.start is None:
            self.start = first
        self._chunk.note(channel, first, last, entries)
        if self._chunk.size >= self._chunk_size:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Hand everything added so far to the operating system, or to the thread that does."""
        chunk = self._chunk
        if not chunk.size:
            return
        self._chunk = _Chunk()
        if self._pool is None:
            try:
                self._store(chunk)
            except KeyboardInterrupt:
                self._chunk = chunk  # nothing is wrong with the file
                raise
            return
        self._waiting.append(self._pool.submit(self._store, chunk))
        while len(self._waiting) > _MOST_WAITING or (self._waiting and self._waiting[0].done()):
            self._waiting.popleft().result()

    def wait(self) -> None:
        """Until every closed chunk is with the operating system; raises what first went wrong."""
        waiting, self._waiting = self._waiting, deque()
        errors = [error for error in [future.exception() for future in waiting] if error is not None]
        if errors:
            raise errors[0]

    def drop(self) -> None:
        """Forget the messages that could not be written."""
        for future in self._waiting:
            future.exception()
        self._waiting.clear()
        self._chunk, self._failed = _Chunk(), False
        self._counts = dict(self.written.channel_message_counts)

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write rosbag2's metadata and the summary; every chunk must be closed and written."""
        written = self.written
        written.message_start_time = min(written.message_start_time, written.message_end_time)
        written.schema_count, written.channel_count = len(self._schemas), len(self._declared)
        kept = _packed(Metadata("rosbag2", dict(metadata)))
        end = kept + _packed(DataEnd(0))
        start, summary, offsets = self.size + len(end), b"", b""
        for opcode, group in (
            (Opcode.SCHEMA, _packed(*self._schemas.values())),
            (Opcode.CHANNEL, _packed(*self._declared)),
            (Opcode.STATISTICS, _packed(written)),
            (Opcode.CHUNK_INDEX, bytes(self._indexes)),
            (Opcode.METADATA_INDEX, _packed(MetadataIndex(self.size, len(kept), "rosbag2"))),
        ):
            if group:
                offsets += _packed(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        places = start, start + len(summary)
        checksum = zlib.crc32(summary + offsets + struct.pack("<BQQQ", Opcode.FOOTER, 20, *places))
        self._put(end + summary + offsets + _packed(Footer(*places, checksum)) + MAGIC)

    def release(self) -> None:
        """Close the file as it is."""
        if self._pool is not None:
            self._pool.shutdown()
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            os.close(fd)

    def _store(self, chunk: _Chunk) -> None:
        """Write a chunk; after one that could not be written none is."""
        if self._failed:
            return
        data, start = b"".join(chunk.parts), self.size
        first, name = (0 if chunk.opened is None else chunk.first), self._compression.replace("none", "")
        stored = _COMPRESS[self._compression](data)
        record = _packed(Chunk(name, stored, chunk.last, first, zlib.crc32(data), len(data)))
        places, index = {}, b""
        for channel, entries in chunk.index.items():
            places[channel] = start + len(record) + len(index)
            index += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries
        try:
            self._put(record + index)
        except OSError:
            self._failed = True
            raise
        sizes = len(stored), chunk.last, len(index), places, first, len(data)
        self._indexes += _packed(ChunkIndex(len(record), start, name, *sizes))
        written = self.written
        written.chunk_count += 1
        written.message_start_time = min(written.message_start_time, chunk.first)
        written.message_end_time = max(written.message_end_time, chunk.last)
        for channel, entries in chunk.index.items():
            written.channel_message_counts[channel] += len(entries) // _ENTRY.size
            written.message_count += len(entries) // _ENTRY.size

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
    """Records of the chunk that is being filled, their times, and where the messages of each channel are."""

    def __init__(self) -> None:
        self.parts: list[bytes | memoryview] = []
        self.size = 0
        self.opened: float | None = None
        self.first, self.last = 2**64 - 1, 0
        self.index: dict[int, bytearray] = {}

    def add(self, records: bytes | memoryview) -> None:
        self.parts.append(records)
        self.size += len(records)

    def note(self, channel: int, first: int, last: int, entries: bytes) -> None:
        if self.opened is None:
            self.opened = time.monotonic()
        self.first, self.last = min(self.first, first), max(self.last, last)
        self.index.setdefault(channel, bytearray()).extend(entries)


def _create(path: Path, overwrite: bool) -> int:
    """File descriptor of a new, locked file."""
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | (0 if overwrite else os.O_EXCL)
    fd = os.open(path, flags, 0o666)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(fd, 0)
    except BaseException as exc:
        os.close(fd)
        if isinstance(exc, BlockingIOError):
            raise BagError(path, "is being written by another process") from exc
        raise
    return fd


def _packed(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
