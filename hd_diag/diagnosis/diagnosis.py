"""The whole diagnosis of one joint: checks, refit, causes, unexplained parts, gain on held-out data."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.calibration import HINTED, LEAST_SIZE, MISFIT, MORE, WORSE
from hd_diag.diagnosis.detectability import NOT_PROVED, Detectability, testability
from hd_diag.diagnosis.evidence.kept_parameters import DISPLACEMENTS, HELD, Kept, kept_parameters
from hd_diag.diagnosis.evidence.naming import standings
from hd_diag.diagnosis.evidence.order_table import OrderRow
from hd_diag.diagnosis.evidence.search import FURTHER_CAUSES, of_motor, search, without_causes
from hd_diag.diagnosis.evidence.sets import Set
from hd_diag.diagnosis.evidence.solution import Cause, Function, Solution, motor_deviations, solution
from hd_diag.diagnosis.evidence.undeclared_current import is_current, is_suspected
from hd_diag.diagnosis.evidence.unexplained import Unexplained, unexplained, with_table
from hd_diag.diagnosis.extension import encoder_zeros, extended_model
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import GROUPS, numbers_of
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.fit.motor_torque import less_motor
from hd_diag.diagnosis.fit.refit import AMBIGUOUS, Refit, refit, usable
from hd_diag.diagnosis.gain import Gain, Misfit, Rms, Rows, held_out, measured_gain, renumbered
from hd_diag.diagnosis.noise import ORDER
from hd_diag.diagnosis.record import MINIMUM_SAMPLES, Record
from hd_diag.diagnosis.screening import Screened, screened, without_misleading_torque
from hd_diag.diagnosis.subsampling import some_rows
from hd_diag.diagnosis.work import Work
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.extended_model import ExtendedModel
from hd_diag.formatting import words

_ROUNDING = 1e-12  # rounding error of a transmission error [rad]
_SIZED_ROWS = 2000  # rows that measure the effect of a parameter group
_SEARCHED_ROWS = 6_000  # rows of a search; more cost time and resolve large effects no better
_TESTED = 0.9  # share of the time limit at which the detectability test must end
_KEPT = 0.7  # the same, for testing which parameters are as configured
_KEPT_TEST = "testing which parameters may be as configured"
_NO_LAWS = ("no law was found", "no law was found")
_RATIO = "ratio_error"
# Once per output turn, as gravity is; over part of a turn, a ramp.
_BY_GRAVITY = ("output_runout", "output_encoder_eccentricity", _RATIO)
_BY_MOTOR = "a motor's own friction and constant imitate it: measure the torque at the joint"
_OTHER_ANGLE = "the ratio is off, and with it the angle at which the teeth meet: correct it first"
_HIDDEN = "more than noise is left at the gear's lines: what else is wrong may hide it"
_AT_BOUND = "a parameter is as far off as it can be: something else takes part in it"
_UNFINISHED = "there was no time to weigh them against all causes"
_NOT_PREDICTED = "held-out data are predicted no better with the causes than without"
_SHAPE = "it is the torsion's own shape: see the function of torque"
_PARAMETERS = "it is a parameter of the model: see these"
_NO_CAUSES = {"torsional_hardening": _SHAPE, "torque_gain": _PARAMETERS, "wear_backlash": _PARAMETERS}
"""Effects that duplicate parameters or remainders, and the reason why they are not named."""


class Allowed(NamedTuple):
    """Largest eccentricity that an assembly may have [m], and the criterion that limits it."""

    eccentricity: float
    criterion: str


@dataclass(frozen=True)
class Diagnosis:
    """Result for one joint; `orders` is its order table if no tooth model was fitted.

    `kept` maps each parameter that stays as configured, because the evidence is about as good with it, to how
    far off it may be, at 95 % (SI). The caller sets `allowed`; the diagnosis does not compute it.
    `encoder_zeros` holds one zero per recording [rad]. `motor_std` holds the standard deviations of what the
    motor takes of its current, by name. `left_out` lists the steps that were skipped for lack of time.
    """

    record: Record
    configured: Drive
    findings: tuple[Finding, ...]
    refitted: Refit | None = None
    found: Solution | None = None
    rms: Rms | None = None
    gain: Gain | None = None
    kept: dict[str, float] = field(default_factory=dict)
    unexplained: tuple[Unexplained, ...] = ()
    testable: tuple[Detectability, ...] = ()
    model: ExtendedModel | None = None
    catalogue: Catalogue = CATALOGUE
    orders: tuple[OrderRow, ...] = ()
    allowed: Allowed | None = None
    encoder_zeros: tuple[float, ...] = ()
    motor_std: dict[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    @property
    def misfit(self) -> Misfit | None:
        """Residual of the extended model over the noise; None if nothing was fitted."""
        return self.rms.misfit if self.rms else None

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Causes that can be named without doubt; the one with the largest gain first."""
        return tuple(cause for cause in (self.found.causes if self.found else ()) if not self.doubt(cause))

    @property
    def hints(self) -> tuple[Cause, ...]:
        """Causes that are probable and in the model, but too doubtful to be named."""
        return tuple(
            cause
            for cause in (self.found.causes if self.found else ())
            if self.doubt(cause) and cause.standing.probability >= HINTED
        )

    @property
    def predicting(self) -> bool:
        """Whether held-out rows are predicted better with causes than without, refitted or as configured."""
        rms = self.rms
        return rms is None or rms.with_causes < rms.without_causes

    def doubt(self, cause: Cause) -> str:
        """The first reason why a cause is not named; empty if it is named.

        If the residual exceeds the fit's noise, other effects may imitate the cause, so evidence counts less.
        """
        times = self.rms.overstated(cause.standing.slow) if self.rms else 1.0
        if doubt := cause.standing.beside(times).doubt:
            return doubt
        if cause.effect.name not in cause.alike:
            return f"{words(cause.alike[0])} explains it better"
        why = next((self._nameless[name] for name in cause.alike if name in self._nameless), "")
        return why or ("" if self.predicting else _NOT_PREDICTED)

    @property
    def undecided(self) -> dict[str, str]:
        """Effects that are neither found nor excluded, and the reason."""
        doubted = [cause for cause in (self.found.causes if self.found else ()) if self.doubt(cause)]
        of_hints = {name: NOT_PROVED for cause in doubted for name in cause.alike}
        of_classes = {
            name: f"this record cannot tell it from {words(cause.alike[0])}"
            for cause in self.causes
            for name in cause.alike[1:]
        }
        return of_hints | of_classes | self._nameless

    @property
    def _nameless(self) -> dict[str, str]:
        """Effects that would not be named at any size, and the reason."""
        names, why = [effect.name for effect in self.catalogue], ""
        found = self.found.causes if self.found else ()
        if self.rms and self.rms.misfit.certain and self.rms.hides_lines:
            why = _HIDDEN
        elif self.refitted and fit_parameters.at_bound(self.refitted.parameters, self.configured):
            why = _AT_BOUND
        elif any(one.alike == (_RATIO,) and not one.standing.doubt for one in found):
            names.remove(_RATIO)
            why = _OTHER_ANGLE
        elif self.record.by_current:
            names = [one.name for one in self.catalogue if of_motor(one) or one.name in _BY_GRAVITY]
            why = _BY_MOTOR
        return _NO_CAUSES | (dict.fromkeys(names, why) if why else {})

    @property
    def untestable(self) -> tuple[Detectability, ...]:
        """Effects that this record could not have shown, except for those that it hints at."""
        hinted = {name for cause in self.hints for name in cause.alike}
        return tuple(test for test in self.testable if not test.testable and test.name not in hinted)

    @property
    def order_table(self) -> tuple[OrderRow, ...]:
        """Waves without a cause, the largest first; the model contains those that repeat."""
        return self.found.table if self.found else self.orders

    @property
    def functions(self) -> tuple[Function, ...]:
        """Slow unexplained functions of torque, speed, place and time, and the lines of any gear."""
        return self.found.functions if self.found else ()

    @property
    def larger(self) -> tuple[Function, ...]:
        """Functions that are larger than usual and large enough to report."""
        return tuple(one for one in self.functions if one.is_larger and one.rms >= LEAST_SIZE)

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Fitted parameters by name: value, std, unit, configured; empty if nothing was fitted."""
        fit = self.refitted
        return fit_parameters.physical(fit.parameters, fit.covariance, self.configured) if fit else {}


def diagnose(
    record: Record | Screened,
    configured: Drive,
    rng: np.random.Generator,
    work: Work | None = None,
    catalogue: Catalogue = CATALOGUE,
) -> Diagnosis:
    """Compare the model with a record and find the causes of the difference.

    Parameters
    ----------
    record : Record or Screened
        A caller can screen a long record first and free its memory.
    configured : Drive
        The simulation as configured.
    rng : numpy.random.Generator
        For bootstrap intervals.
    work : Work, optional
        Reports progress and limits the time. The result lists steps that were left out for lack of time; the
        fit, the gain and the unexplained parts are never left out.
    catalogue : tuple of Effect
        Causes to search among.
    """
    work = work or Work()
    checked = record if isinstance(record, Screened) else screened(record, configured)
    record, findings = checked
    if any(finding.fatal for finding in findings):
        return Diagnosis(record, configured, findings, catalogue=catalogue)
    apart = renumbered(record)
    # Isolated rows of a long record carry history for effects with memory but no weight in a fit.
    together = (np.bincount(apart.run) > ORDER)[apart.run]
    test, which = held_out(record, usable(record) & together)
    record, test = apart, test & together
    record, misleading = without_misleading_torque(record, configured, test, rng)
    findings = (*findings, *([misleading] if misleading else []))
    work.tell(0.02, "fitting the model's own parameters")
    fitted = partial(_fitted, configured=configured, test=test, rng=rng, catalogue=catalogue, work=work)
    record, start = _begun(record, fitted)
    work.tell(0.15, "looking for causes")
    found = search(start.fits, start.every, rng, start.torque_zero, start.first)
    best, kept = found.best, Kept({})
    work.tell(0.62, "testing which parameters are as configured")
    with work.until(_KEPT, _KEPT_TEST):
        best, kept = kept_parameters(best)
    measured = with_table(solution(best, standings(found), rng))
    fit, chosen = measured.fit, measured.chosen
    every = fit.on(usable(fit.data.source, measured.torque_shift)).beside(
        fit.sized(chosen, fit.fit(chosen)[0])
    )
    work.tell(0.7, "measuring the gain")
    without = settle(fit.beside(()), best.motor)
    rms, gain = measured_gain(record, test, which, without, measured, every, rng)
    alone: Solution | None = None
    wanders = any(effect.wanders(nonlinear) for effect, nonlinear in chosen)
    # Causes may cancel in a fit but not in the running model. Wandering does not count against a cause.
    if (rms.foretellable if wanders else rms.extended) > WORSE * rms.refit:
        alone = Solution(without, given=best.motor)
        of_alone, gain = measured_gain(record, test, which, without, alone, every.beside(()), rng)
        rms = rms.running(of_alone)
    work.tell(0.8, "using all data")
    whole = measured.at(settle(replace(every, whiten=fit.whiten), chosen, 2, learn=False))
    wider = _wider(rms, configured)
    parameters, spread = kept.spread(whole, found.rivals, found.datum_reach)
    spread = np.outer(wider, wider) * spread + np.diag(imitated(rms, record, configured, parameters) ** 2)
    doubts = {
        AMBIGUOUS: found.ambiguous,
        _AT_BOUND: bool(fit_parameters.at_bound(parameters, configured)),
        _UNFINISHED: not {FURTHER_CAUSES, _KEPT_TEST}.isdisjoint(work.left_out),
    }
    drive = fit_parameters.drive_of(parameters, configured)
    work.tell(0.9, "looking at what no cause explains")
    whole = replace(whole, table=measured.table)
    left = _described(record, unexplained(whole), rms, wanders)
    result = Diagnosis(
        record,
        configured,
        findings,
        Refit(drive, parameters, spread, next((doubt for doubt, holds in doubts.items() if holds), "")),
        whole,
        rms,
        gain,
        {name: wider[GROUPS[name][0]] * bound for name, bound in kept.physical(configured).items()},
        left,
        model=extended_model(alone or whole, configured, record),
        catalogue=catalogue,
        encoder_zeros=tuple(encoder_zeros(whole).tolist()),
        motor_std=motor_deviations(whole),
    )
    with work.until(_TESTED, "testing what this motion could have shown"):
        result = replace(result, testable=testability(best, result.undecided))
    return replace(result, left_out=tuple(work.left_out))


class _Start(NamedTuple):
    """What a search begins with.

    Fits of some rows, the set without causes at the first of them, the fit of all rows, and the torque's zero
    [N m].
    """

    fits: list[LinearisedFit]
    first: Set
    every: LinearisedFit
    torque_zero: float


def _begun(record: Record, fitted: Callable[[Record], _Start]) -> tuple[Record, _Start]:
    """The record and what a search begins with: its torque may be a current that nobody declared."""
    start = fitted(record)
    if is_suspected(start.first):
        current = fitted(replace(record, by_current=True))
        if is_current(start.first, current.first):
            return replace(record, by_current=True, undeclared=True), current
    return record, start


def _fitted(
    record: Record, configured: Drive, test: Rows, rng: np.random.Generator, catalogue: Catalogue, work: Work
) -> _Start:
    """The parameters fitted to all rows that are not held out, from many starts."""
    if record.by_current:
        every, first = less_motor(record, configured, ~test, rng, catalogue, work)
    else:
        first = refit(renumbered(record.select(~test)), configured, rng)
        every = linearise(record, configured, first.parameters, rows=~test, catalogue=catalogue, work=work)
    every = every.passed()
    fits = _starts(every, test, some_rows(record, _SEARCHED_ROWS))
    return _Start(fits, without_causes(fits[0]), every, first.torque_zero)


def _starts(begun: LinearisedFit, test: Rows, some: Integers) -> list[LinearisedFit]:
    """Starting points of a search, on `some` rows that are not held out: as refitted and as configured."""
    data = begun.data
    record = renumbered(data.source.select(some))
    # Isolated rows only carry the history of causes with memory.
    rows = ~test[some] & (np.bincount(record.run) > ORDER)[record.run]
    fit = begun.in_record(record, rows)
    # A fragmented record may have hardly any usable stretch in the subset.
    fit = (fit if fit.data.at.size >= MINIMUM_SAMPLES else begun).beside(begun.present)
    as_configured = fit_parameters.vector(data.configured, data.configured)
    if record.by_current:
        return [fit]
    displaced = numbers_of(HELD & fit_parameters.groups(data.configured).keys())
    return [fit, replace(fit.moved(as_configured), held=tuple(sorted(displaced)))]


def _wider(rms: Rms, configured: Drive) -> Floats:
    """Factors (p,) by which the parameters' deviations grow if the residual exceeds the noise.

    Averages of disagreeing parts are treated likewise (Birge, Phys. Rev. 40, 1932). Displacements act within
    turns of the input, so a slow residual does not count for them.
    """
    left = rms.misfit.value if rms.misfit.suspected else 1.0
    found = np.full(fit_parameters.count(configured), left)
    found[numbers_of(DISPLACEMENTS)] = min(left, max(rms.gear, 1.0))
    return found


def imitated(rms: Rms, record: Record, configured: Drive, parameters: Floats) -> Floats:
    """Deviations of displacements (p,), which may imitate the residual at the gear's lines; else zero."""
    found, left = np.zeros(parameters.size), rms.noise * math.sqrt(max(rms.gear**2 - MORE**2, 0.0))
    if left == 0.0:
        return found
    sizes = parameter_sizes(record, configured, parameters)
    away = parameters - fit_parameters.vector(configured, configured)
    for name in sizes.keys() & HELD:
        numbers = numbers_of([name])
        if sizes[name] > _ROUNDING:  # without an eccentricity, a runout changes nothing
            found[numbers] = np.linalg.norm(away[numbers]) * left / sizes[name]
    return found


