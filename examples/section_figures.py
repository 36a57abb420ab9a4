"""Backlash and load along the width of a drive in sections; the paper's figures at the middle and both ends.

`hd-diag figures` runs this file for a drive that has more than one section.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import paper_figures as paper
from matplotlib.figure import Figure

from hd_diag.arrays import Floats
from hd_diag.drive import Drive
from hd_diag.report.pictures.canvas import DASHES, INK, SERIES, drawn, sheet, titled

_FREE = 40.0  # backlash above which a tooth counts as free [µm]
_BELOW = 2.0  # room under the least backlash [µm]
_PLACES = ("bottom", "middle", "open_end")


@dataclass(frozen=True)
class AlongWidth:
    """Backlash and load of the teeth near the long axis, section by section, at one moment.

    Attributes
    ----------
    place : ndarray, shape (sections,)
        From the middle of the teeth, positive towards the cup's open end [m].
    tooth : ndarray, shape (teeth,)
        From the long axis, positive to the right.
    backlash, load : ndarray, shape (sections, teeth)
        Lesser of both flanks without torque [m]; sum of both at `torque`, over the section's share of the
        width [N/m].
    eccentricity, torque : float
        [m], [N m]
    """

    place: Floats
    tooth: Floats
    backlash: Floats
    load: Floats
    eccentricity: float
    torque: float


def figures(drive: Drive, study: paper.Study = paper.PAPER) -> list[paper.Drawn]:
    """A figure of all sections, then the paper's figures for the middle section and both end sections."""
    found = along_width(drive, study)
    title = f"Backlash and load by section at {found.eccentricity * 1e6:.1f} µm and {found.torque:g} N m"
    whole = paper.Drawn("sections", title, sections_picture(found), (), _data(found))
    last = found.place.size - 1
    # With two sections there is no middle one.
    numbers = (
        {0: _PLACES[0], last // 2: _PLACES[1], last: _PLACES[2]} if last > 1 else {0: "bottom", 1: "open_end"}
    )
    shown = [whole]
    for number, where in numbers.items():
        told = f"{where.replace('_', ' ')} of the width, z = {_signed(found.place[number] * 1e3)} mm"
        for each in paper.figures(drive, study._replace(section=number)):
            shown.append(each._replace(name=f"{each.name}_{where}", title=f"{each.title}: {told}"))
    return shown


def along_width(drive: Drive, study: paper.Study = paper.PAPER) -> AlongWidth:
    """All sections at the paper's moment, for the largest eccentricity of a study."""
    size, torque, tooth = float(study.sizes[-1]), study.torque or drive.rated_torque, paper.engaged(drive)
    towards = size * np.exp(1j * study.direction)
    free, loaded = (paper.moment(drive, towards, each) for each in (0.0, torque))
    geometry = drive.mesh.geometry
    widths = geometry.face_width * geometry.section_weights
    backlash = np.fmin(*np.moveaxis(free.section_backlash[0], 1, 0))[:, tooth]
    load = loaded.section_load[0].sum(axis=1)[:, tooth] / widths[:, None]
    return AlongWidth(geometry.section_places, tooth.astype(np.float64), backlash, load, size, torque)


def _data(found: AlongWidth) -> dict[str, Floats]:
    columns = {"tooth": found.tooth}
    for name, unit, rows in (("backlash", "m", found.backlash), ("load per width", "N/m", found.load)):
        columns |= {
            f"{name} at z = {z * 1e3:.4g} mm [{unit}]": row for z, row in zip(found.place, rows, strict=True)
        }
    return columns


def _signed(value: float) -> str:
    return f"{value:.2f}".replace("-", "−")


@drawn
def sections_picture(found: AlongWidth) -> Figure:
    """Backlash above, load below; of many sections only as many as there are colours."""
    figure, (top, bottom) = sheet(5.4, 2, sharex=True)
    shown = np.unique(np.linspace(0, found.place.size - 1, len(SERIES)).round().astype(np.int64))
    for colour, dashes, number in zip(SERIES, DASHES, shown.tolist(), strict=False):
        style, label = {"color": colour, "ls": dashes}, f"{_signed(found.place[number] * 1e3)} mm"
        top.plot(found.tooth, found.backlash[number] * 1e6, label=label, **style)
        bottom.plot(found.tooth, found.load[number] * 1e-3, **style)
    top.axhline(0.0, color=INK, lw=0.7)
    top.set_ylim(min(0.0, float(np.nanmin(found.backlash)) * 1e6) - _BELOW, _FREE)
    titled(top, "Backlash [µm], in sections towards the open end at")
    bottom.set_title(f"Their load at {found.torque:g} N m, per width [N/mm]")
    bottom.set_xlabel("Tooth, from the long axis; right: towards the eccentricity")
    bottom.set_xlim(float(found.tooth[0]), float(found.tooth[-1]))
    return figure
