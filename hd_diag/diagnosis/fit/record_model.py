"""The model along all rows of a record, fitted or not."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import DriveAlong
from hd_diag.diagnosis.noise import bounds
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.smoothing import smooth
from hd_diag.diagnosis.stamps import usual_step
from hd_diag.diagnosis.work import Work
from hd_diag.drive import Drive
from hd_diag.effects.array_cache import ArrayCache
from hd_diag.effects.contact_weights import contact_weights
from hd_diag.effects.effect import Values
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.signals import Signals

_MOST_KEPT = 64 << 20  # bytes
_ALIKE = 2.0  # difference of parameters, in their units, within which load sharing is the same
_KNOWN = 3  # cached points of the parameters: a search goes back to them


class AtParameters(NamedTuple):
    """The model at some parameters along a record: signals, derivatives (n, p), the drive at any torque."""

    signals: Signals
    derivatives: Floats
    along: DriveAlong


@dataclass(frozen=True, eq=False)
class RecordModel:
    """A record and the model along it, computed once for all fits of any of its rows.

    Parameters
    ----------
    record : Record
        All rows: causes with memory need every one.
    configured : Drive
    work : Work
        Its time is checked before the model is computed at new parameters.
    """

    record: Record
    configured: Drive
    work: Work = field(default_factory=Work)
    _known: dict[bytes, AtParameters] = field(default_factory=dict, init=False)
    _near: dict[bytes, Floats] = field(default_factory=dict, init=False)

    @cached_property
    def kept(self) -> ArrayCache:
        """Cache of arrays computed for all rows."""
        return ArrayCache(_MOST_KEPT)

    def at(self, parameters: Floats) -> AtParameters:
        """The model at parameters in units of `fit_parameters.units`; the latest results are cached."""
        known, key = self._known, parameters.tobytes()
        known[key] = known.pop(key) if key in known else self._at(parameters)
        while len(known) > _KNOWN + len(self._near):
            del known[next(one for one in known if one not in self._near)]
        return known[key]

    def near(self, parameters: Floats) -> Floats:
        """Cached parameters near some (p,); if there are none, the given ones, which are then cached."""
        for one in self._near.values():
            if np.max(np.abs(np.delete(one - parameters, fit_parameters.CUP))) < _ALIKE:
                return one
        while len(self._near) >= _KNOWN:
            del self._near[next(iter(self._near))]
        self.at(parameters)
        return self._near.setdefault(parameters.tobytes(), parameters)

    @property
    def motion(self) -> Signals:
        """Signals at any cached parameters, for questions about the motion only."""
        known = next(iter(self._known.values()), None)
        return (known or self.at(fit_parameters.vector(self.configured, self.configured))).signals

    def torque(self, effect: MeshTorque, nonlinear: Values) -> Floats:
        """Torque that an effect adds at all rows [N m per unit], shape (n, size)."""

        def torque() -> Floats:
            record, width = self.record, self.record.torque_window
            kept = record.torque_with_waves and effect.frame == "input"
            if kept or not (effect.reported and width.any()):
                seen = self.motion if record.taken is None else self.motion.bearing(record.by_sensor)
                return np.nan_to_num(effect.torque(seen, nonlinear))
            columns = np.nan_to_num(effect.torque(self.motion.bearing(record.reported_torque), nonlinear))
            used, step = np.flatnonzero(columns.any(axis=0)), usual_step(record.time)
            columns[:, used] = smooth(columns[:, used], record.run, step, width)
            return columns

        return self.kept.get(("torque", effect.name, nonlinear), torque)

    def greatest_torque(self, effect: MeshTorque, nonlinear: Values) -> Floats:
        """Greatest magnitude of each of these columns [N m per unit], shape (size,)."""

        def greatest() -> Floats:
            return np.asarray(np.max(np.abs(self.torque(effect, nonlinear)), axis=0, initial=1e-9))

        return self.kept.get(("greatest torque", effect.name, nonlinear), greatest)

    def derivatives(self, parameters: Floats, shift: Floats) -> Floats:
        """The model's derivatives by its parameters at all rows, (n, p); `shift` (n,) adds torque [N m]."""
        if not shift.any():
            return self.at(parameters).derivatives
        return self.at(parameters).along(self.record.torque + shift)[1]

    def under(self, parameters: Floats, shift: Floats) -> tuple[Floats, Floats]:
        """Transmission error at all rows [rad] and its derivative by the torque [rad/(N m)], (n,) each.

        `shift` (n,) adds torque [N m].
        """
        error, _, slope = self.at(parameters).along(self.record.torque + shift)
        return error, slope

    def secants(self, parameters: Floats, shift: Floats, reach: Floats) -> Floats:
        """As `derivatives`, averaged over steps to both sides: columns of `reach` (p, p), in parameter units.

        The slope changes where a pair of teeth comes into load. Steps end at the bounds of the parameters.
        """
        local, torque = self.derivatives(parameters, shift), self.record.torque + shift
        bent = np.zeros((local.shape[0], reach.shape[1]))
        for number, step in enumerate(reach.T):
            if step.any():
                ends = (parameters + step, parameters - step)
                high, low = (fit_parameters.admissible(end, self.configured) for end in ends)
                self.work.check()
                change = np.subtract(*(self._drive_along(end)(torque)[0] for end in (high, low)))
                bent[:, number] = np.nan_to_num(change) - local @ (high - low)
        return np.asarray(local + bent @ np.linalg.pinv(2.0 * reach))

    def _drive_along(self, parameters: Floats) -> DriveAlong:
        """The model at some parameters, for any torques."""
        drive, record = fit_parameters.drive_of(parameters, self.configured), self.record
        return DriveAlong(drive, self.configured, record.input_angle, record.torque)

    def rate(self, values: Floats) -> Floats:
        """Time derivative of values (n,) at all rows, run by run."""
        if self.record.size < 2:
            return np.zeros(self.record.size)
        first, end = np.array(bounds(self.record.run)).T
        with np.errstate(divide="ignore", invalid="ignore"):  # between runs, overwritten below
            rate = np.gradient(values, self.record.time)
            step = np.diff(values) / np.diff(self.record.time)
        long = end - first > 2
        rate[first[long]], rate[end[long] - 1] = step[first[long]], step[end[long] - 2]
        rate[(~long)[np.repeat(np.arange(first.size), end - first)]] = 0.0
        return rate

    def _at(self, parameters: Floats) -> AtParameters:
        self.work.check()
        record, along = self.record, self._drive_along(parameters)
        drive = along.drive
        error, derivatives, slope = along(record.torque)
        angle = drive.frame.wave_generator_angle(record.input_angle)
        reported = 0.0 if record.taken is None else float(np.max(np.abs(record.by_sensor)))
        torsion = -drive.frame.torque_sign * (error + drive.cup_compliance * record.torque)
        signals = Signals(
            time=record.time,
            wave_generator_angle=angle,
            output_angle=record.input_angle / drive.frame.ratio,
            speed=record.speed,
            torque=record.torque,
            temperature=record.temperature,
            run=record.stretch,
            predicted=error,
            predicted_torque_slope=slope,
            predicted_rate=self.rate(error),
            contact=contact_weights(drive, angle, record.torque, torsion, reported),
            recording=record.bag,
        )
        return AtParameters(signals, derivatives, along)
