"""The whole criticism of one joint: checks, refit, causes, what is left, gain on data never fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.extension import extended_model, left, map_of
from hd_diag.diagnosis.findings import Finding
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit, linearise, settle
from hd_diag.diagnosis.fit.refit import Refit, refit, usable
from hd_diag.diagnosis.noise import ORDER, bounds
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.screening import Screened, screened
from hd_diag.diagnosis.search.causes import Cause, Search, fitted, parameters_of
from hd_diag.diagnosis.search.detectability import Testability, testability
from hd_diag.diagnosis.search.selection import search
from hd_diag.diagnosis.search.unexplained import Line, lines
from hd_diag.diagnosis.search.unmodelled_terms import Foil
from hd_diag.drive import Drive
from hd_diag.effects import CATALOGUE, Catalogue
from hd_diag.extended_model import ExtendedModel

Rows = npt.NDArray[np.bool_]

_HELD_OUT = 4  # every fourth run, or stretch of a single run, is held out
_STRETCHES = 12
_SLICE = 1.0  # length of a block of the bootstrap [s]


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
    unexplained: tuple[Line, ...] = ()
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
    progress: Callable[[str], None] = lambda text: None,
    catalogue: Catalogue = CATALOGUE,
) -> Diagnosis:
    """Criticise the model by a record.

    Parameters
    ----------
    record : Record or Screened
        Screened already, a long one need not be kept.
    configured : Drive
        The simulation as configured.
    progress : callable
        Told what is being done.
    catalogue : tuple of Effect
        Causes to search among.

    Returns
    -------
    Diagnosis
    """
    looked = record if isinstance(record, Screened) else screened(record, configured, progress)
    record, findings = looked.record, looked.findings
    if any(finding.fatal for finding in findings):
        return Diagnosis(record, configured, findings, None, None, None, None, catalogue=catalogue)
    test, told = held_out(record)
    record = _renumbered(record)
    # Single rows of a long record weigh nothing in a fit, which must know of what came between.
    test &= (np.bincount(record.run) > ORDER)[record.run]
    train = _renumbered(record.select(~test))
    progress("fitting the model's own parameters")
    first = refit(train, configured)
    progress("looking for causes")
    begun = linearise(record, configured, first.parameters, rows=~test, catalogue=catalogue)
    plain = settle(begun, ())
    found = search(plain, progress)
    progress("measuring the gain")
    rows = usable(record, found.torque_shift)
    trained = linearise(record, configured, found.bench.parameters, rows=rows, catalogue=catalogue)
    rms, gain = _gain(record, test, told, configured, plain, found, trained)
    progress("using all data")
    whole = fitted(settle(trained, found.chosen), found)
    del begun, plain, found, trained  # some hundred columns each
    trusted = first.trustworthy
    parameters, covariance = parameters_of(whole)
    refitted = Refit(fit_parameters.drive_of(parameters, configured), parameters, covariance, trusted)
    progress("looking at what is left")
    return Diagnosis(
        record,
        configured,
        findings,
        refitted,
        whole,
        rms,
        gain,
        tuple(lines(whole)),
        tuple(testability(whole)),
        extended_model(whole, configured, record),
        catalogue,
    )


def held_out(record: Record) -> tuple[Rows, str]:
    """Rows that no fit sees, and in words which they are: whole runs where there are enough, else stretches.

    Parameters
    ----------
    record : Record

    Returns
    -------
    rows : ndarray of bool, shape (n,)
    told : str
    """
    if record.runs >= _HELD_OUT:
        rows = record.run % _HELD_OUT == _HELD_OUT - 1
        if 0.1 < rows.mean() < 0.5:
            return rows, f"{np.unique(record.run[rows]).size} of {record.runs} runs"
    stretch = np.arange(record.size) * _STRETCHES // record.size
    return (
        stretch % _HELD_OUT == _HELD_OUT - 1,
        f"{_STRETCHES // _HELD_OUT} of {_STRETCHES} stretches of the record",
    )


def _renumbered(record: Record) -> Record:
    """Run numbers from zero, with a new run wherever rows were taken out."""
    step = float(np.median(np.diff(record.time)))
    change = (np.diff(record.run) != 0) | (np.diff(record.time) > 20.0 * step)
    return replace(record, run=np.concatenate(([0], np.cumsum(change))).astype(np.int64))


def _gain(
    record: Record,
    test: Rows,
    told: str,
    configured: Drive,
    plain: LinearisedFit,
    found: Search,
    trained: LinearisedFit,
) -> tuple[Rms, Gain]:
    unseen = _renumbered(record.select(test))
    kept = trained.data.mask[test]
    rows = test[trained.data.mask]  # of a bench of the whole record, whose effects remember what came before
    nominal = _nominal_left(record, configured, test, trained.data.mask)
    refitted = _left_by(trained.moved(plain.parameters), plain, ())[rows]
    offline = _left_by(trained, found.bench, found.chosen)[rows]
    model = extended_model(found, configured, record.select(~test))
    table = map_of(model)
    extended, live = (
        left(model, record, torque, table)[test][kept] for torque in (record.torque, record.reported_torque)
    )
    time, run = unseen.time[kept], unseen.run[kept]
    noise = found.bench.noise_residual
    low, high = _rms_interval(noise, found.bench.data.record.time, found.bench.data.run)
    freedom = noise.size / max(noise.size - found.bench.always().shape[1] - 30, 1)
    slices = _slices(time, run)
    before, after = _sums(nominal**2, slices), _sums(extended**2, slices)
    rng = np.random.default_rng(0)
    draws = rng.integers(0, before.size, (2000, before.size))
    shares = 1.0 - after[draws].sum(axis=1) / before[draws].sum(axis=1)
    rms = Rms(
        _rms(nominal),
        _rms(refitted),
        _rms(extended),
        _rms(offline),
        _rms(live[np.isfinite(live)]),
        _rms(noise) * float(np.sqrt(freedom)),
        low,
        high,
    )
    fraction = 1.0 - float(after.sum() / before.sum())
    return rms, Gain(fraction, float(np.quantile(shares, 0.025)), float(np.quantile(shares, 0.975)), told)


def _nominal_left(record: Record, configured: Drive, test: Rows, kept: Rows) -> Floats:
    """What the configured drive leaves of held-out rows, the encoders' offset taken off [rad]."""
    known = np.flatnonzero(kept & ~test)[::10]
    offset = float(_left(record.select(known), configured).mean())
    return _left(record.select(kept & test), configured) - offset


