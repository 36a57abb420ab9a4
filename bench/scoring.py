"""Scores of a diagnosis of a generated record: names, sizes, residual, intervals, time."""

# ruff: noqa: D102

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from challenge import records
from challenge.design import SIZE_25
from challenge.families import FAMILIES
from challenge.page import LargeWave, Page, PageJoint
from challenge.truth import Base, as_configured
from challenge.unknown_causes import SHAPES, OutputLines

from hd_diag.config.configuration import resolve
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.gain import held_out
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.record import Record, prepare
from hd_diag.diagnosis.verdict import sentence
from hd_diag.drive import Drive

PARAMETERS = fit_parameters.TILT.start  # the generator's drives have one section and so no tilt
CONFIGURED = resolve({}).joints[0].drive
ORDER_TOLERANCE = 0.02
MISFIT = 1.3  # over this ratio of held-out residual to true noise, the diagnosis must say something
SIZED_OTHERWISE = ("ratio_error", "tooth_skip")  # found before the fit: no rms at the output


@dataclass
class Score:
    """Result of one method on one record.

    Attributes
    ----------
    hidden, found : true names that can be found, and classes that were named
    optional : true names that need not be found
    unknown : name of a cause that is in no catalogue, or ""
    false_names : number of named classes that hold no true name
    amplitude_errors : relative errors, for correctly named causes
    listed : hidden names that, according to the diagnosis, the motion cannot show
    denied : hidden names not found, although larger than the smallest size that the diagnosis stated
    claimed : whether an eccentricity or runout was said to differ from the configured one
    flagged : whether something was said to be unexplained, or the model not to fit
    order_right : whether the order of an unknown cause was found; None if it has no order
    over_floor, running_over_floor : ratio of held-out residual to the true noise of the output at the same
        samples, for the fit and for the model as it runs
    over_noise : as over_floor; the noise includes what noise of the smoothed torque does to the true drive
    covered : number of the seven parameters inside their 95 % interval
    seconds, verdict : CPU time [s]; the sentence
    effects : true sizes [SI] by name
    stated : for every class named or hinted at, its probability and whether it is really present
    """

    method: str
    family: str
    seed: int
    hidden: list[str]
    unknown: str
    found: list[list[str]]
    optional: list[str] = field(default_factory=list)
    false_names: int = 0
    amplitude_errors: list[float] = field(default_factory=list)
    listed: list[str] = field(default_factory=list)
    denied: list[str] = field(default_factory=list)
    claimed: bool = False
    flagged: bool = False
    order_right: bool | None = None
    over_floor: float | None = None
    running_over_floor: float | None = None
    over_noise: float | None = None
    covered: int | None = None
    trusted: bool | None = None
    seconds: float = 0.0
    verdict: str = ""
    effects: dict[str, dict[str, object]] = field(default_factory=dict)
    stated: list[tuple[float, bool]] = field(default_factory=list)

    @property
    def exact(self) -> bool:
        return sorted(alike[0] for alike in self.found) == sorted(self.hidden)

    @property
    def right(self) -> bool:
        """Whether exactly the hidden causes were named, up to class; poor motions may excuse some of them."""
        excused = set(self.listed) if FAMILIES[self.family].excused else set()
        return self.false_names == 0 and self.missed <= excused

    @property
    def missed(self) -> set[str]:
        """Hidden names that are in no named class."""
        return set(self.hidden) - {self.hidden[h] for h, _ in matched(self.hidden, self.found)}

    @property
    def passed_over(self) -> bool:
        """Whether the residual is far above the noise and the diagnosis said nothing."""
        return self.over_noise is not None and self.over_noise > MISFIT and not self.flagged


def matched(hidden: Sequence[str], found: Sequence[Sequence[str]]) -> list[tuple[int, int]]:
    """Largest assignment of hidden names to found classes that hold them, as index pairs (hidden, found)."""
    best: list[tuple[int, int]] = []
    places = range(max(len(hidden), len(found)))
    for order in itertools.permutations(places, len(hidden)):
        pairs = [(h, f) for h, f in enumerate(order) if f < len(found) and hidden[h] in found[f]]
        best = max(best, pairs, key=len)
    return best


