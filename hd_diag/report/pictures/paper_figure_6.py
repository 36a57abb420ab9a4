"""Counterpart of the paper's Fig. 6: backlash and load over the teeth, for several eccentricities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.report.pictures.canvas import DASHES, INK, SERIES, drawn, sheet, titled

_SHOWN = 40.0  # backlash beyond which a tooth is simply free [µm]


@drawn
def paper_figure_6(
    eccentricity: Floats, tooth: npt.NDArray[np.int64], backlash: Floats, load: Floats, torque: float
) -> Figure:
    """Backlash above, load below.

    Parameters
    ----------
    eccentricity : ndarray, shape (eccentricities,)
        [m]
    tooth : ndarray of int64, shape (teeth,)
        From the long axis, positive to the right.
    backlash, load : ndarray, shape (eccentricities, teeth)
        [m], [N]
    torque : float
        [N m]

    Returns
    -------
    Figure
    """
    figure, (top, bottom) = sheet(5.2, 2, sharex=True)
    for colour, dashes, size, free, force in zip(SERIES, DASHES, eccentricity, backlash, load, strict=True):
        top.plot(tooth, free * 1e6, color=colour, ls=dashes, label=f"{size * 1e6:.1f} µm")
        bottom.plot(tooth, force, color=colour, ls=dashes)
    top.axhline(0.0, color=INK, lw=0.7)
    top.set_ylim(top=_SHOWN)
    titled(top, "Backlash [µm] at eccentricities of")
    bottom.set_title(f"Load at {torque:g} N m [N]")
    bottom.set_xlabel("Tooth, from the long axis; right: towards the eccentricity")
    bottom.set_xlim(int(tooth.min()), int(tooth.max()))
    return figure
