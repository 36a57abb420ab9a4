"""Conclusion of a diagnosis: the kind of answer, its evidence, and how bad the joint is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.accuracy import WHOLE_TURN, Accuracy, accuracy
from hd_diag.diagnosis.calibration import ANOTHER, CERTAIN_SIZE, LEAST_SIZE, MISFIT, TWO_SIDED, USUAL_LOOP
from hd_diag.diagnosis.diagnosis import Diagnosis, parameter_sizes
from hd_diag.diagnosis.evidence.solution import Cause
from hd_diag.effects.effect import Effect
from hd_diag.formatting import ARCSEC, words

Judgement = Literal["as_configured", "parameters", "causes", "described", "misfit", "not_judged"]

_LEAST_SHARE = 0.05  # of the noise; a parameter with a smaller effect is not reported
_BY_TORQUE = ("tooth_compliance", "cup_compliance")

Beside = Literal["within", "near", "beyond", "open"]
"""A value against its limit: under it, too near to decide, over it, or unknown."""


_LOOP = "hysteresis"
_ENCODER = 600.0 * ARCSEC  # input encoder: tolerance in a resolver's data sheet
_DISC = 10.0 * ARCSEC  # output encoder: a disc of 100 mm mounted to 2.5 um
_USUAL = {
    _LOOP: 0.5 * USUAL_LOOP,  # half of a peak-to-peak value
    "input_encoder_eccentricity": _ENCODER,
    "encoder_interpolation": _ENCODER,
    "output_encoder_eccentricity": _DISC,
    "output_runout": _DISC,  # a flange's; no record can distinguish it from the disc's
    "output_encoder_interpolation": _DISC,
}
"""Largest values that a new joint may have; of several waves, the first one counts."""

_OF_GEAR = ("circular_spline_pitch", "flexspline_pitch", "circular_spline_form", "input_encoder_eccentricity")
"""Waves that a catalogue's accuracy includes: errors of the teeth, and a wave per input turn like theirs."""

_FRICTION = ("coulomb_windup", "viscous_windup")
"""Causes that are usual up to the effect's usual size. Chosen: two per cent of the rated torque (1 N m in a
joint of 56 N m), the drag of new bearings and seals."""


def _is_usual(cause: Cause) -> bool:
    """Whether a new joint may have a cause of this size, that is, unless it certainly exceeds a usual size.

    If the record cannot distinguish it from others, it is usual if any of these would be usual in its place.
    """
    value, way = _size(cause.effect, cause.coefficients)
    spread = math.sqrt(max(float(way @ cause.covariance[: way.size, : way.size] @ way), 0.0))
    certain = 1.0 - CERTAIN_SIZE * spread / max(value, 1e-300)
    for effect, coefficients in ((cause.effect, cause.coefficients), *cause.others):
        limit = float(effect.usual[0]) if effect.name in _FRICTION else _USUAL.get(effect.name, -math.inf)
        own, _ = _size(effect, coefficients)
        # Only the loop width within the record's torques counts.
        shown = min(own, cause.reach) if effect.name == _LOOP else own
        if shown * certain <= limit:
            return True
    return False


def _size(effect: Effect, coefficients: Floats) -> tuple[float, Floats]:
    """Sum of a loop's two absolute parts, or amplitude of a wave's cosine and sine; its gradient (2,)."""
    own = coefficients[:2]
    norm = 1 if effect.name == _LOOP else 2
    value = float(np.linalg.norm(own, norm))
    return value, np.asarray(np.sign(own) if norm == 1 else own / max(value, 1e-300))


