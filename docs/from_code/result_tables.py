"""Tables that benchmarks and tests write; where one is not there yet, the page names the command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

COMMANDS = {
    "challenge": "make challenge ARGS='--final --markdown docs/tables/challenge.md'",
    "gears": "python docs/gear_table.py",
    "suite": "make bench ARGS='--markdown docs/tables/suite.md'",
    "faults": "python test/faults.py",
    "soak": "make soak",
    "tests": "make pytest PYTEST_ARGS='--slowest=docs/tables/tests.md'",
}


def content(folder: Path) -> dict[str, Any]:
    """What benchmarks.md and faults.md are filled with."""
    return {"tables": {name: _table(Path(folder), name) for name in COMMANDS}}


def _table(folder: Path, name: str) -> str:
    file = folder / "tables" / f"{name}.md"
    if file.is_file():
        return file.read_text(encoding="utf-8")
    told = "There is no table in this tree yet. What writes it, for the next build of this page:"
    return f"{told}\n\n```sh\n{COMMANDS[name]}\n```"
