"""Global refit of the model's own parameters: many starts, nuisance projected out, a word on trust."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive

# Rounds of the search: samples, steps of a fit, starts that go on to the next. Each round can only mistake
# starts that are as good as equal, and what it leaves goes on with all rows.
_ROUNDS = ((250, 5, 5), (700, 5, 2), (1500, 8, 2))
_MIRROR = np.array([-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
_HOPELESS = 2.0  # times the best deviance, beyond which a start is not followed any further
_FIRST_NOISE, _LEAST_NOISE = 2e-5, 1e-6  # of the residual [rad]; each round takes what the one before left
_OFFSET = 0.03  # prior width of the torque's zero, of the rated torque
_MOST_OFFSET = 3.0  # prior widths
_SETTLED = 0.1  # deviance; smaller steps are left to the fit of all rows
Starts = tuple[tuple[float, float], ...]
_TURNS = (0.0, 0.25, 0.5, 0.75)  # [pi rad]
FEW_STARTS: Starts = ((0.0, 0.0), *((10.0, turn) for turn in _TURNS))
STARTS: Starts = ((0.0, 0.0), *((size, turn) for size in (6.0, 16.0) for turn in _TURNS))
"""Eccentricities that a search begins with: magnitude [um], direction [pi rad]."""

_DISTINCT = 12.0  # difference of deviance that tells two minima apart


@dataclass(frozen=True)
class Refit:
    """Result of the global refit.

    Attributes
    ----------
    drive : Drive
        With the fitted parameters.
    parameters : ndarray, shape (7,)
        In the units of `fit_parameters.SCALES`.
    covariance : ndarray, shape (7, 7)
        From the fit on independent samples; the final one is by `diagnosis`.
    trustworthy : bool
        Whether no other minimum fits about as well.
    """

    drive: Drive
    parameters: Floats
    covariance: Floats
    trustworthy: bool


def nuisance(record: Record, ratio: float) -> Floats:
    """Terms that any fit carries along: offset, speed, its sign, temperature, one cycle per output turn.

    Parameters
    ----------
    record : Record
    ratio : float

    Returns
    -------
    ndarray, shape (n, k)
        Dimensionless, of order one.
    """
    output = record.input_angle / ratio
    top = max(float(np.percentile(np.abs(record.speed), 99)), 1e-9)
    columns = [np.ones(record.size)]
    if np.std(record.speed) > 0.05 * top:
        columns += [record.speed / top, np.tanh(record.speed / (0.02 * top))]
    if record.temperature is not None and np.std(record.temperature) > 0.3:
        columns.append(record.temperature - record.temperature.mean())
    if np.ptp(output) > 0.8 * np.pi:
        columns += [np.cos(output), np.sin(output)]
    return np.stack(columns, axis=1)


def refit(
    record: Record,
    configured: Drive,
    extra: Floats | None = None,
    start: Floats | None = None,
    starts: Starts = STARTS,
    rng: np.random.Generator | None = None,
) -> Refit:
    """Fit the model's parameters from many starts, a wrong zero of the torque beside them.

    Parameters
    ----------
    record : Record
    configured : Drive
    extra : ndarray, shape (n, k), optional
        Further columns that may take part freely: effects already found.
    start : ndarray, shape (7,), optional
        One more start.
    starts : sequence of (float, float)
        Eccentricities to begin with: magnitude [um], direction [pi rad].
    rng : numpy.random.Generator, optional
        Chooses the samples.

    Returns
    -------
    Refit
    """
    rng = rng or np.random.default_rng(0)
    free = nuisance(record, configured.kinematics.ratio)
    if extra is not None:
        free = np.concatenate((free, extra), axis=1)
    points, noise = _starts(configured, start, starts), _FIRST_NOISE
    for samples, steps, kept in _ROUNDS:
        problem = _Problem(record, configured, free, _chosen(record, samples, rng), noise)
        trials = sorted((_levenberg(problem, point, steps) for point in points), key=lambda trial: trial[1])
        hopeful = [point for point, value in trials if value < _HOPELESS * trials[0][1]]
        points = distinct(hopeful)[:kept]
        noise = max(problem.left(points[0]), _LEAST_NOISE)
    point, deviance = trials[0]
    covariance = problem.covariance(point)
    trials = [(other[: fit_parameters.COUNT], value) for other, value in trials]
    point = point[: fit_parameters.COUNT]
    rivals = [other for other, value in trials[1:] if value - deviance < _DISTINCT]
    rivals = distinct([point, *rivals])[1:]
    ambiguous = any(_apart(point, rival, covariance) > _DISTINCT for rival in rivals)
    return Refit(fit_parameters.drive_of(point, configured), point, covariance, not ambiguous)


def usable(record: Record, shift: float = 0.0) -> npt.NDArray[np.bool_]:
    """Samples where the model's error is well defined: in a true gap, noise decides the flank.

    Parameters
    ----------
    record : Record
    shift : float
        Real less reported torque, where that is known [N m].

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    if not record.has_torque:
        return np.ones(record.size, dtype=bool)
    least = 0.01 * np.percentile(np.abs(record.torque), 99)
    found: npt.NDArray[np.bool_] = np.minimum(np.abs(record.torque), np.abs(record.torque + shift)) >= least
    return found


