"""What the model says of a drive, kept in the user's cache folder: it takes 0.6 s to load the kernels."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hd_diag.whole_file import whole_file

_MOST = 256  # files; the oldest goes


def kept(compute: Callable[..., dict[str, Any]], *given: object) -> dict[str, Any]:
    """What a function gives for something, from the disk where any process has computed it before.

    Parameters
    ----------
    compute : callable
        Its result is of numbers, texts and lists of them, and depends on `given` and this package alone.
    given : object
        Whose `repr` tells all of it.
    """
    key = hashlib.sha256(f"{_sources()}{compute.__qualname__}{given!r}".encode()).hexdigest()
    with contextlib.suppress(OSError, ValueError, RuntimeError):  # no such file; damaged; a user without home
        name, text = (folder() / f"{key}.json").read_text(encoding="utf-8").split("\n", 1)
        if name == key:
            return dict(json.loads(text))
    found = compute(*given)
    with contextlib.suppress(OSError, RuntimeError):
        _write(folder() / f"{key}.json", f"{key}\n{json.dumps(found)}")
    return found


def folder() -> Path:
    """Where it is kept; RuntimeError where the user has no home."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hd_diag"


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as place:
        place.write_text(text, encoding="utf-8")
    for old in sorted(path.parent.glob("*.json"), key=os.path.getmtime)[:-_MOST]:
        old.unlink()


@functools.cache
def _sources() -> str:
    """Of the code from which results follow: with other code they may be others."""
    package = Path(__file__).parents[1]
    paths = [
        package / "drive.py",
        *(p for room in ("model", "gear", "config") for p in (package / room).rglob("*.py")),
    ]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(paths))).hexdigest()
