"""A drive with the causes that a diagnosis found; it predicts sample by sample or a record at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import Drive, transmission_error
from hd_diag.effects.contact_table import MAP_STEPS, ContactTable
from hd_diag.effects.contact_weights import ContactWeights, greatest_torque
from hd_diag.effects.effect import Effect, Stage, Values, seen_at
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.signals import Signals
from hd_diag.model.torsion_map import STEPS_PER_TOOTH, TorsionMap, build

TORQUE_RANGE = 2.0
"""Torque range of a running joint's map over the rated torque [-]; beyond it the exact solution is used."""


class Term(NamedTuple):
    """An effect with its coefficients and the values of its nonlinear quantities."""

    effect: Effect
    coefficients: tuple[float, ...]
    nonlinear: Values


class Range(NamedTuple):
    """Least and greatest value."""

    low: float
    high: float


class Ranges(NamedTuple):
    """Ranges of the fitted data: torque [N m], input speed [rad/s], temperature [degree Celsius] or None."""

    torque: Range
    speed: Range
    temperature: Range | None = None


class State(NamedTuple):
    """State of a model within a stream.

    Attributes
    ----------
    time, angle, predicted : float
        Values at the last sample [s], [rad], [rad]; nan before the first. `predicted` is the error that
        enters effects of `Stage.STREAM`: the drive's own plus that of the gear and spring stages.
    speed : float
        Input speed at the last sample [rad/s].
    effects : tuple
        States of the effects.
    """

    time: float
    angle: float
    predicted: float
    speed: float
    effects: tuple[Any, ...]

    @property
    def is_fresh(self) -> bool:
        """Whether there was no sample yet."""
        return self.time != self.time


