"""Global refit of the model's own parameters from many starts, nuisance terms projected out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_erosion

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import COMPLIANCE, DATUM, TILT, alike, swapped
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.stamps import usual_step
from hd_diag.drive import Drive
from hd_diag.effects.mesh_torque import MeshTorque

# Rounds of the search: samples, steps of a fit, starts kept for the next round. A round can only confuse
# starts that are nearly equal, and a fit of all rows follows.
_ROUNDS = ((250, 5, 5), (700, 5, 2), (1500, 8, 2))
_HOPELESS = 2.0  # times the best deviance, beyond which a start is dropped
_STEPS = 1  # of the model per tooth pitch: a fit of all rows follows
_FIRST_NOISE, _LEAST_NOISE = 2e-5, 1e-6  # [rad]; later rounds take the residual of the round before
_STILL, _STEADY = 0.02, 0.02  # of the usual top speed, and of the torque's range: below both is rest
_SETTLING = 0.05  # [s] at either end of a rest that stay in the fit
_GAP = 0.01  # of the usual greatest torque, below which the torque may be within the gap
_CERTAIN = 3.0  # standard deviations of a torque, beyond which its flank is certain
_ENOUGH = 0.1  # least share of the samples that must be certain
_OFFSET = 0.03  # prior width of the torque's zero, relative to the rated torque
_MOST_OFF = 3.0  # prior widths, the limit of the torque's zero and of the motor's terms
_DAMPINGS = 6  # tried before a fit gives up
_HELD = 1e-6  # prior width of a parameter that is not fitted
_DATUMS = (-6.0, 3.0, 12.0)  # starts relative to the configured datum, when friction is fitted too
_SETTLED = 0.1  # gain in deviance that ends a fit; the fit of all rows does the rest
_LEANING, _LEANT = 7.0, 2  # start value in units of tilt; best points of the first round that are tilted
_SECTIONS = 3  # most sections in a search
_NEAR = np.array(
    [1.0, 1.0, 1.0, 1.0, 3.0, 0.5, 0.7, 2.0, 2.0]
)  # differences of parameters within which two points are the same drive

Starts = tuple[tuple[float, float], ...]
_QUARTERS = (0.0, 0.25, 0.5, 0.75)  # of the range of distinct directions
FEW_STARTS: Starts = ((0.0, 0.0), *((10.0, turn) for turn in _QUARTERS))
STARTS: Starts = ((0.0, 0.0), *((size, turn) for size in (6.0, 16.0) for turn in _QUARTERS))
"""Eccentricities that a search begins with: magnitude [um], direction [pi rad]."""

DISTINCT = 12.0
"""Difference of deviance above which two minima are distinct."""
AMBIGUOUS = "several sets fit about as well"
"""A reason why the parameters say nothing about the drive."""


@dataclass(frozen=True)
class Refit:
    """Result of the global refit.

    Attributes
    ----------
    drive : Drive
        With the fitted parameters.
    parameters : ndarray, shape (p,)
        In the units of `fit_parameters.units`.
    covariance : ndarray, shape (p, p)
        From the fit on independent samples; `diagnosis` computes the final one.
    doubt : str
        Why the parameters say nothing about the drive; empty if they do.
    taken : ndarray, shape (k,)
        Coefficients of the motor's own torque.
    torque_zero : float
        Fitted real less reported torque [N m].
    """

    drive: Drive
    parameters: Floats
    covariance: Floats
    doubt: str = ""
    taken: Floats = field(default_factory=lambda: np.zeros(0))
    torque_zero: float = 0.0

    @property
    def trustworthy(self) -> bool:
        """Whether the parameters describe the drive."""
        return not self.doubt


class Motor(NamedTuple):
    """The motor's own torque: the effect, and its torque at the record's rows [N m per unit], (n, k)."""

    effect: MeshTorque
    torque: Floats


def nuisance(record: Record, ratio: float) -> Floats:
    """Free terms of every fit: offsets, speed, its sign, temperature, one cycle per output turn.

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
    top = record.top_speed
    columns = [np.ones(record.size), *(record.bag == one for one in np.unique(record.bag)[1:])]
    if np.std(record.speed) > 0.05 * top:
        columns += [record.speed / top, record.way]
    if record.temperature is not None and np.std(record.temperature) > 0.3:
        columns.append(record.temperature - record.temperature.mean())
    if np.ptp(output) > 0.8 * np.pi:
        columns += [np.cos(output), np.sin(output)]
    return np.stack(columns, axis=1)


