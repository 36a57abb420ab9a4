"""Recovery of a bag that a crash, a full disk or damage left unfinished."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from hd_diag.bag.block import Block, Topic
from hd_diag.bag.errors import BagError, check_output, replaced
from hd_diag.bag.folder import decompressed, find_files, unpack
from hd_diag.bag.mcap_chunk import MAX_MESSAGE
from hd_diag.bag.mcap_scan import MAGIC, Scan
from hd_diag.bag.sqlite_file import SqliteFile, is_sqlite
from hd_diag.bag.typestore import store_of
from hd_diag.bag.writer import BagWriter
from hd_diag.messages.schemas import jazzy

# Messages copied at once, because Python numbers take far more memory than columns.
_AT_ONCE = 1 << 14
_TOO_LONG = f"messages are longer than {MAX_MESSAGE} bytes"
_Piece = tuple[dict[int, Topic], Block, int]  # topics, messages, offset in the file [byte]


@dataclass
class FileRecovery:
    """Result for one storage file: its size, unreadable bytes [byte], and the number of saved messages.

    `unverified` counts messages that were read without a checksum. `lost` counts messages that are certainly
    lost: the file counts them but they were not read, or they could not be copied, for example for lack of a
    topic. `problems` has one line for each problem.
    """

    path: Path
    size: int
    unread: int = 0
    messages: int = 0
    lost: int = 0
    unverified: int = 0
    problems: list[str] = field(default_factory=list)


@dataclass
class RecoveryReport:
    """What was saved and what was lost.

    `out` lists the files written and read back, `counts` the number of saved messages of each topic. `start`
    and `end` are their least and greatest log time [ns]. `problems` says what is wrong with the folder.
    `unknown` lists topics whose type definitions in the bag cannot be understood.
    """

    out: list[Path]
    files: list[FileRecovery]
    counts: dict[str, int] = field(default_factory=dict)
    start: int | None = None
    end: int | None = None
    problems: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether no loss is known."""
        return not self.problems and not any(f.problems or f.lost for f in self.files)

    def add(self, topic: str, log_time: int) -> None:
        """Count a message of a topic at a time [ns]."""
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self.start = log_time if self.start is None else min(self.start, log_time)
        self.end = log_time if self.end is None else max(self.end, log_time)

    def statement(self) -> list[str]:
        """What was saved and lost, as lines of text."""
        total = sum(self.counts.values())
        until = "" if self.end is None else f", the last at {self.end * 1e-9:.9f} s"
        lines = [f"saved {total} messages{until}"]
        lines += [f"  {topic}: {count}" for topic, count in sorted(self.counts.items())]
        lines += self.problems
        for file in self.files:
            lines += [f"{file.path.name}: {problem}" for problem in file.problems]
            if file.unread:
                lines.append(f"{file.path.name}: {file.unread} of {file.size} bytes could not be read")
            if file.lost:
                lines.append(f"{file.path.name}: at least {file.lost} messages are lost")
            if file.unverified:
                lines.append(f"{file.path.name}: unverified: {file.unverified} messages have no checksum")
        lines += [f"{topic}: unverified: its definition cannot be understood" for topic in self.unknown]
        verified = not self.unknown and not any(file.unverified for file in self.files)
        found = "nothing is missing" if verified else "nothing is known to be missing"
        return [*lines, *([found] if self.complete else [])]

    def as_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        return {
            "schema": "hd_diag/recovery/1",
            "complete": self.complete,
            "out": [str(p) for p in self.out],
            "messages": self.counts,
            "start": self.start,
            "end": self.end,
            "problems": self.problems,
            "unknown": self.unknown,
            "files": [{**vars(file), "path": str(file.path)} for file in self.files],
        }


