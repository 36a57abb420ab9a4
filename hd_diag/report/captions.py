"""Captions and text alternatives: what each picture of a report shows, with its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.diagnosis.search.detectability import Testability
from hd_diag.diagnosis.search.unexplained import Unexplained
from hd_diag.formatting import ARCSEC, arcsec, direction, number, si, words
from hd_diag.report.binned import HIGH, LOW
from hd_diag.report.facts import JointReport, Judgement
from hd_diag.report.ladder import Rung
from hd_diag.report.stages import EXTENDED, Comparison, OverTime
from hd_diag.report.teeth import Extremes, TeethOverTurn
from hd_diag.report.torsion import Stiffness

_SPREAD = f"bands from the {100 * LOW:.0f} % to the {100 * HIGH:.0f} % quantile"


def held_out(found: Judgement) -> str:
    """The gain in two sentences; empty where nothing was held out."""
    rms, gain = found.diagnosis.rms, found.diagnosis.gain
    if rms is None or gain is None:
        return ""
    extended = f", extended by the causes {arcsec(rms.extended)}" if EXTENDED in found.orders else ""
    return (
        f"On data that no fit saw ({gain.held_out}) the residual of the configured model is "
        f"{arcsec(rms.nominal)} rms, refitted {arcsec(rms.refit)}{extended}; the noise floor is "
        f"{arcsec(rms.noise)}. {_percent(gain.fraction)} of the mean square is explained "
        f"({_percent(gain.low)} to {_percent(gain.high)})."
    )


def over_angle(found: Comparison) -> str:
    """Caption of the comparison over the wave generator's angle."""
    low, high = (number(torque) for torque in found.torques)
    ripple = _each({name: _ripple(mean) for name, mean in found.simulated.items()})
    return (
        f"Over a turn of the wave generator, at torques from {low} to {high} N m ({found.samples} samples): "
        f"means in bins of {360 // found.measured.center.size}°, {_SPREAD}. The drive's mean at "
        "the same torque is taken off. Ripple of the means, peak to peak: measured "
        f"{_ripple(found.measured.mean)}, {ripple}. Greatest mean residual: {_worst(found)}."
    )


def over_torque(found: Comparison) -> str:
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


def _ripple(mean: Floats) -> str:
    return arcsec(float(np.nanmax(mean) - np.nanmin(mean))) if np.isfinite(mean).any() else "–"


def _worst(found: Comparison) -> str:
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
    stretches = found.torque.place.size
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


def residual(rung: Rung) -> str:
    """Residual of a rung, with its interval [arcsec]."""
    value, low, high = (f"{angle / ARCSEC:.2f}" for angle in (rung.rms, rung.low, rung.high))
    return f"{value} ({low} to {high})"


def gain(rung: Rung) -> str:
    """How much a rung explains of the residual of the one before."""
    value, low, high = map(_percent, (rung.gain, rung.gain_low, rung.gain_high))
    return f"{value} ({low} to {high})" if math.isfinite(rung.gain) else "–"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %".replace("-", "−")


def least_size(test: Testability) -> str:
    """The least size that would have been found."""
    return f"{arcsec(test.least_size)} rms" if math.isfinite(test.least_size) else "–"


def unexplained(line: Unexplained) -> str:
    """What a part of the residual is: its order, or what it does where it has no period."""
    per = {"input": "per input turn", "output": "per output turn", "time": "Hz"}[line.frame]
    order = f"a part that {line.description}" if line.description else f"{line.order:.2f} {per}"
    return f"{order} {line.where}".strip()


def parameter(name: str, value: float, std: float, unit: str, configured: float) -> tuple[str, str, str]:
    """A fitted parameter: name, value, as configured."""
    title = words(name).replace(".", ", ")
    if name.endswith("direction"):
        period = math.pi if name.startswith("eccentricity") else math.tau
        return title, direction(value, std, period), direction(configured, math.nan, math.tau)
    return title, si(value, std, unit), si(configured, math.nan, unit)


def torsion(report: JointReport) -> str:
    """Caption of the torsion curve."""
    found, judged = report.torsion, report.judgement is not None
    stiffness = "; ".join(_stiffness(entry, judged) for entry in found.stiffness)
    marks = "Means while the torque rises and falls; their distance is the hysteresis. "
    return (
        f"Torsion curve, averaged over the angle; the band is the {report.best} drive's least and greatest "
        f"over a turn. {marks if found.measured else ''}Stiffness in 10⁴ N m/rad: {stiffness}."
    )


def _stiffness(entry: Stiffness, judged: bool) -> str:
    low, value, high = (1e-4 * k for k in (entry.measured_low, entry.measured, entry.measured_high))
    if not judged:
        parts = f"simulated {entry.fitted * 1e-4:.2f}"
    else:
        measured = f"measured {value:.2f} ({low:.2f} to {high:.2f})"
        parts = measured if math.isfinite(value) else "not measured"
        parts += f", fitted {entry.fitted * 1e-4:.2f}, configured {entry.configured * 1e-4:.2f}"
    return f"{entry.name} ({number(entry.low)} to {number(entry.high)} N m) {parts}"


def maps(report: JointReport) -> str:
    """Caption of the tooth maps."""
    found, seen = report.teeth, 100.0 * float(np.mean(report.teeth.visited))
    where = f"The record was at {seen:.0f} % of the angles; the others are marked under the maps."
    return (
        f"Teeth of the {report.best} drive over a turn of the input, the load at {number(found.torque)} N "
        f"m, which the record hardly exceeds: least backlash {_length(np.nanmin(found.backlash))}, "
        f"greatest load {number(float(found.load.max()))} N. "
        f"{'The record was at every angle.' if seen == 100.0 else where} {_extremes(found.extremes)}"
    )


def _extremes(found: Extremes) -> str:
    pressed = f"the lobes press against each other by up to {_length(found.overlap)}"
    free = f"the lobes never press against each other; {_length(-found.overlap)} of clearance are left"
    return (
        f"At {found.moments} of the record's own moments: least backlash {_length(found.least_backlash)}, "
        f"greatest force {number(found.greatest_load)} N, {found.fewest_pairs} to {found.most_pairs} loaded "
        f"flanks; {pressed if found.overlap > 0.0 else free}."
    )


def _length(length: float) -> str:
    return si(float(length), math.nan, "m")


def around(found: TeethOverTurn) -> str:
    """Caption of the dials."""
    load = found.load[found.moment]
    tooth = int(np.argmax(load))
    angle, where = np.degrees((found.input_angle[found.moment], found.tooth_direction[tooth]))
    displaced = (
        f"The arrow is the wave generator's displacement, {_length(found.displacement)} at "
        f"{math.degrees(found.eccentricity % math.tau):.0f}°. "
        if found.displacement > 0.0
        else "The wave generator is not displaced. "
    )
    return (
        f"Around the gear at {number(found.torque)} N m, directions from slot 0: at input angle "
        f"{angle:.0f}° tooth {tooth} bears most, {number(float(load[tooth]))} N at "
        f"{where:.0f}°. {displaced}Dashed: the long axis."
    )
