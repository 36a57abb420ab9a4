"""Measured against simulated error over the wave generator's angle or over torque, and what is left of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.report.binned import Band
from hd_diag.report.pictures.canvas import EXTENDED, INK, NOMINAL, REFIT, drawn, sheet, titled, turn

_LOOKS = ((NOMINAL, (0, (2, 1.2))), (REFIT, (0, (6, 1.8))), (EXTENDED, "-"))
_HEIGHT = 4.6  # [inch]


@drawn
def over_angle(measured: Band, simulated: Mapping[str, Floats], residual: Mapping[str, Band]) -> Figure:
    """Ripple over a turn of the wave generator.

    Parameters
    ----------
    measured : Band
        Error less its mean at the same torque [rad] over the angle [rad].
    simulated : mapping of str to ndarray, shape (bins,)
        The same of up to three stages of the model.
    residual : mapping of str to Band
        What they leave [rad].

    Returns
    -------
    Figure
    """
    return _both(measured, simulated, residual, 180.0 / np.pi, "Wave generator angle [°]")


@drawn
def over_torque(measured: Band, simulated: Mapping[str, Floats], residual: Mapping[str, Band]) -> Figure:
    """Error over torque: arguments as of :func:`over_angle`, over the torque [N m]."""
    return _both(measured, simulated, residual, 1.0, "Torque on the link [N m]")


def _both(
    measured: Band, simulated: Mapping[str, Floats], residual: Mapping[str, Band], scale: float, label: str
) -> Figure:
    figure, (top, bottom) = sheet(_HEIGHT, 2, sharex=True)
    place = scale * measured.center
    _spread(top, place, measured, INK)
    top.plot(place, measured.mean / ARCSEC, "o", ms=2.8, color=INK, label="measured")
    for (colour, dashes), (name, mean) in zip(_LOOKS, simulated.items(), strict=False):
        top.plot(place, mean / ARCSEC, color=colour, ls=dashes, label=name)
    for (colour, dashes), (name, left) in zip(_LOOKS, residual.items(), strict=False):
        _spread(bottom, place, left, colour)
        bottom.plot(place, left.mean / ARCSEC, color=colour, ls=dashes, label=name)
    bottom.axhline(0.0, color=INK, lw=0.7)
    titled(top, "Transmission error [arcsec]")
    bottom.set_title("What is left: measured less simulated [arcsec]")
    if scale == 1.0:
        bottom.set_xlabel(label)
    else:
        turn(bottom, label)
    return figure


def _spread(axes: Axes, place: Floats, band: Band, colour: str) -> None:
    """From the 10 % to the 90 % quantile of each bin."""
    axes.fill_between(place, band.low / ARCSEC, band.high / ARCSEC, color=colour, alpha=0.18, lw=0)