@functools.lru_cache(maxsize=8)
def drive(base: Base) -> Drive:
    """A drive of the generator as a drive of the package."""
    shape, joint = base.design.shape, {}
    for name, profile in (("flexspline_tooth", shape.tooth), ("circular_spline_slot", shape.slot)):
        for arc in ("addendum", "dedendum"):
            joint[f"{name}.{arc}_radius"] = getattr(profile, f"{arc}_radius")
        joint[f"{name}.addendum_center"] = [profile.addendum_centre, -profile.addendum_offset]
        joint[f"{name}.dedendum_center"] = [profile.dedendum_centre, profile.dedendum_offset]
    joint |= {
        "ratio": base.design.ratio,
        "rated_torque": base.design.rated,
        "flexspline_teeth": shape.flexspline_teeth,
        "circular_spline_teeth": shape.circular_spline_teeth,
        "neutral_curve.semi_major": shape.semi_major,
        "neutral_curve.semi_minor": shape.semi_minor,
        "flexspline_tooth.root": shape.tooth_root,
        "flexspline_tooth.tip": shape.tooth_tip,
        "circular_spline_tip_radius": shape.circular_spline_tip_radius,
        "circular_spline_datum": base.datum,
        "tooth_compliance": base.compliance,
        "cup_compliance": base.cup,
        "eccentricity.magnitude": base.e,
        "eccentricity.direction": base.psi,
        "runout.magnitude": base.runout,
        "runout.direction": base.runout_psi,
    }
    return resolve({f"joint_1.{name}": value for name, value in joint.items()}).joints[0].drive


@functools.lru_cache(maxsize=8)
def from_page(page: Page) -> Drive:
    """A catalogue page's drive, as `hd-diag gear` makes it."""
    numbers = {f"gear.{name}": getattr(page, name) for name in ("size", "k1", "k2", "k3", "t1", "t2")}
    numbers |= {"ratio": page.ratio, "gear.ratio": page.ratio, "gear.rated_torque": page.rated}
    return resolve({f"joint_1.{name}": value for name, value in numbers.items()}).joints[0].drive


def configured(made: records.Record) -> Drive:
    """The drive that the user believes in."""
    if isinstance(made.base, PageJoint):
        return from_page(made.base.design)
    return CONFIGURED if made.base.design == SIZE_25 else drive(as_configured(made.base.design))


def prepared(made: records.Record) -> Record:
    """The record as the package reads it. Currents become torques by the constant that the user knows."""
    constant = made.truth["recording"]["torque_constant"]
    torque = made.torque * constant if constant else made.torque
    columns = (made.time, made.input_angle, made.output_angle, torque, made.temperature)
    part, ratio = made.part.astype(np.int64), made.base.design.ratio
    return prepare(*columns, part, ratio, by_current=bool(constant))


def size_of(made: records.Record, name: str, rows: np.ndarray | slice = slice(None)) -> float:
    """Rms at the output of what a cause adds [rad], over the given rows."""
    return float(np.std(records.added_by(made, name)[rows]))


def noise_by_torque(made: records.Record) -> np.ndarray:
    """Effect of the smoothed torque's noise on the true drive's output (n,) [rad].

    Zero if no sensor measures the torque: the smoothing of a motor's current is part of the method.
    """
    if made.torque is None or made.truth["recording"]["torque_constant"]:
        return np.zeros(made.time.size)
    smoothed = prepared(made)
    seen = records.scene(made.motion, made.time - sum(cause.delay for cause in made.causes))
    clean, real = seen.torque, records.borne(made.causes, seen)
    for cause in made.causes:
        clean = cause.torque_reading(clean, real)
    off = np.interp(made.time, smoothed.time, smoothed.torque) - clean
    more = dataclasses.replace(seen, torque=seen.torque + off)
    return records.output(made.base, made.causes, more) - records.output(made.base, made.causes, seen)


def score(made: records.Record, family: str, seed: int) -> Score:
    """Score of the package's diagnosis."""
    begin = time.process_time()
    found = diagnose(prepared(made), configured(made), np.random.default_rng(0))
    seconds = time.process_time() - begin
    named = [[finding.name] for finding in found.findings] + [list(cause.alike) for cause in found.causes]
    sizes = [float("nan")] * len(found.findings) + [cause.amplitude for cause in found.causes]
    judged = np.searchsorted(made.time, found.record.time[usable(found.record)])  # rows of the amplitudes
    result = scored("hd_diag", made, family, seed, named, sizes, judged)
    result.listed = [t.name for t in found.testable if not t.testable and t.name in result.hidden]
    shown = {t.name: t.least_size for t in found.testable if t.testable}
    result.denied = [n for n in result.missed & shown.keys() if size_of(made, n, judged) > shown[n]]
    true = {*result.hidden, *result.optional}
    result.stated = [
        (cause.standing.probability, bool(true & set(cause.alike)))
        for cause in (*found.causes, *found.hints)
        if math.isfinite(cause.standing.probability)
    ]
    result.seconds = seconds
    answer = Answer(found)
    result.verdict = sentence(answer)
    _judge_unknown(result, made, answer)
    _judge_fit(result, made, found)
    return result


