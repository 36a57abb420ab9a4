"""The torsion curve: transmission error over torque, with the ranges and values of K1, K2 and K3."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hd_diag.formatting import ARCSEC
from hd_diag.report.pictures.canvas import ACCENT, GRID, INK, REFIT, STAGES, drawn, sheet, titled
from hd_diag.report.torsion import Torsion

_ARCMIN = 60.0 * ARCSEC
_LEAST_LABELLED = 0.1  # width of a range over the greatest torque, from which its name has room


@drawn
def torsion_curve(found: Torsion, judged: bool) -> Figure:
    """Error over torque, of the configured and, where it was judged, of the fitted drive."""
    figure, (axes,) = sheet(3.6)
    torque, most = found.torque, float(found.torque[-1])
    axes.fill_between(torque, found.low / _ARCMIN, found.high / _ARCMIN, color=REFIT, alpha=0.18, lw=0)
    names = ("configured", "fitted") if judged else ("", "simulated")
    for (colour, dashes), name, curve in zip(STAGES, names, (found.configured, found.fitted), strict=False):
        if name:
            axes.plot(torque, curve / _ARCMIN, color=colour, ls=dashes, label=name)
    colour, dashes = STAGES[2]
    for band, curve, name in zip(found.measured, found.extended, ("extended", "_"), strict=False):
        axes.plot(band.center, curve / _ARCMIN, color=colour, ls=dashes, label=name)
    for band, mark, name in zip(found.measured, "^v", ("torque rising", "torque falling"), strict=False):
        axes.plot(band.center, band.mean / _ARCMIN, mark, ms=3.2, mfc="none", mew=0.8, color=INK, label=name)
    for entry, colour in zip(found.stiffness, (GRID, ACCENT, GRID), strict=True):
        end = min(entry.high, most)
        if entry.low < most:
            axes.axvspan(entry.low, end, color=colour, alpha=0.12, lw=0)
        if end - entry.low >= _LEAST_LABELLED * most:
            value = entry.measured if found.measured else entry.fitted
            label = f"{entry.name}\n{value * 1e-4:.1f}" if np.isfinite(value) else entry.name
            middle = 0.5 * (entry.low + end)
            axes.text(middle, 0.985, label, transform=axes.get_xaxis_transform(), ha="center", va="top")
    axes.set_xlim(-most, most)
    axes.axhline(0.0, color=INK, lw=0.7)
    axes.axvline(0.0, color=INK, lw=0.7)
    axes.set_xlabel("Torque on the link [N m]; K in 10⁴ N m/rad")
    titled(axes, "Transmission error [arcmin]")
    return figure
