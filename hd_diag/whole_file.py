"""Files that are replaced only by what is whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Where to write a file, put in its place when it is whole and on the disk.

    Until then, and after an exception, what was there before stays. A link stays one: what it leads to is
    replaced. Pipes and devices are written to, as are files of a folder where nothing new can be made.
    """
    target = Path(os.path.realpath(path))
    if (target.exists() and not target.is_file()) or not os.access(target.parent, os.W_OK):
        yield target
        return
    with TemporaryDirectory(prefix=".part.", dir=target.parent) as folder:
        draft = Path(folder) / target.name
        yield draft
        with draft.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(draft, target)
