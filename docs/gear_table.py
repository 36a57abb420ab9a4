"""Write docs/tables/gears.md: how well drives made from catalogue pages match the pages' torsion curves.

    python docs/gear_table.py

Gears with the same page share a row. 115 gears take about half a minute.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from hd_diag.config.assessment import Assessment, assess
from hd_diag.config.configuration import resolve
from hd_diag.gears.catalogue import Gear, table
from hd_diag.gears.page import Page

TABLE = Path(__file__).with_name("tables") / "gears.md"
ARCSEC = np.pi / 648_000.0  # [rad]
HEAD = (
    "| gears | torsion at T1/10, T1/4, T1/2, T1, (T1 + T2)/2, T2, 1.5 T2, 2 T2 over the page's [%] | lost "
    "motion [arcsec] | overlap at rest [µm] | force at rest [N] |\n|---|---|---|---|---|"
)


def assessed(gear: Gear) -> Assessment:
    """Assessment of the drive made from a gear's page."""
    config = resolve({f"joint_1.gear.{name}": value for name, value in gear.given.items()})
    return assess(config, config.joints[0])


def rows(gears: Mapping[str, Gear]) -> Iterable[str]:
    """Lines of the table for some gears; gears with the same page share a line."""
    same: dict[Page, list[str]] = {}
    for name, gear in gears.items():
        same.setdefault(gear.page, []).append(name)
    for names in same.values():
        found = assessed(gears[names[0]])
        _, page, reached = found.torsion
        off = ", ".join(f"{value:+.1f}" for value in 100.0 * (reached / page - 1.0))
        rest = found.found
        yield (
            f"| {', '.join(names)} | {off} | {rest.lost_motion / ARCSEC:.1f} | "
            f"{rest.loads.overlap * 1e6:.1f} | {rest.loads.idle:.1f} |"
        )


if __name__ == "__main__":
    TABLE.write_text("\n".join([HEAD, *rows(table())]) + "\n", encoding="utf-8")