def refit(
    record: Record,
    configured: Drive,
    rng: np.random.Generator,
    extra: Floats | None = None,
    start: Floats | None = None,
    starts: Starts = STARTS,
    motor: Motor | None = None,
) -> Refit:
    """Fit the model's parameters from many starts, together with an offset of the torque.

    With torque from motor current the tooth compliance stays as configured: only its product with the
    motor's torque constant shows.

    Parameters
    ----------
    record : Record
    configured : Drive
    rng : numpy.random.Generator
        Draws the samples.
    extra : ndarray, shape (n, k), optional
        Further free columns: effects already found.
    start : ndarray, shape (p,), optional
        One more start, at the current fit. The search ends once all hopeful starts lead back to it.
    starts : sequence of (float, float)
        Eccentricities to begin with: magnitude [um], direction [pi rad].
    motor : Motor, optional
        The motor's own torque, which is fitted too.

    Returns
    -------
    Refit
    """
    if configured.mesh.geometry.sections > 1 and starts is STARTS:
        starts = FEW_STARTS  # the cost of each grows with the sections
    free = nuisance(record, configured.kinematics.ratio)
    if extra is not None:
        free = np.concatenate((free, extra), axis=1)
    points, noise = _starts(configured, start, starts), _FIRST_NOISE
    if motor is not None:
        points = _of_motor(points, record, motor)
    rows = np.flatnonzero(usable(record))
    for samples, steps, kept in _ROUNDS:
        some = np.sort(rng.choice(rows, min(samples, rows.size), replace=False))
        problem = _Problem(record, configured, free, some, noise, motor)
        trials = sorted((_levenberg(problem, point, steps) for point in points), key=lambda trial: trial[1])
        hopeful = [point for point, value in trials if value < _HOPELESS * trials[0][1]]
        points = distinct(hopeful, configured)[:kept]
        noise = max(float(np.sqrt(np.mean(problem.residual_and_jacobian(points[0])[0] ** 2))), _LEAST_NOISE)
        if start is not None and not distinct([start, *points], configured)[1:]:
            break
        if samples == _ROUNDS[0][0]:
            points += [leaning for point in points[:_LEANT] for leaning in _leaning(point, configured)]
    covariance = problem.covariance(trials[0][0])
    own = fit_parameters.count(configured)
    (point, deviance), *others = [(found[:own], value) for found, value in trials]
    near = [other for other, value in others if value - deviance < DISTINCT]
    rivals = distinct([point, *near], configured)[1:]
    ambiguous = any(_apart(point, rival, covariance, configured) > DISTINCT for rival in rivals)
    zero, *taken = trials[0][0][own:].tolist()
    drive = fit_parameters.drive_of(point, configured)
    return Refit(
        drive, point, covariance, AMBIGUOUS if ambiguous else "", np.array(taken), zero * problem.offset
    )


