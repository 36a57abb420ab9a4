"""The one exception of the bag edge."""

from __future__ import annotations

import os
from pathlib import Path

from hd_diag.formatting import visible

_LONGEST = 300  # characters of a path or a cause: names in a bag may be hostile


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
    """Real place of a path; before Python 3.13 a circle of links is a RuntimeError."""
    try:
        return Path(name).resolve()
    except RuntimeError:
        raise BagError(name, "a circle of symbolic links") from None