def parameter_sizes(record: Record, configured: Drive, parameters: Floats) -> dict[str, float]:
    """Change of the error when a group of parameters (p,) is reset to the configured [rad rms], by group."""
    some = record.select(usable(record)).thinned(_SIZED_ROWS)
    as_configured = fit_parameters.vector(configured, configured)

    def error(parameters: Floats) -> Floats:
        drive = fit_parameters.drive_of(parameters, configured)
        return fit_parameters.along(drive, configured, some.input_angle, some.torque)[0]

    whole, sizes = error(parameters), {}
    for name, numbers in fit_parameters.groups(configured).items():
        without = parameters.copy()
        without[list(numbers)] = as_configured[list(numbers)]
        sizes[name] = float(np.nanstd(whole - error(without)))
    return sizes


def _described(record: Record, lines: list[Unexplained], rms: Rms, wanders: bool) -> tuple[Unexplained, ...]:
    """Unexplained parts; there is always an entry if the residual exceeds the noise."""
    beyond = math.sqrt(2.0 * max(rms.extended**2 - rms.wandering**2 - rms.expected**2, 0.0))
    if wanders and rms.extended > MISFIT * rms.expected:
        what = "wanders in phase or amplitude, which the fit follows and a model that runs cannot"
        lines = [*lines, Unexplained(0.0, "input", math.sqrt(2.0) * rms.wandering, *_NO_LAWS, what)]
    elif rms.foretellable > MISFIT * rms.expected and math.isnan(rms.discarded) and not rms.misfit.suspected:
        what = "is left only as the model runs: with late signals, without parts that held-out data deny"
        lines = [*lines, Unexplained(0.0, "input", beyond, *_NO_LAWS, what)]
    if lines or not rms.misfit.suspected:
        return tuple(lines)
    what = "is left, in no shape that was tried"
    if not rms.repeated:
        means = "drive the same motion twice" if record.has_torque else "record the torque"
        what += f": {means}, and noise can be separated from it"
    return (Unexplained(0.0, "input", beyond, *_NO_LAWS, what),)
