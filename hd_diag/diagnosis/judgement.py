"""What a diagnosis comes to: the kind of answer, its grounds, and how bad the joint is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.gain import MISFIT
from hd_diag.diagnosis.regression import centered, usual_laws
from hd_diag.diagnosis.search.kept_parameters import DISPLACEMENTS, GROUPS, PLAIN, TWO_SIDED
from hd_diag.formatting import ARCSEC, words

Judgement = Literal["as_configured", "parameters", "causes", "described", "misfit", "not_judged"]

_SIGMAS = 3.0  # a parameter this many standard deviations off its configured value is another
_LEAST_SHARE = 0.05  # of the noise, below which what a parameter changes is of no use
_BY_TORQUE = ("tooth_compliance", "cup_compliance")
_MOST_ROWS = 2000
_PEAK_TO_PEAK = 2.0 * math.sqrt(2.0)  # of a wave, over its rms
_STRETCHES = 12  # of a record, whose scatter tells how well its mean square is known

Beside = Literal["within", "near", "beyond", "open"]
"""A value beside its limit: under it, over it, too near to it to tell which, or unknown."""


class Limited(NamedTuple):
    """A quantity with its standard deviation beside its limit, all in `unit`."""

    quantity: str
    value: float
    std: float
    limit: float
    unit: str

    @property
    def within(self) -> bool:
        """Whether the value itself is no more than the limit."""
        return self.value <= self.limit

    @property
    def place(self) -> Beside:
        """Where its 95 % interval is; ``near`` where that holds the limit.

        With an unknown deviation (nan) a value under the limit says nothing, one over it no more than
        ``near``.
        """
        value, limit = self.value, self.limit
        if math.isnan(value) or math.isnan(limit):
            return "open"
        if math.isnan(self.std):
            return "near" if value > limit else "open"
        if value + TWO_SIDED * self.std <= limit:
            return "within"
        return "beyond" if value - TWO_SIDED * self.std > limit else "near"


class Change(NamedTuple):
    """A parameter that is not as configured; `explains` is what it changes in the error [rad rms]."""

    name: str
    value: float
    std: float
    configured: float
    unit: str
    explains: float


@dataclass(frozen=True, eq=False)
class Answer:
    """What a diagnosis comes to, each part computed once."""

    diagnosis: Diagnosis

    @cached_property
    def judgement(self) -> Judgement:
        """Kind of the answer; ``misfit`` goes before all that was fitted."""
        found = self.diagnosis
        if found.rms is None:
            return "not_judged"
        if found.refitted is None:
            return "described" if found.order_table else "not_judged"
        if found.rms.misfit.certain:
            return "misfit"
        if found.causes or any(finding.name == "tooth_skip" for finding in found.findings):
            return "causes"
        if found.order_table or found.unexplained or found.hints:
            return "described"
        return "parameters" if self.changes else "as_configured"

    @property
    def vague(self) -> bool:
        """Whether a displacement that is not plain may be a part of what is left, or undo a cause."""
        left = self.diagnosis.misfit
        return bool(left and left.suspected) or any(map(self.diagnosis.is_undone, self.diagnosis.hints))

    @cached_property
    def changes(self) -> list[Change]:
        """Parameters that are not as configured, the one that changes the error most first.

        No compliance where the torque is a motor's current: only its product with the constant shows. No
        displacement that is not plain where all is vague.
        """
        found = self.diagnosis
        if found.refitted is None or not found.refitted.trustworthy:
            return []
        least = _LEAST_SHARE * found.rms.noise if found.rms else 0.0
        changed = []
        for name, explains in _parameter_sizes(found).items():
            if found.record.by_current and name in _BY_TORQUE:
                continue
            entry = found.parameters[name if name in found.parameters else f"{name}.magnitude"]
            off = abs(entry["value"] - entry["configured"])
            sigmas = math.sqrt(PLAIN) if self.vague and name in DISPLACEMENTS else _SIGMAS
            if off > sigmas * entry["std"] and explains > least:
                number = (entry["value"], entry["std"], entry["configured"], entry["unit"])
                changed.append(Change(name, *number, explains))
        return sorted(changed, key=lambda change: -change.explains)

    @property
    def eccentricity(self) -> float:
        """Its value, found or as configured [m]; nan where nothing is."""
        found = self.diagnosis
        if found.refitted is None or not found.refitted.trustworthy:
            return math.nan
        changed = [change.value for change in self.changes if change.name == "eccentricity"]
        return changed[0] if changed else abs(found.configured.mesh.eccentricity)

    @property
    def tolerance(self) -> Limited | None:
        """The eccentricity beside its limit; None without one. In a misfit its standard deviation is nan."""
        most = self.diagnosis.allowed
        if most is None:
            return None
        known = self.judgement != "misfit"
        std = self.diagnosis.parameters["eccentricity.magnitude"]["std"] if known else math.nan
        return Limited("eccentricity", self.eccentricity, std, most.eccentricity, "m")

    @cached_property
    def normal(self) -> Limited | None:
        """The joint's error beside what its catalogue allows; None where nothing can be said.

        Notes
        -----
        The catalogue measures without load. Here torsion, friction and an offset of every run are taken off
        by a regression that knows no gear, and the noise's variance; the rest counts as one wave of that rms.
        The scatter of its mean square over stretches of the record gives the standard deviation, with that
        of the noise. Without a measured torque a rest that is too large may be torsion: nothing is said.
        """
        found, record = self.diagnosis, self.diagnosis.record
        if any(finding.fatal for finding in found.findings):
            return None
        error = record.output_angle - record.input_angle / found.configured.kinematics.ratio
        laws = [centered(law, record.run) for law in usual_laws(record, found.configured.rated_torque)]
        matrix, target = np.stack(laws, axis=1), centered(error, record.run)
        rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        noise, noise_spread = _noise(found)
        own = max(float(np.mean(rest**2)) - noise, 0.0)
        stretches = [float(np.mean(part**2)) for part in np.array_split(rest, _STRETCHES)]
        spread = math.hypot(float(np.std(stretches, ddof=1)) / math.sqrt(_STRETCHES), noise_spread)
        # d sqrt(x) = dx / (2 sqrt(x)), and no more than sqrt(dx) where x vanishes.
        std = min(spread / (2.0 * math.sqrt(own)), math.sqrt(spread)) if own > 0.0 else math.sqrt(spread)
        sizes = _PEAK_TO_PEAK * math.sqrt(own), _PEAK_TO_PEAK * std
        limited = Limited("transmission_error", *sizes, found.configured.accuracy, "rad")
        return limited if record.has_torque or limited.within else None

    @property
    def evidence(self) -> dict[str, Any]:
        """Numbers that the judgement stands on."""
        found = self.diagnosis
        return {
            "residual_over_noise": found.misfit.value if found.misfit else math.nan,
            "misfit_above": MISFIT,
            "fraction_explained": found.gain.fraction if found.gain else math.nan,
            "changed": {change.name: change.explains for change in self.changes},
            "causes": {cause.effect.name: cause.gain for cause in found.causes},
            "described": len(found.order_table),
            "unexplained": len(found.unexplained),
        }


def _parameter_sizes(diagnosis: Diagnosis) -> dict[str, float]:
    """How much the refitted drive's error changes where a group of parameters is as configured [rad rms]."""
    configured, refitted = diagnosis.configured, diagnosis.refitted
    assert refitted is not None
    record = diagnosis.record.select(usable(diagnosis.record)).thinned(_MOST_ROWS)
    as_configured = fit_parameters.vector(configured, configured)

    def error(parameters: np.ndarray) -> np.ndarray:
        drive = fit_parameters.drive_of(parameters, configured)
        return fit_parameters.along(drive, configured, record.input_angle, record.torque)[0]

    whole, sizes = error(refitted.parameters), {}
    for name, numbers in GROUPS.items():
        without = refitted.parameters.copy()
        without[list(numbers)] = as_configured[list(numbers)]
        sizes[name] = float(np.nanstd(whole - error(without)))
    return sizes