class Limited(NamedTuple):
    """A quantity with its standard deviation and its limit, all in `unit`."""

    quantity: str
    value: float
    std: float
    limit: float
    unit: str

    @property
    def within(self) -> bool | None:
        """True if the whole interval is under the limit, False if it is over, None if undecided."""
        return {"within": True, "beyond": False}.get(self.place)

    @property
    def place(self) -> Beside:
        """Place of the 95 % interval; ``near`` if it contains the limit.

        If the deviation is unknown (nan), a value under the limit is ``open`` and one over it is ``near``.
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
    """A parameter that is not as configured; `explains` is its effect on the error [rad rms]."""

    name: str
    value: float
    std: float
    configured: float
    unit: str
    explains: float


@dataclass(frozen=True, eq=False)
class Answer:
    """Conclusion of a diagnosis, with each part computed once."""

    diagnosis: Diagnosis

    @cached_property
    def judgement(self) -> Judgement:
        """Kind of the answer; ``misfit`` takes precedence over all fitted results."""
        found = self.diagnosis
        if found.rms is None:
            return "not_judged"
        if found.refitted is None:
            return "described" if found.order_table else "not_judged"
        if found.rms.misfit.certain and found.rms.hides_lines:
            return "misfit"
        if found.causes or any(finding.name == "tooth_skip" for finding in found.findings):
            return "causes"
        if found.order_table or found.unexplained or found.hints or found.larger:
            return "described"
        return "parameters" if self.changes else "as_configured"

    def is_usual(self, cause: Cause) -> bool:
        """Whether a new joint may have a cause of this size.

        A wave of the gear is usual in a joint that is within its accuracy, and so is all below `LEAST_SIZE`.
        """
        if cause.standing.own < LEAST_SIZE:
            return True
        within = self.normal is not None and self.normal.within is True
        return _is_usual(cause) or (within and any(name in _OF_GEAR for name in cause.alike))

    @property
    def vague(self) -> bool:
        """Whether a displacement may be part of the residual at the gear's lines."""
        rms = self.diagnosis.rms
        return bool(rms and rms.misfit.suspected and rms.hides_lines)

    @cached_property
    def changes(self) -> list[Change]:
        """Parameters that are not as configured; the one with the largest effect on the error first.

        Compliances are excluded if the torque is a motor's current, which shows only their product with the
        torque constant.
        """
        found = self.diagnosis
        if found.refitted is None or not found.refitted.trustworthy:
            return []
        least = _LEAST_SHARE * found.rms.noise if found.rms else 0.0
        changed = []
        sizes = parameter_sizes(found.record, found.configured, found.refitted.parameters)
        for name, explains in sizes.items():
            if found.record.by_current and name in _BY_TORQUE:
                continue
            entry = found.parameters[name if name in found.parameters else f"{name}.magnitude"]
            off = abs(entry["value"] - entry["configured"])
            if off > ANOTHER * entry["std"] and explains > least:
                number = (entry["value"], entry["std"], entry["configured"], entry["unit"])
                changed.append(Change(name, *number, explains))
        return sorted(changed, key=lambda change: -change.explains)

    @property
    def eccentricity(self) -> float:
        """Magnitude of the eccentricity, found or as configured [m]; nan without a trustworthy fit."""
        found = self.diagnosis
        if found.refitted is None or not found.refitted.trustworthy:
            return math.nan
        changed = [change.value for change in self.changes if change.name == "eccentricity"]
        return changed[0] if changed else abs(found.configured.mesh.eccentricity)

    @property
    def tolerance(self) -> Limited | None:
        """The eccentricity and its limit; None without a limit. In a misfit its standard deviation is nan."""
        most = self.diagnosis.allowed
        if most is None:
            return None
        known = self.judgement != "misfit"
        std = self.diagnosis.parameters["eccentricity.magnitude"]["std"] if known else math.nan
        return Limited("eccentricity", self.eccentricity, std, most.eccentricity, "m")

    @cached_property
    def accuracy(self) -> Accuracy | None:
        """The joint's peak-to-peak error; None if its signals are wrong."""
        found = self.diagnosis
        if any(finding.fatal for finding in found.findings):
            return None
        kinematics, rated_torque = found.configured.kinematics, found.configured.rated_torque
        frames = {"input": 1.0, "output": 1.0 / abs(kinematics.ratio)}
        orders = [row.nonlinear[0] for row in found.order_table]
        lines = (line for line in found.unexplained if line.order > 0.0 and line.frame in frames)
        orders += [line.order * frames[line.frame] for line in lines]
        return accuracy(found.record, kinematics, rated_torque, orders, _noise(found))

    @cached_property
    def normal(self) -> Limited | None:
        """The joint's error and its catalogue's limit; None if it cannot be judged.

        Without a measured torque, an error may be torsion and is only judged if it is within the limit.
        """
        if self.accuracy is None:
            return None
        value, std, _ = self.accuracy
        limited = Limited("transmission_error", value, std, self.diagnosis.configured.accuracy, "rad")
        return limited if self.diagnosis.record.has_torque or limited.place == "within" else None

    @property
    def evidence(self) -> dict[str, Any]:
        """Numbers behind the judgement."""
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


