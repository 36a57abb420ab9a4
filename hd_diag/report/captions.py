"""Captions and text alternatives: what each picture of a report shows, with its numbers."""

from __future__ import annotations

import math

import numpy as np

from hd_diag.diagnosis.search.detectability import Testability
from hd_diag.formatting import arcsec, number, si
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.report.binned import HIGH, LOW, Band
from hd_diag.report.facts import Held, JointReport, Judgement
from hd_diag.report.ladder import Rung
from hd_diag.report.stages import Comparison
from hd_diag.report.teeth import Done, Teeth
from hd_diag.report.torsion import Stiffness

_SPREAD = f"bands from the {100 * LOW:.0f} % to the {100 * HIGH:.0f} % quantile"


def over_angle(found: Comparison) -> str:
    """Caption of the comparison over the wave generator's angle."""
    low, high = (number(torque) for torque in found.torques)
    return (
        f"Over a turn of the wave generator, at torques from {low} to {high} N m ({found.samples} samples): "
        f"means in bins of {360 // found.measured.center.size}°, {_SPREAD}. The drive's mean at "
        "the same torque is taken off. Ripple of the means, peak to peak: measured "
        f"{_ripple(found.measured.mean)}, "
        f"{_each({name: _ripple(mean) for name, mean in found.simulated.items()})}. Greatest mean left: "
        f"{_each(_worst(found))}."
    )


def over_torque(found: Comparison) -> str:
    """Caption of the comparison over torque."""
    return (
        f"Over torque, all {found.samples} samples: means in {found.measured.center.size} bins, {_SPREAD}. "
        f"Greatest mean left: {_each(_worst(found))}."
    )


