"""Backlash and load of every tooth: maps over a turn of the input, and dials around the gear."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from hd_diag.arrays import Floats
from hd_diag.report.pictures.canvas import ACCENT, INK, NOMINAL, REFIT, WIDTH, drawn, sheet, turn
from hd_diag.report.teeth import TeethOverTurn

_LEAST = 1e-6  # least interference at the end of the scale [m]
_LEAST_LOAD = 1.0  # least load at the end of the scale [N]
_EMPTY = (0.54, 0.56, 0.6, 0.25)
_PLACES = np.radians(np.arange(11.25, 360.0, 22.5))  # directions in which the radius may be labelled [rad]


@drawn
def tooth_maps(found: TeethOverTurn) -> Figure:
    """Maps of tooth over input angle; angles that the record never reached are marked under them."""
    figure, (top, bottom) = sheet(6.2, 2, sharex=True)
    least = min(float(np.nanmin(found.backlash)), -_LEAST)
    near = np.where(found.backlash < found.free, found.backlash, np.nan)
    norm = TwoSlopeNorm(0.0, least * 1e6, found.free * 1e6)
    _map(figure, top, near.T * 1e6, "PuOr", norm, "Backlash of a tooth [µm]; below 0: interference")
    loaded = np.where(found.load > 0.0, found.load, np.nan)
    most = Normalize(0.0, max(float(np.max(found.load)), _LEAST_LOAD))
    _map(figure, bottom, loaded.T, "cividis_r", most, "Load of a tooth [N]")
    for axes in (top, bottom):
        axes.set_ylabel("Tooth of the flexspline")
        free = np.degrees(found.input_angle[~found.visited])
        axes.bar(free, 4.0, 360.0 / found.input_angle.size, color=ACCENT, lw=0)
    turn(bottom, "Input angle [°]")
    return figure


def _map(figure: Figure, axes: Axes, table: Floats, colours: str, norm: Any, title: str) -> None:
    extent = (0.0, 360.0, 0.0, float(table.shape[0]))
    options: dict[str, Any] = {"origin": "lower", "aspect": "auto", "interpolation": "nearest"}
    image = axes.imshow(table, extent=extent, cmap=colours, norm=norm, **options)
    axes.grid(False)
    axes.set_facecolor(_EMPTY)
    bar = figure.colorbar(image, ax=axes, location="top", aspect=40, pad=0.03, fraction=0.05)
    bar.outline.set_linewidth(0.5)
    if norm.vmin < 0.0:
        below = np.asarray(MaxNLocator(3).tick_values(norm.vmin, 0.0))
        inside = (below > norm.vmin) & (below < 0.0)
        bar.set_ticks([*below[inside].tolist(), *np.linspace(0.0, norm.vmax, 5).tolist()])
    bar.ax.set_title(title, pad=4)


@drawn
def around_the_gear(found: TeethOverTurn) -> Figure:
    """Dials of load and backlash along the gear's axis: moment of greatest load, and the turn's extremes."""
    figure = Figure(figsize=(WIDTH, 6.6), layout="constrained")
    dials = top, bottom = figure.subplots(2, 1, subplot_kw={"projection": "polar"})
    place, closed = found.tooth_direction, np.append(found.direction, found.direction[0])
    backlash, load = found.backlash[found.moment], found.load[found.moment]
    bears, width = load > 0.0, 2.0 * np.pi / place.size * 0.75
    greatest = np.append(found.greatest_load, found.greatest_load[0])
    top.bar(place[bears], load[bears], width, color=REFIT, lw=0, label="at this moment")
    top.plot(closed, greatest, color=NOMINAL, lw=1.0, label="most in a turn")
    top.set_title("Load of the teeth [N]", pad=40)
    top.set_ylim(0.0, 1.1 * max(float(np.max(greatest)), _LEAST_LOAD))
    near = np.where(backlash < found.free, backlash, np.nan) * 1e6
    least = np.minimum(np.append(found.least_backlash, found.least_backlash[0]), found.free) * 1e6
    bottom.plot(place, near, "o", ms=2.0, color=REFIT, label="at this moment")
    bottom.plot(closed, least, color=NOMINAL, lw=1.0, label="least in a turn")
    bottom.set_title("Backlash of the teeth [µm]", pad=40)
    floor = min(float(np.nanmin(near, initial=0.0)), float(np.nanmin(least, initial=0.0)))
    bottom.set_ylim(floor - 0.25 * (found.free * 1e6 - floor), found.free * 1e6)
    for axes in dials:
        _dial(axes, found.long_axis, found.eccentricity if found.displacement > 0.0 else None)
    return figure


def _dial(axes: PolarAxes, long_axis: float, eccentricity: float | None) -> None:
    """Draw the long axis dashed, the displacement's direction as an arrow, and labels where there is room."""
    low, high = axes.get_ylim()
    axes.plot([long_axis, long_axis + np.pi], [high, high], color=INK, lw=0, marker="s", ms=4, clip_on=False)
    for side in (0.0, np.pi):
        axes.plot([long_axis + side] * 2, [low, high], color=INK, lw=0.7, ls=(0, (4, 2)))
    lines = [long_axis, long_axis + np.pi]
    if eccentricity is not None:
        arrow = {"arrowstyle": "-|>", "color": ACCENT, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
        tip = low + 0.72 * (high - low)
        axes.annotate("", xy=(eccentricity, tip), xytext=(eccentricity, low), arrowprops=arrow)
        lines.append(eccentricity)
    away = np.min(np.abs(np.angle(np.exp(1j * (_PLACES[:, None] - np.array(lines))))), axis=1)
    axes.set_rlabel_position(float(np.degrees(_PLACES[np.argmax(np.round(away, 6))])))
    axes.set_xticks(np.radians(range(0, 360, 45)))
    axes.tick_params(pad=4)
    axes.yaxis.set_major_locator(MaxNLocator(4, prune="both"))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.12), ncols=2)