def usable(record: Record, shift: Floats | float = 0.0) -> npt.NDArray[np.bool_]:
    """Samples where the model's error is well defined and new: moving, or under a torque that changes.

    Near zero torque the noise of the torque decides the flank. Such samples are excluded, unless less than a
    tenth would remain. At rest an encoder repeats one count, so many samples say no more than one.

    Parameters
    ----------
    record : Record
    shift : ndarray, shape (n,) or (n, k), or float
        Real less reported torque [N m], if it is known; k columns for k possibilities.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    found = ~_resting(record)
    if record.has_torque:
        shifted = np.abs(record.torque + np.atleast_2d(np.asarray(shift).T)).min(axis=0)
        load = np.minimum(np.abs(record.torque), shifted)
        for least in (_GAP * np.percentile(np.abs(record.torque), 99), _CERTAIN * record.torque_deviation):
            certain = found & (load >= least)
            if np.count_nonzero(certain) >= _ENOUGH * np.count_nonzero(found):
                found = certain
    return found


def _resting(record: Record) -> npt.NDArray[np.bool_]:
    """Samples well inside a rest of both motion and torque."""
    if record.size < 2:
        return np.zeros(record.size, dtype=np.bool_)
    lag = max(round(_SETTLING / max(usual_step(record.time), 1e-6)), 1)
    change = np.abs(record.torque - np.roll(record.torque, lag))
    speed = np.abs(record.speed)
    still = (speed <= _STILL * np.percentile(speed, 95)) & (change <= _STEADY * np.ptp(record.torque))
    return np.asarray(binary_erosion(still, iterations=lag))


def _starts(configured: Drive, start: Floats | None, starts: Starts) -> list[Floats]:
    first = fit_parameters.vector(configured, configured)
    points = []
    for size, turn in starts:
        point = first.copy()
        point[:2] = size * np.cos(np.pi * turn), size * np.sin(np.pi * turn)
        points.append(point)
    again = [] if any(np.array_equal(first, point) for point in points) else [first]
    return [*points, *again, *([] if start is None else [start])]


def _leaning(point: Floats, configured: Drive) -> list[Floats]:
    """A point tilted in each direction, for a drive with sections: at zero tilt the slopes vanish."""
    points = list[Floats]()
    if fit_parameters.count(configured) > TILT.start:
        turn = 2.0 * np.pi if configured.mesh.geometry.cup_length else np.pi  # a ring's ends are alike
        for angle in turn * np.array(_QUARTERS):
            points.append(point.copy())
            points[-1][TILT] = _LEANING * np.cos(angle), _LEANING * np.sin(angle)
    return points


def _of_motor(points: list[Floats], record: Record, motor: Motor) -> list[Floats]:
    """Starts with the motor's friction, from the current both ways through each place, at several datums."""
    place, taken = record.output_angle, motor.torque[:, 1:]
    waves = [f(order * place) for order in (1.0, 2.0) for f in (np.cos, np.sin)]
    columns = np.column_stack((taken, *waves, np.ones(record.size)))
    known = np.append(0.0, -np.linalg.lstsq(columns, record.torque, rcond=None)[0][: taken.shape[1]])
    known = np.clip(known, -_MOST_OFF * motor.effect.usual, _MOST_OFF * motor.effect.usual)
    found = []
    for datum in _DATUMS:
        for point in points:
            begun = np.concatenate((point, [0.0], known))
            begun[DATUM] += datum
            found.append(begun)
    return found


def _coarse(configured: Drive) -> Drive:
    """The drive with as few sections as a search needs."""
    mesh = configured.mesh
    geometry = replace(mesh.geometry, sections=min(mesh.geometry.sections, _SECTIONS))
    return replace(configured, mesh=replace(mesh, geometry=geometry))


