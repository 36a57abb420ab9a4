"""A ladder of models: what each rung leaves of data that its fit did not see, above the noise floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from hd_diag.arrays import Floats
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.report.pictures.canvas import EXTENDED, GRID, INK, REFIT, drawn, sheet, titled

_FLOOR = 0.4  # height of the noise floor at each rung
_ROOM = 1.9  # factor to the right of the largest for its number


@drawn
def model_ladder(
    names: Sequence[str],
    rms: Floats,
    low: Floats,
    high: Floats,
    held: Sequence[tuple[int, float]],
    noise: tuple[float, float, float],
) -> Figure:
    """Rungs from top to bottom.

    Parameters
    ----------
    names : sequence of str
    rms, low, high : ndarray, shape (rungs,)
        Of stretches held out in turn, with the interval [rad].
    held : sequence of (rung, rms)
        Of the data that were never fitted [rad].
    noise : (value, low, high)
        Noise floor [rad].

    Returns
    -------
    Figure
    """
    figure, (axes,) = sheet(1.1 + 0.46 * len(names))
    axes.set_xscale("log")
    place = np.arange(len(names))
    floor, *ends = (each / ARCSEC for each in noise)
    axes.barh(place, ends[1] - ends[0], _FLOOR, left=ends[0], color=GRID, alpha=0.45, lw=0)
    at = np.full(place.size, floor)
    axes.vlines(at, place - _FLOOR / 2, place + _FLOOR / 2, color=INK, lw=1.2, label="noise floor")
    axes.errorbar(
        rms / ARCSEC,
        place,
        xerr=np.stack((rms - low, high - rms)) / ARCSEC,
        fmt="o",
        ms=5,
        capsize=3,
        color=EXTENDED,
        label="each stretch in turn",
    )
    axes.plot(
        [value / ARCSEC for _, value in held],
        [rung for rung, _ in held],
        "D",
        ms=6.5,
        mfc="none",
        mew=1.2,
        color=REFIT,
        label="never fitted",
    )
    for rung, (name, value) in enumerate(zip(names, rms / ARCSEC, strict=True)):
        axes.text(0.0, rung - 0.36, name, transform=axes.get_yaxis_transform(), ha="left", va="center")
        axes.text(high[rung] / ARCSEC * 1.12, rung, f"{value:.2f}", ha="left", va="center")
    axes.set_ylim(len(names) - 0.65, -0.6)
    axes.set_yticks([])
    axes.grid(False, axis="y")
    axes.spines["left"].set_visible(False)
    least, most = min(noise[1], float(low.min())), float(high.max())
    axes.set_xlim(0.8 * least / ARCSEC, _ROOM * most / ARCSEC)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    titled(axes, "Left of data held out, rms [arcsec]")
    return figure
