"""The torsion curve: transmission error over torque, with the ranges and values of K1, K2 and K3."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.report.binned import Band
from hd_diag.report.pictures.canvas import ACCENT, EXTENDED, GRID, INK, NOMINAL, REFIT, drawn, sheet, titled

_ARCMIN = 60.0 * ARCSEC
_LEAST_LABELLED = 0.1  # width of a range over the greatest torque, from which its name has room


@drawn
def torsion_curve(
    torque: Floats,
    configured: Floats | None,
    fitted: Floats,
    spread: tuple[Floats, Floats],
    measured: tuple[Band, Band] | None,
    extended: tuple[Floats, Floats] | None,
    stiffness: Sequence[tuple[str, float, float, float]],
) -> Figure:
    """Error over torque.

    Parameters
    ----------
    torque, fitted : ndarray, shape (n,)
        [N m]; mean error of the drive over the angle [rad].
    configured : ndarray, shape (n,), or None
        The same of the drive before it was fitted [rad]; None where it never was.
    spread : tuple of two ndarray, shape (n,)
        Least and greatest error over the angle [rad].
    measured : tuple of two Band, or None
        While the torque rises and falls [rad].
    extended : tuple of two ndarray, or None
        The extended model's means in the same bins [rad].
    stiffness : sequence of (name, low, high, value)
        Ranges of torque [N m] and stiffness [N m/rad].

    Returns
    -------
    Figure
    """
    figure, (axes,) = sheet(3.6)
    most = float(torque[-1])
    axes.fill_between(torque, spread[0] / _ARCMIN, spread[1] / _ARCMIN, color=REFIT, alpha=0.18, lw=0)
    if configured is not None:
        axes.plot(torque, configured / _ARCMIN, color=NOMINAL, ls=(0, (2, 1.2)), label="configured")
    name = "simulated" if configured is None else "fitted"
    axes.plot(torque, fitted / _ARCMIN, color=REFIT, ls=(0, (6, 1.8)), label=name)
    for way, told in enumerate(extended or ()):
        assert measured is not None
        name = "_" if way else "extended"
        axes.plot(measured[way].center, told / _ARCMIN, color=EXTENDED, label=name)
    for band, mark, name in zip(measured or (), "^v", ("torque rising", "torque falling"), strict=False):
        axes.plot(band.center, band.mean / _ARCMIN, mark, ms=3.2, mfc="none", mew=0.8, color=INK, label=name)
    for number, (name, low, high, value) in enumerate(stiffness):
        if low >= most:
            continue
        axes.axvspan(low, min(high, most), color=(GRID, ACCENT, GRID)[number % 3], alpha=0.12, lw=0)
        if min(high, most) - low < _LEAST_LABELLED * most:
            continue
        middle = 0.5 * (low + min(high, most))
        label = f"{name}\n{value * 1e-4:.1f}" if np.isfinite(value) else name
        axes.text(middle, 0.985, label, transform=axes.get_xaxis_transform(), ha="center", va="top")
    axes.set_xlim(-most, most)
    axes.axhline(0.0, color=INK, lw=0.7)
    axes.axvline(0.0, color=INK, lw=0.7)
    axes.set_xlabel("Torque on the link [N m]; K in 10⁴ N m/rad")
    titled(axes, "Transmission error [arcmin]")
    return figure
