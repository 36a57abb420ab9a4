"""Gears with known catalogue pages, by name, and plausible values for a gear of a size.

The table beside this module holds component sets HFUC and CSG (cup), HFUS and SHG (hollow shaft) of Harmonic
Drive SE, sizes 11 to 90: facts of the maker's catalogue as tabulated in AimanHaidar/harmonic-drive-selector,
commit e1df012, data/reducers_tables.py (Apache-2.0). Rated torques are those at 2000 rpm; K1 to K3 are mean
values for ratios 30, 50, 80 and above. T1 of size 14 is 2.0 N m here; the source has 0.2 for CSG by mistake.
"""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from hd_diag.gears.page import TENTH_OF_AN_INCH, Page

_NAME = re.compile(r"([a-z]+)[ _/-]*(\d+)[ _/-]+(\d+)(?:[ _/-].*)?", re.IGNORECASE)  # units: CSG-25-100-2UH
_COLUMNS = ("ratio", "rated_torque", "k1", "k2", "k3", "t1", "t2")  # of the table, after series and size
_NEAREST = 3  # names that an error lists

_FAR = 3.0  # no gear differs from the table's value for its size by this factor [-]
_ARCMIN = math.pi / 10800.0  # [rad]
_KGF = 9.80665  # [N]
_UNITS = {
    "N m/rad": {
        "× 10⁴ N m/rad": 1e4,
        "N m/arcmin": 1.0 / _ARCMIN,
        "kgf m/arcmin": _KGF / _ARCMIN,
        "kN m/rad": 1e3,
        "N mm/rad": 1e-3,
    },
    "N m": {"kgf m": _KGF, "N mm": 1e-3},
}
"""Other units on catalogue pages and their factors, by the unit used here."""


class Gear(NamedTuple):
    """A gear of the table: series, size [0.1 inch], and page, whose ratio is for a fixed circular spline."""

    series: str
    size: float
    page: Page

    @property
    def given(self) -> dict[str, float]:
        """Values of the table, as in the section ``gear`` of a parameter file."""
        return {"size": self.size, **{name: getattr(self.page, name) for name in _COLUMNS}}


@lru_cache(maxsize=1)
def table() -> Mapping[str, Gear]:
    """All gears by their names, as CSG-25-100: series, size, ratio."""
    with Path(__file__).with_suffix(".csv").open(encoding="utf-8", newline="") as file:
        rows = [_gear(**row) for row in csv.DictReader(file)]
    return {f"{row.series}-{row.size:.0f}-{row.page.ratio:.0f}": row for row in rows}


def _gear(series: str, size: str, **numbers: str) -> Gear:
    values: dict[str, Any] = {name: float(numbers[name]) for name in _COLUMNS}
    return Gear(series, float(size), Page(float(size) * TENTH_OF_AN_INCH, **values))


def named(name: str) -> tuple[str, Gear]:
    """A gear and its name in the table; raises ValueError with the nearest names for an unknown one.

    Case does not matter. Text after the ratio describes the housing and is ignored.
    """
    parts = _NAME.fullmatch(name.strip())
    plain = "-".join(parts.groups()).upper() if parts else name
    if plain in table():
        return plain, table()[plain]
    series = ", ".join(sorted({gear.series for gear in table().values()}))
    raise ValueError(
        f"no gear {name!r} in the table ({series}); the nearest are {', '.join(_nearest(plain, parts))}: "
        "of another gear give the numbers of its page"
    )


def _nearest(plain: str, parts: re.Match[str] | None) -> list[str]:
    if not parts:
        return difflib.get_close_matches(plain.upper(), table(), _NEAREST, cutoff=0.0)
    size, ratio = (math.log(max(float(part), 1.0)) for part in parts.groups()[1:])

    def distance(name: str) -> tuple[float, float]:
        gear = table()[name]
        other = 1.0 - difflib.SequenceMatcher(None, gear.series, plain.partition("-")[0]).ratio()
        return abs(math.log(gear.size) - size) + abs(math.log(gear.page.ratio) - ratio), other

    return sorted(table(), key=distance)[:_NEAREST]


def usual(name: str, size: float, ratio: float) -> float:
    """Usual value in a column of the table for gears of a size and about this ratio, in the column's unit.

    Stiffness and torque go with the cube of the size: K between sizes 11 and 90 within a factor of 1.5, and
    so do T1 and T2 except for the smallest size.
    """
    ratios = {gear.page.ratio for gear in table().values()}
    nearest = min(ratios, key=lambda each: abs(math.log(each / abs(ratio))))
    same = [gear for gear in table().values() if gear.page.ratio == nearest]
    logs = [math.log(getattr(gear.page, name) / gear.size**3) for gear in same]
    return size**3 * math.exp(math.fsum(logs) / len(logs))


def check(name: str, value: float, unit: str, size: float, ratio: float) -> None:
    """Raise ValueError if no gear of a size has such a K1, K2, K3, T1 or T2; it suggests the unit meant."""
    expected = usual(name, size, ratio)

    def far(factor: float) -> float:
        return abs(math.log(value * factor / expected))

    if far(1.0) <= math.log(_FAR):
        return
    meant = min(_UNITS[unit], key=lambda each: far(_UNITS[unit][each]))
    factor = _UNITS[unit][meant]
    advice = "look at size and unit"
    if far(factor) <= math.log(_FAR):
        advice = f"if the page means {value:g} {meant}, write {value * factor:.4g}"
    raise ValueError(f"no gear of size {size:.3g} has {value:g} {unit}, usual is {expected:.2g}: {advice}")
