"""The pictures of a report as SVG, each with its title, caption and text alternative."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from hd_diag.report import captions
from hd_diag.report.facts import Held, JointReport, Judgement
from hd_diag.report.ladder import Rung
from hd_diag.report.pictures.against_model import over_angle, over_torque
from hd_diag.report.pictures.around_the_gear import around_the_gear
from hd_diag.report.pictures.markup import inline_svg
from hd_diag.report.pictures.model_ladder import model_ladder
from hd_diag.report.pictures.record_over_time import record_over_time
from hd_diag.report.pictures.residual_orders import residual_orders
from hd_diag.report.pictures.tooth_maps import tooth_maps
from hd_diag.report.pictures.torsion_curve import torsion_curve
from hd_diag.report.teeth import Teeth


class Picture(NamedTuple):
    """A figure of the page: its markup, made here and from numbers alone, and its caption."""

    svg: str
    caption: str


def drawn(report: JointReport, number: int) -> dict[str, Picture]:
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
    result = {}
    for name, title, figure, told, more in _all(report):
        svg = inline_svg(figure, f"joint{number}-{name}", title, f"{told} {more}".strip())
        result[name] = Picture(svg, told)
    return result


def _all(report: JointReport) -> Iterator[tuple[str, str, Figure, str, str]]:
    """Name, title, figure, caption, and what a table says beside it."""
    if report.judgement is not None:
        yield from _judged(report.judgement)
    yield "torsion", "Torsion curve", _torsion(report), captions.torsion(report), ""
    teeth = report.teeth
    maps = tooth_maps(teeth.input_angle, teeth.backlash, teeth.load, teeth.visited)
    yield "maps", "Backlash and load of every tooth", maps, captions.maps(teeth, report), ""
    yield "around", "Around the gear", _around(teeth), captions.around(teeth), ""


def _judged(found: Judgement) -> Iterator[tuple[str, str, Figure, str, str]]:
    angle, torque = found.over_angle, found.over_torque
    title = "Measured against simulated over the wave generator's angle"
    drawing = over_angle(angle.measured, angle.simulated, angle.residual)
    yield "angle", title, drawing, captions.over_angle(angle), ""
    title = "Measured against simulated over torque"
    drawing = over_torque(torque.measured, torque.simulated, torque.residual)
    yield "torque", title, drawing, captions.over_torque(torque), ""
    drawing = residual_orders(found.orders, [mark.order for mark in found.marks], found.highest_order)
    yield "orders", "Order spectrum", drawing, captions.orders(found), captions.named_orders(found)
    if found.ladder and found.held is not None:
        drawing = _ladder(found.ladder, found.held)
        yield "ladder", "Ladder of models", drawing, captions.ladder(found), captions.rungs(found)
    left = {name: column for name, column in found.over_time.items() if name not in ("torque", "speed")}
    drawing = record_over_time(found.over_time["torque"], found.over_time["speed"], left)
    yield "time", "The record over time", drawing, captions.over_time(found), ""


def _ladder(rungs: Sequence[Rung], held: Held) -> Figure:
    columns = [np.array([getattr(rung, name) for rung in rungs]) for name in ("rms", "low", "high")]
    marks = ((0, held.nominal), (1, held.refit), (len(rungs) - 1, held.extended))
    floor = (held.noise, held.noise_low, held.noise_high)
    names = [rung.name for rung in rungs]
    return model_ladder(names, columns[0], columns[1], columns[2], marks[: len(rungs)], floor)


def _torsion(report: JointReport) -> Figure:
    found = report.torsion
    before = None if report.judgement is None else found.configured
    both = None if found.rising is None or found.falling is None else (found.rising, found.falling)
    stiffness = [
        (entry.name, entry.low, entry.high, entry.fitted if both is None else entry.measured)
        for entry in found.stiffness
    ]
    spread = (found.low, found.high)
    return torsion_curve(found.torque, before, found.fitted, spread, both, found.extended, stiffness)


def _around(found: Teeth) -> Figure:
    at = found.moment
    return around_the_gear(
        found.tooth_direction,
        found.backlash[at],
        found.load[at],
        found.direction,
        found.least_backlash,
        found.greatest_load,
        found.long_axis,
        found.eccentricity if found.displacement > 0.0 else None,
    )
