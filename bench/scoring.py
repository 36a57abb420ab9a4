"""What a diagnosis of a generated record is worth: names, sizes, residual, intervals, time."""

# ruff: noqa: D102, D103

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from challenge import records
from challenge.families import POOR
from challenge.unknown_causes import SHAPES

from hd_diag.config.configuration import resolve
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose, held_out
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.record import Record, prepare

CONFIGURED = resolve({}).joints[0].drive
RATIO = CONFIGURED.kinematics.ratio
MIRROR = np.array([-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
ORDER_TOLERANCE = 0.02
SIZED_OTHERWISE = ("ratio_error", "tooth_skip")  # findings before the fit: no rms at the output


@dataclass
class Score:
    """One method on one record.

    Attributes
    ----------
    hidden, found : names that are true, and classes that were named
    unknown : name of a cause that no catalogue has, or ""
    false_names : classes named that hold nothing true
    amplitude_errors : relative, of those named rightly
    listed : hidden names that the record's motion was said not to show
    flagged, order_right : for an unknown cause; None where it has no order
    over_floor, running_over_floor : held-out residual over the true noise of those samples, of the fit
        and of the model as it runs
    covered : parameters within their 95 % interval, of seven
    seconds : CPU
    """

    method: str
    family: str
    seed: int
    hidden: list[str]
    unknown: str
    found: list[list[str]]
    false_names: int = 0
    amplitude_errors: list[float] = field(default_factory=list)
    listed: list[str] = field(default_factory=list)
    flagged: bool = False
    order_right: bool | None = None
    over_floor: float | None = None
    running_over_floor: float | None = None
    covered: int | None = None
    trusted: bool | None = None
    seconds: float = 0.0

    @property
    def exact(self) -> bool:
        return sorted(alike[0] for alike in self.found) == sorted(self.hidden)

    @property
    def right(self) -> bool:
        """All that is hidden named up to its class, no more; poor motions may say what they cannot show."""
        named = {self.hidden[h] for h, _ in matched(self.hidden, self.found)}
        excused = set(self.listed) if self.family in POOR else set()
        return self.false_names == 0 and set(self.hidden) <= named | excused


def matched(hidden: Sequence[str], found: Sequence[Sequence[str]]) -> list[tuple[int, int]]:
    """Pairs (hidden, found) of the largest assignment of names to classes that hold them."""
    best: list[tuple[int, int]] = []
    places = range(max(len(hidden), len(found)))
    for order in itertools.permutations(places, len(hidden)):
        pairs = [(h, f) for h, f in enumerate(order) if f < len(found) and hidden[h] in found[f]]
        best = max(best, pairs, key=len)
    return best


def prepared(made: records.Record) -> Record:
    columns = (made.time, made.input_angle, made.output_angle, made.torque, made.temperature)
    return prepare(*columns, np.zeros(made.time.size, dtype=np.int64), RATIO)


def size_of(made: records.Record, name: str, rows: np.ndarray | slice = slice(None)) -> float:
    """Rms at the output of what a cause adds [rad], on some samples."""
    return float(np.std(records.added_by(made, name)[rows]))


def score(made: records.Record, family: str, seed: int) -> Score:
    """Score of the package's diagnosis."""
    begin = time.process_time()
    found = diagnose(prepared(made), CONFIGURED, np.random.default_rng(0))
    seconds = time.process_time() - begin
    named = [[finding.name] for finding in found.findings] + [list(cause.alike) for cause in found.causes]
    sizes = [float("nan")] * len(found.findings) + [cause.amplitude for cause in found.causes]
    judged = np.searchsorted(made.time, found.record.time[usable(found.record)])  # amplitudes are of these
    result = scored("hd_diag", made, family, seed, named, sizes, judged)
    result.listed = [t.name for t in found.testable if not t.testable and t.name in result.hidden]
    result.seconds = seconds
    _judge_unknown(result, made, found)
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
    """Names and sizes of any method, judged."""
    hidden, unknown = made.truth["hidden"], "".join(made.truth["unknown"])
    result = Score(method, family, seed, list(hidden), unknown, named)
    pairs = matched(hidden, named)
    result.false_names = len(named) - len(pairs)
    for h, f in pairs:
        if hidden[h] not in SIZED_OTHERWISE:
            result.amplitude_errors.append(abs(sizes[f] / size_of(made, hidden[h], rows) - 1.0))
    return result


def _judge_unknown(result: Score, made: records.Record, found: Diagnosis) -> None:
    result.flagged = bool(found.unexplained)
    kind = SHAPES.get(result.unknown)
    if kind is None or kind.order is None:
        return
    true = kind.order / RATIO if kind.frame == "output" else kind.order
    result.order_right = any(abs(line.order - true) < ORDER_TOLERANCE for line in found.unexplained)


def _judge_fit(result: Score, made: records.Record, found: Diagnosis) -> None:
    if found.rms is None or found.refitted is None:
        return
    unseen, _ = held_out(found.record)
    unseen &= usable(found.record)
    at = np.searchsorted(made.time, found.record.time[unseen])
    noise = (made.output_angle - made.clean_output)[at]
    floor = float(np.sqrt(np.mean(noise**2)))
    result.over_floor, result.running_over_floor = found.rms.offline / floor, found.rms.extended / floor
    result.covered = covered(found, made)
    result.trusted = found.refitted.trustworthy


def covered(found: Diagnosis, made: records.Record) -> int:
    """How many of the seven parameters are within their 95 % interval, lobes swapped or not."""
    assert found.refitted is not None
    truth, spread = true_vector(made), np.sqrt(np.diag(found.refitted.covariance))
    offs = (found.refitted.parameters - truth, found.refitted.parameters - MIRROR * truth)
    off = min(offs, key=lambda x: float(np.hypot(*x[:2]) + np.hypot(*x[2:4])))
    return int(np.sum(np.abs(off) < 1.96 * spread))


def true_vector(made: records.Record) -> np.ndarray:
    """True parameters in the units of the fit, shape (7,)."""
    b = made.base
    shift, runout = b.e * np.exp(1j * b.psi), b.runout * np.exp(1j * b.runout_psi)
    compliance = b.compliance / CONFIGURED.mesh.tooth_compliance
    values = [shift.real, shift.imag, runout.real, runout.imag, b.datum, compliance, b.cup]
    return np.array(values) / [scale.si for scale in fit_parameters.SCALES]


def plain(result: Score) -> dict[str, object]:
    """For JSON."""
    return {**dataclasses.asdict(result), "exact": result.exact, "right": result.right}
