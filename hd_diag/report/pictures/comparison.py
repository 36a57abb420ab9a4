"""Measured against simulated: over angle, over torque, over time, and by orders of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from hd_diag.arrays import Floats
from hd_diag.formatting import ARCSEC
from hd_diag.report.binned import Band
from hd_diag.report.pictures.canvas import INK, STAGES, drawn, sheet, titled, turn
from hd_diag.report.stages import Comparison, OverTime

_TURN = 2.0 * np.pi
_WIDTHS = (0.8, 0.9, 1.3)  # of the stages' spectra: the last one is drawn over the others
_DECADES = 4.0
_RAISED = 16.0  # room for the marks' numbers [points]
_CLOSE = 0.045  # of the width; marks nearer to each other share the height


@drawn
def over_angle(found: Comparison) -> Figure:
    """Ripple over a turn of the wave generator above, residual below."""
    figure, axes = _compared(found, 180.0 / np.pi)
    turn(axes, "Wave generator angle [°]")
    return figure


@drawn
def over_torque(found: Comparison) -> Figure:
    """Error over torque above, residual below."""
    figure, axes = _compared(found, 1.0)
    axes.set_xlabel("Torque on the link [N m]")
    return figure


def _compared(found: Comparison, scale: float) -> tuple[Figure, Axes]:
    figure, (top, bottom) = sheet(4.6, 2, sharex=True)
    place = scale * found.measured.center
    _spread(top, place, found.measured, INK)
    top.plot(place, found.measured.mean / ARCSEC, "o", ms=2.8, color=INK, label="measured")
    for (colour, dashes), (name, mean) in zip(STAGES, found.simulated.items(), strict=False):
        top.plot(place, mean / ARCSEC, color=colour, ls=dashes, label=name)
    for (colour, dashes), (name, residual) in zip(STAGES, found.residual.items(), strict=False):
        _spread(bottom, place, residual, colour)
        bottom.plot(place, residual.mean / ARCSEC, color=colour, ls=dashes, label=name)
    bottom.axhline(0.0, color=INK, lw=0.7)
    titled(top, "Transmission error [arcsec]")
    bottom.set_title("Residual: measured less simulated [arcsec]")
    return figure, bottom


def _spread(axes: Axes, place: Floats, band: Band, colour: str) -> None:
    """From the 10 % to the 90 % quantile of each bin."""
    axes.fill_between(place, band.low / ARCSEC, band.high / ARCSEC, color=colour, alpha=0.18, lw=0)


@drawn
def over_time(found: OverTime) -> Figure:
    """Torque, speed and residuals as envelopes."""
    figure, axes = sheet(4.8, 3, sharex=True, height_ratios=(1.0, 1.0, 1.5))
    for panel, column, scale in ((axes[0], found.torque, 1.0), (axes[1], found.speed, _TURN)):
        panel.fill_between(column.place, column.low / scale, column.high / scale, color=INK, lw=0.5)
        panel.axhline(0.0, color=INK, lw=0.5)
    for (colour, _), (name, column) in zip(STAGES, found.residual.items(), strict=False):
        low, high = column.low / ARCSEC, column.high / ARCSEC
        axes[2].fill_between(column.place, low, high, color=colour, lw=0.3, label=name)
    axes[0].set_title("Torque on the link [N m]")
    axes[1].set_title("Speed of the input [turns per second]")
    axes[2].set_xlabel("Time [s]")
    titled(axes[2], "Residual, least to greatest [arcsec]")
    return figure


@drawn
def orders(spectra: Mapping[str, tuple[Floats, Floats]], marks: Sequence[float], highest: float) -> Figure:
    """Amplitude [rad] of the residual over the order of the wave generator's turn, up to the highest.

    Marks are orders, rising; they get the numbers 1, 2, ...
    """
    figure, (axes,) = sheet(3.1)
    for (colour, _), width, (name, (order, amplitude)) in zip(STAGES, _WIDTHS, spectra.items(), strict=False):
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
    titled(axes, "Amplitude of the residual [arcsec]", _RAISED if marks else 0.0)
    return figure