def _left(record: Record, drive: Drive) -> Floats:
    """Measured less predicted error [rad]."""
    error, _, _ = fit_parameters.along(drive, drive, record.input_angle, record.torque)
    return np.asarray(record.output_angle - record.input_angle / drive.kinematics.ratio - error)


def _left_by(bench: LinearisedFit, trained: LinearisedFit, chosen: Chosen) -> Floats:
    """What a model trained on some rows leaves of all rows, at the parameters of training [rad].

    Shapes without a name are fitted, but are no part of a model; nor is what a cause wanders by.
    """
    beta, _, _ = trained.fit(chosen)
    fixed = bench.always()
    left = bench.uncorrected - fixed @ beta[: fixed.shape[1]]
    sized = tuple((item, part[: item[0].size]) for item, part in trained.sized(chosen, beta))
    beside = bench.beside(sized)
    for (effect, nonlinear), coefficients in sized:
        if not isinstance(effect, Foil):
            left = left - beside.full_size(effect, nonlinear, coefficients)
    return np.asarray(left)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _slices(time: Floats, run: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Numbers of consecutive stretches of about `_SLICE` seconds within runs."""
    result = np.zeros(time.size, dtype=np.int64)
    number = 0
    for begin, end in bounds(run):
        inner = ((time[begin:end] - time[begin]) / _SLICE).astype(np.int64)
        result[begin:end] = number + inner
        number = int(result[end - 1]) + 1
    return result


def _sums(values: Floats, slices: npt.NDArray[np.int64]) -> Floats:
    sums = np.bincount(slices, weights=values)
    return np.asarray(sums[np.bincount(slices) > 0])


def _rms_interval(values: Floats, time: Floats, run: npt.NDArray[np.int64]) -> tuple[float, float]:
    """95 % block bootstrap interval of an rms."""
    slices = _slices(time, run)
    sums, counts = _sums(values**2, slices), _sums(np.ones(values.size), slices)
    draws = np.random.default_rng(0).integers(0, sums.size, (1000, sums.size))
    rms = np.sqrt(sums[draws].sum(axis=1) / counts[draws].sum(axis=1))
    low, high = np.quantile(rms, (0.025, 0.975))
    return float(low), float(high)
