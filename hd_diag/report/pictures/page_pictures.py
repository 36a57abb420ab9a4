"""The pictures of a report as SVG, each with its title, caption and text alternative."""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import Figure

from hd_diag.report import captions
from hd_diag.report.facts import JointReport, Judgement
from hd_diag.report.pictures import comparison
from hd_diag.report.pictures.markup import inline_svg
from hd_diag.report.pictures.teeth import around_the_gear, tooth_maps

_Drawing = tuple[str, str, Figure, str]  # name, title, figure, caption


def pictures(report: JointReport, number: int) -> dict[str, dict[str, str]]:
    """Markup, made here and from numbers alone, and caption of the pictures of a page's joint by name."""
    return {
        name: {"svg": inline_svg(figure, f"joint{number}-{name}", title, caption), "caption": caption}
        for name, title, figure, caption in _drawings(report)
    }


def _drawings(report: JointReport) -> Iterator[_Drawing]:
    judged, teeth = report.judgement is not None, report.teeth
    if report.judgement is not None:
        yield from _comparisons(report.judgement)
    if report.ripple is not None:
        lines = report.ripple
        yield "ripple", "Ripple of the torque", comparison.ripple(lines), captions.ripple(lines)
    curve = comparison.torsion_curve(report.torsion, judged)
    yield "torsion", "Torsion curve", curve, captions.torsion(report)
    yield "maps", "Backlash and load of every tooth", tooth_maps(teeth), captions.maps(report)
    yield "around", "Around the gear", around_the_gear(teeth), captions.around(teeth)


def _comparisons(found: Judgement) -> Iterator[_Drawing]:
    title, angle, torque = "Measured against simulated over", found.over_angle, found.over_torque
    drawn = comparison.over_angle(angle)
    yield "angle", f"{title} the wave generator's angle", drawn, captions.over_angle(angle)
    yield "torque", f"{title} torque", comparison.over_torque(torque), captions.over_torque(torque)
    drawn = comparison.orders(found.orders, [mark.order for mark in found.marks], found.highest_order)
    yield "orders", "Order spectrum", drawn, captions.orders(found)
    if found.ladder and found.diagnosis.rms is not None:
        drawn = comparison.model_ladder(found.ladder, found.diagnosis.rms)
        yield "ladder", "Ladder of models", drawn, captions.ladder(found)
    drawn = comparison.over_time(found.over_time)
    yield "time", "The record over time", drawn, captions.over_time(found.over_time)
