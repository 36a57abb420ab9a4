"""Bags in place of older ones, which stay until the new one is whole."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from hd_diag.bag.errors import BagError
from hd_diag.bag.mcap_storage import is_locked


@contextmanager
def replaced(path: str | os.PathLike[str], *, overwrite: bool) -> Iterator[Path]:
    """Where to write a bag, so that one that it replaces stays until the new one is whole.

    Without `overwrite`, or where there is no bag, that is `path`, as for `BagWriter`; else a place beside it.
    After an exception, Ctrl-C included, the old bag is as it was. Raises BagError where the old bag is being
    written, or cannot be replaced, and what the body raises of the new one, with its own name.
    """
    place = Path(path)
    if not (overwrite and (place.is_dir() or (place.suffix == ".mcap" and place.is_file()))):
        yield place
        return
    try:
        old = place.resolve()
        for file in [old] if old.is_file() else bag_files(old):
            with file.open("rb") as opened:
                if is_locked(opened.fileno()):
                    raise BagError(file, "is being written by another process")
        with TemporaryDirectory(prefix=f".{old.name}.", dir=old.parent) as folder:
            # The name decides between file and folder, and a folder's names its files.
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


def bag_files(folder: Path) -> list[Path]:
    """Files of the bag in a folder, and nothing else that lies there; none where there is no folder."""
    own = re.compile(re.escape(folder.resolve().name) + r"_\d+\.(mcap|db3)|metadata\.yaml")
    return [file for file in (folder.iterdir() if folder.is_dir() else ()) if own.fullmatch(file.name)]


def _put_in_place(draft: Path, old: Path) -> None:
    """Move a new bag, where there is one, over the old one; a folder's metadata come last."""
    if draft.is_file():
        os.replace(draft, old)
    elif draft.is_dir():
        new = sorted(draft.iterdir(), key=lambda file: file.name == "metadata.yaml")
        for file in new:
            os.replace(file, old / file.name)
        for file in bag_files(old):
            if file.name not in {entry.name for entry in new}:
                file.unlink()
