"""Files that a verb writes: checked before the work, and put in place only when they are complete."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from hd_diag.cli.lines import show
from hd_diag.formatting import json_ready
from hd_diag.whole_file import whole_file


class Problem(click.ClickException):
    """Bad input: one line on stderr, exit code 2."""

    exit_code = 2


def check_targets(targets: Iterable[str | Path | None], *inputs: Path) -> None:
    """Raise a Problem for outputs that cannot be written, or would overwrite each other or an input."""
    wanted = [Path(target) for target in targets if target not in (None, "-")]
    for one, other in itertools.permutations(wanted, 2):
        own, within = (Path(os.path.realpath(path)) for path in (one, other))
        is_same = one.is_file() and other.is_file() and one.samefile(other)  # also by hard links
        if own == within or own in within.parents or is_same:
            raise Problem(f"{one} and {other} must be different files")
    for target in wanted:
        folder = target.absolute().parent
        if not folder.is_dir():
            raise Problem(f"{target}: cannot be written: no such folder")
        if not os.access(target if target.exists() else folder, os.W_OK):
            raise Problem(f"{target}: cannot be written: no permission, or a disk that is read-only")
    there = [path for path in inputs if path.exists()]  # a missing file is an error when it is read
    if wanted and there:
        from hd_diag.bag.errors import BagError, check_output  # late: slow to import

        for target in wanted:
            try:
                check_output(target, *there)
            except BagError as error:
                raise Problem(str(error)) from error


def check_new(path: Path) -> None:
    """Raise a Problem for a file that exists: people may have edited it."""
    if path.exists():
        raise Problem(f"{path}: exists already: --overwrite replaces it")


@contextmanager
def writing(path: str | Path) -> Iterator[Path]:
    """Give a draft's path and put it in place when complete; raise a Problem if it cannot be written."""
    try:
        with whole_file(path) as place:
            yield place
    except OSError as error:
        raise Problem(f"{path}: cannot be written: {error.strerror or error}") from error


def write_columns(path: str | Path, columns: Mapping[str, Any]) -> None:
    """Write columns (n,) by their names as CSV."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    with writing(path) as place:
        place.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_json(path: str | None, result: Any) -> bool:
    """Write a result as JSON if there is a path, nan as null; return False if it went to stdout."""
    if path:
        text = json.dumps(json_ready(result), indent=1, allow_nan=False)
        if path == "-":
            show(f"{text}\n")
            return False
        with writing(path) as place:
            place.write_text(text + "\n", encoding="utf-8")
    return True
