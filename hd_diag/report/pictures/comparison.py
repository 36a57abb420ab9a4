"""Measured against simulated: over angle, torque and time, by orders of the residual, by models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from hd_diag.arrays import Floats
from hd_diag.diagnosis.calibration import NAMED, ODDS
from hd_diag.diagnosis.gain import Rms
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.formatting import ARCSEC, words
from hd_diag.report.pictures import canvas
from hd_diag.report.pictures.canvas import GRID, INK, REFIT, STAGES, drawn, sheet, titled, turn
from hd_diag.report.stages import Band, BinnedResiduals, Curve, OverTime, Rung
from hd_diag.report.torsion import Torsion, k_shown

_TURN = 2.0 * np.pi
_ARCMIN = 60.0 * ARCSEC
_WIDTHS = (0.8, 0.9, 1.3)  # line widths of the stages' spectra: the last one is drawn over the others
_DECADES = 4.0
_RAISED = 16.0  # room for the marks' numbers [points]
_CLOSE = 0.045  # distance over the width: nearer marks get different heights
_LEAST_LABELLED = 0.1  # least width of a labelled range over the greatest torque
_FLOOR = 0.4  # height of the noise floor at each rung
_IN_TURN: Any = {"fmt": "o", "ms": 5, "capsize": 3, "color": canvas.EXTENDED, "label": "each stretch in turn"}
_NEVER_FITTED: Any = {"ms": 6.5, "mfc": "none", "mew": 1.2, "color": REFIT, "label": "never fitted"}
_NONE_WORSE = 60.0  # log odds above which a bar is cut
_BESIDE: Any = {"xytext": (7.0, 0.0), "textcoords": "offset points", "ha": "left", "va": "center"}
_ROOM = 1.9  # factor of free room right of the largest value, for its number


@drawn
def binned(found: BinnedResiduals, by_torque: bool) -> Figure:
    """Above: error over torque, or ripple over a turn of the wave generator. Below: residual."""
    scale = 1.0 if by_torque else 180.0 / np.pi
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
    if by_torque:
        bottom.set_xlabel("Torque on the link [N m]")
    else:
        turn(bottom, "Wave generator angle [°]")
    return figure


def _spread(axes: Axes, place: Floats, band: Band, colour: str) -> None:
    """Fill each bin from its 10 % to its 90 % quantile."""
    axes.fill_between(place, band.low / ARCSEC, band.high / ARCSEC, color=colour, alpha=0.18, lw=0)


@drawn
def over_time(found: OverTime) -> Figure:
    """Torque, speed and residuals as envelopes."""
    figure, axes = sheet(4.8, 3, sharex=True, height_ratios=(1.0, 1.0, 1.5))
    for panel, column, scale in ((axes[0], found.torque, 1.0), (axes[1], found.speed, _TURN)):
        panel.fill_between(column.center, column.low / scale, column.high / scale, color=INK, lw=0.5)
        panel.axhline(0.0, color=INK, lw=0.5)
    for (colour, _), (name, column) in zip(STAGES, found.residual.items(), strict=False):
        low, high = column.low / ARCSEC, column.high / ARCSEC
        axes[2].fill_between(column.center, low, high, color=colour, lw=0.3, label=name)
    axes[0].set_title("Torque on the link [N m]")
    axes[1].set_title("Speed of the input [turns per second]")
    axes[2].set_xlabel("Time [s]")
    titled(axes[2], "Residual, least to greatest [arcsec]")
    return figure


@drawn
def orders(spectra: Mapping[str, tuple[Floats, Floats]], marks: Sequence[float], highest: float) -> Figure:
    """Amplitude [rad] of the residual over the order of the wave generator's turn, up to the highest.

    `marks` are rising orders; they get the numbers 1, 2, ...
    """
    figure, (axes,) = sheet(3.1)
    for (colour, _), width, (name, (order, amplitude)) in zip(STAGES, _WIDTHS, spectra.items(), strict=False):
        axes.semilogy(order, np.maximum(amplitude, 1e-12) / ARCSEC, color=colour, lw=width, label=name)
    top = 2.0 * max(float(np.max(amplitude)) for _, amplitude in spectra.values()) / ARCSEC
    axes.set(xlim=(0.0, highest), ylim=(top * 10.0**-_DECADES, top))
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


@drawn
def ripple(found: Ripple) -> Figure:
    """Amplitude of the torque's waves over the order of the output's turn; the gear's orders are marked."""
    figure, (axes,) = sheet(2.8)
    axes.plot(found.orders, found.spectrum, color=REFIT, lw=0.9)
    for order in {line.order for line in found.lines}:
        axes.axvline(order, color=INK, lw=0.8, ls=(0, (1, 1.5)))
    axes.set(xlim=(0.0, found.orders[-1]), xlabel="Order: cycles per turn of the output")
    axes.set_ylim(bottom=0.0)
    titled(axes, "Amplitude of the torque [N m]")
    return figure


