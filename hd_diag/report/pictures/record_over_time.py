"""A record over time as envelopes: torque, speed, and what the model leaves before and after."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from hd_diag.model.torsion_map import ARCSEC
from hd_diag.report.binned import Envelope
from hd_diag.report.pictures.canvas import EXTENDED, INK, NOMINAL, REFIT, drawn, sheet, titled

_TURN = 2.0 * np.pi
_COLOURS = (NOMINAL, REFIT, EXTENDED)


@drawn
def record_over_time(torque: Envelope, speed: Envelope, residual: Mapping[str, Envelope]) -> Figure:
    """Three panels over time.

    Parameters
    ----------
    torque, speed : Envelope
        [N m] and [rad/s] over time [s].
    residual : mapping of str to Envelope
        What up to three stages leave [rad].

    Returns
    -------
    Figure
    """
    figure, axes = sheet(4.8, 3, sharex=True, height_ratios=(1.0, 1.0, 1.5))
    for panel, column, scale in ((axes[0], torque, 1.0), (axes[1], speed, _TURN)):
        panel.fill_between(column.place, column.low / scale, column.high / scale, color=INK, lw=0.5)
        panel.axhline(0.0, color=INK, lw=0.5)
    for colour, (name, column) in zip(_COLOURS, residual.items(), strict=False):
        low, high = column.low / ARCSEC, column.high / ARCSEC
        axes[2].fill_between(column.place, low, high, color=colour, lw=0.3, label=name)
    axes[0].set_title("Torque on the link [N m]")
    axes[1].set_title("Speed of the input [turns per second]")
    axes[2].set_xlabel("Time [s]")
    titled(axes[2], "What is left, least to greatest [arcsec]")
    return figure
