"""Files that are replaced only by complete ones."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Path to write a file at; the file moves to its place when it is complete and on the disk.

    Until then, and after an exception, the old file stays. A link stays a link, and its target is replaced.
    Pipes and devices are written directly, and so are files in a folder that is not writeable.
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
