"""The whole diagnosis of one joint: checks, refit, causes, unexplained parts, gain on data never fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.extension import extended_model, running_residual
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit, linearise
from hd_diag.diagnosis.fit.refit import Refit, refit, usable
from hd_diag.diagnosis.noise import ORDER, slices
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.screening import Screened, screened
from hd_diag.diagnosis.search.causes import Cause, Search, parameters_of, refitted
from hd_diag.diagnosis.search.detectability import Testability, testability
from hd_diag.diagnosis.search.selection import search
from hd_diag.diagnosis.search.unexplained import Unexplained, unexplained
from hd_diag.diagnosis.search.unmodelled_terms import UnmodelledTerm
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.extended_model import ExtendedModel

Rows = npt.NDArray[np.bool_]

_HELD_OUT = 4  # every fourth run, or stretch of a single run, is held out
_STRETCHES = 12
_SLICE = 1.0  # length of a block of the bootstrap [s]
_DRAWS = 2000


@dataclass(frozen=True)
class Rms:
    """Root mean squares on held-out data [rad].

    `extended` is that of the model as it runs, with causal signals, along the record; `offline` that of the
    fit's own signals; `live` that of the model as it runs with the torque as reported, not smoothed.
    """

    nominal: float
    refit: float
    extended: float
    offline: float
    live: float
    noise: float
    noise_low: float
    noise_high: float


@dataclass(frozen=True)
class Gain:
    """Share of the nominal model's mean square that the extended model explains, with its 95 % interval."""

    fraction: float
    low: float
    high: float
    held_out: str


@dataclass(frozen=True)
class Diagnosis:
    """Result for one joint."""

    record: Record
    configured: Drive
    findings: tuple[Finding, ...]
    refitted: Refit | None
    found: Search | None
    rms: Rms | None
    gain: Gain | None
    unexplained: tuple[Unexplained, ...] = ()
    testable: tuple[Testability, ...] = ()
    model: ExtendedModel | None = None
    catalogue: Catalogue = CATALOGUE

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Causes found, most explaining first."""
        return self.found.causes if self.found else ()

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Fitted parameters by name: value, std, unit, configured; empty where nothing was fitted."""
        fit = self.refitted
        return fit_parameters.physical(fit.parameters, fit.covariance, self.configured) if fit else {}


