"""Counterpart of the paper's Fig. 7: one tooth while a lobe passes it, for several eccentricities."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.report.pictures.canvas import DASHES, INK, SERIES, drawn, sheet, titled

_SHOWN = 60.0  # backlash beyond which the tooth is simply free [µm]


@drawn
def paper_figure_7(
    eccentricity: Floats,
    angle: Floats,
    backlash: Floats,
    load: Floats,
    near: tuple[Floats, Floats],
    torque: float,
) -> Figure:
    """Backlash above, load below.

    Parameters
    ----------
    eccentricity : ndarray, shape (eccentricities,)
        Away from the tooth [m].
    angle : ndarray, shape (angles,)
        Of the wave generator [rad].
    backlash, load : ndarray, shape (eccentricities, angles)
        [m], [N]
    near : tuple of two ndarray, shape (angles,)
        The same for the largest eccentricity towards the tooth.
    torque : float
        [N m]

    Returns
    -------
    Figure
    """
    figure, (top, bottom) = sheet(5.4, 2, sharex=True)
    place = np.degrees(angle)
    for colour, dashes, size, free, force in zip(SERIES, DASHES, eccentricity, backlash, load, strict=True):
        top.plot(place, free * 1e6, color=colour, ls=dashes, label=f"{size * 1e6:.1f} µm")
        bottom.plot(place, force, color=colour, ls=dashes)
    told = f"{eccentricity[-1] * 1e6:.1f} µm towards it"
    top.plot(place, near[0] * 1e6, color=INK, lw=0.9, ls=(0, (1, 1)), label=told)
    bottom.plot(place, near[1], color=INK, lw=0.9, ls=(0, (1, 1)))
    top.axhline(0.0, color=INK, lw=0.7)
    top.set_ylim(top=_SHOWN)
    titled(top, "Backlash of a tooth away from eccentricities of [µm]")
    bottom.set_title(f"Its load at {torque:g} N m [N]")
    bottom.set_xlabel("Wave generator angle from the tooth [°]")
    bottom.set_xlim(float(place[0]), float(place[-1]))
    return figure
