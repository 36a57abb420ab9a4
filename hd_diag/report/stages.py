"""A record compared with the model as configured, refitted and extended: in bins, and as a ladder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.calibration import LEAST_SIZE
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.evidence.solution import Solution, part_of
from hd_diag.diagnosis.extension import running_residual
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.design import solve
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import Chosen, LinearisedFit
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive, transmission_error
from hd_diag.effects.order_spectrum import spectrum
from hd_diag.effects.remainders import Remainder
from hd_diag.formatting import words
from hd_diag.report.teeth import strongest_torque

NOMINAL, REFIT, EXTENDED = "as configured", "refitted", "extended"

LOW, HIGH = 0.1, 0.9
"""Quantiles at both ends of a band [-]."""

_REMAINDERS = "+ remainders"
_LEAST = 5  # least number of samples for a bin's mean
_ANGLE_BINS, _TORQUE_BINS = 72, 40
_STRETCHES = 240
_SPECTRUM_POINTS = 600
_TURN = 2.0 * np.pi
_GRID_ANGLES, _GRID_TORQUES = 48, 41
_DRAWS, _CURVE_POINTS = 2000, 100
_INTERVAL = (0.025, 0.975)


class Band(NamedTuple):
    """Bins of samples, shape (bins,): center, mean and quantiles, nan where too few; number of samples."""

    center: Floats
    mean: Floats
    low: Floats
    high: Floats
    samples: Integers


@dataclass(frozen=True)
class Stages:
    """Samples of a record at which the model's error is well defined, with the residual of each model stage.

    The wave generator's `angle`, the `measured` error less the encoders' offset, and the residuals, measured
    less simulated, have shape (n,) [rad]. `drive` is the refitted one, or the configured one if nothing was
    fitted.
    """

    record: Record
    angle: Floats
    measured: Floats
    residual: dict[str, Floats]
    drive: Drive


class BinnedResiduals(NamedTuple):
    """Measured error and residuals in bins of an angle or a torque [rad]; least and greatest torque [N m]."""

    measured: Band
    residual: dict[str, Band]
    torques: tuple[float, float]
    samples: int

    @property
    def simulated(self) -> dict[str, Floats]:
        """Simulated means over the same samples in each bin [rad]."""
        return {name: self.measured.mean - rest.mean for name, rest in self.residual.items()}


class OverTime(NamedTuple):
    """Torque [N m], speed of the input [rad/s] and the stages' residuals [rad] along a record [s]."""

    torque: Band
    speed: Band
    residual: dict[str, Band]


def stages(diagnosis: Diagnosis, plain: LinearisedFit | None) -> Stages:
    """Residual of each stage of the model; `plain` is the fit to the whole record without causes."""
    rows = usable(diagnosis.record)
    if plain is not None:  # the fit may leave out more
        rows = rows & plain.data.mask
    record, configured = diagnosis.record.select(rows), diagnosis.configured
    error = record.output_angle - record.input_angle / configured.kinematics.ratio
    first = error - fit_parameters.along(configured, configured, record.input_angle, record.torque)[0]
    offset = float(first.mean()) if diagnosis.model is None else diagnosis.model.offset
    residual = {NOMINAL: first - first.mean()}
    if plain is not None:
        residual[REFIT] = plain.remainder(())[rows[plain.data.mask]]
    if diagnosis.model is not None and (diagnosis.causes or diagnosis.hints):
        whole, model = diagnosis.record, diagnosis.model
        residual[EXTENDED] = running_residual(model, whole, whole.torque, model.coarse_map)[rows]
    drive = diagnosis.refitted.drive if diagnosis.refitted else configured
    angle = drive.frame.wave_generator_angle(record.input_angle)
    return Stages(record, angle, error - offset, residual, drive)