class _Problem:
    """Least squares of the transmission error on some rows: free columns projected out, prior included."""

    def __init__(
        self,
        record: Record,
        configured: Drive,
        free: Floats,
        rows: npt.NDArray[np.int64],
        noise: float,
        motor: Motor | None,
    ) -> None:
        self.configured, self.own = _coarse(configured), fit_parameters.count(configured)
        self.motor = None if motor is None else motor._replace(torque=motor.torque[rows])
        own = np.zeros(0) if motor is None else motor.effect.usual
        self.input_angle, self.torque = record.input_angle[rows], record.torque[rows]
        self.measured = record.output_angle[rows] - self.input_angle / configured.kinematics.ratio
        self.free = np.linalg.qr(free[rows])[0]
        center, width = fit_parameters.prior(configured)
        fixed = [COMPLIANCE] if record.by_current else []
        center[fixed], width[fixed] = fit_parameters.vector(configured, configured)[fixed], _HELD
        self.center = np.concatenate((center, [0.0], np.zeros(own.size)))
        self.width = np.concatenate((width, [1.0 if record.has_torque else _HELD], own))
        self.offset = _OFFSET * configured.rated_torque
        self.noise = noise

    def admissible(self, point: Floats) -> Floats:
        """A point moved into bounds: the drive's parameters, the torque's zero and the current's gain."""
        found = np.zeros(self.center.size)
        found[: point.size] = point
        found[: self.own] = fit_parameters.admissible(point[: self.own], self.configured)
        two = slice(self.own, self.own + 2)  # the torque's zero, and the gain of a current
        most = _MOST_OFF * self.width[two]
        found[two] = np.clip(found[two], -most, most)
        return found

    def residual_and_jacobian(self, point: Floats) -> tuple[Floats, Floats]:
        point = self.admissible(point)
        drive = fit_parameters.drive_of(point[: self.own], self.configured)
        torque = self.torque + float(point[self.own]) * self.offset
        by_torque = [np.full_like(self.torque, self.offset)]
        if self.motor is not None:
            effect, own = self.motor
            torque = torque + effect.more(own, point[self.own + 1 :])
            by_torque += list(effect.changes(own, point[self.own + 1 :]).T)
        error, jacobian, slope = fit_parameters.along(
            drive, self.configured, self.input_angle, torque, _STEPS
        )
        columns = np.concatenate((jacobian, slope[:, None] * np.stack(by_torque, axis=1)), axis=1)
        return self._projected(self.measured - error), self._projected(columns)

    def _projected(self, columns: Floats) -> Floats:
        columns = np.nan_to_num(columns, posinf=0.0, neginf=0.0)
        return columns - self.free @ (self.free.T @ columns)

    def deviance(self, residual: Floats, point: Floats) -> float:
        away = (point - self.center) / self.width
        return float(residual @ residual) / self.noise**2 + float(np.sum(away**2))

    def covariance(self, point: Floats) -> Floats:
        residual, jacobian = self.residual_and_jacobian(point)
        variance = float(residual @ residual) / max(residual.size - point.size - self.free.shape[1], 1)
        spread = np.linalg.inv(jacobian.T @ jacobian / variance + np.diag(self.width**-2.0))
        return np.asarray(spread[: self.own, : self.own])


def _levenberg(problem: _Problem, point: Floats, iterations: int) -> tuple[Floats, float]:
    """Levenberg-Marquardt: the point reached and its deviance."""
    point, damping = problem.admissible(point), 1e-3
    residual, jacobian = problem.residual_and_jacobian(point)
    deviance = problem.deviance(residual, point)
    for _ in range(iterations):
        normal = jacobian.T @ jacobian / problem.noise**2 + np.diag(problem.width**-2.0)
        slope = jacobian.T @ residual / problem.noise**2 - (point - problem.center) / problem.width**2
        for _ in range(_DAMPINGS):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope)
            trial = problem.admissible(point + step)
            new_residual, new_jacobian = problem.residual_and_jacobian(trial)
            new = problem.deviance(new_residual, trial)
            if new < deviance:
                break
            damping *= 8.0
        else:
            break
        gain, deviance = deviance - new, new
        point, residual, jacobian, damping = trial, new_residual, new_jacobian, max(damping / 6.0, 1e-9)
        if gain < _SETTLED:
            break
    return point, deviance


def _apart(point: Floats, other: Floats, covariance: Floats, configured: Drive) -> float:
    """Deviance by which another drive would be worse if there were one minimum; least of its equivalents."""
    away = [each - point for each in alike(other, configured)]
    return min(float(step @ np.linalg.solve(covariance, step)) for step in away)


def distinct(points: list[Floats], configured: Drive | None = None) -> list[Floats]:
    """Points that are distinct drives. Swapped lobes count as the same drive.

    With `configured`, swapped ends of a ring do as well.

    Parameters
    ----------
    points : list of ndarray, shape (p,)
        In the units of `fit_parameters.units`; with `configured`, further entries are not compared.
    configured : Drive, optional

    Returns
    -------
    list of ndarray
        The first point of every distinct drive.
    """
    found: list[Floats] = []
    for point in points:
        own = point if configured is None else point[: fit_parameters.count(configured)]
        same = (own, swapped(own)) if configured is None else alike(own, configured)
        near = (np.abs(each[: own.size] - other) < _NEAR[: own.size] for each in found for other in same)
        if not any(map(np.all, near)):
            found.append(point)
    return found