def _ripple(mean: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    return arcsec(float(np.nanmax(mean) - np.nanmin(mean))) if np.isfinite(mean).any() else "–"


def _worst(found: Comparison) -> dict[str, str]:
    return {name: arcsec(_greatest(band)) for name, band in found.residual.items()}


def _greatest(band: Band) -> float:
    known = np.abs(band.mean[np.isfinite(band.mean)])
    return float(known.max()) if known.size else math.nan


def _each(told: dict[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in told.items())


def orders(found: Judgement) -> str:
    """Caption of the order spectrum."""
    peaks = {
        name: f"{arcsec(float(amplitude.max()))} at order {order[np.argmax(amplitude)]:.2f}"
        for name, (order, amplitude) in found.orders.items()
    }
    return f"Order spectrum of what is left, every peak kept. Highest: {_each(peaks)}."


def named_orders(found: Judgement) -> str:
    """The marks of the order spectrum, for those who see no table."""
    return "; ".join(
        f"mark {at}: order {mark.order:.2f}, {mark.name}, {arcsec(mark.amplitude)}"
        for at, mark in enumerate(found.marks, start=1)
    )


def torsion(report: JointReport) -> str:
    """Caption of the torsion curve."""
    found = report.torsion
    told = "; ".join(_stiffness(entry, report.judgement is not None) for entry in found.stiffness)
    marks = (
        "Means while the torque rises and falls; their distance is the hysteresis. " if found.rising else ""
    )
    return (
        f"Torsion curve, averaged over the angle; the band is the {report.best} drive's least and greatest "
        f"over a turn. {marks}Stiffness in 10⁴ N m/rad: {told}."
    )


def _stiffness(entry: Stiffness, judged: bool) -> str:
    scale, parts = 1e-4, []
    if math.isfinite(entry.measured):
        ends = f"{entry.measured_low * scale:.2f} to {entry.measured_high * scale:.2f}"
        parts.append(f"measured {entry.measured * scale:.2f} ({ends})")
    elif judged:
        parts.append("not measured")
    parts.append(f"{'fitted' if judged else 'simulated'} {entry.fitted * scale:.2f}")
    if judged:
        parts.append(f"configured {entry.configured * scale:.2f}")
    return f"{entry.name} ({number(entry.low)} to {number(entry.high)} N m) {', '.join(parts)}"


def ladder(found: Judgement) -> str:
    """Caption of the ladder of models."""
    return (
        f"Rms of {found.stretches} stretches, each predicted by a fit to the others, with 95 % intervals. "
        + _floor(found.held)
    )


def rungs(found: Judgement) -> str:
    """The ladder's numbers, for those who see no table."""
    return "; ".join(f"{rung.name} {arcsec(rung.rms)}, explained {gain(rung)}" for rung in found.ladder)


def left(rung: Rung) -> str:
    """What a rung leaves, with its interval [arcsec]."""
    value, low, high = (f"{angle / ARCSEC:.2f}" for angle in (rung.rms, rung.low, rung.high))
    return f"{value} ({low} to {high})"


def gain(rung: Rung) -> str:
    """How much a rung explains of what the one before left."""
    if not math.isfinite(rung.gain):
        return "–"
    return f"{_percent(rung.gain)} ({_percent(rung.gain_low)} to {_percent(rung.gain_high)})"


def least_size(test: Testability) -> str:
    """The least size that would have been found."""
    return f"{arcsec(test.least_size)} rms" if math.isfinite(test.least_size) else "–"


def _floor(held: Held | None) -> str:
    if held is None:
        return ""
    return (
        f"Diamonds: the data that were never fitted ({held.told}), the last model as the node runs it. "
        f"Noise floor {arcsec(held.noise)} ({arcsec(held.noise_low)} to {arcsec(held.noise_high)})."
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %".replace("-", "−")


def maps(found: Teeth, report: JointReport) -> str:
    """Caption of the tooth maps."""
    seen = float(np.mean(found.visited))
    where = (
        "The record was at every angle."
        if seen == 1.0
        else (f"The record was at {100.0 * seen:.0f} % of the angles; the others are marked under the maps.")
    )
    return (
        f"Teeth of the {report.best} drive over a turn of the input, the load at {number(found.torque)} N "
        "m, which the record hardly exceeds: least backlash "
        f"{si(float(np.nanmin(found.backlash)), math.nan, 'm')}, greatest load "
        f"{number(float(found.load.max()))} N. {where} {_done(report.done)}"
    )


def _done(found: Done) -> str:
    pressed = f"the lobes press against each other by up to {si(found.overlap, math.nan, 'm')}"
    free = (
        f"the lobes never press against each other; {si(-found.overlap, math.nan, 'm')} of clearance are left"
    )
    return (
        f"At {found.moments} of the record's own moments: least backlash "
        f"{si(found.least_backlash, math.nan, 'm')}, greatest force {number(found.greatest_load)} N, "
        f"{found.fewest_pairs} to {found.most_pairs} loaded flanks; "
        f"{pressed if found.overlap > 0.0 else free}."
    )


def around(found: Teeth) -> str:
    """Caption of the dials."""
    angle = math.degrees(float(found.input_angle[found.moment]))
    at = int(np.argmax(found.load[found.moment]))
    where = math.degrees(float(found.tooth_direction[at]))
    displaced = (
        f"The arrow is the wave generator's displacement, {si(found.displacement, math.nan, 'm')} at "
        f"{math.degrees(found.eccentricity % math.tau):.0f}°. "
        if found.displacement > 0.0
        else "The wave generator is not displaced. "
    )
    return (
        f"Around the gear at {number(found.torque)} N m, directions from slot 0: at input angle "
        f"{angle:.0f}° tooth {at} bears most, {number(float(found.load[found.moment, at]))} N at "
        f"{where:.0f}°. {displaced}Dashed: the long axis."
    )


def over_time(found: Judgement) -> str:
    """Caption of the record over time."""
    ends = {
        name: f"{arcsec(float(np.nanmin(column.low)))} to {arcsec(float(np.nanmax(column.high)))}"
        for name, column in found.over_time.items()
        if name not in ("torque", "speed")
    }
    stretches = found.over_time["torque"].place.size
    return f"The record over time, least to greatest of {stretches} stretches. What is left: {_each(ends)}."
