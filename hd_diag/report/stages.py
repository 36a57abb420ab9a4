"""A record beside the model in its stages, as configured, refitted and extended, binned for pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.diagnosis import Diagnosis
from hd_diag.diagnosis.extension import running_residual
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.fit.refit import usable
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive, transmission_error
from hd_diag.effects.order_spectrum import spectrum
from hd_diag.report.binned import Band, Envelope, band, envelope, strongest
from hd_diag.report.teeth import strongest_torque

NOMINAL, REFIT, EXTENDED = "as configured", "refitted", "extended"

_ANGLE_BINS = 72
_TORQUE_BINS = 40
_STRETCHES = 240
_SPECTRUM_POINTS = 600
_TURN = 2.0 * np.pi
_GRID_ANGLES, _GRID_TORQUES = 48, 41


@dataclass(frozen=True)
class Stages:
    """A record where the model's error is well defined, with the residual of each stage of the model.

    The wave generator's angle, the error measured, less the encoders' offset, and the residuals, measured
    less simulated, have shape (n,) [rad]. The drive is the refitted one, or the configured one where nothing
    was fitted.
    """

    record: Record
    angle: Floats
    measured: Floats
    residual: dict[str, Floats]
    drive: Drive


class BinnedResiduals(NamedTuple):
    """Measured error and residuals in bins of an angle or a torque [rad]; the samples' torques [N m]."""

    measured: Band
    residual: dict[str, Band]
    torques: tuple[float, float]
    samples: int

    @property
    def simulated(self) -> dict[str, Floats]:
        """Means over the very samples of each bin [rad]."""
        return {name: self.measured.mean - rest.mean for name, rest in self.residual.items()}


class OverTime(NamedTuple):
    """Torque [N m], speed of the input [rad/s] and the stages' residuals [rad] along a record [s]."""

    torque: Envelope
    speed: Envelope
    residual: dict[str, Envelope]


def stages(diagnosis: Diagnosis, plain: LinearisedFit | None) -> Stages:
    """Residual of each stage of the model; `plain` is the fit to the whole record without causes."""
    rows = usable(diagnosis.record)
    record, configured = diagnosis.record.select(rows), diagnosis.configured
    error = record.output_angle - record.input_angle / configured.kinematics.ratio
    first = error - fit_parameters.along(configured, configured, record.input_angle, record.torque)[0]
    offset = float(first.mean()) if diagnosis.model is None else diagnosis.model.offset
    residual = {NOMINAL: first - first.mean()}
    if plain is not None:
        residual[REFIT] = plain.remainder(())
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

    The ripple changes its sign with the torque: only torques of the stronger direction are taken, the middle
    half of them.
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
