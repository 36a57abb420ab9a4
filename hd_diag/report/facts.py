"""All numbers that the page of a report says and draws, from a diagnosis or from a motion alone."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.config.configuration import JointConfig
from hd_diag.config.defaults import EXAMPLE, page_of
from hd_diag.config.parameters import JOINT_PARAMETERS, SIGNALS, Value
from hd_diag.diagnosis.action import Advice, advice, cannot_be_judged
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.record import GAP_STEPS
from hd_diag.diagnosis.ripple.ripple import Ripple
from hd_diag.diagnosis.ripple.verdict import sentence as ripple_sentence
from hd_diag.diagnosis.statements import sentences
from hd_diag.effects.order_spectrum import line_width, peaks, spectrum
from hd_diag.formatting import number, percent, words
from hd_diag.gears.page import ASSUMED_PROFILE, Page
from hd_diag.records.joint_record import InputRecord
from hd_diag.replay.versions import running
from hd_diag.report import stages, torsion
from hd_diag.report.cards import Card, Gauge, cards, gauges
from hd_diag.report.stages import BinnedResiduals, Curve, OverTime, Rung, Stages, benches, curves, ladder
from hd_diag.report.teeth import TeethOverTurn, teeth_over_turn

_LINE_SHARE = 0.2  # share of a cause's mean square above which a spectral peak is its order
_LEAK = 0.1  # relative strength of side lobes that are not counted as peaks
_MOST_MARKS = 2  # orders marked for one cause
_NOT_OF_THE_DRIVE = ("output_joint", "limits.", "tolerance.", *SIGNALS)
_ORDERS = (8.0, 40.0)  # least and greatest upper end of the spectrum
_TURN = 2.0 * np.pi
_PART = 1 << 20  # part of a file read at a time [byte]


class Fact(NamedTuple):
    """A name and a value with its unit, in words."""

    name: str
    value: str


class Mark(NamedTuple):
    """A named order of the wave generator's turn, with its amplitude [rad]."""

    order: float
    name: str
    amplitude: float


@dataclass(frozen=True)
class Judgement:
    """The part of a report that needs measured angles.

    `diagnosis` comes without its fit, whose columns are large; `kind` is the judgement. `classes` are causes
    that the record cannot distinguish, `orders` are order and amplitude [rad] of the residual by stage,
    `stretches` is the number of stretches in the ladder's data.
    """

    diagnosis: Diagnosis
    gauges: tuple[Gauge, ...]
    kind: str
    classes: tuple[tuple[str, ...], ...]
    cards: tuple[Card, ...]
    over_angle: BinnedResiduals
    over_torque: BinnedResiduals
    over_time: OverTime
    orders: dict[str, tuple[Floats, Floats]]
    highest_order: float
    marks: tuple[Mark, ...]
    ladder: tuple[Rung, ...]
    remainders: tuple[Curve, ...]
    weighed: dict[str, Mapping[str, float]]
    stretches: int


@dataclass(frozen=True)
class JointReport:
    """One joint's part of a report; `judgement` is None if nothing could be judged.

    `said` is the headline with further sentences. `best` is the drive of the teeth and the torsion curve:
    ``refitted`` or ``configured``; without a judgement ``configured`` or ``extended``. `ripple` holds the
    torque's lines of a joint with one angle.
    """

    name: str
    advice: Advice
    said: tuple[str, ...]
    best: str
    torsion: torsion.Torsion
    teeth: TeethOverTurn
    quality: tuple[Fact, ...]
    settings: tuple[Fact, ...]
    judgement: Judgement | None
    ripple: Ripple | None = None

    @property
    def lines(self) -> list[str]:
        """The joint's lines for a terminal."""
        return [self.advice.text, *self.said]


def _weighed(found: Diagnosis) -> dict[str, Mapping[str, float]]:
    """Log odds of the alternatives fitted in place of each cause, by the names of cause and alternative."""
    causes = (*found.causes, *found.hints)
    return {one.effect.name: one.standing.values for one in causes if len(one.standing.values) > 1}


