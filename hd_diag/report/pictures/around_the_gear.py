"""Load and backlash around the gear, seen along its axis: at one moment, and the worst of a whole turn."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from hd_diag.arrays import Floats
from hd_diag.report.pictures.canvas import ACCENT, INK, NOMINAL, REFIT, WIDTH, drawn

_SHOWN = 40e-6  # backlash beyond which a tooth is simply free [m]
_PLACES = np.radians(np.arange(11.25, 360.0, 22.5))  # where the radius may be labelled [rad]


@drawn
def around_the_gear(
    tooth_direction: Floats,
    backlash: Floats,
    load: Floats,
    direction: Floats,
    least_backlash: Floats,
    greatest_load: Floats,
    long_axis: float,
    eccentricity: float | None,
) -> Figure:
    """Two dials.

    Parameters
    ----------
    tooth_direction : ndarray, shape (teeth,)
        Where the teeth stand in the housing [rad].
    backlash, load : ndarray, shape (teeth,)
        At that moment [m], [N].
    direction, least_backlash, greatest_load : ndarray, shape (directions,)
        Worst of a turn around the housing [rad], [m], [N].
    long_axis : float
        Direction of the wave generator's long axis [rad].
    eccentricity : float or None
        Direction of its displacement [rad]; None where there is none.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(WIDTH, 6.6), layout="constrained")
    dials = figure.subplots(2, 1, subplot_kw={"projection": "polar"})
    closed = np.append(direction, direction[0])
    width = 2.0 * np.pi / tooth_direction.size * 0.75
    top, bottom = dials
    bears = load > 0.0
    top.bar(tooth_direction[bears], load[bears], width, color=REFIT, lw=0, label="at this moment")
    top.plot(
        closed, np.append(greatest_load, greatest_load[0]), color=NOMINAL, lw=1.0, label="most in a turn"
    )
    top.set_title("Load of the teeth [N]", pad=40)
    near = np.where(backlash < _SHOWN, backlash, np.nan) * 1e6
    least = np.minimum(least_backlash, _SHOWN) * 1e6
    bottom.plot(tooth_direction, near, "o", ms=2.0, color=REFIT, label="at this moment")
    bottom.plot(closed, np.append(least, least[0]), color=NOMINAL, lw=1.0, label="least in a turn")
    bottom.set_title("Backlash of the teeth [µm]", pad=40)
    floor = min(float(np.nanmin(near, initial=0.0)), float(np.nanmin(least, initial=0.0)))
    bottom.set_ylim(floor - 0.25 * (_SHOWN * 1e6 - floor), _SHOWN * 1e6)
    top.set_ylim(0.0, 1.1 * max(float(np.max(greatest_load)), 1e-3))
    for axes in dials:
        _dial(axes, long_axis, eccentricity)
    return figure


def _dial(axes: PolarAxes, long_axis: float, eccentricity: float | None) -> None:
    low, high = axes.get_ylim()
    axes.plot([long_axis, long_axis + np.pi], [high, high], color=INK, lw=0, marker="s", ms=4, clip_on=False)
    for side in (0.0, np.pi):
        axes.plot([long_axis + side] * 2, [low, high], color=INK, lw=0.7, ls=(0, (4, 2)))
    if eccentricity is not None:
        arrow = {"arrowstyle": "-|>", "color": ACCENT, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
        tip = low + 0.72 * (high - low)
        axes.annotate("", xy=(eccentricity, tip), xytext=(eccentricity, low), arrowprops=arrow)
    lines = [long_axis, long_axis + np.pi] + ([] if eccentricity is None else [eccentricity])
    away = np.min(np.abs(np.angle(np.exp(1j * (_PLACES[:, None] - np.array(lines))))), axis=1)
    axes.set_rlabel_position(float(np.degrees(_PLACES[np.argmax(np.round(away, 6))])))
    axes.set_xticks(np.radians(range(0, 360, 45)))
    axes.tick_params(pad=1)
    axes.yaxis.set_major_locator(MaxNLocator(4, prune="both"))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.12), ncols=2)
