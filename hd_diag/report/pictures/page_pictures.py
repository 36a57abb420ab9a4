"""The pictures of a report as SVG, each with its title, caption and text alternative."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from matplotlib.figure import Figure

from hd_diag.report import captions
from hd_diag.report.facts import JointReport, Judgement
from hd_diag.report.pictures import comparison
from hd_diag.report.pictures.markup import inline_svg
from hd_diag.report.pictures.model_ladder import model_ladder
from hd_diag.report.pictures.teeth import around_the_gear, tooth_maps
from hd_diag.report.pictures.torsion_curve import torsion_curve

_Drawing = tuple[str, str, Figure, str]  # name, title, figure, caption


class Picture(NamedTuple):
    """A figure of the page: its markup, made here and from numbers alone, and its caption."""

    svg: str
    caption: str


def pictures(report: JointReport, number: int) -> dict[str, Picture]:
    """All pictures of a joint by name.

    Parameters
    ----------
    report : JointReport
    number : int
        Of the joint on the page, for ids of its own.

    Returns
    -------
    dict of str to Picture
    """
    return {
        name: Picture(inline_svg(figure, f"joint{number}-{name}", title, caption), caption)
        for name, title, figure, caption in _drawings(report)
    }


def _drawings(report: JointReport) -> Iterator[_Drawing]:
    judged, teeth = report.judgement is not None, report.teeth
    if report.judgement is not None:
        yield from _comparisons(report.judgement)
    yield "torsion", "Torsion curve", torsion_curve(report.torsion, judged), captions.torsion(report)
    yield "maps", "Backlash and load of every tooth", tooth_maps(teeth), captions.maps(report)
    yield "around", "Around the gear", around_the_gear(teeth), captions.around(teeth)


def _comparisons(found: Judgement) -> Iterator[_Drawing]:
    title, caption = "Measured against simulated over", captions.over_angle(found.over_angle)
    yield "angle", f"{title} the wave generator's angle", comparison.over_angle(found.over_angle), caption
    caption = captions.over_torque(found.over_torque)
    yield "torque", f"{title} torque", comparison.over_torque(found.over_torque), caption
    marks = [mark.order for mark in found.marks]
    spectra = comparison.orders(found.orders, marks, found.highest_order)
    yield "orders", "Order spectrum", spectra, captions.orders(found)
    if found.ladder and found.rms is not None:
        rungs = model_ladder(found.ladder, found.rms)
        yield "ladder", "Ladder of models", rungs, captions.ladder(found)
    caption = captions.over_time(found.over_time)
    yield "time", "The record over time", comparison.over_time(found.over_time), caption