def of_diagnosis(
    diagnosis: Diagnosis, joint: JointConfig, flat: Mapping[str, Value], rng: np.random.Generator
) -> JointReport:
    """A joint's report from its diagnosis; `flat` are the configuration's parameters by their full names."""
    fitted, answer = benches(diagnosis), Answer(diagnosis)
    found = stages.stages(diagnosis, fitted[0] if fitted else None)
    record, drive = diagnosis.record, found.drive
    torque = record.torque if record.has_torque else None
    quality = quality_of(record.time, record.input_angle, torque, drive.kinematics.ratio, record.bag)
    runs = Fact("Runs", f"{record.extent.runs}, {number(record.extent.duration)} s in all")
    excluded = Fact("Taken out", f"{record.outliers} outliers, {record.dropped} not finite or out of order")
    return JointReport(
        joint.name,
        advice(answer),
        tuple(sentences(answer)),
        "refitted" if diagnosis.refitted else "configured",
        torsion.measured(found, diagnosis.configured, rng, _page(joint, flat)),
        teeth_over_turn(drive, record.input_angle, record.torque),
        (quality[0], excluded, runs, *quality[1:]),
        settings(joint, flat),
        _judgement(answer, found, fitted, rng),
    )


def of_motion(
    motion: InputRecord,
    joint: JointConfig,
    flat: Mapping[str, Value],
    reason: str,
    ripple: Ripple | None = None,
) -> JointReport:
    """A joint's report from the model alone, over a bag's motion; `reason`: why nothing could be judged."""
    found = () if ripple is None else (ripple_sentence(ripple),)
    lost = (f"{line[:1].upper()}{line[1:]}." for line in motion.stamps.lines if line not in reason)
    drive, assumed = joint.drive, np.full(motion.time.size, joint.torque)
    teeth = teeth_over_turn(drive, motion.input_angle, assumed if motion.torque is None else motion.torque)
    most = max(abs(teeth.torque), drive.rated_torque)
    return JointReport(
        joint.name,
        cannot_be_judged(reason),
        (*found, *lost, "What follows is what the model says of the motion."),
        "configured" if joint.model is None else "extended",
        torsion.simulated(joint.configured, drive, most, _page(joint, flat)),
        teeth,
        tuple(quality_of(motion.time, motion.input_angle, motion.torque, drive.kinematics.ratio, motion.bag)),
        settings(joint, flat),
        None,
        ripple,
    )


def _page(joint: JointConfig, flat: Mapping[str, Value]) -> Page | None:
    """The joint's catalogue page; None if it has none."""
    return page_of({p.name: flat.get(f"{joint.name}.{p.name}", p.default) for p in JOINT_PARAMETERS})


def quality_of(
    time: Floats, input_angle: Floats, torque: Floats | None, ratio: float, bag: Integers
) -> list[Fact]:
    """Facts on a record's stamps [s], angles [rad] and, if measured, torque [N m], shape (n,) each.

    `bag` numbers the recording of each sample. Steps between two recordings, or between stamps that do not
    rise, are left out; at least one step must remain.
    """
    rising = (np.diff(bag) == 0) & (np.diff(time) > 0.0)
    step = np.diff(time)[rising]
    usual = float(np.median(step))
    near = step[step <= GAP_STEPS * usual]
    gaps = step[step > GAP_STEPS * usual]
    off = 1e6 * np.abs(near - usual)
    moved = np.diff(input_angle)[np.diff(bag) == 0]
    way, reach = float(np.abs(moved).sum()), float(np.ptp(input_angle)) / _TURN
    forwards = float(moved[moved > 0.0].sum()) / max(way, 1e-300)
    speed = np.abs(np.diff(input_angle)[rising] / step) / _TURN
    ends = () if torque is None else (number(float(torque.min())), number(float(torque.max())))
    return [
        Fact("Samples used", f"{time.size:d}"),
        Fact("Sample rate", f"{number(1.0 / usual)} Hz"),
        Fact("Jitter of the stamps", f"{off.mean():.0f} µs mean, {np.percentile(off, 99):.0f} µs at 99 %"),
        Fact("Gaps", f"{gaps.size}, {number(float(gaps.sum()))} s in all" if gaps.size else "none"),
        Fact("Input turns", f"{number(way / _TURN)} in all, over a range of {number(reach)}"),
        Fact("Output range", f"{number(reach / abs(ratio))} turns"),
        Fact("Input speed", f"up to {number(float(np.percentile(speed, 99)))} turns per second"),
        Fact("Ways turned", f"{percent(forwards, 0)} forwards, {percent(1.0 - forwards, 0)} back"),
        Fact("Torque", f"{' to '.join(ends)} N m" if ends else "not measured"),
    ]


