"""The exception of this package, and checks and locks that protect inputs and existing bags."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from hd_diag.formatting import visible

_TAKEN = "is being written by another process"
_LONGEST = 300  # characters of a path or cause, because names in a bag may be hostile


class BagError(ValueError):
    """A bag cannot be read or written; the message is one line that names the file and the cause."""

    def __init__(self, path: str | os.PathLike[str], cause: str | Exception) -> None:
        self.path = Path(path)
        text = cause.strerror if isinstance(cause, OSError) and cause.strerror else str(cause)
        self.cause = visible(text, _LONGEST)
        super().__init__(f"{visible(str(path), _LONGEST)}: {self.cause}")


def check_output(out: str | os.PathLike[str], *inputs: str | os.PathLike[str]) -> None:
    """Raise BagError for an output that is, holds, or lies inside one of the inputs."""
    target = _resolved(out)
    for name in inputs:
        source = _resolved(name)
        if target == source or target in source.parents or (source.is_dir() and source in target.parents):
            raise BagError(out, f"output would overwrite the input {source}")
        if target.exists() and source.exists() and os.path.samefile(target, source):
            raise BagError(out, f"output is the same file as the input {source}")


def _resolved(name: str | os.PathLike[str]) -> Path:
    """Path with links resolved; a loop of links raises RuntimeError before Python 3.13, here BagError."""
    try:
        return Path(name).resolve()
    except RuntimeError:
        raise BagError(name, "a loop of symbolic links") from None


@contextmanager
def replaced(path: str | os.PathLike[str], *, overwrite: bool) -> Iterator[Path]:
    """Yield a path for writing a bag; the bag that it replaces stays until the new one is complete.

    Without `overwrite`, or if no bag exists yet, this is `path` itself, as for `BagWriter`. Otherwise it is a
    temporary path beside the old bag. After an exception, also Ctrl-C, the old bag is unchanged. Raises
    BagError if the old bag is being written or cannot be replaced. A BagError of the ``with`` body about the
    new bag is raised again with `path`.
    """
    place = Path(path)
    if not (overwrite and (place.is_dir() or (place.suffix == ".mcap" and place.is_file()))):
        yield place
        return
    try:
        check_not_written(old := place.resolve())
        with TemporaryDirectory(prefix=f".{old.name}.", dir=old.parent) as folder:
            # The suffix decides between file and folder, and a folder's name is part of its file names.
            draft = Path(folder) / (place.name if old.is_file() else old.name)
            try:
                yield draft
            except BagError as exc:
                if draft not in (exc.path, *exc.path.parents):
                    raise
                raise BagError(place, f"{exc.cause}; what was there before is kept") from exc
            _put_in_place(draft, old)
    except OSError as exc:
        raise BagError(place, exc) from exc


def check_not_written(bag: Path) -> None:
    """Raise BagError if a writer of this package has locked the bag, OSError if a file cannot be opened."""
    for file in [bag] if bag.is_file() else bag_files(bag):
        with file.open("rb") as opened:
            if is_locked(opened.fileno()):
                raise BagError(bag, _TAKEN)


def taken(bag: Path) -> BagError:
    """The error for a path that is taken: another process writes a bag there, or one exists already."""
    try:
        check_not_written(bag)
    except BagError as error:
        return error
    except OSError:
        pass
    return BagError(bag, "exists already")


def bag_files(folder: Path) -> list[Path]:
    """The bag's own files in a folder; empty if the folder does not exist."""
    own = re.compile(re.escape(folder.resolve().name) + r"_\d+\.(mcap|db3)|metadata\.yaml")
    return [file for file in (folder.iterdir() if folder.is_dir() else ()) if own.fullmatch(file.name)]


def _put_in_place(draft: Path, old: Path) -> None:
    """Move a new bag, if any, over the old one, metadata last; then delete surplus files of the old bag."""
    if draft.is_file():
        os.replace(draft, old)
    elif draft.is_dir():
        new = sorted(draft.iterdir(), key=lambda file: file.name == "metadata.yaml")
        for file in new:
            os.replace(file, old / file.name)
        for file in bag_files(old):
            if file.name not in {entry.name for entry in new}:
                file.unlink()


def new_file(path: Path, overwrite: bool) -> int:
    """File descriptor of a new or emptied, locked file; symbolic links are not followed."""
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | (0 if overwrite else os.O_EXCL)
    fd = os.open(path, flags, 0o666)
    try:
        lock(fd, path)
        os.ftruncate(fd, 0)
    except BaseException:
        os.close(fd)
        raise
    return fd


def lock(fd: int, path: Path) -> None:
    """Lock an open file or folder until it is closed; BagError if another writer has locked it."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as exc:
        raise BagError(path, _TAKEN) from exc


def is_locked(fd: int) -> bool:
    """Whether a writer of this package has locked the file."""
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    with suppress(OSError):
        fcntl.flock(fd, fcntl.LOCK_UN)
    return False