def recover(
    bag: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> RecoveryReport:
    """Copy all readable messages of a bag into a new, whole bag, and verify it by reading it back.

    If nothing of an unfinished or damaged bag can be saved, nothing is written or replaced. After an error a
    new output has no end, so that no reader takes it for whole. A bag that `overwrite` would replace stays
    unchanged after an error or Ctrl-C.

    `progress` is called with the bytes done and the bytes in all. If it raises KeyboardInterrupt, a new
    output is finished with the messages copied so far.

    Raises
    ------
    BagError
        If `bag` is not a bag at all, or `out` cannot be written or does not read back the same.
    """
    check_output(out, bag)
    found = find_files(Path(bag), lenient=True)
    files = [FileRecovery(path, path.stat().st_size) for path in found.paths]
    total, before = sum(file.size for file in files), 0
    report, topics = RecoveryReport([], files, problems=found.problems), dict[tuple[str, str], Topic]()
    with replaced(out, overwrite=overwrite) as place:
        with ExitStack() as stack:
            begin = functools.cache(lambda: stack.enter_context(BagWriter(place, overwrite=overwrite)))
            for file in files:
                size = file.size
                for known, block, reached in _salvage(file):
                    topics |= _copy(begin, known, block, report, file, packed=found.message_compression)
                    progress(min(before + reached, total), total)
                before += size
            if report.complete:
                begin()  # a whole but empty bag is copied too
            paths = begin().paths if begin.cache_info().currsize else []
        if paths:
            _verify(paths, sum(file.messages for file in files), lambda: progress(total, total))
            report.out = [Path(out) / path.relative_to(place) for path in paths]
    report.unknown = sorted({topic.name for topic in topics.values() if not _is_understood(topic)})
    return report


def _copy(
    begin: Callable[[], BagWriter],
    topics: dict[int, Topic],
    block: Block,
    report: RecoveryReport,
    file: FileRecovery,
    *,
    packed: bool,
) -> dict[tuple[str, str], Topic]:
    """Write the messages with valid times and defined types; returns their topics by name and type."""
    here = set(np.unique(block.channel).tolist())
    known = {number: topics[number] for number in here & topics.keys() if _is_defined(topics[number])}
    for topic in known.values():
        is_given = topic.definition is not None and (topic.foreign or topic.definition.text)
        text = topic.definition if is_given else None
        begin().add_topic(topic.name, topic.type_name, topic.offers, text)
    is_late, is_known = (block.log_time < 0) | (block.publish_time < 0), np.isin(block.channel, [*known])
    lost = {
        "messages have a time beyond the year 2262": int(is_late.sum()),
        "messages belong to no topic with a known definition": int((~is_late & ~is_known).sum()),
        "compressed messages are damaged": 0,
        _TOO_LONG: 0,
    }
    good, zstd = block[~is_late & is_known], zstandard.ZstdDecompressor()
    for first in range(0, len(good), _AT_ONCE):
        part = good[first : first + _AT_ONCE]
        columns = (column.tolist() for column in (part.channel, part.log_time, part.publish_time))
        contents = part.messages() if part.long is None else [part.long]
        for data, channel, *times in zip(contents, *columns, strict=True):
            try:
                message = decompressed(file.path, data, zstd, packed)
            except BagError:
                lost["compressed messages are damaged"] += 1
                continue
            if len(message) > MAX_MESSAGE:
                lost[_TOO_LONG] += 1
                continue
            topic = known[channel]
            begin().write(topic.name, topic.type_name, message, *times)
            report.add(topic.name, times[0])
    file.problems += [f"{count} {what}" for what, count in lost.items() if count]
    file.lost += sum(lost.values())
    file.messages += len(block) - sum(lost.values())
    return {(topic.name, topic.type_name): topic for topic in known.values()}


def _is_defined(topic: Topic) -> bool:
    """Whether the type of a topic is defined in the bag or in ROS 2 Jazzy, or the topic is foreign."""
    has_text = topic.definition is not None and topic.definition.text != ""
    return bool(topic.foreign) or has_text or topic.type_name in jazzy().fielddefs


def _is_understood(topic: Topic) -> bool:
    """Whether a topic's definition can be understood; true for foreign topics, which are only copied."""
    if topic.foreign:
        return True
    try:
        store_of(topic.type_name, topic.definition)
    except ValueError:
        return False
    return True


def _salvage(report: FileRecovery) -> Iterator[_Piece]:
    """Yield topics, messages and offset in the file for each readable piece; notes problems in `report`."""
    try:
        with ExitStack() as stack:
            plain, problem = unpack(report.path, stack)
            report.size = plain.stat().st_size
            report.problems += [problem] if problem else []
            yield from (_salvage_sqlite if is_sqlite(plain) else _salvage_mcap)(plain, report, stack)
    except (BagError, OSError) as exc:
        report.problems.append(exc.cause if isinstance(exc, BagError) else str(exc))
        report.unread = report.size


def _salvage_sqlite(path: Path, report: FileRecovery, stack: ExitStack) -> Iterator[_Piece]:
    """All messages, also those without a topic; BagError if the database is damaged."""
    found, place = SqliteFile(path, stack), 0
    for block in found.blocks(None):
        place += int(block.size.sum())
        report.unverified += len(block)
        yield found.topics, block, min(place, report.size)


def _salvage_mcap(path: Path, report: FileRecovery, stack: ExitStack) -> Iterator[_Piece]:
    """Messages of every section, and of truncated chunks where the walk over the records stopped."""
    found = Scan(path, stack.enter_context(path.open("rb")))
    gaps, read = [], 0
    while found.problem:
        report.problems.append(found.problem)
        following = found.find_chunk(found.end + 1)
        gaps.append((found.end, found.size if following is None else following))
        if following is None:
            break
        found.end = following
        found.walk()
    for section in found.sections:
        try:
            for part in found.parts(section):
                block = found.load([part]) if part.channel is None else found.long_message(part)
                read += len(block)
                report.unverified += 0 if section.checksum else len(block)
                yield found.topics(), block, section.offset + section.size
        except BagError as exc:
            report.problems.append(exc.cause)
            report.unread += section.size
    for begin, end in gaps:
        report.unread += end - begin
        before = read
        for block in found.load_part(begin, end):
            read += len(block)
            report.unverified += len(block)
            yield found.topics(), block, end
        if read > before:
            what = f"{read - before} messages were read from a chunk that is cut off at byte {end}"
            report.problems.append(what)
    if found.statistics is not None:
        report.lost += max(0, found.statistics.message_count - read)


def _verify(paths: list[Path], count: int, progress: Callable[[], None]) -> None:
    """Read the result back, check checksums and count; if wrong, cut off its end and raise BagError."""
    try:
        found = 0
        for path in paths:
            again = FileRecovery(path, path.stat().st_size)
            for _, block, _ in _salvage(again):  # in file order, so nothing is held for sorting
                found += len(block)
                progress()
            if again.problems:
                raise BagError(path, f"was written but {again.problems[0]}")
        if found != count:
            raise BagError(paths[0], f"was written but holds {found} messages instead of {count}")
    except BagError:
        for path in paths:
            os.truncate(path, max(0, path.stat().st_size - len(MAGIC)))
        raise
