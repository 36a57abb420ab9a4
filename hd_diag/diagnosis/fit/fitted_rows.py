"""The rows of a record that fits use, and the results that all fits of these rows share."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.drift import drift_columns
from hd_diag.diagnosis.fit.fit_parameters import COMPLIANCE
from hd_diag.diagnosis.fit.record_model import RecordModel
from hd_diag.diagnosis.measured_noise import (
    NEVER,
    MeasuredNoise,
    Revisits,
    count_steps,
    measured_covariance,
    measured_noise,
    revisits,
    rounding,
)
from hd_diag.diagnosis.noise import Whitening, whitening, whitening_of
from hd_diag.diagnosis.record import Record
from hd_diag.drive import Drive
from hd_diag.effects import Catalogue
from hd_diag.effects.array_cache import ArrayCache
from hd_diag.effects.effect import Effect, Starts, Values
from hd_diag.effects.signals import Signals

_BLOCKS = 24
_MISFIT = 1.15  # times the measured noise, from which a residual is not used as noise
_MOST_KEPT = 160 << 20  # bytes
_KNOWN = 2  # cached points of the parameters: a search goes back to them


class PassNoise(NamedTuple):
    """Noise measured by passes of the same states: rms [rad], covariances at lags 0 to ORDER [rad^2]."""

    rms: float
    covariance: Floats


@dataclass(frozen=True, eq=False)
class FittedRows:
    """Rows of a record to be fitted.

    Parameters
    ----------
    model : RecordModel
        The model along all rows.
    mask : ndarray of bool, shape (n,)
        Which rows are fitted.
    catalogue : tuple of Effect
        Causes to search among.
    known : PassNoise, optional
        Noise measured on more rows of the record.

    Attributes
    ----------
    counts : dict
        Numbers of columns of effects, by name and nonlinear values.
    """

    model: RecordModel
    mask: npt.NDArray[np.bool_]
    catalogue: Catalogue
    known: PassNoise | None = None
    counts: dict[tuple[str, Values], int] = field(default_factory=dict, init=False)
    _signals: dict[bytes, Signals] = field(default_factory=dict, init=False)
    _testable: dict[str, tuple[bool, str]] = field(default_factory=dict, init=False)
    _grids: dict[str, Starts] = field(default_factory=dict, init=False)

    @property
    def source(self) -> Record:
        """The record with all rows."""
        return self.model.record

    @property
    def configured(self) -> Drive:
        """The simulation as configured."""
        return self.model.configured

    def on(self, mask: npt.NDArray[np.bool_]) -> FittedRows:
        """The same for other rows of the record."""
        same = np.array_equal(mask, self.mask)
        return self if same else FittedRows(self.model, mask, self.catalogue, self.known)

    @cached_property
    def at(self) -> Integers:
        """Indices of the fitted rows: several times as fast as a mask."""
        return np.flatnonzero(self.mask)

    @cached_property
    def record(self) -> Record:
        """The record with the fitted rows."""
        return self.source.select(self.mask)

    @cached_property
    def run(self) -> Integers:
        """Run numbers of the fitted rows, with a new number after every omitted row."""
        gap = np.concatenate(([False], np.diff(self.at) > 1))
        change = np.concatenate(([False], np.diff(self.source.run[self.mask]) != 0))
        return np.cumsum(gap | change).astype(np.int64)

    @cached_property
    def block(self) -> Integers:
        """Numbers of 24 contiguous blocks of equal length; each block can be held out."""
        return (np.arange(self.at.size) * _BLOCKS // max(self.at.size, 1)).astype(np.int64)

    @cached_property
    def bag_of_block(self) -> Integers:
        """Recording in which the middle of each block lies."""
        edges = np.searchsorted(self.block, np.arange(self.block[-1] + 2))
        return np.asarray(self.record.bag[(edges[:-1] + edges[1:]) // 2], np.int64)

    @cached_property
    def offsets(self) -> Floats:
        """Columns of the encoders' zero at the fitted rows, one per recording; or of a velocity's drift."""
        if self.source.by_velocity:
            return drift_columns(self.source.time, self.source.bag)[self.at]
        bag = self.record.bag
        return np.column_stack((np.ones(bag.size), *(bag == one for one in np.unique(self.source.bag)[1:])))

    @property
    def searched(self) -> Catalogue:
        """Effects of the catalogue that are searched for in the residual."""
        return tuple(effect for effect in self.catalogue if effect.searched)

    @property
    def given(self) -> tuple[tuple[Effect, Values], ...]:
        """Effects that are part of every fit of these rows, with initial nonlinear values."""
        every = self.catalogue if self.source.by_current else ()
        return tuple((effect, effect.grid[0]) for effect in every if effect.given)

    @property
    def held(self) -> tuple[int, ...]:
        """Indices of unidentifiable parameters. Motor current shows only stiffness times torque constant."""
        return (COMPLIANCE,) if self.source.by_current else ()

    @cached_property
    def kept(self) -> ArrayCache:
        """Cache of arrays computed for these rows."""
        return ArrayCache(_MOST_KEPT)

    @cached_property
    def revisits(self) -> Revisits:
        """Pairs of fitted rows at which the drive is in the same state; none if no torque is measured."""
        return revisits(self._motion) if self.record.has_torque else NEVER

    @cached_property
    def count_steps(self) -> tuple[float, float]:
        """Count steps of the input encoder, at the output, and of the output encoder [rad]; 0: none found."""
        return count_steps(self.record, self.configured.kinematics.ratio)

    @property
    def counted(self) -> float:
        """Rms quantisation error of both encoders together [rad]."""
        return rounding(math.hypot(*self.count_steps))

    def noise_of(self, residual: Floats) -> MeasuredNoise:
        """Noise in a residual (n,) [rad] of the fitted rows, even if the residual contains misfit."""
        return measured_noise(residual, self.record.time, self.run, self.revisits, self.counted)

    def whitening_of(self, residual: Floats, fitted: Floats) -> Whitening:
        """Noise model from the residual of orthonormal columns, or from passes if it exceeds their noise."""
        known = self.passes(residual)
        if known is None or float(np.std(residual)) < _MISFIT * known.rms:
            return whitening(residual, self.run, fitted)
        return whitening_of(known.covariance)

    def passes(self, residual: Floats) -> PassNoise | None:
        """Least noise measured by repeated passes of the same states; None if no states repeat.

        The model's error differs between passes as well, so a better model or more rows give less noise.
        """
        noise = self.noise_of(residual)
        if not noise.repeated or (self.known is not None and (noise.vague or self.known.rms < noise.rms)):
            return self.known
        return PassNoise(noise.rms, measured_covariance(residual, self.run, self.revisits, noise))

    def signals(self, parameters: Floats) -> Signals:
        """Signals of the fitted rows at parameters in units of `fit_parameters.units`; the latest cached."""
        known, key = self._signals, parameters.tobytes()
        part = known.pop(key) if key in known else self.model.at(parameters).signals.part(self.at)
        known[key] = part
        while len(known) > _KNOWN:
            del known[next(iter(known))]
        return part

    def testable(self, effect: Effect) -> tuple[bool, str]:
        """Whether the motion can show an effect; if not, which extra motion would."""
        if effect.name not in self._testable:
            self._testable[effect.name] = effect.testable(self._motion)
        return self._testable[effect.name]

    def grid(self, effect: Effect) -> list[Values]:
        """Start points of an effect's nonlinear values."""
        return self._starts(effect).points

    def trials(self, effect: Effect) -> int:
        """Number of places at which an effect is looked for, at least 1."""
        return max(self._starts(effect).trials, 1)

    def _starts(self, effect: Effect) -> Starts:
        if effect.name not in self._grids:
            self._grids[effect.name] = effect.starts(self._motion)
        return self._grids[effect.name]

    def grid_step(self, effect: Effect, point: Values) -> Floats:
        """Grid step about a point in each nonlinear value; a usual size if the grid has one value only."""
        found = []
        for quantity, place, column in zip(
            effect.nonlinear, point, zip(*self.grid(effect), strict=True), strict=True
        ):
            values = np.unique(column)
            about = np.searchsorted(values[1:-1], place)
            found.append(np.diff(values)[about] if values.size > 1 else quantity.prior_scale)
        return np.array(found)

    @cached_property
    def smooth(self) -> Floats:
        """Columns (n, k) that imitate smooth causes: low orders, powers of the torque, torque times speed."""
        s = self._motion
        theta, turned = s.wave_generator_angle, s.wave_generator_angle + s.output_angle
        load = s.torque / max(float(np.max(np.abs(s.torque))), 1e-9)
        columns = [f(k * theta) for k in (1, 2, 3, 4, 6, 8) for f in (np.cos, np.sin)]
        columns += [f(k * theta) * load for k in (1, 2, 4) for f in (np.cos, np.sin)]
        columns += [f(k * turned) for k in (2, 4) for f in (np.cos, np.sin)]
        columns += [f(k * s.output_angle) for k in (1, 2) for f in (np.cos, np.sin)]
        speed = s.speed / max(float(np.max(np.abs(s.speed))), 1e-9)
        return np.stack([*columns, load**3, load * np.abs(load), np.abs(load), load * speed]).T

    @cached_property
    def _motion(self) -> Signals:
        """Signals at any cached parameters, for questions about the motion only."""
        return self.model.motion.part(self.at)