def diagnose(
    record: Record | Screened,
    configured: Drive,
    rng: np.random.Generator,
    progress: Callable[[str], None] = lambda text: None,
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
    progress : callable
        Called with what is being done.
    catalogue : tuple of Effect
        Causes to search among.
    """
    checked = record if isinstance(record, Screened) else screened(record, configured, progress)
    record, findings = checked.record, checked.findings
    if any(finding.fatal for finding in findings):
        return Diagnosis(record, configured, findings, None, None, None, None, catalogue=catalogue)
    test, which = held_out(record)
    record = _renumbered(record)
    # Single rows of a long record weigh nothing in a fit, which must know of what came between.
    test &= (np.bincount(record.run) > ORDER)[record.run]
    progress("fitting the model's own parameters")
    first = refit(_renumbered(record.select(~test)), configured, rng)
    progress("looking for causes")
    begun = linearise(record, configured, first.parameters, rows=~test, catalogue=catalogue)
    plain = settle(begun, ())
    found = search(plain, rng, progress)
    progress("measuring the gain")
    rows = usable(record, found.torque_shift)
    every = linearise(record, configured, found.fit.parameters, rows=rows, catalogue=catalogue)
    rms, gain = _gain(record, test, which, plain, found, every, rng)
    progress("using all data")
    whole = refitted(settle(every, found.chosen), found)
    del begun, plain, found, every  # some hundred columns each
    parameters, covariance = parameters_of(whole)
    drive = fit_parameters.drive_of(parameters, configured)
    progress("looking at what no cause explains")
    return Diagnosis(
        record,
        configured,
        findings,
        Refit(drive, parameters, covariance, first.trustworthy),
        whole,
        rms,
        gain,
        tuple(unexplained(whole)),
        tuple(testability(whole)),
        extended_model(whole, configured, record),
        catalogue,
    )


def held_out(record: Record) -> tuple[Rows, str]:
    """Rows that no fit sees, shape (n,), and in words which: whole runs if there are enough, or stretches."""
    if record.extent.runs >= _HELD_OUT:
        rows = record.run % _HELD_OUT == _HELD_OUT - 1
        if 0.1 < rows.mean() < 0.5:
            return rows, f"{np.unique(record.run[rows]).size} of {record.extent.runs} runs"
    stretch = np.arange(record.size) * _STRETCHES // record.size
    which = f"{_STRETCHES // _HELD_OUT} of {_STRETCHES} stretches of the record"
    return stretch % _HELD_OUT == _HELD_OUT - 1, which


def _renumbered(record: Record) -> Record:
    """Run numbers from zero, with a new run wherever rows are missing."""
    step = float(np.median(np.diff(record.time)))
    change = (np.diff(record.run) != 0) | (np.diff(record.time) > 20.0 * step)
    return replace(record, run=np.concatenate(([0], np.cumsum(change))).astype(np.int64))


def _gain(
    record: Record,
    test: Rows,
    which: str,
    plain: LinearisedFit,
    found: Search,
    every: LinearisedFit,
    rng: np.random.Generator,
) -> tuple[Rms, Gain]:
    """Residuals of held-out rows; `every` fits all rows, so that its effects remember what came before."""
    plain = replace(plain, whiten=found.fit.whiten)  # one noise model, that of the whole model, for both
    configured, fitted = every.data.configured, every.data.mask
    kept, rows = fitted[test], test[fitted]
    nominal = _nominal_residual(record, configured, test, fitted)
    model = extended_model(found, configured, record.select(~test))
    extended, live = (
        running_residual(model, record, torque, model.torsion_map)[test][kept]
        for torque in (record.torque, record.reported_torque)
    )
    noise, own = found.fit.noise_residual, found.fit.data
    noise_number = slices(own.record.time, own.run, _SLICE)
    squares, counts = _sums(noise**2, noise_number), _sums(np.ones(noise.size), noise_number)
    noise_low, noise_high = np.sqrt(_ratio_interval(squares, counts, rng)).tolist()
    freedom = noise.size / max(noise.size - found.fit.always().shape[1] - 30, 1)
    unseen = _renumbered(record.select(test))
    number = slices(unseen.time[kept], unseen.run[kept], _SLICE)
    before, after = _sums(nominal**2, number), _sums(extended**2, number)
    high, low = (1.0 - _ratio_interval(after, before, rng)).tolist()
    rms = Rms(
        nominal=_rms(nominal),
        refit=_rms(_residual_of(every.moved(plain.parameters), plain, ())[rows]),
        extended=_rms(extended),
        offline=_rms(_residual_of(every, found.fit, found.chosen)[rows]),
        live=_rms(live[np.isfinite(live)]),
        noise=_rms(noise) * float(np.sqrt(freedom)),
        noise_low=noise_low,
        noise_high=noise_high,
    )
    return rms, Gain(1.0 - float(after.sum() / before.sum()), low, high, which)


def _nominal_residual(record: Record, configured: Drive, test: Rows, fitted: Rows) -> Floats:
    """Residual of the configured drive on held-out rows, less the encoders' offset on others [rad]."""

    def residual(rows: Rows | Integers) -> Floats:
        part = record.select(rows)
        error, _, _ = fit_parameters.along(configured, configured, part.input_angle, part.torque)
        return np.asarray(part.output_angle - part.input_angle / configured.kinematics.ratio - error)

    return residual(fitted & test) - float(residual(np.flatnonzero(fitted & ~test)[::10]).mean())


def _residual_of(fit: LinearisedFit, trained: LinearisedFit, chosen: Chosen) -> Floats:
    """Residual of all rows of a fit, with coefficients trained on some rows [rad].

    Unmodelled terms are fitted, but are no part of the model; nor is what a cause wanders by.
    """
    beta, _, _ = trained.fit(chosen)
    fixed = fit.always()
    residual = fit.uncorrected - fixed @ beta[: fixed.shape[1]]
    sized = tuple((item, part[: item[0].size]) for item, part in trained.sized(chosen, beta))
    beside = fit.beside(sized)
    for (effect, nonlinear), coefficients in sized:
        if not isinstance(effect, UnmodelledTerm):
            residual = residual - beside.full_size(effect, nonlinear, coefficients)
    return np.asarray(residual)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _sums(values: Floats, number: Integers) -> Floats:
    return np.asarray(np.bincount(number, values), np.float64)


def _ratio_interval(top: Floats, bottom: Floats, rng: np.random.Generator) -> Floats:
    """95 % interval of a ratio of sums by bootstrap of their parts, shape (2,)."""
    draws = rng.integers(0, top.size, (_DRAWS, top.size))
    return np.asarray(np.quantile(top[draws].sum(axis=1) / bottom[draws].sum(axis=1), (0.025, 0.975)))