def mean_error(drive: Drive, torque: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean, least and greatest transmission error over half a turn at some torques [rad]."""
    turn = np.pi * np.arange(_GRID_ANGLES) / _GRID_ANGLES
    angle, load = (g.ravel() for g in np.meshgrid(turn, torque, indexing="ij"))
    table = transmission_error(drive, angle, load).reshape(_GRID_ANGLES, torque.size)
    return np.asarray(table.mean(axis=0)), np.asarray(table.min(axis=0)), np.asarray(table.max(axis=0))


def over_angle(found: Stages) -> BinnedResiduals:
    """Errors over the wave generator's angle, less the drive's mean over a turn at the same torque.

    The ripple changes its sign with the torque, so only the middle half of the torques in the stronger
    direction is used.
    """
    torque, rows = found.record.torque, np.arange(found.record.size)
    way = torque > 0.0 if strongest_torque(torque) > 0.0 else torque < 0.0
    if found.record.has_torque and way.any():
        low, high = np.quantile(torque[way], (0.25, 0.75))
        rows = np.flatnonzero((torque >= low) & (torque <= high))
    nodes = max(float(np.max(np.abs(torque[rows]))), 1e-3) * np.linspace(-1.0, 1.0, _GRID_TORQUES)
    level = np.interp(torque[rows], nodes, mean_error(found.drive, nodes)[0])
    edges = np.linspace(0.0, _TURN, _ANGLE_BINS + 1)
    return _compared(found, rows, np.mod(found.angle[rows], _TURN), edges, level)


def over_torque(found: Stages) -> BinnedResiduals:
    """Errors over the torque."""
    torque = found.record.torque
    edges = np.linspace(torque.min(), max(torque.max(), torque.min() + 1e-6), _TORQUE_BINS + 1)
    return _compared(found, np.arange(torque.size), torque, edges, 0.0)


def _compared(
    found: Stages, rows: Integers, place: Floats, edges: Floats, level: Floats | float
) -> BinnedResiduals:
    """Means of some rows in bins of `place`; `level` is subtracted from the measured error [rad]."""
    torque = found.record.torque[rows]
    return BinnedResiduals(
        band(place, found.measured[rows] - level, edges),
        {name: band(place, rest[rows], edges) for name, rest in found.residual.items()},
        (float(torque.min()), float(torque.max())),
        rows.size,
    )


def orders(found: Stages, highest: float) -> dict[str, tuple[Floats, Floats]]:
    """Order and amplitude [rad] of each stage's residual, every peak kept."""
    spectra = {name: spectrum(found.angle, rest, highest) for name, rest in found.residual.items()}
    return {name: strongest(*pair, highest, _SPECTRUM_POINTS) for name, pair in spectra.items()}


def over_time(found: Stages) -> OverTime:
    """Least and greatest torque, input speed and residuals along the record."""
    time = found.record.time - found.record.time[0]
    torque, speed = (envelope(time, c, _STRETCHES) for c in (found.record.torque, found.record.speed))
    residual = {name: envelope(time, rest, _STRETCHES) for name, rest in found.residual.items()}
    return OverTime(torque, speed, residual)


# Bins ---


def band(
    place: Floats, value: Floats, edges: Floats, ends: tuple[float, float] = (LOW, HIGH), least: int = _LEAST
) -> Band:
    """Means and spread of samples, shape (n,), in bins with rising edges, shape (bins + 1,).

    The spread lies between the quantiles `ends`. Bins with fewer than `least` samples get nan.
    """
    order = np.argsort(place, kind="stable")
    starts = np.searchsorted(place[order], edges)
    starts[-1] = np.searchsorted(place[order], edges[-1], side="right")
    table = np.full((3, edges.size - 1), np.nan)
    for k, part in enumerate(np.split(value[order], starts)[1:-1]):
        if part.size >= least:
            table[:, k] = part.mean(), *np.quantile(part, ends)
    return Band(0.5 * (edges[:-1] + edges[1:]), table[0], table[1], table[2], np.diff(starts))


def envelope(place: Floats, value: Floats, stretches: int) -> Band:
    """Least and greatest values in stretches of equal length; `place`, shape (n,), must rise."""
    known = np.isfinite(value)
    edges = np.linspace(place[0], place[-1], stretches + 1)
    return band(place[known], value[known], edges, (0.0, 1.0), 1)


def strongest(place: Floats, value: Floats, highest: float, count: int) -> tuple[Floats, Floats]:
    """Place and value of the greatest one in each of `count` equal intervals from 0 to `highest`."""
    index = np.minimum((place / highest * count).astype(np.int64), count - 1)
    order = np.lexsort((-value, index))
    first = order[np.unique(index[order], return_index=True)[1]]
    return place[first], value[first]


# Remainders ---


class Curve(NamedTuple):
    """A remainder over its variable, at k rising points: name, unit, place, and part of the error [rad]."""

    name: str
    unit: str
    place: Floats
    part: Floats


_UNITS = {"torque": "N m", "speed": "rad/s", "output_angle": "rad", "time": "s"}


def curves(found: Solution) -> list[Curve]:
    """Remainders with an rms of at least `LEAST_SIZE`, each over the variable that it follows."""
    result = []
    for one in found.functions:
        if one.rms < LEAST_SIZE:
            continue
        place = getattr(found.fit.signals, one.effect.follows)
        order = np.argsort(place, kind="stable")[:: max(place.size // _CURVE_POINTS, 1)]
        part = part_of(found.fit, found.chosen, (one.effect, one.nonlinear), one.is_larger)
        unit = _UNITS[one.effect.follows]
        result.append(Curve(words(one.effect.name), unit, place[order], part[order]))
    return result


# Ladder ---


class Rung(NamedTuple):
    """One model of the ladder: rms residual of stretches that a fit to all others predicts [rad].

    `gain` is the share of the previous rung's mean square that this rung explains; nan on the first.
    Intervals are 95 % intervals.
    """

    name: str
    rms: float
    low: float
    high: float
    gain: float = float("nan")
    gain_low: float = float("nan")
    gain_high: float = float("nan")


def benches(diagnosis: Diagnosis) -> list[LinearisedFit]:
    """Linearised fit of each fitted rung's model, with refined parameters; empty if nothing was fitted."""
    if diagnosis.found is None or diagnosis.refitted is None:
        return []
    whole, start = diagnosis.found.fit, diagnosis.refitted.parameters
    *fewer, _ = _fitted(diagnosis.found).values()
    return [*(settle(whole.moved(start), chosen) for chosen in fewer), whole]


def _fitted(found: Solution) -> dict[str, Chosen]:
    """Effects of each fitted rung: one cause or shape more than in the rung before, last all remainders."""
    apart = tuple(one for one in found.chosen if not isinstance(one[0], Remainder))
    more = {f"+ {words(effect.name)}": apart[:count] for count, (effect, _) in enumerate(apart, 1)}
    return {REFIT: (), **more, **({_REMAINDERS: found.chosen} if len(apart) < len(found.chosen) else {})}


def ladder(
    diagnosis: Diagnosis, nominal: Floats, fitted: list[LinearisedFit], rng: np.random.Generator
) -> list[Rung]:
    """Rungs from the configured model, with residual `nominal` [rad], over the `fitted` ones to the extended.

    Intervals come from a bootstrap over stretches.
    """
    if diagnosis.found is None or not fitted:
        return []
    rungs = _fitted(diagnosis.found)
    names = [NOMINAL, *rungs]
    data = fitted[-1].data
    shown = usable(diagnosis.record)[data.mask]  # the rows of `nominal`
    unseen = (_unseen(bench, chosen)[shown] for bench, chosen in zip(fitted, rungs.values(), strict=True))
    residuals = [nominal, *unseen]
    block = np.unique(data.block[shown], return_inverse=True)[1]
    squares, counts = np.stack([np.bincount(block, rest**2) for rest in residuals]), np.bincount(block)
    draws = rng.integers(0, counts.size, (_DRAWS, counts.size))
    drawn, total = squares[:, draws].sum(axis=2), squares.sum(axis=1)
    spread = np.quantile(np.sqrt(drawn / counts[draws].sum(axis=1)), _INTERVAL, axis=1)
    gains = [1.0 - total[1:] / total[:-1], *np.quantile(1.0 - drawn[1:] / drawn[:-1], _INTERVAL, axis=1)]
    rms = np.stack([np.sqrt(total / block.size), *spread], axis=1).tolist()
    gained = [[], *np.stack(gains, axis=1).tolist()]
    return [Rung(name, *of_rms, *of_gain) for name, of_rms, of_gain in zip(names, rms, gained, strict=True)]


def _unseen(bench: LinearisedFit, chosen: Chosen) -> Floats:
    """Residual of every stretch with coefficients fitted to the others [rad]."""
    columns = np.concatenate((bench.always(), bench.joined(chosen)), axis=1)
    rest = np.empty(bench.residual.size)
    for block, (_, _, others, towards) in enumerate(bench.design(chosen).blocks()):
        rows = bench.data.block == block
        rest[rows] = bench.residual[rows] - columns[rows] @ solve(others, towards)
    return rest