def _noise(diagnosis: Diagnosis) -> tuple[float, float]:
    """Mean square of the noise and its standard deviation [rad²]; zero where it is unknown."""
    if diagnosis.rms is None or not math.isfinite(diagnosis.rms.noise):
        return 0.0, 0.0
    low, high = diagnosis.rms.noise_low, diagnosis.rms.noise_high
    return diagnosis.rms.noise**2, float(np.nan_to_num((high**2 - low**2) / (2.0 * TWO_SIDED)))


def first_words(answer: Answer) -> str:
    """What the verdict begins with: whether the model describes the record, and how bad the joint is."""
    fatal = [finding for finding in answer.diagnosis.findings if finding.fatal]
    return f"First of all: {fatal[0].text}" if fatal else "; ".join([*_misfit(answer), *_severity(answer)])


def _misfit(answer: Answer) -> list[str]:
    left = answer.diagnosis.misfit
    if left is None or not left.suspected or (left.measured and not left.certain):
        return []
    if not left.certain:
        return [
            "whether the model describes this record cannot be determined: "
            f"{left.low:.1f} to {left.value:.1f} times the noise is left, "
            "and too little of the motion repeats to tell"
        ]
    text = "the model does not describe this record"
    if not answer.diagnosis.record.has_torque:
        text += ", whose torque is not measured, so that torsion by it counts as unexplained"
    return [f"{text}: {left.value:.1f} times the noise is left"]


def _severity(answer: Answer) -> list[str]:
    """The joint beside its catalogue's accuracy, and its eccentricity beside what the assembly may have."""
    parts, usual, assembly = [], answer.normal, answer.tolerance
    if usual is not None:
        size, allowed = usual.value / ARCSEC, usual.limit / ARCSEC
        where = "within" if usual.within else "beyond"
        own = f"{size:.0f}" if size >= 0.5 else "none to be seen beside the noise,"
        parts.append(f"the joint is {where} its accuracy ({own} of {allowed:.0f} arcsec peak to peak)")
    else:
        parts.append("whether the joint is within its accuracy cannot be judged without its torque")
    if assembly is not None and answer.diagnosis.allowed is not None and not math.isnan(assembly.value):
        where = "may be beyond" if assembly.place in ("near", "open") else f"is {assembly.place}"
        sizes = f"{assembly.value * 1e6:.1f} of {assembly.limit * 1e6:.1f} µm"
        by = words(answer.diagnosis.allowed.criterion)
        parts.append(f"its eccentricity {where} the tolerance's limit ({sizes}, by {by})")
    return [" and ".join(parts)]
