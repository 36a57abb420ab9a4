"""What can be saved of a bag that a crash, a full disk or damage left unfinished."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.bag.block import Block
from hd_diag.bag.errors import BagError, check_output
from hd_diag.bag.folder import Unpacked, find_files, unpacked
from hd_diag.bag.mcap_chunk import find_chunk, load, load_part, load_storable
from hd_diag.bag.mcap_file import MAGIC
from hd_diag.bag.mcap_scan import Scan, Section, scan, walk
from hd_diag.bag.mcap_storage import Topics, declared, kept_custom_data
from hd_diag.bag.sqlite_damaged import DamagedSqlite
from hd_diag.bag.sqlite_database import is_sqlite
from hd_diag.bag.writer import BagWriter, replaced
from hd_diag.messages.schemas import Definition, definition

Progress = Callable[[int, int], None]
# Messages copied at once.
_AT_ONCE = 1 << 14


@dataclass
class FileRecovery:
    """What became of one storage file.

    Attributes
    ----------
    path : Path
    size, unread : int
        Size of the file, and bytes of it that could not be read [byte].
    messages : int
        Messages saved.
    lost : int
        Messages lost for certain: those that an index counts in a damaged chunk, or that belong to no topic.
    problems : list of str
        What is wrong with the file, one line each; empty for a whole file.
    """

    path: Path
    size: int
    unread: int = 0
    messages: int = 0
    lost: int = 0
    problems: list[str] = field(default_factory=list)


@dataclass
class RecoveryReport:
    """What was saved and what was lost.

    Attributes
    ----------
    out : list of Path
        Files written, read back and found equal to what was saved; none where nothing could be saved.
    files : list of FileRecovery
    counts : dict
        Messages saved of each topic.
    start, end : int or None
        Least and greatest log time saved [ns]; None where nothing was.
    problems : list of str
        What is wrong with the folder: metadata that cannot be understood, missing files.
    """

    out: list[Path]
    files: list[FileRecovery]
    counts: dict[str, int]
    start: int | None = None
    end: int | None = None
    problems: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether nothing was lost that is known of."""
        return not self.problems and not any(f.problems for f in self.files)

    def statement(self) -> list[str]:
        """What was saved and lost, in lines for people."""
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
        return lines if not self.complete else [*lines, "nothing is missing"]

    def as_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        files = [
            {"path": str(f.path), "size": f.size, "unread": f.unread, "messages": f.messages, "lost": f.lost}
            | {"problems": f.problems}
            for f in self.files
        ]
        return {
            "schema": "hd_diag/recovery/1",
            "complete": self.complete,
            "out": [str(p) for p in self.out],
            "messages": self.counts,
            "start": self.start,
            "end": self.end,
            "problems": self.problems,
            "files": files,
        }


