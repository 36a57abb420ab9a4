"""Captions, which are text alternatives too: what each picture of a report shows, with its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.formatting import arcsec, number, percent, size
from hd_diag.report.facts import JointReport, Judgement
from hd_diag.report.stages import HIGH, LOW, BinnedResiduals, OverTime
from hd_diag.report.teeth import TeethOverTurn

_SPREAD = f"bands from the {100 * LOW:.0f} % to the {100 * HIGH:.0f} % quantile"


def over_angle(found: BinnedResiduals) -> str:
    """Caption of the comparison over the wave generator's angle."""
    low, high = (number(torque) for torque in found.torques)
    means = {"measured": found.measured.mean, **found.simulated}
    ripple = {
        name: arcsec(float(np.nanmax(mean) - np.nanmin(mean))) if np.isfinite(mean).any() else "–"
        for name, mean in means.items()
    }
    return (
        f"Over a turn of the wave generator, at torques from {low} to {high} N m ({found.samples} samples): "
        f"means in bins of {360 // found.measured.center.size}°, {_SPREAD}. The drive's mean at "
        f"the same torque is taken off. Ripple of the means, peak to peak: {_each(ripple)}. "
        f"Greatest mean residual: {_worst(found)}."
    )


def over_torque(found: BinnedResiduals) -> str:
    """Caption of the comparison over torque."""
    return (
        f"Over torque, all {found.samples} samples: means in {found.measured.center.size} bins, {_SPREAD}. "
        f"Greatest mean residual: {_worst(found)}."
    )


def ripple(found: Ripple) -> str:
    """Caption of the torque's lines over position."""
    return (
        f"Mean over {found.windows} stretches of {found.turns / found.windows:g} turns of the wave generator "
        f"in {found.runs} runs; gravity, friction and inertia are taken off as smooth parts. Dotted: the "
        "gear's orders. A strong line has images of itself at either side."
    )


def _worst(found: BinnedResiduals) -> str:
    means = {name: np.abs(band.mean[np.isfinite(band.mean)]) for name, band in found.residual.items()}
    return _each({name: arcsec(float(mean.max(initial=-math.inf))) for name, mean in means.items()})


def _each(values: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())


def orders(found: Judgement) -> str:
    """Caption of the order spectrum."""
    peaks = {
        name: f"{arcsec(float(amplitude.max()))} at order {order[np.argmax(amplitude)]:.2f}"
        for name, (order, amplitude) in found.orders.items()
    }
    return f"Order spectrum of the residual, every peak kept. Highest: {_each(peaks)}."


def over_time(found: OverTime) -> str:
    """Caption of the record over time."""
    ends = {
        name: f"{arcsec(float(np.nanmin(column.low)))} to {arcsec(float(np.nanmax(column.high)))}"
        for name, column in found.residual.items()
    }
    stretches = found.torque.center.size
    return f"The record over time, least to greatest of {stretches} stretches. Residual: {_each(ends)}."


def ladder(found: Judgement) -> str:
    """Caption of the ladder of models."""
    rms, gain = found.diagnosis.rms, found.diagnosis.gain
    assert rms is not None
    assert gain is not None
    floor, low, high = map(arcsec, (rms.noise, rms.noise_low, rms.noise_high))
    return (
        f"Rms of {found.stretches} stretches, each predicted by a fit to the others, with 95 % intervals. "
        f"Diamonds: the data that were never fitted ({gain.held_out}), the last model as the node runs "
        f"it. Noise floor {floor} ({low} to {high})."
    )


def torsion(report: JointReport) -> str:
    """Caption of the torsion curve."""
    found = report.torsion
    marks = "Means while the torque rises and falls; their distance is the hysteresis. "
    return (
        f"Torsion curve up to {number(float(found.torque[-1]))} N m, averaged over the angle; the band is "
        f"the {report.best} drive's least and greatest over a turn. {marks if found.measured else ''}"
    )


def maps(report: JointReport) -> str:
    """Caption of the tooth maps."""
    found, seen = report.teeth, float(np.mean(report.teeth.visited))
    where = f"The record was at {percent(seen, 0)} of the angles; the others are marked under the maps."
    return (
        f"Teeth of the {report.best} drive over a turn of the input, the load at {number(found.torque)} N "
        f"m, which the record hardly exceeds: least backlash {size(np.nanmin(found.backlash), 'm')}, "
        f"greatest load {number(float(found.load.max()))} N. "
        f"{'The record was at every angle.' if seen == 1.0 else where}"
    )


def around(found: TeethOverTurn) -> str:
    """Caption of the dials."""
    load = found.load[found.moment]
    tooth = int(np.argmax(load))
    angle, where = np.degrees((found.input_angle[found.moment], found.tooth_direction[tooth]))
    displaced = "The wave generator is not displaced. "
    if found.displacement > 0.0:
        towards = round(math.degrees(found.eccentricity)) % 360
        of = size(found.displacement, "m")
        displaced = f"The arrow is the wave generator's displacement, {of} at {towards}°. "
    return (
        f"Around the gear at {number(found.torque)} N m, directions from slot 0: at input angle "
        f"{angle:.0f}° tooth {tooth} bears most, {number(float(load[tooth]))} N at "
        f"{where:.0f}°. {displaced}Dashed: the long axis."
    )