def _noise(diagnosis: Diagnosis) -> tuple[float, float]:
    """Mean square of the noise and its standard deviation [rad²]; zero if unknown."""
    if diagnosis.rms is None or not math.isfinite(diagnosis.rms.noise):
        return 0.0, 0.0
    low, high = diagnosis.rms.noise_low, diagnosis.rms.noise_high
    return diagnosis.rms.noise**2, float(np.nan_to_num((high**2 - low**2) / (2.0 * TWO_SIDED)))


def first_words(answer: Answer) -> str:
    """Beginning of the verdict: whether the model describes the record, and how bad the joint is."""
    fatal = [finding for finding in answer.diagnosis.findings if finding.fatal]
    return f"First of all: {fatal[0].text}" if fatal else "; ".join([*_misfit(answer), *_severity(answer)])


def _misfit(answer: Answer) -> list[str]:
    rms = answer.diagnosis.rms
    if rms is None:
        return []
    left = rms.misfit
    if not left.suspected and rms.left > MISFIT * rms.noise:
        return [
            f"this record tests the model only to {rms.expected / ARCSEC:.0f} arcsec, "
            "because parts of the motion are driven once: drive it again, or back as well"
        ]
    if not left.suspected or (left.measured and not left.certain):
        return []
    if not left.certain:
        return [
            "whether the model describes this record cannot be determined: "
            f"{left.low:.1f} to {left.value:.1f} times the noise is left, "
            "and too little of the motion repeats to tell"
        ]
    if not rms.hides_lines:
        return [
            "the model describes the gear's lines in this record, but not what is slower than an input turn: "
            f"{rms.slow:.1f} times the noise is left there"
        ]
    text = "the model does not describe this record"
    if not answer.diagnosis.record.has_torque:
        text += ", whose torque is not measured, so that torsion by it counts as unexplained"
    return [f"{text}: {left.value:.1f} times the noise is left"]


def _severity(answer: Answer) -> list[str]:
    """The joint's error against its catalogue's accuracy, and its eccentricity against the tolerance."""
    usual, assembly = answer.normal, answer.tolerance
    parts = ["whether the joint is within its accuracy cannot be judged without its torque"]
    if usual is not None and answer.accuracy is not None:
        turns = answer.accuracy.turns
        over = "" if turns >= WHOLE_TURN else f" over {turns:.2f} of an output turn"
        of = f"of {usual.limit / ARCSEC:.0f} arcsec peak to peak{over}"
        parts = [_beside(usual, "the joint", "its accuracy", of, 1.0 / ARCSEC, 0)]
    if assembly is not None and answer.diagnosis.allowed is not None and not math.isnan(assembly.value):
        of = f"of {assembly.limit * 1e6:.1f} µm, by {words(answer.diagnosis.allowed.criterion)}"
        parts.append(_beside(assembly, "its eccentricity", "the tolerance's limit", of, 1e6, 1))
    return [" and ".join(parts)]


def _beside(one: Limited, who: str, limit: str, of: str, unit: float, digits: int) -> str:
    """A value against its limit, in words; an undecided one is given with its deviation."""
    value = f"{one.value * unit:.{digits}f}"
    if one.within is not None:
        if not float(value):
            value = "none to be seen beside the noise,"
        return f"{who} is {one.place} {limit} ({value} {of})"
    std = "" if math.isnan(one.std) else f" ± {one.std * unit:.{digits}f}"
    return f"whether {who} is within {limit} cannot be judged ({value}{std} {of})"
