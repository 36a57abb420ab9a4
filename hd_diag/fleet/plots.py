"""The picture of a fleet: every series over time with its steps or its drift."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from hd_diag.fleet.trend import Trend
from hd_diag.formatting import SCALES, words

MOST = 24  # most panels; of more series those with the clearest changes are drawn
_COLUMNS = 3
_PANEL = (4.6, 2.6)  # [inch]
_LIMIT_NEAR = 3.0  # limit over largest value above which it is not drawn: it would flatten the series


def draw(trends: Sequence[Trend], path: Path) -> None:
    """Draw the series, the clearest changes first; raises OSError if the file cannot be written."""
    there = [trend for trend in trends if trend.series.value.size]
    shown = sorted(there, key=lambda trend: np.nanmin([trend.step_q, trend.drift_q, 2.0]))[:MOST]
    lines = max(-(-len(shown) // _COLUMNS), 1)
    figure = Figure(figsize=(_COLUMNS * _PANEL[0], lines * _PANEL[1] + 0.4), layout="constrained")
    for place, trend in enumerate(shown, start=1):
        _panel(figure.add_subplot(lines, _COLUMNS, place), trend)
    left_off = f"; {len(there) - len(shown)} more series are not drawn" if len(there) > len(shown) else ""
    figure.suptitle(f"{len(there)} series, 1 σ bars{left_off}", fontsize="medium")
    figure.savefig(path, dpi=120)


def _panel(axes: Axes, trend: Trend) -> None:
    """A series with its drift, or with its steps and the intervals of their times."""
    series, (scale, unit) = trend.series, SCALES[trend.series.unit]
    spread = np.where(np.isfinite(series.std), series.std, 0.0) / scale
    axes.errorbar(_dates(series.time), series.value / scale, spread, fmt=".", color="C0", elinewidth=0.8)
    if trend.form == "drift":
        ends = series.time[[0, -1]]
        values = trend.line.intercept + trend.line.slope * (ends - series.time[0])
        axes.plot(_dates(ends), values / scale, color="C1")
    if trend.form == "steps":
        edges = np.searchsorted(series.time, [change.after for change in trend.changes])
        for rows in np.split(np.arange(series.time.size), edges):
            mean = np.average(series.value[rows], weights=trend.weights[rows])
            axes.plot(_dates(series.time[rows[[0, -1]]]), np.full(2, mean / scale), color="C1")
    for change in trend.changes:
        axes.axvspan(*_dates(np.array([change.low, change.high])), color="C1", alpha=0.15)
    if series.limit <= _LIMIT_NEAR * series.value.max():
        axes.axhline(series.limit / scale, color="C3", linestyle=":")
    name = f"{series.robot} {series.joint}".strip()
    axes.set_title(f"{name}: {words(series.quantity)}: {trend.form}", fontsize="small", parse_math=False)
    axes.set_ylabel(f"[{unit}]")
    locator = AutoDateLocator(minticks=2, maxticks=6)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))


def _dates(time: npt.NDArray[np.float64]) -> npt.NDArray[np.datetime64]:
    return np.asarray((time * 1e6).astype("datetime64[us]"))
