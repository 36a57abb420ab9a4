"""Order spectrum of what the model leaves, before and after, with the orders that have a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from hd_diag.arrays import Floats
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.report.pictures.canvas import EXTENDED, INK, NOMINAL, REFIT, drawn, sheet, titled

_LOOKS = ((NOMINAL, 0.8), (REFIT, 0.9), (EXTENDED, 1.3))
_DECADES = 4.0
_RAISED = 16.0  # room for the marks' numbers [points]
_CLOSE = 0.045  # of the width; marks nearer to each other share the height


@drawn
def residual_orders(
    spectra: Mapping[str, tuple[Floats, Floats]], marks: Sequence[float], highest: float
) -> Figure:
    """Amplitude over the order of the wave generator's turn.

    Parameters
    ----------
    spectra : mapping of str to (order, amplitude)
        Of up to three stages; amplitude [rad].
    marks : sequence of float
        Orders to mark, rising; they get the numbers 1, 2, ...
    highest : float
        End of the axis.

    Returns
    -------
    Figure
    """
    figure, (axes,) = sheet(3.1)
    for (colour, width), (name, (order, amplitude)) in zip(_LOOKS, spectra.items(), strict=False):
        axes.semilogy(order, np.maximum(amplitude, 1e-12) / ARCSEC, color=colour, lw=width, label=name)
    top = 2.0 * max(float(np.max(amplitude)) for _, amplitude in spectra.values()) / ARCSEC
    axes.set_xlim(0.0, highest)
    axes.set_ylim(top * 10.0**-_DECADES, top)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("Order: cycles per turn of the wave generator")
    before = -1.0
    for number, mark in enumerate(marks, start=1):
        axes.axvline(mark, color=INK, lw=0.8, ls=(0, (1, 1.5)))
        level = 1.01 if mark - before > _CLOSE * highest else 1.055
        before = mark if level < 1.02 else -1.0
        axes.text(mark, level, f"{number}", transform=axes.get_xaxis_transform(), ha="center", va="bottom")
    titled(axes, "Amplitude of what is left [arcsec]", _RAISED if marks else 0.0)
    return figure
