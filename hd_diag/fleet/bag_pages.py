"""Pages of single joints in single bags, in a folder beside the fleet's page that links to them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from hd_diag.fleet import FleetError
from hd_diag.fleet.rows import Task
from hd_diag.whole_file import whole_file

_NAME = re.compile(r"[\w.-]+_[0-9a-f]{16}\.html", re.ASCII)


class BagPages:
    """The folder ``<name>_joints`` beside ``<name>.html``; pages are named by joint and key of the task.

    Raises FleetError where it cannot be written.
    """

    def __init__(self, report: Path) -> None:
        self.folder = report.with_name(f"{report.stem}_joints")

    def place(self, task: Task) -> Path:
        """Where a task's page is, or will be."""
        return self.folder / f"{re.sub(r'[^A-Za-z0-9.-]', '_', task.joint.name)}_{task.key[:16]}.html"

    def link(self, task: Task) -> str | None:
        """Its path from the fleet's page; None where there is none."""
        place = self.place(task)
        return f"{self.folder.name}/{place.name}" if place.exists() else None

    def write(self, task: Task, html: str) -> None:
        """Keep a page; one that is there is whole."""
        place = self.place(task)
        try:
            self.folder.mkdir(exist_ok=True)
            with whole_file(place) as draft:
                draft.write_text(html, encoding="utf-8")
        except OSError as error:
            raise FleetError(f"{place}: cannot be written: {error.strerror or error}") from error

    def keep(self, links: Iterable[str | None]) -> None:
        """Delete the pages of this folder that the fleet's page does not link to any more."""
        kept = {Path(link).name for link in links if link}
        for path in self.folder.iterdir() if self.folder.is_dir() else ():
            if _NAME.fullmatch(path.name) and path.name not in kept:
                path.unlink(missing_ok=True)
