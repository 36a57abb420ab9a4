"""Backlash and load of every tooth over a turn of the input, as two maps."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hd_diag.arrays import Floats
from hd_diag.report.pictures.canvas import ACCENT, drawn, sheet, turn

_SHOWN = 40e-6  # backlash beyond which a tooth is simply free [m]
_LEAST = 1e-6  # [m]
_EMPTY = (0.54, 0.56, 0.6, 0.25)


@drawn
def tooth_maps(input_angle: Floats, backlash: Floats, load: Floats, visited: npt.NDArray[np.bool_]) -> Figure:
    """Maps of tooth over input angle.

    Parameters
    ----------
    input_angle : ndarray, shape (angles,)
        Middles of equal parts of a turn [rad].
    backlash, load : ndarray, shape (angles, teeth)
        [m], nan where a pair cannot touch; [N].
    visited : ndarray of bool, shape (angles,)
        Where the record was; the rest is marked under the maps.

    Returns
    -------
    Figure
    """
    figure, (top, bottom) = sheet(6.2, 2, sharex=True)
    least = min(float(np.nanmin(backlash)), -_LEAST)
    near = np.where(backlash < _SHOWN, backlash, np.nan)
    norm = TwoSlopeNorm(0.0, least * 1e6, _SHOWN * 1e6)
    _map(figure, top, near.T * 1e6, "PuOr", norm, "Backlash of a tooth [µm]; below 0: interference")
    loaded = np.where(load > 0.0, load, np.nan)
    _map(figure, bottom, loaded.T, "cividis_r", None, "Load of a tooth [N]")
    for axes in (top, bottom):
        axes.set_ylabel("Tooth of the flexspline")
        width = 360.0 / input_angle.size
        free = np.degrees(input_angle[~visited])
        axes.bar(free, 4.0, width, color=ACCENT, lw=0)
    turn(bottom, "Input angle [°]")
    return figure


def _map(figure: Figure, axes: Axes, table: Floats, colours: str, norm: Any, title: str) -> None:
    image = axes.imshow(
        table,
        origin="lower",
        aspect="auto",
        extent=(0.0, 360.0, 0.0, table.shape[0]),
        cmap=colours,
        norm=norm,
        interpolation="nearest",
    )
    axes.grid(False)
    axes.set_facecolor(_EMPTY)
    bar = figure.colorbar(image, ax=axes, location="top", aspect=40, pad=0.03, fraction=0.05)
    bar.outline.set_linewidth(0.5)
    if norm is not None:
        below = np.asarray(MaxNLocator(3).tick_values(norm.vmin, 0.0))
        inside = (below > norm.vmin) & (below < 0.0)
        bar.set_ticks([*below[inside].tolist(), *np.linspace(0.0, norm.vmax, 5).tolist()])
    bar.ax.set_title(title, pad=4)
