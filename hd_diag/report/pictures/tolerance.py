"""What eccentricity an assembly may have: criteria over eccentricity, yield over tolerance, what matters."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hd_diag.report.pictures.canvas import ACCENT, DASHES, GRID, INK, SERIES, drawn, sheet
from hd_diag.tolerance.assembly import FACTORS
from hd_diag.tolerance.criteria import CRITERIA
from hd_diag.tolerance.sensitivity import Indices
from hd_diag.tolerance.study import Study, Yield

_WIDTH, _PANEL = 5.6, 2.9  # of a panel with its legend [inch]
_BAR = 0.26  # [inch]


@drawn
def tolerance_picture(found: Study) -> Figure:
    """Up to three panels, one above the other."""
    bars = _BAR * len(FACTORS) + 1.4
    heights = (
        [_PANEL + 0.3] + [_PANEL] * (found.assemblies is not None) + [bars] * (found.sensitivity is not None)
    )
    figure, axes = sheet(sum(heights), len(heights), height_ratios=heights)
    figure.set_figwidth(_WIDTH)
    panels = iter(axes)
    _limits(next(panels), found)
    if found.assemblies is not None:
        _yield(next(panels), found.assemblies, found.question.target)
    if found.sensitivity is not None:
        _sensitivity(next(panels), found.sensitivity)
    return figure


def _legend(axes: Axes) -> None:
    """Above the panel, where it covers nothing."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.02), ncols=3)


def _limits(axes: Axes, found: Study) -> None:
    """Every criterion over its limit at the first torque, and where it crosses."""
    for k, (criterion, limit) in enumerate(zip(CRITERIA, found.limits[0], strict=True)):
        scale = limit.limit if limit.limit > 0.0 else 1.0 / criterion.scale
        offset = 1.0 if limit.limit <= 0.0 else 0.0  # a limit of zero is crossed at 1 all the same
        values = (limit.scanned[1] - limit.limit * (offset > 0.0)) / scale + offset
        label = criterion.name.replace("_", " ")
        axes.plot(limit.scanned[0] * 1e6, values, color=SERIES[k], linestyle=DASHES[k], label=label)
        if limit.reached:
            axes.plot(limit.eccentricity * 1e6, 1.0, "o", color=SERIES[k], markersize=4)
    axes.axhline(1.0, color=INK, linewidth=0.7)
    axes.set_ylim(0.0, 2.0)
    axes.set_xlim(0.0, found.question.largest * 1e6)
    axes.set_xlabel("eccentricity [µm]")
    axes.set_ylabel(f"worst over limit at {found.question.torque[0]:g} N m")
    _legend(axes)


def _yield(axes: Axes, drawn_: Yield, target: float) -> None:
    tolerances = drawn_.tolerances * 1e6
    together = drawn_.together
    axes.fill_between(tolerances, 100 * together.low, 100 * together.high, color=GRID, alpha=0.4, linewidth=0)
    axes.plot(tolerances, 100 * together.share, color=INK, label="all limits (95 %)")
    for k, (criterion, share) in enumerate(zip(CRITERIA, drawn_.each, strict=True)):
        if np.any(share.share < 1.0):
            axes.plot(
                tolerances,
                100 * share.share,
                color=SERIES[k],
                linestyle=DASHES[k],
                label=criterion.name.replace("_", " "),
            )
    axes.axhline(100 * target, color=ACCENT, linewidth=0.7)
    axes.axvline(drawn_.configured * 1e6, color=GRID, linewidth=0.7)
    axes.set_xlim(tolerances[0], tolerances[-1])
    axes.set_ylim(0.0, 101.0)
    axes.set_xlabel("tolerance of the eccentricity (99.73 %) [µm]")
    axes.set_ylabel("assemblies within the limits [%]")
    _legend(axes)


def _sensitivity(axes: Axes, indices: Indices) -> None:
    """Total index of the factors, one mark per criterion, with its interval."""
    place = np.arange(len(FACTORS))[::-1]
    for k, criterion in enumerate(CRITERIA):
        total, low, high = (100 * values[k] for values in vars(indices.total).values())
        beside = place + 0.11 * (len(CRITERIA) / 2 - k)
        ends = np.stack((total - low, high - total))
        axes.errorbar(
            total,
            beside,
            xerr=np.maximum(ends, 0.0),
            fmt="o",
            markersize=2.5,
            linewidth=0.8,
            color=SERIES[k],
            label=criterion.name.replace("_", " "),
        )
    axes.set_yticks(place, [factor.replace("_", " ") for factor in FACTORS])
    axes.set_xlim(left=-2.0)
    axes.set_xlabel("total Sobol index [%]")
    _legend(axes)