@drawn
def torsion_curve(found: Torsion, judged: bool) -> Figure:
    """Error over torque: configured and fitted drive if the joint was judged, otherwise simulated alone."""
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
    for entry, colour in zip(found.stiffness, (GRID, canvas.ACCENT, GRID), strict=True):
        end = min(entry.high, most)
        if entry.low < most:
            axes.axvspan(entry.low, end, color=colour, alpha=0.12, lw=0)
        if end - entry.low >= _LEAST_LABELLED * most:
            value = entry.measured if found.measured else entry.fitted
            label = f"{entry.name}\n{k_shown(value)}" if np.isfinite(value) else entry.name
            middle = 0.5 * (entry.low + end)
            axes.text(middle, 0.985, label, transform=axes.get_xaxis_transform(), ha="center", va="top")
    axes.axhline(0.0, color=INK, lw=0.7)
    axes.axvline(0.0, color=INK, lw=0.7)
    axes.set(xlim=(-most, most), xlabel="Torque on the link [N m]; K in 10⁴ N m/rad")
    titled(axes, "Transmission error [arcmin]")
    return figure


@drawn
def remainders(curves: Sequence[Curve]) -> Figure:
    """Each remainder over the variable that it follows."""
    figure, axes = sheet(1.0 + 1.3 * len(curves), len(curves))
    for panel, curve in zip(axes, curves, strict=True):
        panel.plot(curve.place, curve.part / ARCSEC, ".", ms=2.5, color=canvas.EXTENDED)
        panel.axhline(0.0, color=INK, lw=0.7)
        panel.set_title(f"{curve.name.capitalize()} [arcsec], over [{curve.unit}]")
    return figure


@drawn
def evidence(weighed: Mapping[str, Mapping[str, float]]) -> Figure:
    """Log odds against the rivals of each cause, by name; the empty name means no cause."""
    rows = [(name, other, -odds[other]) for name, odds in weighed.items() for other in _by_odds(name, odds)]
    figure, (axes,) = sheet(0.9 + 0.42 * len(rows))
    for place, (name, other, worse) in enumerate(rows):
        shown = min(worse, _NONE_WORSE)
        axes.barh(place, shown, _FLOOR, color=REFIT if other else INK, lw=0)
        axes.annotate(f"{worse:.3g}", (shown, place), **_BESIDE)
        label = f"{words(other)} for {words(name)}" if other else f"no {words(name)}"
        axes.text(0.0, place - 0.4, label, transform=axes.get_yaxis_transform(), ha="left", va="center")
    axes.axvline(ODDS, color=INK, lw=0.8, ls=(0, (1, 1.5)))
    axes.set(xlim=(0.0, 1.2 * _NONE_WORSE), ylim=(len(rows) - 0.6, -0.7), yticks=[])
    axes.grid(False, axis="y")
    titled(axes, f"Log odds against; dotted: {100.0 * NAMED:.0f} %")
    return figure


def _by_odds(name: str, odds: Mapping[str, float]) -> list[str]:
    """Names of the alternatives of a cause: no cause first, then the most probable."""
    return sorted((other for other in odds if other != name), key=lambda one: (one != "", -odds[one]))


@drawn
def model_ladder(rungs: Sequence[Rung], held_out: Rms) -> Figure:
    """Rungs from top to bottom, residuals on data that were never fitted, and the noise floor."""
    figure, (axes,) = sheet(1.1 + 0.46 * len(rungs))
    axes.set_xscale("log")
    place = np.arange(len(rungs))
    rms, low, high = np.array([(rung.rms, rung.low, rung.high) for rung in rungs]).T / ARCSEC
    noise = np.array([held_out.noise, held_out.noise_low, held_out.noise_high]) / ARCSEC
    axes.barh(place, noise[2] - noise[1], _FLOOR, left=noise[1], color=GRID, alpha=0.45, lw=0)
    ends = place - _FLOOR / 2, place + _FLOOR / 2
    axes.vlines(np.full(place.size, noise[0]), *ends, color=INK, lw=1.2, label="noise floor")
    axes.errorbar(rms, place, xerr=(rms - low, high - rms), **_IN_TURN)
    held = np.full(place.size, np.nan)
    held[-1], held[:2] = held_out.extended / ARCSEC, (held_out.nominal / ARCSEC, held_out.refit / ARCSEC)
    axes.plot(held, place, "D", **_NEVER_FITTED)
    for step, rung in enumerate(rungs):
        axes.text(0.0, step - 0.36, rung.name, transform=axes.get_yaxis_transform(), ha="left", va="center")
        axes.annotate(f"{rms[step]:.2f}", (np.fmax(high, held)[step], step), **_BESIDE)
    across = 0.8 * min(noise[1], np.fmin(low, held).min()), _ROOM * np.fmax(high, held).max()
    axes.set(xlim=across, ylim=(len(rungs) - 0.65, -0.6), yticks=[])
    axes.grid(False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    titled(axes, "Residual on data held out, rms [arcsec]")
    return figure
