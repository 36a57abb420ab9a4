"""Place of a bag that is written: file names, lock and metadata, and syncing of its files to the disk."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from hd_diag.bag.errors import BagError, bag_files, lock
from hd_diag.bag.mcap_file import McapFile
from hd_diag.bag.rosbag2 import dump_yaml


class Place:
    """Path of a bag: a file if it ends in ``.mcap``, otherwise a folder; links are not followed.

    The folder, or without one the first file, is locked against other writers of this package until
    `release`.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.is_folder = path, path.suffix != ".mcap"
        self._lock = -1

    def take(self, *, exist_ok: bool) -> None:
        """Make and lock the folder; BagError or OSError if it is in use, a link, or exists already."""
        if self.path.is_symlink():
            raise BagError(self.path, "is a symbolic link: give the place it leads to")
        if self.is_folder:
            self.path.mkdir(parents=True, exist_ok=exist_ok)
            self.release()
            self._lock = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            with suppress(OSError):  # some network folders cannot be locked, but their files can
                lock(self._lock, self.path)

    def clear(self) -> None:
        """Delete the old bag in the folder."""
        for file in bag_files(self.path) if self.is_folder else ():
            file.unlink()

    def began(self, file: McapFile) -> None:
        """Keep the first file locked if there is no folder to lock."""
        if self._lock < 0:
            self._lock = file.held()

    def name(self, number: int) -> Path:
        """Path of a file by its number, from 0 on."""
        if self.is_folder:
            return self.path / f"{self.path.resolve().name}_{number}.mcap"
        return self.path.with_name(f"{self.path.stem}_{number}.mcap") if number else self.path

    def free(self, number: int) -> int:
        """The first number from `number` on whose file does not exist."""
        while os.path.lexists(self.name(number)):
            number += 1
        return number

    def save(self, information: Mapping[str, Any]) -> None:
        """Write a folder's ``metadata.yaml``; the old file stays until the new one is complete."""
        if self.is_folder:
            draft = self.path / "metadata.yaml.tmp"
            draft.unlink(missing_ok=True)
            try:
                with draft.open("x", encoding="utf-8") as file:  # "x" never follows a link
                    file.write(dump_yaml({"rosbag2_bagfile_information": information}))
                draft.replace(self.path / "metadata.yaml")
            except BaseException:
                with suppress(OSError):
                    draft.unlink(missing_ok=True)
                raise

    def release(self) -> None:
        """Unlock the place for other writers."""
        fd, self._lock = self._lock, -1
        if fd >= 0:
            os.close(fd)


class Disk:
    """Syncs written data to the disk in a thread, because it may take long; a period of 0 means never."""

    def __init__(self, period: float) -> None:
        self._period, self._last = period, -float("inf")
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="bag to disk")
        self._job: Future[None] | None = None

    def sync_if_due(self, file: McapFile, now: float) -> None:
        """Start a sync if the period is over and none is running; raises the error of an earlier sync."""
        if now - self._last >= self._period and (self._job is None or self._job.done()):
            self._last = now
            self.sync(file)

    def sync(self, file: McapFile) -> None:
        """Start a sync after any running one, unless the period is 0; raises the error of an earlier sync."""
        if self._period:
            self._raise()
            self._job = self._pool.submit(_synced, file.held(), file.path.parent)

    def close(self) -> None:
        """Wait for running syncs; raises their error."""
        self._pool.shutdown()
        self._raise()

    def _raise(self) -> None:
        if self._job is not None and self._job.done():
            job, self._job = self._job, None
            job.result()


def _synced(fd: int, folder: Path) -> None:
    """Sync a file to the disk, close its descriptor, and sync the folder, which holds its name."""
    try:
        os.fdatasync(fd)
    finally:
        os.close(fd)
    with suppress(FileNotFoundError):  # the next chunk raises the error
        there = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(there)
        finally:
            os.close(there)
