"""The pictures of a report, each with a title and a caption that gives its numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hd_diag.diagnosis.calibration import NAMED, ODDS
from hd_diag.formatting import arcsec, number, percent, size
from hd_diag.report.facts import JointReport, Judgement
from hd_diag.report.pictures import comparison
from hd_diag.report.pictures.teeth import around_the_gear, tooth_maps
from hd_diag.report.stages import HIGH, LOW, BinnedResiduals

_SPREAD = f"bands from the {100 * LOW:.0f} % to the {100 * HIGH:.0f} % quantile"
_AGAINST = "Measured against simulated over"

_Drawing = tuple[str, str, Any, str]  # name, title, figure, caption (also the alternative text)


def drawings(report: JointReport) -> Iterator[_Drawing]:
    """Name, title, figure and caption of every picture of a joint."""
    if report.judgement is not None:
        yield from _comparisons(report.judgement)
    if (found := report.ripple) is not None:
        caption = (
            f"Mean over {found.windows} stretches of {found.turns / found.windows:g} turns of the wave "
            f"generator in {found.runs} runs; gravity, friction and inertia are taken off as smooth parts. "
            "Dotted: the gear's orders. A strong line has images of itself at either side."
        )
        yield "ripple", "Ripple of the torque", comparison.ripple(found), caption
    yield from _of_the_model(report)


def _comparisons(found: Judgement) -> Iterator[_Drawing]:
    angle, torque, time, rms = found.over_angle, found.over_torque, found.over_time, found.diagnosis.rms
    low, high = (number(each) for each in angle.torques)
    means = {"measured": angle.measured.mean, **angle.simulated}
    ripple = {
        name: arcsec(float(np.nanmax(mean) - np.nanmin(mean))) if np.isfinite(mean).any() else "–"
        for name, mean in means.items()
    }
    caption = (
        f"Over a turn of the wave generator, at torques from {low} to {high} N m ({angle.samples} samples): "
        f"means in bins of {360 // angle.measured.center.size}°, {_SPREAD}. The drive's mean at "
        f"the same torque is taken off. Ripple of the means, peak to peak: {_each(ripple)}. {_worst(angle)}"
    )
    drawn = comparison.binned(angle, by_torque=False)
    yield "angle", f"{_AGAINST} the wave generator's angle", drawn, caption
    bins = f"means in {torque.measured.center.size} bins, {_SPREAD}"
    caption = f"Over torque, all {torque.samples} samples: {bins}. {_worst(torque)}"
    yield "torque", f"{_AGAINST} torque", comparison.binned(torque, by_torque=True), caption
    peaks = {
        name: f"{arcsec(float(amplitude.max()))} at order {order[np.argmax(amplitude)]:.2f}"
        for name, (order, amplitude) in found.orders.items()
    }
    caption = f"Order spectrum of the residual, every peak kept. Highest: {_each(peaks)}."
    drawn = comparison.orders(found.orders, [mark.order for mark in found.marks], found.highest_order)
    yield "orders", "Order spectrum", drawn, caption
    if found.ladder and rms is not None and found.diagnosis.gain is not None:
        floor, low, high = map(arcsec, (rms.noise, rms.noise_low, rms.noise_high))
        caption = (
            f"Rms of {found.stretches} stretches, each predicted by a fit to the others, with 95 % "
            f"intervals. Diamonds: the data that were never fitted ({found.diagnosis.gain.held_out}), the "
            f"last model as the node runs it. Noise floor {floor} ({low} to {high})."
        )
        yield "ladder", "Ladder of models", comparison.model_ladder(found.ladder, rms), caption
    if found.weighed:
        caption = (
            "How much less probable the record is with nothing, or with another cause, in the place of each "
            "that was found, all else settled again: the natural logarithm of the odds, "
            f"{ODDS:.1f} for {100.0 * NAMED:.0f} %."
        )
        yield "evidence", "Evidence of the causes", comparison.evidence(found.weighed), caption
    if found.remainders:
        largest = {one.name: arcsec(float(np.abs(one.part).max())) for one in found.remainders}
        caption = (
            "What no cause explains, as functions that are fitted with them; none is named as a cause. "
            f"Greatest: {_each(largest)}."
        )
        yield "remainders", "What is slow and unexplained", comparison.remainders(found.remainders), caption
    ends = {
        name: f"{arcsec(float(np.nanmin(column.low)))} to {arcsec(float(np.nanmax(column.high)))}"
        for name, column in time.residual.items()
    }
    stretches = f"least to greatest of {time.torque.center.size} stretches"
    caption = f"The record over time, {stretches}. Residual: {_each(ends)}."
    yield "time", "The record over time", comparison.over_time(time), caption


def _worst(found: BinnedResiduals) -> str:
    means = {name: np.abs(band.mean[np.isfinite(band.mean)]) for name, band in found.residual.items()}
    worst = {name: arcsec(float(mean.max(initial=-math.inf))) for name, mean in means.items()}
    return f"Greatest mean residual: {_each(worst)}."


def _each(values: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())


def _of_the_model(report: JointReport) -> Iterator[_Drawing]:
    curve, teeth, best = report.torsion, report.teeth, report.best
    marks = "Means while the torque rises and falls; their distance is the hysteresis. "
    caption = (
        f"Torsion curve up to {number(float(curve.torque[-1]))} N m, averaged over the angle; the band is "
        f"the {best} drive's least and greatest over a turn. {marks if curve.measured else ''}"
    )
    drawn = comparison.torsion_curve(curve, report.judgement is not None)
    yield "torsion", "Torsion curve", drawn, caption
    seen, where = float(np.mean(teeth.visited)), "The record was at every angle."
    if seen < 1.0:
        where = f"The record was at {percent(seen, 0)} of the angles; the others are marked under the maps."
    caption = (
        f"Teeth of the {best} drive over a turn of the input, the load at {number(teeth.torque)} N "
        f"m, which the record hardly exceeds: least backlash {size(np.nanmin(teeth.backlash), 'm')}, "
        f"greatest load {number(float(teeth.load.max()))} N. {where}"
    )
    yield "maps", "Backlash and load of every tooth", tooth_maps(teeth), caption
    load = teeth.load[teeth.moment]
    tooth = int(np.argmax(load))
    at, towards = np.degrees((teeth.input_angle[teeth.moment], teeth.tooth_direction[tooth]))
    displaced = "The wave generator is not displaced. "
    if teeth.displacement > 0.0:
        turned = round(math.degrees(teeth.eccentricity)) % 360
        displacement = size(teeth.displacement, "m")
        displaced = f"The arrow is the wave generator's displacement, {displacement} at {turned}°. "
    caption = (
        f"Around the gear at {number(teeth.torque)} N m, directions from slot 0: at input angle "
        f"{at:.0f}° tooth {tooth} bears most, {number(float(load[tooth]))} N at "
        f"{towards:.0f}°. {displaced}Dashed: the long axis."
    )
    yield "around", "Around the gear", around_the_gear(teeth), caption
