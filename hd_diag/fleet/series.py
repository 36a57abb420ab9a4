"""Rows as series: eccentricity, error, residuals, amplitudes of causes, torque ripple over time."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.fleet.rows import Row

ECCENTRICITY = "eccentricity"
ERROR = "transmission_error"
NOMINAL = "residual_nominal"
REFIT = "residual_refit"
RIPPLE = "ripple_"
"""Beginning of the name of a ripple; its order per turn of the output follows."""

_SIGMAS_95 = 2.0 * 1.959964  # width of a 95 % interval in standard deviations
_UNSEEN = 0.5  # deviation over the least size found: an unseen amplitude is within two of them

Limits = Mapping[tuple[str, str], float]
"""By joint and quantity, in SI."""

Point = tuple[float, float, float]  # time [s], value, standard deviation


@dataclass(frozen=True)
class Series:
    """A quantity of one joint over time, in time order.

    Times since 1970 [s], values and their standard deviations in `unit`, each (n,); nan deviations are
    unknown. The quantity should stay below the limit; nan means no limit.
    """

    robot: str
    joint: str
    quantity: str
    unit: str
    time: Floats
    value: Floats
    std: Floats
    limit: float = math.nan


def series_of(rows: Sequence[Row], limits: Limits) -> list[Series]:
    """Series of every diagnosed joint of every robot; limits by joint and quantity.

    Eccentricity where the refit is trustworthy [m]; transmission error without torsion, peak to peak [rad];
    held-out residuals, nominal and refitted [rad]; the amplitude of each cause found at least once [rad rms].
    If a cause was not found but could have been, its amplitude is 0 and its standard deviation half the least
    size that would be found; names that a record could not distinguish make one cause. A joint with one angle
    has the amplitude of each line of its torque that was found at least once [N m].
    """
    joints: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: (row.get("start") or 0, row["bag"])):
        judged = row.get("rms_nominal_rad") is not None or row.get("ripple_orders")
        if row.get("start") is not None and judged:
            joints[row.get("robot") or "", row["joint"]].append(row)
    found = []
    for (robot, joint), own in sorted(joints.items()):
        rippled = [row for row in own if row.get("ripple_orders")]
        compared = [row for row in own if not row.get("ripple_orders")]
        for quantity, points in {**_of_errors(compared), **_ripples(rippled)}.items():
            time, value, std = np.array(points).reshape(-1, 3).T
            unit = "m" if quantity == ECCENTRICITY else "N m" if quantity.startswith(RIPPLE) else "rad"
            limit = limit_of(limits, joint, quantity)
            found.append(Series(robot, joint, quantity, unit, time, value, std, limit))
    return found


def limit_of(limits: Limits, joint: str, quantity: str) -> float:
    """The least limit of a joint's quantity, whose name may hold several causes; nan without a limit."""
    own = [limits[joint, name] for name in quantity.split(" or ") if (joint, name) in limits]
    return min(own, default=math.nan)


def _ripples(rows: list[Row]) -> dict[str, list[Point]]:
    """Amplitudes of each line that was found in at least one row."""
    names = [f"ripple_{name}" for name in ("orders", "reverses", "amplitudes_Nm", "stds_Nm", "found")]
    found: dict[str, list[Point]] = defaultdict(list)
    seen = set()
    for row in rows:
        for order, reverses, size, std, there in zip(*(row[name] for name in names), strict=True):
            name = f"{RIPPLE}{order:g}{'_reversing' * reverses}"
            found[name].append((began(row), size, _known(std)))
            seen |= {name} if there else set()
    return {name: points for name, points in found.items() if name in seen}


def _of_errors(rows: list[Row]) -> dict[str, list[Point]]:
    compared = [row for row in rows if row.get("error_rad") is not None]
    errors = [(began(row), row["error_rad"], _known(row["error_std_rad"])) for row in compared]
    found = {ERROR: errors} if errors else {}
    if rows:
        sure = [row for row in rows if row.get("trustworthy") and row.get("eccentricity_m") is not None]
        found[ECCENTRICITY] = [
            (began(row), row["eccentricity_m"], _known(row["eccentricity_std_m"])) for row in sure
        ]
        found[NOMINAL] = [_residual(row, row["rms_nominal_rad"]) for row in rows]
        found[REFIT] = [_residual(row, row["rms_refit_rad"]) for row in rows]
    for names in classes(row.get("cause_classes") or [] for row in rows):
        points = [point for row in rows if (point := _amplitude(row, names))]
        if any(size > 0.0 for _, size, _ in points):
            found[" or ".join(sorted(names))] = points
    return found


def classes(of_rows: Iterable[Sequence[Sequence[str]]]) -> list[frozenset[str]]:
    """Sets of the names of causes that some row could not distinguish, in the order of the names."""
    merged: list[frozenset[str]] = []
    for alike in (frozenset(names) for row in of_rows for names in row):
        touching = [one for one in merged if one & alike]
        merged = [one for one in merged if one not in touching] + [alike.union(*touching)]
    return sorted(merged, key=sorted)


def _amplitude(row: Row, names: frozenset[str]) -> Point | None:
    """Amplitude of a cause in a row; None if the record could not have shown it."""
    columns = (row[f"cause{end}"] for end in ("s", "_amplitudes_rad", "_amplitude_stds_rad"))
    for name, size, std in zip(*columns, strict=True):
        if name in names:
            return None if size is None else (began(row), size, _known(std))
    tested = zip(row["tested"], row["tested_least_rad"], strict=True)
    least = [size for name, size in tested if name in names and size is not None]
    return (began(row), 0.0, _UNSEEN * min(least)) if least else None


def _residual(row: Row, rms: float) -> Point:
    """A residual with the same relative deviation as the noise floor."""
    noise, low, high = (row[f"noise_floor{end}_rad"] for end in ("", "_low", "_high"))
    known = None not in (noise, low, high) and noise > 0.0
    return began(row), rms, (high - low) / _SIGMAS_95 / noise * rms if known else math.nan


def began(row: Row) -> float:
    """When a row's recording began [s since 1970]; nan if it is not known."""
    return math.nan if row.get("start") is None else float(row["start"]) * 1e-9


def _known(value: float | None) -> float:
    return math.nan if value is None else value
