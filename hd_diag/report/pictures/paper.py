"""Counterparts of the paper's Figs. 5, 6 and 7, without and with eccentricity."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.report.paper_figures import Engagement, NeutralLayer
from hd_diag.report.pictures.canvas import DASHES, INK, SERIES, drawn, sheet, titled, turn

_SHOWN = 30.0  # to either side of the long axis [°]: over the whole wave the change is a line's width
_FREE = {6: 40.0, 7: 60.0}  # backlash beyond which a tooth is simply free [µm]
_NEAR: Any = {"color": INK, "lw": 0.9, "ls": (0, (1, 1))}


@drawn
def figure_5(found: NeutralLayer) -> Figure:
    """Radial displacement of the neutral layer's points, and its change by the eccentricity."""
    figure, (top, bottom) = sheet(5.4, 2)
    place = np.degrees(found.from_long_axis)
    displacement, change = found.displacement * 1e6, found.change * 1e6
    top.plot(place, displacement[0, 0], color=INK, lw=2.6, alpha=0.4, label="none: all points")
    for colour, dashes, angle, row in zip(SERIES, DASHES, found.stations, displacement[1], strict=False):
        top.plot(place, row, color=colour, ls=dashes, lw=1.0, label=f"point at {np.degrees(angle):.0f}°")
    shown = displacement[:, :, np.abs(place) <= _SHOWN]
    top.set_xlim(-_SHOWN, _SHOWN)
    top.set_ylim(shown.min() - 5.0, shown.max() + 5.0)
    top.set_xlabel("Arc from the long axis [°]")
    titled(top, f"Radial displacement [µm], none and {found.eccentricity[-1] * 1e6:.1f} µm")
    order = np.argsort(found.direction)
    direction = np.degrees(found.direction[order])
    for colour, dashes, size, row in zip(SERIES, DASHES, found.eccentricity, change, strict=True):
        bottom.plot(direction, row[order], color=colour, ls=dashes, label=f"{size * 1e6:.1f} µm")
    turn(bottom, "Where the point is [°]; the eccentricity points to 90°")
    titled(bottom, "Its change by eccentricity [µm]")
    return figure


@drawn
def figure_6(found: Engagement) -> Figure:
    """Backlash and load over the teeth at one moment."""
    figure, top, bottom = _engagement(found, found.place, 5.2, _FREE[6])
    titled(top, "Backlash [µm] at eccentricities of")
    bottom.set_title(f"Load at {found.torque:g} N m [N]")
    bottom.set_xlabel("Tooth, from the long axis; right: towards the eccentricity")
    return figure


@drawn
def figure_7(found: Engagement) -> Figure:
    """Backlash and load of one tooth while a lobe passes it."""
    figure, top, bottom = _engagement(found, np.degrees(found.place), 5.4, _FREE[7])
    titled(top, "Backlash of a tooth away from eccentricities of [µm]")
    bottom.set_title(f"Its load at {found.torque:g} N m [N]")
    bottom.set_xlabel("Wave generator angle from the tooth [°]")
    return figure


def _engagement(found: Engagement, place: Floats, height: float, free: float) -> tuple[Figure, Axes, Axes]:
    """Backlash above, load below; the titles are still to come."""
    figure, (top, bottom) = sheet(height, 2, sharex=True)
    rows = zip(SERIES, DASHES, found.eccentricity, found.backlash, found.load, strict=True)
    for colour, dashes, size, backlash, load in rows:
        top.plot(place, backlash * 1e6, color=colour, ls=dashes, label=f"{size * 1e6:.1f} µm")
        bottom.plot(place, load, color=colour, ls=dashes)
    if found.near is not None:
        top.plot(
            place, found.near[0] * 1e6, label=f"{found.eccentricity[-1] * 1e6:.1f} µm towards it", **_NEAR
        )
        bottom.plot(place, found.near[1], **_NEAR)
    top.axhline(0.0, color=INK, lw=0.7)
    top.set_ylim(top=free)
    bottom.set_xlim(float(place[0]), float(place[-1]))
    return figure, top, bottom
