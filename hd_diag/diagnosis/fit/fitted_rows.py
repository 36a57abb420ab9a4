"""The rows of a record that fits use, and what all fits of these rows share."""

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
_MISFIT = 1.15  # times the measured noise, beyond which a residual does not say what the noise is like
_MOST_KEPT = 160 << 20  # bytes
_KNOWN = 2  # parameters, for a search that goes back to them


class PassNoise(NamedTuple):
    """Noise as passes of the same states measure it: rms [rad], covariances at lags 0 to ORDER [rad^2]."""

    rms: float
    covariance: Floats


@dataclass(frozen=True, eq=False)
class FittedRows:
    """Rows of a record to be fitted.

    Parameters
    ----------
    model : RecordModel
        Of all rows.
    mask : ndarray of bool, shape (n,)
        Which rows are fitted.
    catalogue : tuple of Effect
        Causes to search among.
    known : PassNoise, optional
        Noise as more rows of the record showed it.

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
        """All rows."""
        return self.model.record

    @property
    def configured(self) -> Drive:
        """The simulation as configured."""
        return self.model.configured

    def on(self, mask: npt.NDArray[np.bool_]) -> FittedRows:
        """Other rows of the same record."""
        same = np.array_equal(mask, self.mask)
        return self if same else FittedRows(self.model, mask, self.catalogue, self.known)

    @cached_property
    def at(self) -> Integers:
        """Numbers of the fitted rows: several times as fast as a mask."""
        return np.flatnonzero(self.mask)

    @cached_property
    def record(self) -> Record:
        """The fitted rows."""
        return self.source.select(self.mask)

    @cached_property
    def run(self) -> Integers:
        """Run numbers of the fitted rows, with a new number after every row left out."""
        gap = np.concatenate(([False], np.diff(self.at) > 1))
        change = np.concatenate(([False], np.diff(self.source.run[self.mask]) != 0))
        return np.cumsum(gap | change).astype(np.int64)

    @cached_property
    def block(self) -> Integers:
        """Numbers of some 24 contiguous stretches of equal length, of which each can be held out."""
        return (np.arange(self.at.size) * _BLOCKS // max(self.at.size, 1)).astype(np.int64)

    @cached_property
    def bag_of_block(self) -> Integers:
        """Recording in which the middle of each block lies."""
        edges = np.searchsorted(self.block, np.arange(self.block[-1] + 2))
        return np.asarray(self.record.bag[(edges[:-1] + edges[1:]) // 2], np.int64)

    @cached_property
    def offsets(self) -> Floats:
        """Columns of the encoders' zero at the fitted rows, one for each recording; or of its drift."""
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
        """What is part of every fit of these rows, with nonlinear values to begin with."""
        every = self.catalogue if self.source.by_current else ()
        return tuple((effect, effect.grid[0]) for effect in every if effect.given)

    @property
    def held(self) -> tuple[int, ...]:
        """Numbers of the parameters that no fit can tell: by a current only stiffness times its constant."""
        return (COMPLIANCE,) if self.source.by_current else ()

    @cached_property
    def kept(self) -> ArrayCache:
        """What was computed of these rows and may be needed again."""
        return ArrayCache(_MOST_KEPT)

    @cached_property
    def revisits(self) -> Revisits:
        """Fitted rows at which the drive is in the same state; none are known where no torque is measured."""
        return revisits(self._motion) if self.record.has_torque else NEVER

    @cached_property
    def count_steps(self) -> tuple[float, float]:
        """Steps of the input's encoder, at the output, and of the output's [rad]; see :func:`count_steps`."""
        return count_steps(self.record, self.configured.kinematics.ratio)

    @property
    def counted(self) -> float:
        """Rms of the rounding of both encoders to their counts [rad]."""
        return rounding(math.hypot(*self.count_steps))

    def noise_of(self, residual: Floats) -> MeasuredNoise:
        """Noise of a residual of the fitted rows [rad], shape (n,), whatever misfit is in it."""
        return measured_noise(residual, self.record.time, self.run, self.revisits, self.counted)

    def whitening_of(self, residual: Floats, fitted: Floats) -> Whitening:
        """Noise model from what orthonormal columns leave at the fitted rows: it may be more than noise."""
        known = self.passes(residual)
        if known is None or float(np.std(residual)) < _MISFIT * known.rms:
            return whitening(residual, self.run, fitted)
        return whitening_of(known.covariance)

    def passes(self, residual: Floats) -> PassNoise | None:
        """Noise as passes of the same states measure it, the least that is known; None where they do not.

        What a model leaves out differs between passes too, so that a better model or more rows show less.
        """
        noise = self.noise_of(residual)
        if not noise.repeated or (self.known is not None and (noise.vague or self.known.rms < noise.rms)):
            return self.known
        return PassNoise(noise.rms, measured_covariance(residual, self.run, self.revisits, noise))

    def signals(self, parameters: Floats) -> Signals:
        """Of the fitted rows at parameters in units of `fit_parameters.units`; the latest are kept."""
        known, key = self._signals, parameters.tobytes()
        part = known.pop(key) if key in known else self.model.at(parameters).signals.part(self.at)
        known[key] = part
        while len(known) > _KNOWN:
            del known[next(iter(known))]
        return part

    def testable(self, effect: Effect) -> tuple[bool, str]:
        """Whether the motion allows to find an effect; if not, which extra motion would."""
        if effect.name not in self._testable:
            self._testable[effect.name] = effect.testable(self._motion)
        return self._testable[effect.name]

    def grid(self, effect: Effect) -> list[Values]:
        """Start points of an effect's nonlinear values."""
        return self._starts(effect).points

    def trials(self, effect: Effect) -> int:
        """Number of places among which an effect is looked for."""
        return max(self._starts(effect).trials, 1)

    def _starts(self, effect: Effect) -> Starts:
        if effect.name not in self._grids:
            self._grids[effect.name] = effect.starts(self._motion)
        return self._grids[effect.name]

    def grid_step(self, effect: Effect, point: Values) -> Floats:
        """Step of the grid about a point, in each nonlinear value; a usual size where all are one."""
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
        """What any cause may look like at the fitted rows: low orders, powers of torque, speed; (n, k)."""
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
        """At whatever parameters, for what is asked of the motion alone."""
        return self.model.motion.part(self.at)