@dataclass(frozen=True)
class ExtendedModel:
    """A refitted drive, the effects beside it and the encoders' offset.

    Parameters
    ----------
    drive : Drive
        Drive with refitted parameters.
    effects : tuple of Term
    offset : float
        Added to the transmission error [rad].
    ranges : Ranges

    Notes
    -----
    All signals are causal. The speed is the reported one, otherwise the difference of the last two input
    angles over their times. The rate of the prediction is a backward difference. The first sample is computed
    at rest; if its speed is not reported, the state of the effects begins with the second sample.
    """

    drive: Drive
    effects: tuple[Term, ...]
    offset: float
    ranges: Ranges

    def start(self) -> State:
        """State before the first sample of a stream."""
        nothing = float("nan")
        effects = tuple(term.effect.start(term.nonlinear) for term in self.effects)
        return State(nothing, nothing, nothing, 0.0, effects)

    def step(
        self,
        state: State,
        time: Floats,
        input_angle: Floats,
        speed: Floats | None,
        torque: Floats,
        temperature: Floats | None = None,
        table: TorsionMap | None = None,
    ) -> tuple[Floats, State]:
        """Transmission error (n,) [rad] at the next n samples, and the state after them.

        Columns (n,): time, rising [s]; input angle as reported, continuous over the turns [rad]; input speed
        as reported [rad/s], computed from the angles where it is None or nan; torque on the link [N m];
        temperature [degree Celsius]. The table is a map of the drive's mesh. nan if the teeth cannot bear it.
        """
        if not time.size:
            return np.empty(0), state
        if state.is_fresh and time.size > 1:
            parts = []
            for rows in (slice(0, 1), slice(1, None)):
                known, heat = (None if c is None else c[rows] for c in (speed, temperature))
                here = time[rows], input_angle[rows], known, torque[rows], heat
                part, state = self.step(state, *here, table)
                parts.append(part)
            return np.concatenate(parts), state
        signals = self._signals(state, time, input_angle, speed, torque, temperature)
        step, after = _change(time, state.time), list(state.effects)
        terms = sorted(enumerate(self.effects), key=lambda one: one[1].effect.stage)
        mesh_torque = torque
        for index, (effect, coefficients, nonlinear) in terms:
            if isinstance(effect, MeshTorque):
                columns, after[index] = effect.torque_step(state.effects[index], signals, nonlinear)
                mesh_torque = mesh_torque + np.nan_to_num(effect.more(columns, np.array(coefficients)))
        own = transmission_error(self.drive, input_angle, mesh_torque, table)
        rate = _rate(_change(own, state.predicted), step)
        if mesh_torque is not torque:
            signals = signals.bearing(mesh_torque)
        signals = replace(signals, predicted=own, predicted_rate=rate)
        added: list[tuple[Effect, Floats]] = []
        for index, term in terms:
            if isinstance(term.effect, MeshTorque):
                continue
            seen = seen_at(
                term.effect.stage, signals, added, lambda error: _rate(_change(error, state.predicted), step)
            )
            part, after[index] = term.effect.step(
                state.effects[index], seen, np.array(term.coefficients), term.nonlinear
            )
            added.append((term.effect, np.where(np.isfinite(part), part, 0.0)))
        before = [part for effect, part in added if Stage.GEAR <= effect.stage < Stage.STREAM]
        streamed = float(own[-1] + sum(part[-1] for part in before))
        total: Floats = own + self.offset + sum(part for _, part in added)
        begun = not state.is_fresh or (speed is not None and bool(np.isfinite(speed[0])))
        now = float(time[-1]), float(input_angle[-1]), streamed, float(signals.speed[-1])
        return total, State(*now, tuple(after) if begun else state.effects)

    @property
    def needs(self) -> frozenset[str]:
        """Names of the signals that the effects are computed from."""
        return frozenset(name for term in self.effects for name in term.effect.needs)

    @cached_property
    def contact_table(self) -> ContactTable:
        """Contact of the teeth up to the greatest torque of the fit, cached with the model.

        In a shared cache many joints would evict each other's tables.
        """
        return ContactTable(self.drive, greatest_torque(self.drive, np.array(self.ranges.torque)))

    @cached_property
    def torsion_map(self) -> TorsionMap | None:
        """Torsion map for a node's predictions; None if the mesh has none: predictions are then exact."""
        return self._map(STEPS_PER_TOOTH)

    @cached_property
    def coarse_map(self) -> TorsionMap | None:
        """Coarser map to run along a record; it is built in an eighth of the time."""
        return self._map(MAP_STEPS)

    def _map(self, steps: int) -> TorsionMap | None:
        try:
            return build(self.drive.mesh, TORQUE_RANGE * self.drive.rated_torque, steps_per_tooth=steps)
        except ValueError:
            return None

    def _signals(
        self,
        state: State,
        time: Floats,
        angle: Floats,
        speed: Floats | None,
        torque: Floats,
        temperature: Floats | None,
    ) -> Signals:
        """Signals that the effects are computed from; the caller adds the prediction."""
        step = _change(time, state.time)
        moved = _rate(_change(angle, state.angle), step)
        frame = self.drive.frame
        turned = frame.wave_generator_angle(angle)
        return Signals(
            time=time,
            wave_generator_angle=turned,
            output_angle=angle / frame.ratio,
            speed=moved if speed is None else np.where(np.isfinite(speed), speed, moved),
            torque=torque,
            temperature=temperature,
            run=np.zeros(time.size, dtype=np.int64),
            predicted=np.full(torque.shape, np.nan),
            predicted_torque_slope=np.full(torque.shape, np.nan),  # for fits only
            predicted_rate=np.full(torque.shape, np.nan),
            contact=ContactWeights(self.contact_table, turned, torque),
        )


def _change(values: Floats, before: float) -> Floats:
    """Difference of every value to the one before it."""
    return np.asarray(values - np.concatenate(([before], values[:-1])))


def _rate(change: Floats, step: Floats) -> Floats:
    """Change over time, zero where either is not known."""
    rising = np.isfinite(change) & (step > 0.0)
    return np.where(rising, change, 0.0) / np.where(rising, step, 1.0)
