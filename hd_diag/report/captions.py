"""Captions and text alternatives: what each picture of a report shows, with its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.diagnosis.search.detectability import Detectability
from hd_diag.diagnosis.search.unexplained import Unexplained
from hd_diag.formatting import ARCSEC, arcsec, direction, number, percent, percents, rounded, si, size, words
from hd_diag.report.binned import HIGH, LOW
from hd_diag.report.facts import Fact, JointReport, Judgement
from hd_diag.report.ladder import Rung
from hd_diag.report.stages import EXTENDED, BinnedResiduals, OverTime
from hd_diag.report.teeth import Extremes, TeethOverTurn
from hd_diag.report.torsion import Stiffness, k_shown

_SPREAD = f"bands from the {100 * LOW:.0f} % to the {100 * HIGH:.0f} % quantile"


def held_out(found: Judgement) -> list[tuple[str, str]]:
    """What the models leave of data that no fit saw: name and rms; empty where nothing was held out."""
    rms, gain = found.diagnosis.rms, found.diagnosis.gain
    if rms is None or gain is None:
        return []
    extended = [("extended by the causes", arcsec(rms.extended))] if EXTENDED in found.orders else []
    return [
        ("model as configured", arcsec(rms.nominal)),
        ("its parameters refitted", arcsec(rms.refit)),
        *extended,
        ("noise floor", arcsec(rms.noise)),
        (
            "explained of the mean square",
            f"{percent(gain.fraction)} ({percents(gain.low, gain.high)})",
        ),
    ]


def over_angle(found: BinnedResiduals) -> str:
    """Caption of the comparison over the wave generator's angle."""
    low, high = (number(torque) for torque in found.torques)
    ripple = _each({name: _ripple(mean) for name, mean in found.simulated.items()})
    return (
        f"Over a turn of the wave generator, at torques from {low} to {high} N m ({found.samples} samples): "
        f"means in bins of {360 // found.measured.center.size}°, {_SPREAD}. The drive's mean at "
        "the same torque is taken off. Ripple of the means, peak to peak: measured "
        f"{_ripple(found.measured.mean)}, {ripple}. Greatest mean residual: {_worst(found)}."
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


def _ripple(mean: Floats) -> str:
    return arcsec(float(np.nanmax(mean) - np.nanmin(mean))) if np.isfinite(mean).any() else "–"


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
    interval = percents(rung.gain_low, rung.gain_high)
    return f"{percent(rung.gain)} ({interval})" if math.isfinite(rung.gain) else "–"


def tested(tests: Sequence[Detectability]) -> list[Fact]:
    """Causes that were tested, with the least size that would have been found."""
    return [
        Fact(words(test.name), f"{arcsec(test.least_size)} rms{', found' * (test.reason == 'found')}")
        for test in tests
        if test.testable
    ]


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
    return title, si(value, std, unit), size(configured, unit)


def torsion(report: JointReport) -> str:
    """Caption of the torsion curve."""
    found = report.torsion
    marks = "Means while the torque rises and falls; their distance is the hysteresis. "
    return (
        f"Torsion curve up to {number(float(found.torque[-1]))} N m, averaged over the angle; the band is "
        f"the {report.best} drive's least and greatest over a turn. {marks if found.measured else ''}"
    )


def stiffness(report: JointReport) -> list[tuple[str, ...]]:
    """Titles, then K1, K2 and K3 [10⁴ N m/rad] with their ranges; without a judgement as simulated alone."""
    rows = [("Range", "Measured", "Fitted" if report.judgement else "Simulated", "Configured")]
    for entry in report.torsion.stiffness:
        name = f"{entry.name}, {rounded(entry.low):g} to {rounded(entry.high):g} N m"
        rows.append((name, _measured(entry), k_shown(entry.fitted), k_shown(entry.configured)))
    return [row if report.judgement else (row[0], row[2]) for row in rows]


def _measured(entry: Stiffness) -> str:
    if not math.isfinite(entry.measured):
        return "not measured"
    ends = f"{k_shown(entry.measured_low)} to {k_shown(entry.measured_high)}"
    return f"{k_shown(entry.measured)} ({ends})"


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


def extremes(found: Extremes) -> list[Fact]:
    """What the record's own moments did to the teeth."""
    overlap = Fact("Greatest overlap of the lobes", size(found.overlap, "m"))
    free = Fact("Least clearance of the lobes", size(-found.overlap, "m"))
    return [
        Fact("Least backlash of a tooth", size(found.least_backlash, "m")),
        Fact("Greatest force on a tooth", f"{number(found.greatest_load)} N"),
        Fact("Loaded flanks", f"{found.fewest_pairs} to {found.most_pairs}"),
        overlap if found.overlap > 0.0 else free,
    ]


def around(found: TeethOverTurn) -> str:
    """Caption of the dials."""
    load = found.load[found.moment]
    tooth = int(np.argmax(load))
    angle, where = np.degrees((found.input_angle[found.moment], found.tooth_direction[tooth]))
    displaced = (
        f"The arrow is the wave generator's displacement, {size(found.displacement, 'm')} at "
        f"{round(math.degrees(found.eccentricity)) % 360}°. "
        if found.displacement > 0.0
        else "The wave generator is not displaced. "
    )
    return (
        f"Around the gear at {number(found.torque)} N m, directions from slot 0: at input angle "
        f"{angle:.0f}° tooth {tooth} bears most, {number(float(load[tooth]))} N at "
        f"{where:.0f}°. {displaced}Dashed: the long axis."
    )
