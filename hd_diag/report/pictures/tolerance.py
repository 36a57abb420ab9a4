"""Pictures of a tolerance study: criteria over eccentricity and tilt, yield over tolerance, sensitivity."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hd_diag.formatting import words
from hd_diag.report.pictures.canvas import ACCENT, DASHES, GRID, INK, SERIES, drawn, save, sheet
from hd_diag.tolerance.assembly import FACTORS
from hd_diag.tolerance.evaluation import CRITERIA
from hd_diag.tolerance.sensitivity import Indices
from hd_diag.tolerance.study import Study, Tilts, Yield

__all__ = ["save", "tolerance_picture"]

_WIDTH, _PANEL = 5.6, 2.9  # width and height of a panel with its legend [inch]
_BAR = 0.26  # height of a factor's row [inch]
_LINES: list[dict[str, Any]] = [
    {"color": colour, "ls": dashes, "label": words(criterion.name)}
    for criterion, colour, dashes in zip(CRITERIA, SERIES, DASHES, strict=False)
]


@drawn
def tolerance_picture(found: Study) -> Figure:
    """Up to four panels, one above the other."""
    drawn_, indices, tilts = found.assemblies, found.sensitivity, found.tilts
    heights = [_PANEL + 0.3] + [_PANEL] * (tilts is not None) + [_PANEL] * (drawn_ is not None)
    heights += [_BAR * len(FACTORS) + 1.4] * (indices is not None)
    figure, axes = sheet(sum(heights), len(heights), height_ratios=heights)
    figure.set_figwidth(_WIDTH)
    _limits(axes[0], found)
    if tilts is not None:
        _chart(axes[1], tilts)
    if drawn_ is not None:
        _yield(axes[1 + (tilts is not None)], drawn_, found.question.target)
    if indices is not None:
        _sensitivity(axes[-1], indices)
    for panel in axes:  # the legend above it, where it covers nothing
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.02), ncols=3)
    return figure


def _limits(axes: Axes, found: Study) -> None:
    """Every criterion divided by its limit at the first torque, over eccentricity, with its crossing."""
    for line, criterion, limit in zip(_LINES, CRITERIA, found.limits[0], strict=True):
        scale = limit.limit if limit.limit > 0.0 else 1.0 / criterion.scale
        offset = 1.0 if limit.limit <= 0.0 else 0.0  # a limit of zero is crossed at 1 too
        values = (limit.scanned[1] - limit.limit * (offset > 0.0)) / scale + offset
        axes.plot(limit.scanned[0] * 1e6, values, **line)
        if limit.reached:
            axes.plot(limit.eccentricity * 1e6, 1.0, "o", color=line["color"], ms=4)
    axes.axhline(1.0, color=INK, lw=0.7)
    axes.set(xlim=(0.0, found.question.largest * 1e6), xlabel="eccentricity [µm]", ylim=(0.0, 2.0))
    axes.set_ylabel(f"worst over limit at {found.question.torque[0]:g} N m")


def _chart(axes: Axes, tilts: Tilts) -> None:
    """Eccentricity against tilt: each line encloses what is within a limit."""
    lines = {criterion.name: line for criterion, line in zip(CRITERIA, _LINES, strict=True)}
    for name, (eccentricity, tilt) in tilts.chart.items():
        axes.plot(tilt * 1e3, eccentricity * 1e6, **lines[name])
    axes.axvline(0.0, color=GRID, lw=0.7)
    axes.set(ylim=(0.0, None), xlabel="tilt, right: towards the eccentricity, left: against it [mrad]")
    axes.set_ylabel("eccentricity [µm]")


def _yield(axes: Axes, drawn_: Yield, target: float) -> None:
    tolerances, together = drawn_.tolerances * 1e6, drawn_.together
    axes.fill_between(tolerances, 100 * together.low, 100 * together.high, color=GRID, alpha=0.4, lw=0)
    axes.plot(tolerances, 100 * together.share, color=INK, label="all limits (95 %)")
    for line, share in zip(_LINES, drawn_.each, strict=True):
        if np.any(share.share < 1.0):
            axes.plot(tolerances, 100 * share.share, **line)
    axes.axhline(100 * target, color=ACCENT, lw=0.7)
    axes.axvline(drawn_.configured * 1e6, color=GRID, lw=0.7)
    axes.set(xlim=(tolerances[0], tolerances[-1]), xlabel="tolerance of the eccentricity (99.73 %) [µm]")
    axes.set(ylim=(0.0, 101.0), ylabel="assemblies within the limits [%]")


def _sensitivity(axes: Axes, indices: Indices) -> None:
    """Total index of the factors, one mark per criterion, with its interval."""
    place = np.arange(len(FACTORS))[::-1]
    for k, line in enumerate(_LINES):
        total, low, high = (100 * values[k] for values in vars(indices.total).values())
        ends, beside = np.stack((total - low, high - total)), place + 0.11 * (len(CRITERIA) / 2 - k)
        marks = {"fmt": "o", "ms": 2.5, "lw": 0.8, "color": line["color"], "label": line["label"]}
        axes.errorbar(total, beside, xerr=np.maximum(ends, 0.0), **marks)
    axes.set_yticks(place, list(map(words, FACTORS)))
    axes.set_xlim(left=-2.0)
    axes.set_xlabel("total Sobol index [%]")
