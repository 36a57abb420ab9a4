"""Counterpart of the paper's Fig. 5: motion of the neutral layer's points, without and with eccentricity."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.report.pictures.canvas import DASHES, INK, SERIES, drawn, sheet, titled, turn

_SHOWN = 30.0  # to either side of the long axis [°]: over the whole wave the change is a line's width


@drawn
def paper_figure_5(
    stations: Floats,
    from_long_axis: Floats,
    displacement: Floats,
    direction: Floats,
    change: Floats,
    eccentricity: Floats,
) -> Figure:
    """Radial displacement of points, and its change.

    Parameters
    ----------
    stations : ndarray, shape (stations,)
        Where the points stand [rad].
    from_long_axis : ndarray, shape (places,)
        [rad]
    displacement : ndarray, shape (2, stations, places)
        Without and with eccentricity [m].
    direction : ndarray, shape (directions,)
        [rad]
    change : ndarray, shape (eccentricities, directions)
        [m]
    eccentricity : ndarray, shape (eccentricities,)
        [m]

    Returns
    -------
    Figure
    """
    figure, (top, bottom) = sheet(5.4, 2)
    place = np.degrees(from_long_axis)
    top.plot(place, displacement[0, 0] * 1e6, color=INK, lw=2.6, alpha=0.4, label="none: all points")
    for colour, dashes, angle, row in zip(SERIES, DASHES, stations, displacement[1], strict=False):
        top.plot(
            place, row * 1e6, color=colour, ls=dashes, lw=1.0, label=f"point at {np.degrees(angle):.0f}°"
        )
    near = np.abs(place) <= _SHOWN
    shown = displacement[:, :, near] * 1e6
    top.set_xlim(-_SHOWN, _SHOWN)
    top.set_ylim(shown.min() - 5.0, shown.max() + 5.0)
    top.set_xlabel("Arc from the long axis [°]")
    titled(top, f"Radial displacement [µm], none and {eccentricity[-1] * 1e6:.1f} µm")
    order = np.argsort(direction)
    for colour, dashes, size, row in zip(SERIES, DASHES, eccentricity, change, strict=True):
        bottom.plot(
            np.degrees(direction[order]),
            row[order] * 1e6,
            color=colour,
            ls=dashes,
            label=f"{size * 1e6:.1f} µm",
        )
    turn(bottom, "Where the point is [°]; the eccentricity points to 90°")
    titled(bottom, "Its change by eccentricity [µm]")
    return figure
