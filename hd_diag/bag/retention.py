"""Path of the log of each start of the node, and deletion of old log files."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hd_diag.bag.errors import BagError, bag_files, is_locked
from hd_diag.bag.mcap_file import WRITTEN_BY
from hd_diag.bag.place import Place
from hd_diag.bag.reader import BagReader
from hd_diag.bag.rosbag2 import UNREADABLE, load_yaml
from hd_diag.bag.writer import BagWriter

_NAME = "%Y-%m-%d_%H-%M-%S"
_START = r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(-\d+)?"

_PERIOD = 10.0  # between checks [s]
_HEAD = 64  # first bytes of a file, which name its writer


@dataclass(frozen=True)
class LogFolder:
    """The configured place of a log.

    Each start writes its own bag, named by date and time: a folder in `path`, or a file beside `path` if that
    ends in ``.mcap`` and exists already. If `fixed`, the bag is always `path` itself.
    """

    path: Path
    fixed: bool = False

    def bag(self) -> Path:
        """Path of the bag for a start that begins now; only a fixed one may exist already."""
        is_file = self.path.suffix == ".mcap"
        if self.fixed or (is_file and not os.path.lexists(self.path)):
            return self.path
        name = time.strftime(_NAME)
        for more in ("", *(f"-{number}" for number in range(2, 1000))):
            own = f"{self.path.stem}_{name}{more}.mcap" if is_file else f"{name}{more}"
            bag = self.path.with_name(own) if is_file else self.path / own
            if not os.path.lexists(bag):
                return bag
        raise BagError(self.path, f"holds a thousand logs named {name}")

    def files(self) -> Iterator[Path]:
        """MCAP files of all starts that this package has written, without symbolic links."""
        for file in self._named():
            with suppress(OSError):
                if not file.is_symlink() and file.is_file() and _is_ours(file):
                    yield file

    def _named(self) -> Iterator[Path]:
        if self.path.suffix == ".mcap":
            start = "" if self.fixed else f"(_{_START})?"
            own = re.compile(re.escape(self.path.stem) + start + r"(_\d+)?\.mcap")
            yield from (file for file in _entries(self.path.parent) if own.fullmatch(file.name))
            return
        starts = [each for each in _entries(self.path) if re.fullmatch(_START, each.name)]
        for folder in [self.path] if self.fixed else starts:
            if not folder.is_symlink():
                yield from _files(folder)


class Retention:
    """Keeps a folder within a size [byte] and an age [s], in a thread because a disk may be slow.

    0 means no limit. `problem` says what cannot be deleted. `going` lists the files that are being deleted; a
    new reader must skip them.
    """

    def __init__(self, folder: LogFolder, most_bytes: int, most_age: float) -> None:
        self._limits, self._next = (folder, most_bytes, most_age), 0.0
        self._job: Future[list[Path]] | None = None
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="log retention")
        self.problem = ""
        self.going: Sequence[Path] = ()

    def look(self, writer: BagWriter | None, now: float, at_once: bool = False) -> None:
        """Check for files to delete if it is time or `at_once`; BagError if writing the metadata fails."""
        self._next = now if at_once else self._next
        if not any(self._limits[1:]) or (self._job is not None and not self._job.done()):
            return
        own = writer.paths if writer is not None and writer.error is None else []
        found, self._job = self._job.result() if self._job is not None else [], None
        self.going = found = [file for file in found if not _is_held(file)]  # a diagnosis may now read some
        if writer is not None and any(path in own for path in found):
            writer.take_away(found)
        if found:
            self._job = self._pool.submit(self._delete, found, own)
        elif now >= self._next:
            self._next = now + _PERIOD
            self._job = self._pool.submit(self._surplus, own)

    def close(self) -> None:
        """Wait for the running job."""
        self._pool.shutdown()

    def _surplus(self, own: Sequence[Path]) -> list[Path]:
        try:
            return surplus(*self._limits, own)
        except OSError as error:
            self.problem = str(BagError(self._limits[0].path, error))
            return []

    def _delete(self, files: Sequence[Path], own: Sequence[Path]) -> list[Path]:
        problems = []
        for file in files:
            try:
                delete(file, own)
            except BagError as error:
                problems.append(str(error))
        self.problem = problems[0] if problems else ""
        return []


def surplus(folder: LogFolder, most_bytes: int, most_age: float, own: Sequence[Path] = ()) -> list[Path]:
    """Files to delete, oldest first, so that the rest of a folder is within a size [byte] and an age [s].

    0 means no limit. The last of a writer's `own` files stays. Another writer's bag stays during writing,
    and files that a diagnosis reads stay until it has ended.
    """
    now, found = time.time(), list[tuple[float, int, Path]]()
    for file in folder.files():
        with suppress(OSError):
            about = file.stat()
            found.append((about.st_mtime, about.st_size, file))
    total, gone = sum(size for _, size, _ in found), list[Path]()
    for changed, size, file in sorted(found):
        is_surplus = (most_bytes and total > most_bytes) or (most_age and now - changed > most_age)
        # A writer locks its whole folder, so only each file's own lock counts for `own` files.
        if is_surplus and not (_is_held(file) if file in own[:-1] else _is_written(file)):
            gone.append(file)
            total -= size
    return gone


def delete(file: Path, own: Sequence[Path] = ()) -> None:
    """Delete a file of a bag and its entry in the metadata; with the last file also the folder.

    The writer itself updates the metadata of its `own` files. Raises BagError if deletion fails.
    """
    try:
        if file not in own and (file.parent / "metadata.yaml").is_file():
            with suppress(BagError, *UNREADABLE):  # unreadable metadata stay as they are
                _forget(file)
        file.unlink(missing_ok=True)
        if file.parent not in (path.parent for path in own) and re.fullmatch(_START, file.parent.name):
            _remove_empty(file.parent)
    except OSError as error:
        raise BagError(file, f"cannot be deleted: {error.strerror or error}") from error


def _forget(file: Path) -> None:
    """Remove a file from the metadata of its folder."""
    info = load_yaml(file.parent / "metadata.yaml")["rosbag2_bagfile_information"]
    gone = [each for each in info["files"] if each["path"] == file.name]
    info["files"] = rest = [each for each in info["files"] if each["path"] != file.name]
    info["relative_file_paths"] = [each["path"] for each in rest]
    info["message_count"] -= (count := sum(each["message_count"] for each in gone))
    if not rest:
        return
    starts = [each["starting_time"]["nanoseconds_since_epoch"] for each in rest]
    ends = [start + each["duration"]["nanoseconds"] for start, each in zip(starts, rest, strict=True)]
    info["starting_time"]["nanoseconds_since_epoch"] = min(starts)
    info["duration"]["nanoseconds"] = max(0, max(ends) - min(starts))
    if count:
        with BagReader(file) as reader:
            counts = {topic.name: topic.count for topic in reader.topics}
        for topic in info["topics_with_message_count"]:
            left = topic["message_count"] - counts.get(topic["topic_metadata"]["name"], 0)
            topic["message_count"] = max(0, left)
    Place(file.parent).save(info)


def _remove_empty(folder: Path) -> None:
    """Delete a folder without bag files and its unlocked verdicts, unless it has other files."""
    verdicts = [*folder.glob("verdict_*")]
    if not [*_files(folder)] and not any(map(_is_held, verdicts)):
        for verdict in verdicts:
            verdict.unlink(missing_ok=True)
        (folder / "metadata.yaml").unlink(missing_ok=True)
        with suppress(OSError):
            folder.rmdir()


def _entries(folder: Path) -> list[Path]:
    return [*folder.iterdir()] if folder.is_dir() else []


def _files(folder: Path) -> Iterator[Path]:
    return (file for file in bag_files(folder) if file.suffix == ".mcap")


def _is_ours(file: Path) -> bool:
    with file.open("rb") as opened:
        return WRITTEN_BY.encode() in opened.read(_HEAD)


def _is_written(file: Path) -> bool:
    """Whether a writer or reader has locked the file, or the folder that it is in."""
    return any(_is_held(place) for place in (file, file.parent))


def _is_held(place: Path) -> bool:
    try:
        fd = os.open(place, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return True
    try:
        return is_locked(fd)
    finally:
        os.close(fd)