def settings(joint: JointConfig, flat: Mapping[str, Value]) -> tuple[Fact, ...]:
    """Parameters of a joint's drive as configured, each with its unit."""
    found = [Fact("input_joint", joint.input_joint), Fact("output_joint", joint.output_joint)]
    for entry in JOINT_PARAMETERS:
        key = f"{joint.name}.{entry.name}"
        unset = entry.name.startswith("gear.") and not flat.get(key)
        if key in flat and not unset and not entry.name.startswith(_NOT_OF_THE_DRIVE):
            unit = "" if entry.unit == "-" else entry.unit
            found.append(Fact(entry.name, f"{flat[key]} {unit}".strip() or "none"))
    if _page(joint, flat):
        found.append(Fact("of a page", ASSUMED_PROFILE))
    elif joint.configured.mesh.geometry == EXAMPLE.mesh.geometry:
        found.append(Fact("teeth", "those of the example drive"))
    return tuple(found)


def versions() -> tuple[Fact, ...]:
    """Versions of the software that computed and drew a report."""
    found = [Fact(name, version or "not used") for name, version in running().items()]
    return (*found, *(Fact(name, metadata.version(name)) for name in ("matplotlib", "Jinja2")))


def _judgement(
    answer: Answer, found: Stages, fitted: list[LinearisedFit], rng: np.random.Generator
) -> Judgement:
    diagnosis = answer.diagnosis
    marks = _marks(diagnosis)
    highest = float(np.clip(1.2 * max((mark.order for mark in marks), default=0.0), *_ORDERS))
    return Judgement(
        replace(diagnosis, found=None),
        gauges(answer),
        answer.judgement,
        tuple(cause.alike for cause in diagnosis.causes if len(cause.alike) > 1),
        tuple(cards(answer)),
        stages.over_angle(found),
        stages.over_torque(found),
        stages.over_time(found),
        stages.orders(found, highest),
        highest,
        tuple(mark for mark in marks if mark.order <= highest),
        tuple(ladder(diagnosis, found.residual[stages.NOMINAL], fitted, rng)),
        tuple(curves(diagnosis.found)) if diagnosis.found else (),
        _weighed(diagnosis),
        int(fitted[-1].data.block[-1]) + 1 if fitted else 0,
    )


def _marks(diagnosis: Diagnosis) -> list[Mark]:
    """Orders of causes and unexplained lines in the wave generator's angle."""
    lines = [line for line in diagnosis.unexplained if line.frame == "input" and not line.description]
    marks = [Mark(line.order, "unexplained", line.amplitude) for line in lines]
    for cause in diagnosis.causes:
        assert diagnosis.found is not None
        fit = diagnosis.found.fit
        # Columns after the cause's own describe slow wandering, which has no order.
        columns = fit.columns(cause.effect, cause.nonlinear)[:, : cause.coefficients.size]
        part = columns @ cause.coefficients
        marks += _own_orders(fit.signals.wave_generator_angle, part, words(cause.effect.name))
    return sorted(marks)


def _own_orders(angle: Floats, part: Floats, name: str) -> list[Mark]:
    """Strong spectral peaks of a cause's part of the error [rad]; empty if it is not a sum of a few waves."""
    order, strength = spectrum(angle, part, _ORDERS[1])
    strongest = peaks(strength, int(line_width(angle, _LEAK) / (order[1] - order[0])))[:_MOST_MARKS]
    least = _LINE_SHARE * float(np.var(part))
    return [
        Mark(float(order[at]), name, float(strength[at]))
        for at in strongest
        if 0.5 * strength[at] ** 2 > least
    ]


# Files ---


def sources(bags: Sequence[Path]) -> list[Fact]:
    """Every file of some bags with its SHA-256; OSError if one cannot be read."""
    return [
        Fact(f"{bag.resolve().name}/{name}" if bag.is_dir() else name, f"SHA-256 {digest}")
        for bag in bags
        for name, digest in digests(bag).items()
    ]


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of a file, or of every file of a folder, by name."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return {file.name: sha256(file).hex() for file in files if file.is_file()}


def sha256(file: Path) -> bytes:
    """SHA-256 of a file, read a part at a time."""
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while part := opened.read(_PART):
            digest.update(part)
    return digest.digest()