def scored(
    method: str,
    made: records.Record,
    family: str,
    seed: int,
    named: list[list[str]],
    sizes: Sequence[float],
    rows: np.ndarray | slice = slice(None),
) -> Score:
    """Score of the names and sizes that any method found."""
    hidden, unknown = made.truth["hidden"], "".join(made.truth["unknown"])
    result = Score(method, family, seed, list(hidden), unknown, named, list(made.truth["optional"]))
    result.effects = made.truth["effects"]
    pairs = matched(hidden, named)
    others = [alike for f, alike in enumerate(named) if f not in {found for _, found in pairs}]
    result.false_names = sum(not set(alike) & set(result.optional) for alike in others)
    for h, f in pairs:
        if hidden[h] not in SIZED_OTHERWISE:
            result.amplitude_errors.append(abs(sizes[f] / size_of(made, hidden[h], rows) - 1.0))
    return result


def _judge_unknown(result: Score, made: records.Record, answer: Answer) -> None:
    found = answer.diagnosis
    result.flagged = bool(found.unexplained) or answer.judgement in ("misfit", "described", "not_judged")
    result.claimed = bool({"eccentricity", "runout"} & {change.name for change in answer.changes})
    ratio, lines = made.base.design.ratio, [*found.unexplained, *found.order_table]
    seen = {line.order / ratio if line.frame == "output" else line.order for line in lines}
    kind, tolerance = SHAPES.get(result.unknown), ORDER_TOLERANCE
    if result.unknown == LargeWave.name and result.claimed:  # such a wave looks like an eccentricity
        result.order_right = True
        return
    if result.unknown == LargeWave.name:
        wanted = [made.truth["effects"][result.unknown]["order"]]
    elif result.unknown == OutputLines.name:
        wanted = [order / ratio for order in made.truth["effects"][result.unknown]["orders"]]
        tolerance = 0.3 / ratio
    elif kind is None or kind.order is None:
        return
    else:
        wanted = [kind.order / ratio if kind.frame == "output" else kind.order]
    result.order_right = all(any(abs(w - order) < tolerance for order in seen) for w in wanted)


def _judge_fit(result: Score, made: records.Record, found: Diagnosis) -> None:
    if found.rms is None or found.refitted is None:
        return
    unseen, _ = held_out(found.record)
    unseen &= usable(found.record)
    at = np.searchsorted(made.time, found.record.time[unseen])
    noise = (made.output_angle - made.clean_output)[at]
    floor = float(np.sqrt(np.mean(noise**2)))
    result.over_floor, result.running_over_floor = found.rms.offline / floor, found.rms.extended / floor
    by_torque = noise_by_torque(made)[at]
    result.over_noise = found.rms.offline / float(np.sqrt(np.mean(noise**2 + by_torque**2)))
    if isinstance(made.base, PageJoint):
        return
    if not {"wear_backlash", "torsional_hardening"} & set(result.optional):  # both change parameters
        result.covered = covered(found, made)
    result.trusted = found.refitted.trustworthy


def covered(found: Diagnosis, made: records.Record) -> int:
    """Number of the seven parameters whose 95 % interval holds the nearest equivalent drive's value."""
    assert found.refitted is not None
    parameters = found.refitted.parameters[:PARAMETERS]
    spread = np.sqrt(np.diag(found.refitted.covariance))[:PARAMETERS]
    truth = fit_parameters.vector(drive(as_seen(made)), found.configured)
    offs = tuple(parameters - one for one in fit_parameters.alike(truth, found.configured))
    off = min(offs, key=lambda x: float(np.hypot(*x[:2]) + np.hypot(*x[2:4])))
    return int(np.sum(np.abs(off) < 1.96 * spread))


def as_seen(made: records.Record) -> Base:
    """The drive as its torque reading shows it: a gain of the reading changes all compliances."""
    gain = made.truth["effects"].get("torque_gain", {}).get("gain", 1.0)
    return dataclasses.replace(made.base, compliance=made.base.compliance / gain, cup=made.base.cup / gain)


def plain(result: Score) -> dict[str, object]:
    """The score as a dictionary for JSON."""
    derived = {"exact": result.exact, "right": result.right, "passed_over": result.passed_over}
    return {**dataclasses.asdict(result), **derived}
