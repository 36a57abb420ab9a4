"""Picture of a table that `hd-diag mesh` writes: teeth of one moment, or a sweep over angle or torque."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.formatting import ARCSEC
from hd_diag.report.pictures.canvas import DASHES, SERIES, drawn, sheet, titled


@drawn
def table_picture(table: Mapping[str, Floats]) -> Figure:
    """Backlash and load over the teeth, or error and largest force over the swept angle or torque."""
    figure, (top, bottom) = sheet(5.2, 2, sharex=True)
    if "tooth" in table:
        for colour, dashes, sign in zip(SERIES, DASHES, "+-", strict=False):
            top.plot(table["tooth"], table[f"backlash {sign} [m]"] * 1e6, color=colour, ls=dashes, label=sign)
            bottom.plot(table["tooth"], table[f"load {sign} [N]"], color=colour, ls=dashes, label=sign)
        titled(top, "Backlash of both flanks [µm]")
        titled(bottom, "Load [N]")
        bottom.set_xlabel("Tooth of the flexspline")
        return figure
    name = "input_angle [rad]" if np.ptp(table["input_angle [rad]"]) else "torque [N m]"
    top.plot(table[name], table["transmission_error [rad]"] / ARCSEC, color=SERIES[0])
    bottom.plot(table[name], table["peak_tooth_load [N]"], color=SERIES[0])
    titled(top, "Transmission error [arcsec]")
    titled(bottom, "Largest force on a flank [N]")
    bottom.set_xlabel({"torque [N m]": "Torque [N m]"}.get(name, "Input angle [rad]"))
    return figure
