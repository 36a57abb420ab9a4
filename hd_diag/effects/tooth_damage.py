"""One tooth or slot worn or displaced: a pulse whenever a lobe passes it."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.effects.effect import Effect, Starts, Stepped, Values
from hd_diag.effects.excitation import enough_input_turns, enough_output_turns, loaded
from hd_diag.effects.quantity import Quantity, switch
from hd_diag.effects.signals import Signals
from hd_diag.model.geometry import Geometry

SLOT, TOOTH = 0.0, 1.0
"""Member that the damage is on: circular spline or flexspline."""

ARCS = (0.4, 0.7, 1.1)
"""Arcs of the wave generator's turn over which the pairs at a lobe share the load [rad]. Makers state that 15
to 30 % of the teeth engage, half of them at either lobe: 0.5 to 0.9."""

_ARC = "of the wave generator's turn, over which the pairs at a lobe share the load; 0: as the contact has it"
_BINS = 720  # bins over half a turn
_CANDIDATES = 2  # positions per member
_BESIDE = range(-2, 3)  # teeth around a position that are compared exactly
_ENOUGH = 5_000  # samples in that comparison, for speed: a pulse is many teeth wide


class ToothDamage(Effect):
    """Additional clearance at one slot or one tooth, which shows in proportion to its share of the load.

    A second form is a raised cosine over an arc. The first form assumes the configured flanks, and these
    determine how many pairs bear at once; the second form does not.
    """

    def columns(self, signals: Signals, nonlinear: Values) -> Floats:
        """Both flanks; a flank that never bears in this record has zeros. See :meth:`Effect.columns`."""
        return self.slopes(signals, np.zeros(2), nonlinear)

    def slopes(self, signals: Signals, coefficients: Floats, nonlinear: Values) -> Floats:
        """Mean slopes up to the flanks' clearance, because a pair that has parted adds nothing more."""
        member, position, arc = nonlinear
        contact, opening = signals.contact, (float(coefficients[0]), float(coefficients[1]))
        if arc:
            share = _share(signals.seen_from(member) - position, arc)
            return contact.one_by_share(share / contact.drive.mesh.geometry.flexspline_teeth)
        one = contact.one_slot if member == SLOT else contact.one_tooth
        return one(position, opening)

    def step(self, state: Any, signals: Signals, coefficients: Floats, nonlinear: Values) -> Stepped:
        """Response at full size; see :meth:`Effect.step`."""
        return np.asarray(self.slopes(signals, coefficients, nonlinear) @ coefficients), state

    def starts(self, signals: Signals, residual: Floats | None = None) -> Starts:
        """Slots and teeth whose pulses fit a residual best; without a residual, position zero of each."""
        geometry = signals.contact.drive.mesh.geometry
        trials = geometry.circular_spline_teeth + geometry.flexspline_teeth
        if residual is None:
            return Starts([(member, 0.0, arc) for member in (SLOT, TOOTH) for arc in (0.0, *ARCS)], trials)
        every = slice(None, None, -(-signals.size // _ENOUGH))
        some, rest = signals.part(every), residual[every]
        best = list[Values]()
        for member in (SLOT, TOOTH):
            angle, pitch = signals.seen_from(member), _pitch(geometry, member)
            for position in _positions(signals, angle, residual):
                near = [(member, pitch * (round(position / pitch) + beside), 0.0) for beside in _BESIDE]
                best.append(max(near, key=lambda nonlinear: self._gain(some, rest, nonlinear)))
            best += [(member, *place) for place in _in_arcs(signals, angle, residual)]
        return Starts(list(dict.fromkeys(best)), trials)

    def _gain(self, signals: Signals, residual: Floats, nonlinear: Values) -> float:
        """Sum of squares of the residual that a slot or tooth explains [rad^2]."""
        columns = self.columns(signals, nonlinear)
        moment = columns.T @ (residual - residual.mean())
        return float(moment @ np.linalg.lstsq(columns.T @ columns, moment, rcond=None)[0])


def _share(away: Floats, arc: float) -> Floats:
    """Load of a pair over the mean of all (n,), by its angle from the lobes [rad]: raised cosines."""
    away = np.mod(away + 0.5 * np.pi, np.pi) - 0.5 * np.pi
    pulse = np.where(np.abs(away) < 0.5 * arc, np.cos(np.pi * away / arc) ** 2, 0.0)
    return np.asarray(2.0 * np.pi / arc * pulse)


def _pitch(geometry: Geometry, member: float) -> float:
    return geometry.slot_pitch if member == SLOT else geometry.tooth_pitch


def _positions(signals: Signals, angle: Floats, residual: Floats) -> list[float]:
    """Angles in the member [rad] where a damaged tooth fits best, by circular correlation over bins."""
    table, rows = signals.contact.table, signals.contact.torque_rows
    template = table.mean_slot
    bins = table.steps
    row = np.where(rows[0][1] >= 0.5, rows[0][0], rows[1][0])
    place = np.floor(np.mod(angle, 2.0 * np.pi) * (bins / (2.0 * np.pi)) + 0.5).astype(np.int64) % bins
    cell, cells = row * bins + place, template.shape[1] * bins
    sums = np.bincount(cell, residual - residual.mean(), cells).astype(np.float64).reshape(-1, bins)
    count = np.bincount(cell, minlength=cells).astype(np.float64).reshape(-1, bins)
    moment = np.stack([_correlation(sums, flank) for flank in template], axis=1)
    gram = np.array([[_correlation(count, one * two) for two in template] for one in template])
    gram = np.moveaxis(gram, 2, 0) + 1e-6 * np.max(gram) * np.eye(2)
    gain = np.einsum("bi,bij,bj->b", moment, np.linalg.inv(gram), moment)
    best, near = list[int](), 2 * table.per_slot
    for _ in range(_CANDIDATES):
        best.append(int(np.argmax(gain)))
        gain[(best[-1] + np.arange(-near, near + 1)) % bins] = -np.inf
    return [2.0 * np.pi / bins * index for index in best]


def _in_arcs(signals: Signals, angle: Floats, residual: Floats) -> list[tuple[float, float]]:
    """Best angle of a pair in the member and arc [rad], for every arc; the flanks fit separately."""
    place = np.floor(np.mod(angle, np.pi) * (_BINS / np.pi) + 0.5).astype(np.int64) % _BINS
    rest, found = residual - residual.mean(), list[tuple[float, float]]()
    sides = [
        (np.bincount(place[side], rest[side], _BINS), np.bincount(place[side], minlength=_BINS))
        for side in (signals.torque > 0.0, signals.torque <= 0.0)
    ]
    for arc in ARCS:
        pulse = _share(np.linspace(0.0, np.pi, _BINS, endpoint=False), arc)
        pulse -= pulse.mean()
        gain = np.zeros(_BINS)
        for sums, count in sides:
            square = _correlation(count[None].astype(np.float64), pulse[None] ** 2)
            gain += _correlation(sums[None].astype(np.float64), pulse[None]) ** 2 / np.maximum(square, 1e-300)
        found.append((float(np.pi / _BINS * np.argmax(gain)), arc))
    return found


def _correlation(sums: Floats, template: Floats) -> Floats:
    """Circular correlation of sums and template (torques, bins), added over torques; (bins,)."""
    product = np.fft.rfft(sums, axis=1) * np.conj(np.fft.rfft(template, axis=1))
    return np.asarray(np.fft.irfft(product.sum(axis=0), template.shape[1]))


EFFECT = ToothDamage(
    name="tooth_damage",
    cause=(
        "One tooth of the circular spline or the flexspline is worn or displaced and bears later than its "
        "neighbours."
    ),
    kind="kinematic",
    frame="housing",
    needs=("wave_generator_angle", "torque"),
    excitation=(loaded, partial(enough_input_turns, turns=10.0), partial(enough_output_turns, turns=1.0)),
    of_teeth=True,
    proportional=False,
    own_slopes=True,
    quantities=(
        Quantity("counter_clockwise_flank", "m", -2e-4, 2e-4, 2e-5, "clearance added to the tooth's + flank"),
        Quantity("clockwise_flank", "m", -2e-4, 2e-4, 2e-5, "clearance added to its - flank"),
        switch("member", "0: slot of the circular spline, 1: tooth of the flexspline"),
        Quantity(
            "position", "rad", 0.0, 2.0 * np.pi, 6.3, "its angle in the member", False, 2.0 * np.pi, True
        ),
        Quantity("arc", "rad", 0.0, ARCS[-1], 1.0, _ARC, linear=False, discrete=True),
    ),
    confused_with=("circular_spline_pitch", "flexspline_pitch", "circular_spline_form"),
    source="share of the stiffness of a single flank (see contact_weights)",
    inspect=(
        "Open the gear and look at the teeth around the position given, and at those opposite: a worn flank "
        "shines, a displaced or cracked one stands off under the feeler. Wear of both flanks has equal "
        "signs, a displaced tooth opposite ones. 10 µm on one of some fifty bearing pairs read about 1 "
        "arcsec, twice per wave generator turn."
    ),
)