def recover(
    bag: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RecoveryReport:
    """Copy everything that can be read of a bag into a new, whole one, and read that back.

    Where nothing of an unfinished or damaged bag can be saved, nothing is written or replaced. After an error
    a new output is left without its end, so that no reader takes it for whole; a bag that `overwrite` would
    replace stays as it was, also after Ctrl-C.

    Parameters
    ----------
    bag : str or path-like
        MCAP file, ``.db3`` file or rosbag2 folder.
    out : str or path-like
        Bag to write, as for `BagWriter`.
    overwrite : bool, optional
        Replace `out` where it exists.
    progress : callable, optional
        Called with the bytes done and the bytes in all. If it raises KeyboardInterrupt, a new output is
        finished with what it has.

    Raises
    ------
    BagError
        Where `bag` is not a bag at all, or `out` cannot be written or does not read back the same.
    """
    check_output(out, bag)
    with replaced(out, overwrite=overwrite) as place:
        result = _recover(Path(bag), place, overwrite, progress or (lambda done, total: None))
    result.out = [Path(out) / path.relative_to(place) for path in result.out]
    return result


def _recover(bag: Path, out: Path, overwrite: bool, progress: Progress) -> RecoveryReport:
    found = find_files(bag, lenient=True)
    total = sum(p.stat().st_size for p in found.paths)
    tally, files, done = _Tally(), [], 0
    extra = found.custom_data or _custom_data(found.paths)
    with _Output(lambda: BagWriter(out, overwrite=overwrite, custom_data=extra)) as output:
        for path in found.paths:
            report = FileRecovery(path, path.stat().st_size)
            before = done
            for topics, block, place in _salvage(path, report):
                report.messages += _copy(
                    output, topics, block, tally, report, packed=found.message_compression
                )
                progress(min(before + place, total), total)
            done += path.stat().st_size
            files.append(report)
        result = RecoveryReport([], files, tally.counts, problems=found.problems)
        if result.complete:
            output.writer()  # a whole bag that is empty stays one
    if output.opened is not None:
        _verify(output.opened, tally, lambda: progress(total, total))
        result.out = output.opened.paths
    if tally.counts:
        result.start, result.end = tally.start, tally.end
    return result


class _Output:
    """Writer that is opened for the first message that can be saved."""

    def __init__(self, open_writer: Callable[[], BagWriter]) -> None:
        self.opened: BagWriter | None = None
        self._open = open_writer

    def writer(self) -> BagWriter:
        if self.opened is None:
            self.opened = self._open()
        return self.opened

    def __enter__(self) -> _Output:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.opened is not None:
            self.opened.__exit__(kind, exc, trace)


def _custom_data(paths: list[Path]) -> dict[str, str]:
    """Custom data from inside MCAP files, for a file without a folder's metadata."""
    kept: dict[str, str] = {}
    for path in paths:
        with suppress(BagError, OSError), path.open("rb") as file:
            kept = kept_custom_data(scan(path, file)) | kept
    return kept


class _Tally:
    """Order-independent digest of the messages that were saved."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.digest = 0
        self.start, self.end = 2**63 - 1, 0

    def add(self, topic: str, data: memoryview, log_time: int) -> None:
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self.start, self.end = min(self.start, log_time), max(self.end, log_time)
        self.digest += zlib.crc32(data, zlib.crc32(topic.encode(), log_time & 0xFFFFFFFF))


def _salvage(path: Path, report: FileRecovery) -> Iterator[tuple[Topics, Block, int]]:
    """Topics, messages and place in the file, piece by piece, for as much as can be read."""
    try:
        with closing(Unpacked([path])) as unpacked_files:
            plain, problem = unpacked_files.file(path)
            report.size = plain.stat().st_size
            report.problems += [problem] if problem else []
            if is_sqlite(plain):
                yield from _salvage_sqlite(plain, report)
            else:
                with plain.open("rb") as file:
                    yield from _salvage_mcap(plain, file, report)
    except (BagError, OSError) as exc:
        report.problems.append(exc.cause if isinstance(exc, BagError) else str(exc))
        report.unread = report.size


def _salvage_sqlite(path: Path, report: FileRecovery) -> Iterator[tuple[Topics, Block, int]]:
    with closing(DamagedSqlite(path)) as found:
        for block in found.blocks():
            yield found.topics, block, min(found.read, report.size)
        report.problems += found.problems
        report.lost += found.lost


def _salvage_mcap(path: Path, file: Any, report: FileRecovery) -> Iterator[tuple[Topics, Block, int]]:
    found = scan(path, file)
    gaps = _rescan(path, file, found, report)
    for section in found.sections:
        try:
            block = _load(path, file, section, found, report)
        except BagError as exc:
            report.problems.append(exc.cause)
            report.unread += section.size
            report.lost += sum((section.counts or {}).values())
            continue
        yield declared(found), block, section.offset
    for start, end in gaps:
        try:
            block = load_part(path, file, start, end, found)
        except BagError as exc:
            report.problems.append(exc.cause)
            continue
        if len(block):
            report.problems.append(
                f"{len(block)} messages were read from a chunk that is cut off at byte {end}"
            )
        yield declared(found), block, start


def _load(path: Path, file: Any, section: Section, found: Scan, report: FileRecovery) -> Block:
    """Messages of a section; those whose times cannot be written are counted as lost.

    Raises
    ------
    BagError
        Where it is damaged.
    """
    try:
        return load(path, file, [section], found)
    except BagError:
        block, late = load_storable(path, file, section, found)
    report.lost += late
    report.problems.append(f"{late} messages have a time beyond the year 2262")
    return block


def _rescan(path: Path, file: Any, found: Scan, report: FileRecovery) -> list[tuple[int, int]]:
    """Go on behind damage where a whole chunk follows; gives the ranges of bytes that were not understood."""
    gaps = []
    while found.problem:
        report.problems.append(found.problem)
        gap = found.end
        following = find_chunk(file, gap + 1, found.size)
        end = found.size if following is None else following
        if end > gap:
            gaps.append((gap, end))
        report.unread += end - gap
        if following is None:
            break
        found.end = following
        walk(path, file, found)
    return gaps


def _copy(
    output: _Output, topics: Topics, block: Block, tally: _Tally, report: FileRecovery, *, packed: bool
) -> int:
    """Write the messages whose topics are known; gives their number."""
    lost: dict[int, int] = {}
    damaged = 0
    names: dict[int, tuple[str, str]] = {}
    if any(_is_known(topics[n]) for n in topics.keys() & set(block.channel.tolist())):
        names = {n: topic[:2] for n, topic in topics.items() if _declare(output.writer(), topic)}
    columns = (block.channel, block.offset, block.size, block.log_time, block.publish_time)
    view = memoryview(block.data)
    for channel, offset, size, log_time, publish_time in _lines(*columns):
        if channel not in names:
            lost[channel] = lost.get(channel, 0) + 1
            continue
        data = view[offset : offset + size]
        try:
            message = unpacked(report.path, [data])[0] if packed else data
        except BagError:
            damaged += 1
            continue
        output.writer().write(*names[channel], message, log_time, publish_time)
        tally.add(names[channel][0], message, log_time)
    for count in lost.values():
        report.problems.append(f"{count} messages belong to no topic with a known definition")
    if damaged:
        report.problems.append(f"{damaged} compressed messages are damaged")
    report.lost += damaged + sum(lost.values())
    return len(block) - damaged - sum(lost.values())


def _lines(*columns: npt.NDArray[np.int64]) -> Iterator[tuple[int, ...]]:
    """The values of some columns side by side; a few at once, as they take far more memory than columns."""
    for first in range(0, len(columns[0]), _AT_ONCE):
        yield from zip(*(column[first : first + _AT_ONCE].tolist() for column in columns), strict=True)


def _is_known(topic: tuple[str, str, str, Definition | None]) -> bool:
    """Whether the topic's type has a definition, in the bag or in ROS 2 Jazzy."""
    _, kind, _, known = topic
    if known is None or not known.text:
        try:
            definition(kind)
        except KeyError:
            return False
    return True


def _declare(writer: BagWriter, topic: tuple[str, str, str, Definition | None]) -> bool:
    """Whether the topic could be declared: it cannot where its type has no definition anywhere."""
    name, kind, offers, known = topic
    try:
        writer.add_topic(name, kind, offers, known if known is not None and known.text else None)
    except BagError:
        if writer.error is not None:
            raise
        return False
    return True


def _verify(writer: BagWriter, tally: _Tally, progress: Callable[[], None]) -> None:
    """Read the result and compare it with what was saved; a result that is wrong loses its end."""
    try:
        again = _read_back(writer.paths, progress)
        if (again.counts, again.digest) != (tally.counts, tally.digest):
            raise BagError(writer.path, "does not read back as it was written")
    except BagError:
        for path in writer.paths:
            os.truncate(path, max(0, path.stat().st_size - len(MAGIC)))
        raise


def _read_back(paths: list[Path], progress: Callable[[], None]) -> _Tally:
    again = _Tally()
    for path in paths:
        report = FileRecovery(path, path.stat().st_size)
        for topics, block, _ in _salvage(
            path, report
        ):  # in the order of the file: nothing is held for sorting
            view = memoryview(block.data)
            for channel, offset, size, log_time in _lines(
                block.channel, block.offset, block.size, block.log_time
            ):
                again.add(topics[channel][0], view[offset : offset + size], log_time)
            progress()
        if report.problems:
            raise BagError(path, f"was written but {report.problems[0]}")
    return again
