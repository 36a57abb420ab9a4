"""The demo's steps: each has one eccentricity of the model, and the diagnostics of that time."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from hd_diag.watch.state import JointView

# Key, heading of three lines, decimals of a column.
_COLUMNS = (
    ("eccentricity_um", ("eccen-", "tricity", "µm"), 1),
    ("minimum_backlash_um", ("least", "backlash", "µm"), 1),
    ("lost_motion_arcmin", ("lost", "motion", "arcmin"), 2),
    ("loaded_pairs", ("loaded", "pairs", ""), 0),
    ("peak_tooth_load_N", ("peak", "load", "N"), 1),
    ("predicted_te_pp_arcsec", ("predicted", "error", "arcsec"), 1),
    ("residual_rms_arcsec", ("residual", "rms", "arcsec"), 2),
    ("sample_rate_hz", ("rate", "", "Hz"), 0),
)
_EXTREMES = {"minimum_backlash_um": min, "peak_tooth_load_N": max}


@dataclass
class Step:
    """The time during which the model has one eccentricity [µm], and the reports of that time."""

    eccentricity: float
    reports: list[JointView] = field(default_factory=list)

    def take(self, report: JointView) -> bool:
        """Keep a report if it is of this step."""
        own = abs(report.number("eccentricity_um") - self.eccentricity) < 1e-3
        if own:
            self.reports.append(report)
        return own

    def number(self, key: str) -> float:
        """One number of all reports: least backlash, largest load, usual residual, else the last one."""
        if key == "residual_rms_arcsec":
            return statistics.median(self.residuals or [math.nan])
        values = [report.number(key) for report in self.reports]
        return _EXTREMES.get(key, lambda every: every[-1])(values or [math.nan])

    @property
    def residuals(self) -> list[float]:
        """Residuals of the reports with the map in force [arcsec]; without the map a busy node is late.

        The first is left out: its window reaches back before the step.
        """
        settled = [report for report in self.reports if report.values.get("prediction") == "map"]
        values = [report.number("residual_rms_arcsec") for report in settled]
        return [value for value in values if math.isfinite(value)][1:]

    def text(self, key: str) -> str | None:
        """The most frequent text of all reports."""
        texts = [str(report.values.get(key, "")) for report in self.reports]
        return statistics.mode(texts) if texts else None

    def summary(self) -> dict[str, Any]:
        """Values by diagnostics key; nan or None if there is none."""
        numbers = {key: self.number(key) for key, _, _ in _COLUMNS} | {"eccentricity_um": self.eccentricity}
        return numbers | {key: self.text(key) for key in ("log_state", "fault_code")}


def table(steps: Sequence[Step]) -> list[str]:
    """Heading of three lines, then a line for each step that has reports."""
    above = ["".join(f"{lines[i]:>10}" for _, lines, _ in _COLUMNS) for i in range(3)]
    return [*above[:2], f"{above[2]}  fault", *(_row(step) for step in steps if step.reports)]


def _row(step: Step) -> str:
    values = ((step.number(key), places) for key, _, places in _COLUMNS)
    cells = (f"{value:.{places}f}" if math.isfinite(value) else "-" for value, places in values)
    return "".join(f"{cell:>10}" for cell in cells) + f"  {step.text('fault_code')}"
