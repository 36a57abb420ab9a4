"""Checks of all rows and signals of a record before any fit, and the subset of rows that the fits get."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.drift import check_velocity
from hd_diag.diagnosis.findings import (
    Finding,
    check_ratio,
    declared,
    find_steps,
    follows,
    wrong_ratio,
)
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import lower_bound, projection
from hd_diag.diagnosis.fit.refit import nuisance, refit
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.regression import centered, regression
from hd_diag.diagnosis.stamps import UNPAIRED
from hd_diag.diagnosis.subsampling import LIMIT, subsample
from hd_diag.drive import Drive
from hd_diag.effects.quantity import turning
from hd_diag.formatting import ARCSEC

_TORQUE_SIGN = "torque_sign"  # after this finding the torque's sign is inverted
_NO_ERROR = 1e-7  # [rad]; a tenth of the resolution of a 26 bit encoder
_REPEATED = 0.05  # least share of rows for a finding
_OUT_OF_STEP = 0.012  # [s]; a smaller delay is a cause of the catalogue, found by a fit of the gear
_MOST_LEFT = 0.3  # largest residual with the speed over the one without it
_MOST_ROWS = 4000
_GRID = 20_001  # times in a recording
_MATCHED = 0.1  # largest difference of synchronised streams, over the output's travel, rms
_SIGMAS = 6.0
_MUCH = 0.02  # a larger slope over the angle means a wrong ratio
_LEAST_TORSION = 0.02  # least range of the torque, over the rated torque
_OTHER_UNIT = 4.0  # torsion over the configured one; no wrong stiffness explains more
_WRONG_SIGN = -0.3  # torsion over the configured one
_LEAST_REACH, _REACH_WITHOUT_TORQUE = 0.3, 1.5  # least output travel [rad]
_PARTNER_MISS = 0.15  # tolerance of the slope between a ratio and its partner, relative
_FULL_TURN = 360.0
_DEGREES, _DEGREES_MISS = 180.0 / math.pi, 0.3  # torsion over the configured one; its relative tolerance
_LEAST_IN_DEGREES = 0.01  # [rad]; no gear's error has a larger range
_WORSE = 1.3  # a torque misleads if the residual with it is larger by this factor
_BLOCKS, _MOST_UNSEEN = 8, 2000  # held-out blocks; most held-out rows in use
_MOST_TORQUE = 50.0  # over the rated torque; teeth skip at a fifth or half of this


class Screened(NamedTuple):
    """A record short enough to be fitted, without steps, and the findings from all rows."""

    record: Record
    findings: tuple[Finding, ...]


def screened(record: Record, configured: Drive, limit: int = LIMIT) -> Screened:
    """Check sensors, units, signs, ratio and steps in every row of a record; then keep at most `limit` rows.

    If the ratio is not that of the configured teeth, the tooth model describes another gear. Torsion is then
    not compared.
    """
    ratio, teeth = configured.kinematics.ratio, configured.kinematics.of_teeth
    wrong = _one_sensor(record, ratio) or _wrapped_degrees(record)
    wrong = wrong or check_velocity(record, configured.kinematics) or _out_of_step(record, ratio)
    if not record.by_velocity:  # an integrated velocity may drift freely
        wrong = wrong or check_ratio(record, ratio)
    wrong = wrong or _partner_ratio(record, configured)
    if teeth:
        wrong = wrong or _other_units(record, configured)
    stamps = _lost_samples(record)
    if wrong is not None:
        return Screened(subsample(record, limit), (wrong, *stamps))
    record, again = _without_repeated_rows(record)
    # If the teeth are unknown, assume two more on the circular spline, as in nearly all gears.
    pitch = configured.mesh.geometry.tooth_pitch if teeth else math.pi / abs(ratio)

    def torsion(angle: Floats, torque: Floats) -> Floats:
        return fit_parameters.along(configured, configured, angle, torque)[0]

    correction, steps = find_steps(record, ratio, pitch, torsion if teeth and record.has_torque else None)
    if steps:
        record = replace(record, output_angle=record.output_angle - correction)
    del correction  # one hour takes 30 MB per column
    record = subsample(record, limit)
    torque = _wrong_torque(record, configured) if teeth else None
    found = [one for one in (torque, *stamps, again, *steps) if one is not None]
    if torque is not None and torque.name == _TORQUE_SIGN:
        record = replace(record, torque=-record.torque, reported_torque=-record.reported_torque)
    return Screened(record, tuple(found))


def _one_sensor(record: Record, ratio: float) -> Finding | None:
    """A finding if the output angle equals the input angle over the ratio, digit by digit."""
    error = record.output_angle - record.input_angle / ratio
    if float(np.quantile(np.abs(centered(error, record.run)), 0.95)) > _NO_ERROR:
        return None
    text = (
        "input and output angle are one sensor given twice: their difference is zero to the last digit. "
        "Record the motor's own encoder and the link's"
    )
    return Finding("one_sensor", text, 0.0, "rad", True)


def _wrapped_degrees(record: Record) -> Finding | None:
    """A finding if an angle jumps by 360: it is in degrees."""
    for name, angle in (("input", record.input_angle), ("output", record.output_angle)):
        step = np.abs(np.diff(angle)) / _FULL_TURN
        if np.any(np.abs(step - 1.0) < 0.02) and float(np.median(step)) < 0.1:
            text = f"the {name} angle jumps by 360: it is in degrees: {declared(name, 'deg')}"
            return Finding("unit", text, _FULL_TURN, "-", True)
    return None


def _other_units(record: Record, configured: Drive) -> Finding | None:
    """A finding if no gear could bear the torque or the torsion: torque or angles are in another unit."""
    most = float(np.percentile(np.abs(record.torque), 99.0))
    if record.has_torque and most > _MOST_TORQUE * configured.rated_torque:
        share = most / configured.rated_torque
        text = (
            f"the torque reaches {most:.3g} N m, {share:.0f} times the rated torque: in which unit is it? "
            f"Of N mm: {declared('torque', 'N mm')}"
        )
        return Finding("unit", text, share, "-", True)
    error = record.output_angle - record.input_angle / configured.kinematics.ratio
    if _twisting(record, configured) and float(np.ptp(centered(error, record.bag))) > _LEAST_IN_DEGREES:
        factor, spread = _twist(record, configured)
        if abs(factor / _DEGREES - 1.0) < _DEGREES_MISS and factor > _SIGMAS * spread:
            text = f"the joint twists {factor:.0f} times as much as configured: both angles are in degrees"
            both = "write input=COLUMN[deg],output=COLUMN[deg] in --columns, or unit: deg under input and"
            return Finding("unit", f"{text}: {both} output_signal", factor, "-", True)
    return None


def _lost_samples(record: Record) -> list[Finding]:
    """Findings about second publishers, missing torque, incomplete files, clocks, stamps and lost samples."""
    refused, _, unpaired, set_back, problems, unstamped, others, _ = record.stamps
    found = [Finding("second_publisher", text, float(len(others)), "-", False) for text in others]
    if record.no_torque:
        text = f"the torque {record.no_torque}: it counts as not measured"
        if known := float(record.torque[0]):
            text += f", and {known:g} N m as configured is assumed"
        found.append(Finding("no_torque", text, float(record.torque[0]), "N m", False))
    if problems:
        found.append(Finding("incomplete", record.stamps.broken, float(len(problems)), "-", False))
    if set_back:
        times = "once" if set_back == 1 else f"{set_back} times"
        text = f"the clock was set back {times} in the middle of a recording: what comes after counts as"
        found.append(Finding("clock_set_back", f"{text} another recording", float(set_back), "-", False))
    if unstamped:
        found.append(Finding("stamps_zero", record.stamps.received, float(unstamped), "-", False))
    whole = record.extent.samples + record.dropped + unpaired
    if refused > _REPEATED * whole:
        found.append(Finding("refused_rows", record.stamps.lines[-1], refused / whole, "-", False))
    if unpaired > _REPEATED * whole:
        text = f"{100 * unpaired / whole:.0f} % of the output angles {UNPAIRED}"
        found.append(Finding("unpaired_outputs", text, unpaired / whole, "-", False))
    return found


def _without_repeated_rows(record: Record) -> tuple[Record, Finding | None]:
    """The record without rows that repeat the previous row, and a finding; unchanged if there are few."""
    same = np.diff(record.run) == 0
    for column in (record.input_angle, record.output_angle, record.reported_torque):
        same &= np.diff(column) == 0.0
    moving = np.abs(record.speed[1:]) > 0.05 * float(np.percentile(np.abs(record.speed), 95))
    share = float(np.mean(same[moving])) if moving.any() else 0.0
    if share < _REPEATED:
        return record, None
    again = np.concatenate(([False], same))
    text = (
        f"{100 * share:.0f} % of the samples in motion repeat the one before: they are published faster than "
        "measured; the repeated ones are left out"
    )
    return record.select(~again), Finding("repeated_rows", text, share, "-", False)


def _partner_ratio(record: Record, configured: Drive) -> Finding | None:
    """A finding if the ratio is that of the other output, one more or one less: 101 for 100.

    Notes
    -----
    The regression covers all runs of a recording together, because robots seldom turn far: over half a radian
    the ratios differ by 1000 arcsec. If turns are lost between runs, there is no finding.
    """
    ratio, least = configured.kinematics.ratio, _LEAST_REACH if record.has_torque else _REACH_WITHOUT_TORQUE
    if float(np.ptp(record.input_angle / ratio)) < least:
        return None
    some = record.thinned(_MOST_ROWS)
    output = some.input_angle / ratio
    columns = [output, some.speed, np.sign(some.speed)]
    if some.has_torque:
        columns += [some.torque, some.torque * np.abs(some.torque)]
    found = regression(columns, some.output_angle - output, some.bag)
    slope, spread = float(found.value[0]), float(found.deviation[0])
    for partner in (ratio + 1.0, ratio - 1.0):
        expected = ratio / partner - 1.0
        if abs(slope - expected) < _PARTNER_MISS * abs(expected) and abs(expected) > _SIGMAS * spread:
            return wrong_ratio(partner, ratio)
    return None


def _out_of_step(record: Record, ratio: float) -> Finding | None:
    """A finding if the output angle is late or early: part of the error is proportional to the speed."""
    late = _late(record, ratio)
    if late is None:
        return None
    size = f"{abs(late) * 1e3:.0f} ms" if abs(late) < 1.0 else f"{abs(late):.2f} s"
    where = "behind" if late > 0.0 else "ahead of"
    text = f"the output angle is {size} {where} the input angle: stamp both where they are measured"
    return Finding("out_of_step", text, late, "s", True)


def _late(record: Record, ratio: float) -> float | None:
    """Delay of the output angle [s], negative if early; None if there is none or it is uncertain."""
    some = record.thinned(_MOST_ROWS)
    output = some.input_angle / ratio
    others = [output, np.sign(some.speed), some.torque, some.torque * np.abs(some.torque)]
    error = some.output_angle - output
    # With a ratio of the wrong sign, an oscillating motion looks like a delayed one.
    is_late = not any(follows(record, sign / ratio, _MATCHED) for sign in (1.0, -1.0))
    if is_late and (late := _far_behind(record, ratio)) is not None:
        return late
    found = regression([some.speed / ratio, *others], error, some.bag)
    early, slope = float(found.value[0]), float(found.value[1])
    if abs(early) < max(_OUT_OF_STEP, _SIGMAS * found.deviation[0]) or abs(slope) > _MUCH:
        return None
    # Speed must explain nearly the whole rest: in a short record it correlates with the torque.
    return -early if found.rest <= _MOST_LEFT * regression(others, error, some.bag).rest else None


def _far_behind(record: Record, ratio: float) -> float | None:
    """Large delay of the output against the input [s]; None if there is none at which the streams match.

    The delay is the peak of the correlation of their rates over the longest recording. Shifted by it, the
    streams must match.
    """
    from scipy.signal import correlate  # late: it takes a third of a second

    part = record.select(record.bag == np.argmax(np.bincount(record.bag)))
    grid = np.linspace(part.time[0], part.time[-1], _GRID)
    step = float(grid[1] - grid[0])
    angle, output = (np.interp(grid, part.time, c) for c in (part.input_angle / ratio, part.output_angle))
    match = correlate(np.gradient(output), np.gradient(angle), "same", "fft")
    shift = int(np.argmax(match)) - _GRID // 2
    away = output[max(shift, 0) : _GRID + min(shift, 0)] - angle[max(-shift, 0) : _GRID - max(shift, 0)]
    matched = float(np.std(away)) < _MATCHED * float(np.std(output))
    return shift * step if matched and abs(shift * step) > _OUT_OF_STEP else None


def _twisting(record: Record, configured: Drive) -> bool:
    """Whether the torque is measured and varies enough to twist the gear."""
    return record.has_torque and float(np.ptp(record.torque)) > _LEAST_TORSION * configured.rated_torque


def _wrong_torque(record: Record, configured: Drive) -> Finding | None:
    """A finding if the torsion has the wrong sign for the torque, or is many times too large."""
    if not _twisting(record, configured):
        return None
    factor, spread = _twist(record, configured)
    if factor < min(_WRONG_SIGN, -_SIGMAS * spread):
        text = (
            "the link leads where the torque is positive, and no gear does that: the torque has the other "
            "sign. It is turned here; turn it where it is recorded"
        )
        return Finding(_TORQUE_SIGN, text, factor, "-", False)
    if factor - _SIGMAS * spread > _OTHER_UNIT:
        text = (
            f"the joint twists {factor:.0f} times as much as configured: is the torque in amperes "
            "(torque=COLUMN[A]*K, or unit: A and scale: K, with K N m per A at the link) or at the motor, or "
            "is this another gear?"
        )
        return Finding("torque_unit", text, factor, "-", False)
    return None


def _twist(record: Record, configured: Drive) -> tuple[float, float]:
    """Torsion over the configured one at the same torque, with its standard deviation [-].

    There are four regressions: with waves of the output's turn and the speed, with either, and with neither.
    The smallest factor counts, and zero if the signs differ. Gravity correlates with position, and the torque
    of a starting joint with its speed, so an imperfect torsion shape can give factors of any sign.
    """
    some = record.thinned(_MOST_ROWS)
    output = some.input_angle / configured.kinematics.ratio
    torsion, _, _ = fit_parameters.along(configured, configured, some.input_angle, some.torque)
    column, motion, waves = np.nan_to_num(torsion), (some.speed, np.sign(some.speed)), turning(output).T
    beside = (*motion, *waves), motion, waves, ()
    found = [regression([column, *more], some.output_angle - output, some.bag) for more in beside]
    factors = [(float(one.value[0]), float(one.deviation[0])) for one in found]
    factor, spread = min(factors, key=lambda one: abs(one[0]))
    return (factor if all(factor * each > 0.0 for each, _ in factors) else 0.0), spread


def without_misleading_torque(
    record: Record, configured: Drive, test: npt.NDArray[np.bool_], rng: np.random.Generator
) -> tuple[Record, Finding | None]:
    """The record without its torque, and a finding, if fits predict held-out rows far better without it.

    This must hold with the rows `test` (n,) held out and with all others held out: a large cause, which no
    parameter describes, may mislead one fit by chance. A motor's current is kept, because no fit here models
    what the motor takes of it. A torque that hardly changes is kept too: it cannot mislead.
    """
    if not _twisting(record, configured) or record.by_current:
        return record, None
    unloaded = np.zeros(record.size)
    blind = replace(record, torque=unloaded, reported_torque=unloaded, has_torque=False)
    if np.std(_left(record, configured, test)) < np.std(_left(blind, configured, test)):
        return record, None  # the torque helps the configured drive already
    seed, found = int(rng.integers(2**31)), []
    for unseen in (test, ~test):
        squares = [_foretold(one, configured, unseen, seed) ** 2 for one in (record, blind)]
        lost = [float(part.sum()) for part in np.array_split(squares[0] - squares[1], _BLOCKS)]
        loaded, free = (float(np.sqrt(one.mean())) for one in squares)
        if loaded < _WORSE * free or lower_bound(np.array(lost)) < 0.0:
            return record, None
        found.append((loaded, free))
    loaded, free = found[0]
    text = (
        f"with the torque as measured, held-out data are predicted to {loaded / ARCSEC:.0f} arcsec, without "
        f"it to {free / ARCSEC:.0f}: it is left out here; see whether it is this joint's, and in N m"
    )
    return blind, Finding("torque_misleads", text, loaded / free, "-", False)


def _foretold(record: Record, configured: Drive, unseen: npt.NDArray[np.bool_], seed: int) -> Floats:
    """Residual of the `unseen` rows (n,) from a fit to all others [rad]; the seed chooses its samples."""
    seen = record.select(~unseen)
    fit = refit(seen, configured, np.random.default_rng(seed), _of_encoders(seen))
    # A wrong zero is not a wrong torque.
    return _left(replace(record, torque=record.torque + fit.torque_zero), fit.drive, unseen)


def _left(record: Record, drive: Drive, test: npt.NDArray[np.bool_]) -> Floats:
    """Residual of a drive on about `_MOST_UNSEEN` rows of `test` (n,), nuisance terms projected out [rad]."""
    some = record.select(test).thinned(_MOST_UNSEEN)
    error, _, _ = fit_parameters.along(drive, drive, some.input_angle, some.torque)
    rest = some.output_angle - some.input_angle / drive.kinematics.ratio - np.nan_to_num(error)
    free = np.concatenate((nuisance(some, drive.kinematics.ratio), _of_encoders(some)), axis=1)
    return np.asarray(rest - projection(free, rest))


def _of_encoders(record: Record) -> Floats:
    """Waves once and twice per input turn (n, 4); without them, torque parameters would imitate them."""
    return np.concatenate([turning(order * record.input_angle) for order in (1, 2)], axis=1)
