"""The whole benchmark, measured in one run (`make bench`).

    python bench/suite.py [--only SECTION ...] [--seconds S] [--json FILE] [--markdown FILE]

Every row is a time or a ratio, next to its aim. Both sides of a ratio are timed here in turn, in this process
or in processes of their own; their results are compared first. Times are CPU times on one core unless a row
says wall. No speed makes the benchmark fail.
"""

# ruff: noqa: D103, T201, E402

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "test"), str(ROOT / "bench")]
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import numpy as np
from rich.console import Console
from rich.table import Table
from suite_processes import PROCESSES, Skipped
from suite_sections import SECTIONS

from hd_diag.model.torsion import warm_up


@dataclass(frozen=True)
class Row:
    """One measurement and its comparison; `aim` bounds the ratio (unit "x") or the value, if set."""

    section: str
    what: str
    value: float
    unit: str
    ratio: float | None = None
    against: str = ""
    aim: float | None = None
    aim_unit: str = ""
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the aim is met: a lower bound for a ratio, an upper bound for a value."""
        if self.aim is None:
            return None
        return bool(self.ratio and self.ratio >= self.aim) if self.aim_unit == "x" else self.value <= self.aim


def main() -> int:
    sections = {**SECTIONS, **PROCESSES}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", nargs="+", choices=sorted(sections), metavar="SECTION", help=", ".join(sections)
    )
    parser.add_argument(
        "--seconds", type=float, default=600.0, help="of the record that is read and replayed"
    )
    parser.add_argument("--json", type=Path, help="keep the figures, such as bench/results.json")
    parser.add_argument("--markdown", type=Path, help="the table for a page, such as docs/tables/suite.md")
    options = parser.parse_args()
    warm_up()
    begin, rows, skipped = time.perf_counter(), [], {}
    console = Console(stderr=True)
    for name in options.only or sections:
        with console.status(f"{name} (of {', '.join(options.only or sections)})"):
            try:
                rows += list(measured(name, sections[name](options)))
            except Skipped as reason:
                skipped[name] = str(reason)
            except Exception:
                skipped[name] = traceback.format_exc().strip()
    show(rows, skipped, time.perf_counter() - begin)
    if options.json:
        options.json.write_text(json.dumps(document(rows, skipped), indent=1) + "\n")
    if options.markdown:
        options.markdown.write_text(markdown(rows, skipped) + "\n")
    return 1 if skipped else 0


def measured(section: str, found: Iterator[dict]) -> Iterator[Row]:
    for each in found:
        yield Row(section, **each)


def document(rows: list[Row], skipped: dict[str, str]) -> dict:
    machine = {"python": platform.python_version(), "cores": len(os.sched_getaffinity(0)), "cpu": cpu_name()}
    versions = {"numpy": np.__version__, "load": os.getloadavg()[0]}
    return {
        "schema": "hd_diag/bench/1",
        "machine": machine | versions,
        "rows": [{**asdict(row), "met": row.met} for row in rows],
        "skipped": skipped,
    }


def markdown(rows: list[Row], skipped: dict[str, str]) -> str:
    """The table, ready for a page."""
    head = ["section", "what", "measured", "ratio", "against", "aim", ""]
    lines = [head, ["---", "---", "---:", "---:", "---", "---:", "---"], *map(cells, rows)]
    summary = f"{cpu_name()}, Python {platform.python_version()}, numpy {np.__version__}."
    missing = [f"{name} was not measured: {reason.splitlines()[-1]}" for name, reason in skipped.items()]
    return "\n\n".join((summary, "\n".join(f"| {' | '.join(line)} |" for line in lines), *missing))


def cells(row: Row) -> list[str]:
    """Texts of a row: section, what, measured, ratio, against, aim, whether it is met."""
    sign = ">=" if row.aim_unit == "x" else "<="
    return [
        row.section,
        f"{row.what} ({row.note})" if row.note else row.what,
        f"{row.value:,.4g} {row.unit}",
        f"{row.ratio:,.4g}" if row.ratio is not None else "",
        row.against,
        "" if row.aim is None else f"{sign} {row.aim:,g} {row.aim_unit}",
        {None: "", True: "met", False: "MISSED"}[row.met],
    ]


def cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def show(rows: list[Row], skipped: dict[str, str], took: float) -> None:
    table = Table(
        title=f"{cpu_name()}, load {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores, {took:.0f} s"
    )
    for column in ("section", "what", "measured", "ratio", "against", "aim", ""):
        table.add_column(column, justify="right" if column in ("measured", "ratio", "aim") else "left")
    last = ""
    for row in rows:
        if last and row.section != last:
            table.add_section()
        name, *rest = cells(row)
        table.add_row(name if name != last else "", *rest)
        last = row.section
    Console(width=max(150, Console().width)).print(table)
    for name, reason in skipped.items():
        print(f"{name}: NOT MEASURED: {reason}")


if __name__ == "__main__":
    sys.exit(main())
