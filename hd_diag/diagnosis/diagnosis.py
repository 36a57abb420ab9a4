"""The whole diagnosis of one joint: checks, refit, causes, unexplained parts, gain on data never fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import compress, filterfalse
from typing import Any, NamedTuple

import numpy as np

from hd_diag.diagnosis.detectability import NOT_PROVED, Detectability, testability
from hd_diag.diagnosis.extension import encoder_zeros, extended_model
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import linearise
from hd_diag.diagnosis.fit.motor_torque import less_motor
from hd_diag.diagnosis.fit.refit import Refit, refit, usable
from hd_diag.diagnosis.gain import MISFIT, Gain, Misfit, Rms, held_out, renumbered
from hd_diag.diagnosis.noise import ORDER
from hd_diag.diagnosis.predictive import most_predictive
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.screening import Screened, screened, without_misleading_torque
from hd_diag.diagnosis.search.acceptance import FAMILY_ERROR, chance_in_misfit
from hd_diag.diagnosis.search.causes import Cause, Search, doubted, motor_deviations, refitted
from hd_diag.diagnosis.search.minima import is_only_minimum
from hd_diag.diagnosis.search.order_table import OrderRow
from hd_diag.diagnosis.search.selection import search
from hd_diag.diagnosis.search.unexplained import Unexplained, unexplained
from hd_diag.diagnosis.search.unmodelled_terms import UnmodelledTerm
from hd_diag.diagnosis.work import Work
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.effects.effect import Stage
from hd_diag.extended_model import ExtendedModel
from hd_diag.formatting import words

_MOST_ALIKE = 5  # causes that a class may hold and still say something
_UNDONE = 1.5  # times what the configured drive leaves, that a cause may be of which others undo a part
_TORQUE_ALONE = frozenset(("torque", "run"))  # what a law of the torque is computed from
_TESTED = 0.9  # of the time that a diagnosis may take, by which what could have been shown is tested
_NO_LAWS = ("no law was found", "no law was found")
_BY_TORQUE = ("friction", "torsion")  # kinds of causes that a motor's own friction and constant imitate
_BY_MOTOR = "a motor's own friction and constant imitate it: measure the torque at the joint"
_HIDDEN = "more than noise is left: what else is wrong may hide it"
_AMBIGUOUS = "the parameters are ambiguous: with others it may be there"


class Allowed(NamedTuple):
    """The eccentricity that an assembly may have [m], and the criterion that it is by."""

    eccentricity: float
    criterion: str


@dataclass(frozen=True)
class Diagnosis:
    """Result for one joint; `orders` is its order table where no tooth model was fitted.

    `kept` are the parameters that stay as configured, for held-out data are predicted no better with others,
    and how far off each may be, at 95 % (SI). What is `allowed` is not found here: a caller adds it.
    `encoder_zeros` are those of the recordings [rad]; `motor_std` are the standard deviations of what a motor
    needs of its current, by name; `left_out` is what there was no time for, in words.
    """

    record: Record
    configured: Drive
    findings: tuple[Finding, ...]
    refitted: Refit | None = None
    found: Search | None = None
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
        """What the extended model leaves over the noise; None where nothing was fitted."""
        return self.rms.misfit if self.rms else None

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Causes found that the record can tell, most explaining first."""
        return tuple(filter(self._is_named, self.found.causes if self.found else ()))

    @property
    def hints(self) -> tuple[Cause, ...]:
        """The others: nearest to what the record shows, and in the model, but not to be named for it."""
        return tuple(filterfalse(self._is_named, self.found.causes if self.found else ()))

    @property
    def predicting(self) -> bool:
        """Whether held-out rows are predicted better with the causes than without, or as configured."""
        rms = self.rms
        return rms is None or rms.by_causes < rms.without_causes

    def is_undone(self, cause: Cause) -> bool:
        """Whether a cause is plainly more than all that the configured drive leaves: others undo it.

        Of a law of the torque what is straight counts as a compliance, of which it is no part to undo.
        """
        size = cause.own if _TORQUE_ALONE.issuperset(cause.effect.needs) else cause.amplitude
        return self.rms is not None and size > _UNDONE * self.rms.nominal

    def _is_named(self, cause: Cause) -> bool:
        """Whether a cause is named; not if too many others explain as much, or the parameters are ambiguous.

        Nor in a misfit, or where one may be that is larger than what it explains, or beside which that may be
        chance: what else is wrong may look like it. Nor if held-out rows are predicted no better with the
        causes, or if others undo it. Where the torque is a motor's current nothing is named that may be
        friction, torsion or the torque's reading: the motor's own friction and constant are fitted too, and
        not known well enough.
        """
        named = self.predicting and not self.is_undone(cause) and len(cause.alike) <= _MOST_ALIKE
        if self.rms and self.misfit and self.found and self.misfit.suspected:
            p_value = chance_in_misfit(cause.p_value, self.found.family, self.misfit.value)
            named = named and cause.own > self.rms.beyond_noise and p_value <= FAMILY_ERROR
        return named and not cause.doubtful and not self._nameless.keys() & set(cause.alike)

    @property
    def undecided(self) -> dict[str, str]:
        """Effects that are neither found nor absent, and why."""
        of_hints = {name: NOT_PROVED for cause in self.hints for name in cause.alike}
        of_classes = {
            name: f"this record cannot tell it from {words(cause.alike[0])}"
            for cause in self.causes
            for name in cause.alike[1:]
        }
        return of_hints | of_classes | self._nameless

    @property
    def _nameless(self) -> dict[str, str]:
        """Effects that would not be named whatever their size, and why."""
        names, why = [effect.name for effect in self.catalogue], ""
        if self.misfit and self.misfit.certain:
            why = _HIDDEN
        elif self.refitted and not self.refitted.trustworthy:
            why = _AMBIGUOUS
        elif self.record.by_current:
            of_motor = (
                effect.kind in _BY_TORQUE or effect.stage == Stage.TORQUE for effect in self.catalogue
            )
            names, why = list(compress(names, of_motor)), _BY_MOTOR
        return dict.fromkeys(names, why) if why else {}

    @property
    def order_table(self) -> tuple[OrderRow, ...]:
        """Waves without a cause, the largest first; those that repeat are in the model."""
        return self.found.table if self.found else self.orders

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Fitted parameters by name: value, std, unit, configured; empty where nothing was fitted."""
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
        A caller who screens a long record first need not keep it.
    configured : Drive
        The simulation as configured.
    rng : numpy.random.Generator
        For bootstrap intervals.
    work : Work, optional
        Reports how far this is. Where its time is too short the result says what was left out; the fit, the
        gain and what no cause explains never are.
    catalogue : tuple of Effect
        Causes to search among.
    """
    work = work or Work()
    checked = record if isinstance(record, Screened) else screened(record, configured)
    record, findings = checked
    if any(finding.fatal for finding in findings):
        return Diagnosis(record, configured, findings, catalogue=catalogue)
    apart = renumbered(record)
    # Single rows of a long record weigh nothing in a fit, which must know of what came between.
    together = (np.bincount(apart.run) > ORDER)[apart.run]
    test, which = held_out(record, usable(record) & together)
    record, test = apart, test & together
    record, misleading = without_misleading_torque(record, configured, test, rng)
    findings = (*findings, *([misleading] if misleading else []))
    work.tell(0.02, "fitting the model's own parameters")
    if record.by_current:
        begun, first = less_motor(record, configured, ~test, rng, catalogue, work)
    else:
        first = refit(renumbered(record.select(~test)), configured, rng)
        begun = linearise(record, configured, first.parameters, rows=~test, catalogue=catalogue, work=work)
    work.tell(0.12, "looking for causes")
    plain = settle(begun, begun.data.given)
    found = search(plain, rng, first)
    work.tell(0.73, "measuring the gain")
    best = most_predictive(record, test, which, plain, found, rng)
    kept, rms, gain = best.kept, best.rms, best.gain
    work.tell(0.86, "using all data")
    # A shape without a cause has columns of its rows, of which there may be more here.
    present = (one for one in best.found.fit.present if not isinstance(one[0][0], UnmodelledTerm))
    every = replace(best.every, held=kept.held).beside(tuple(present))
    whole = doubted(refitted(settle(every, best.found.chosen), best.found))
    searched = best.found
    del begun, plain, found, best, every  # some hundred columns each
    # As of an average whose parts disagree: Birge, Phys. Rev. 40 (1932).
    wider = rms.misfit.value if rms.misfit.suspected else 1.0
    parameters, spread = kept.spread(whole)
    # Minima beside a drive without displacement are no rivals of it; nor those that only a cause made alike.
    certain = (
        first.trustworthy or "eccentricity" in kept.bounds or is_only_minimum(whole.fit, whole.chosen, rng)
    )
    trustworthy = certain and not fit_parameters.at_bound(parameters, configured)
    drive = fit_parameters.drive_of(parameters, configured)
    work.tell(0.92, "looking at what no cause explains")
    left = _described(record, unexplained(whole), rms)
    result = Diagnosis(
        record,
        configured,
        findings,
        Refit(drive, parameters, wider**2 * spread, trustworthy),
        whole,
        rms,
        gain,
        {name: wider * bound for name, bound in kept.physical(configured).items()},
        left,
        model=extended_model(whole, configured, record),
        catalogue=catalogue,
        encoder_zeros=tuple(encoder_zeros(whole).tolist()),
        motor_std=motor_deviations(whole),
    )
    with work.until(_TESTED, "testing what this motion could have shown"):
        result = replace(result, testable=testability(searched, rms, result.undecided))
    return replace(result, left_out=tuple(work.left_out))


def _described(record: Record, lines: list[Unexplained], rms: Rms) -> tuple[Unexplained, ...]:
    """What no cause explains; where more than noise is left there is always an entry."""
    beyond = math.sqrt(2.0 * max(rms.extended**2 - rms.noise**2, 0.0))
    if rms.extended > MISFIT * rms.noise and not rms.misfit.suspected:
        what, amplitude = "is left only as the model runs: its signals are late", beyond
        if rms.wandering:
            what = "wanders in phase or amplitude, which the fit follows and a model that runs cannot"
            amplitude = math.sqrt(2.0) * rms.wandering
        lines = [*lines, Unexplained(0.0, "input", amplitude, *_NO_LAWS, what)]
    if lines or not rms.misfit.suspected:
        return tuple(lines)
    what = "is left, in no shape that was tried"
    if not rms.repeated:
        means = "drive the same motion twice" if record.has_torque else "record the torque"
        what += f": {means}, and noise can be separated from it"
    return (Unexplained(0.0, "input", beyond, *_NO_LAWS, what),)
