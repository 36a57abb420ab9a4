"""A ladder of models: rms residual of each rung on data that its fit did not see, above the noise floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from hd_diag.diagnosis.diagnosis import Rms
from hd_diag.formatting import ARCSEC
from hd_diag.report.ladder import Rung
from hd_diag.report.pictures.canvas import EXTENDED, GRID, INK, REFIT, drawn, sheet, titled

_FLOOR = 0.4  # height of the noise floor at each rung
_IN_TURN: Any = {"fmt": "o", "ms": 5, "capsize": 3, "color": EXTENDED, "label": "each stretch in turn"}
_NEVER_FITTED: Any = {"ms": 6.5, "mfc": "none", "mew": 1.2, "color": REFIT, "label": "never fitted"}
_ROOM = 1.9  # factor to the right of the largest for its number


@drawn
def model_ladder(rungs: Sequence[Rung], held_out: Rms) -> Figure:
    """Rungs from top to bottom beside the data that were never fitted, and the noise floor."""
    figure, (axes,) = sheet(1.1 + 0.46 * len(rungs))
    axes.set_xscale("log")
    place = np.arange(len(rungs))
    rms, low, high = np.array([(rung.rms, rung.low, rung.high) for rung in rungs]).T / ARCSEC
    noise = np.array([held_out.noise, held_out.noise_low, held_out.noise_high]) / ARCSEC
    axes.barh(place, noise[2] - noise[1], _FLOOR, left=noise[1], color=GRID, alpha=0.45, lw=0)
    ends = place - _FLOOR / 2, place + _FLOOR / 2
    axes.vlines(np.full(place.size, noise[0]), *ends, color=INK, lw=1.2, label="noise floor")
    spread = np.stack((rms - low, high - rms))
    axes.errorbar(rms, place, xerr=spread, **_IN_TURN)
    marks = {len(rungs) - 1: held_out.extended} | {0: held_out.nominal, 1: held_out.refit}
    at = sorted(marks)
    axes.plot([marks[rung] / ARCSEC for rung in at], at, "D", **_NEVER_FITTED)
    for step, rung in enumerate(rungs):
        axes.text(0.0, step - 0.36, rung.name, transform=axes.get_yaxis_transform(), ha="left", va="center")
        axes.text(high[step] * 1.12, step, f"{rms[step]:.2f}", ha="left", va="center")
    axes.set_ylim(len(rungs) - 0.65, -0.6)
    axes.set_yticks([])
    axes.grid(False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.set_xlim(0.8 * min(noise[1], low.min()), _ROOM * high.max())
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    titled(axes, "Residual on data held out, rms [arcsec]")
    return figure
