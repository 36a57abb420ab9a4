"""Run the commands of the pages again and put their present output beneath them.

    python docs/rerun.py docs/tour.md ...

In blocks of the language ``console`` a line that begins with ``$ `` is a command. Its output follows, without
its progress. The commands of a page run one after the other in one shell, in an empty folder. There the
folders of `TREE` are this tree's; ``hd-diag`` and ``python`` must be on the PATH. Blocks of the language
``sh`` are never run. What a page starts in the background is ended with it.
"""

# ruff: noqa: T201

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"(?ms)^```console\n(.*?)^```$")
END = "\x1e"  # printed after each command
# Progress lines every 10 s, which only a slow machine prints.
PROGRESS = re.compile(r"(?m)^hd-diag: .*: (\d[^:]* so far|\d+ %.*|[\d,]+ of [\d,]+ .*)\n")
TREE = ("config", "docs", "examples")  # folders of the tree that commands name
LONGEST = 900.0  # for a page [s]


def commands(text: str) -> list[str]:
    """Commands of a page, in order."""
    return [line[2:] for block in BLOCK.findall(text) for line in block.splitlines() if line.startswith("$ ")]


def told(lines: list[str], folder: Path) -> Iterator[str]:
    """Output of each command on both streams, without the folder's own name."""
    script = "".join(f"{line}\nprintf '{END}'\n" for line in lines)
    settings = {"COLUMNS": "88", "PYTHONWARNINGS": "ignore", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with subprocess.Popen(
        ["sh", "-c", script],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        cwd=folder,
        env={**os.environ, **settings},
        text=True,
        start_new_session=True,
    ) as shell:
        try:
            output = shell.communicate(timeout=LONGEST)[0]
        finally:
            with contextlib.suppress(ProcessLookupError):  # processes still in the background
                os.killpg(shell.pid, signal.SIGTERM)
    for part in output.split(END)[: len(lines)]:
        text = PROGRESS.sub("", part.replace(f"{folder}/", ""))
        yield "".join(f"{line.rstrip()}\n" for line in text.splitlines())


def refreshed(text: str, outputs: Iterator[str]) -> str:
    """The page with these outputs."""

    def block(found: re.Match[str]) -> str:
        lines = [line for line in found.group(1).splitlines() if line.startswith("$ ")]
        return "```console\n" + "".join(f"{line}\n{next(outputs)}" for line in lines) + "```"

    return BLOCK.sub(block, text)


def rerun(page: Path) -> None:
    """Refresh one page."""
    text = page.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        for part in TREE:
            (folder / part).symlink_to(ROOT / part)
        page.write_text(refreshed(text, told(commands(text), folder)), encoding="utf-8")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        print(argument)
        rerun(Path(argument))