def _chosen(record: Record, count: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    rows = np.flatnonzero(usable(record))
    count = min(count, rows.size)
    return np.sort(rng.choice(rows, count, replace=False))


def _starts(configured: Drive, start: Floats | None, starts: Starts) -> list[Floats]:
    first = fit_parameters.vector(configured, configured)
    points = []
    for size, turn in starts:
        point = first.copy()
        point[0], point[1] = size * np.cos(np.pi * turn), size * np.sin(np.pi * turn)
        points.append(point)
    points.append(first)
    if start is not None:
        points.append(start)
    return points


class _Problem:
    """Least squares of the transmission error on some rows, free columns projected out, prior included."""

    def __init__(
        self, record: Record, configured: Drive, free: Floats, rows: npt.NDArray[np.int64], noise: float
    ) -> None:
        self.configured = configured
        self.input_angle, self.torque = record.input_angle[rows], record.torque[rows]
        self.measured = record.output_angle[rows] - self.input_angle / configured.kinematics.ratio
        self.free = np.linalg.qr(free[rows])[0]
        center, width = fit_parameters.prior(configured)
        self.center = np.append(center, 0.0)
        self.width = np.append(width, 1.0 if record.has_torque else 1e-6)
        self.offset = _OFFSET * configured.rated_torque
        self.noise = noise

    def admissible(self, point: Floats) -> Floats:
        """Parameters that a drive can have, and the torque's offset in widths of its prior; shape (8,)."""
        drive, offset = fit_parameters.admissible(point[: fit_parameters.COUNT], self.configured), 0.0
        if point.size > fit_parameters.COUNT:
            offset = float(np.clip(point[-1], -_MOST_OFFSET, _MOST_OFFSET))
        return np.append(drive, offset)

    def residual_and_jacobian(self, point: Floats) -> tuple[Floats, Floats]:
        drive = fit_parameters.drive_of(point[: fit_parameters.COUNT], self.configured)
        torque = self.torque + float(point[-1]) * self.offset
        error, jacobian, slope = fit_parameters.error_and_jacobian(
            drive, self.configured, self.input_angle, torque
        )
        columns = np.concatenate((jacobian, self.offset * slope[:, None]), axis=1)
        return self._projected(self.measured - error), self._projected(columns)

    def _projected(self, columns: Floats) -> Floats:
        columns = np.nan_to_num(columns, posinf=0.0, neginf=0.0)
        return columns - self.free @ (self.free.T @ columns)

    def deviance(self, residual: Floats, point: Floats) -> float:
        return float(residual @ residual) / self.noise**2 + float(
            np.sum(((point - self.center) / self.width) ** 2)
        )

    def left(self, point: Floats) -> float:
        """What the fit leaves at a point [rad rms]."""
        residual, _ = self.residual_and_jacobian(point)
        return float(np.sqrt(np.mean(residual**2)))

    def covariance(self, point: Floats) -> Floats:
        residual, jacobian = self.residual_and_jacobian(point)
        variance = float(residual @ residual) / max(residual.size - point.size - self.free.shape[1], 1)
        spread = np.linalg.inv(jacobian.T @ jacobian / variance + np.diag(self.width**-2.0))
        return np.asarray(spread[: fit_parameters.COUNT, : fit_parameters.COUNT])


def _levenberg(problem: _Problem, point: Floats, iterations: int) -> tuple[Floats, float]:
    """Levenberg-Marquardt."""
    point = problem.admissible(point)
    damping = 1e-3
    residual, jacobian = problem.residual_and_jacobian(point)
    for _ in range(iterations):
        weight = 1.0 / problem.noise**2
        normal = weight * jacobian.T @ jacobian + np.diag(problem.width**-2.0)
        slope = weight * jacobian.T @ residual - (point - problem.center) / problem.width**2
        moved = False
        for _ in range(6):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope)
            trial = problem.admissible(point + step)
            new_residual, new_jacobian = problem.residual_and_jacobian(trial)
            if problem.deviance(new_residual, trial) < problem.deviance(residual, point):
                moved = True
                break
            damping *= 8.0
        if not moved:
            break
        gain = problem.deviance(residual, point) - problem.deviance(new_residual, trial)
        point, residual, jacobian, damping = trial, new_residual, new_jacobian, max(damping / 6.0, 1e-9)
        if gain < _SETTLED:
            break
    return point, problem.deviance(residual, point)


def _apart(point: Floats, other: Floats, covariance: Floats) -> float:
    """Deviance by which another drive should be worse, were there one minimum only; lobes swapped or not."""
    away = (other - point, other * _MIRROR - point)
    return min(float(step @ np.linalg.solve(covariance, step)) for step in away)


def distinct(points: list[Floats]) -> list[Floats]:
    """Points that are not the same drive: lobes swapped count as the same.

    Parameters
    ----------
    points : list of ndarray, shape (7,) or more
        In the units of `fit_parameters.SCALES`; what follows is not compared.

    Returns
    -------
    list of ndarray
        The first of every kind.
    """
    found: list[Floats] = []
    for point in points:
        own = point[: fit_parameters.COUNT]
        mirrored = own * _MIRROR
        tolerance = np.array([1.0, 1.0, 1.0, 1.0, 3.0, 0.5, 0.7])
        if not any(
            np.all(np.abs(known[: fit_parameters.COUNT] - other) < tolerance)
            for known in found
            for other in (own, mirrored)
        ):
            found.append(point)
    return found
