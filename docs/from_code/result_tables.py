"""Tables that the benchmarks write; where one is not there yet, the page says which command writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

COMMANDS = {
    "challenge": "make challenge ARGS='--final --markdown docs/tables/challenge.md'",
    "suite": "make bench ARGS='--markdown docs/tables/suite.md'",
}


def content(folder: Path) -> dict[str, Any]:
    """What benchmarks.md is filled with."""
    return {"tables": {name: _table(Path(folder), name) for name in COMMANDS}}


def _table(folder: Path, name: str) -> str:
    file = folder / "tables" / f"{name}.md"
    if file.is_file():
        return file.read_text(encoding="utf-8")
    told = "There is no table in this tree yet. What writes it, for the next build of this page:"
    return f"{told}\n\n```sh\n{COMMANDS[name]}\n```"
