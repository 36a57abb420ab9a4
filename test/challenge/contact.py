"""Torsion of a drive, sample by sample: Newton's method balances all tooth pairs of both lobes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from challenge.clearances import (
    NEVER,
    STEPS,
    Clearance,
    Pose,
    at_datum,
    ideal_pose,
    interpolated,
    nodes,
    reach,
    tip,
    weights,
)
from challenge.design import Array, Design
from challenge.truth import Base

WIDEST = 5e-3  # [rad]; pairs with more clearance are never loaded
_CHUNK = 1024  # samples balanced together, so that the arrays fit into the processor's cache
_FRACTIONS = np.arange(-1, STEPS + 2)  # nodes of one slot pitch, plus the neighbours for a cubic


@dataclass(frozen=True)
class Flaws:
    """Departures of single teeth and slots from the ideal drive; a plain number applies to all of them.

    Attributes
    ----------
    slot_out, slot_along : displacement of every slot (Z_G,), outwards and counter-clockwise [m]
    slot_wear, tooth_wear : thickness worn off (2, Z), flanks + and - [m]
    slot_softness, tooth_softness : compliance added (Z,), as a fraction of the pair's
    tooth_along : displacement of every tooth (Z_R,) along the neutral curve, counter-clockwise [m]
    """

    slot_out: Array | float = 0.0
    slot_along: Array | float = 0.0
    slot_wear: Array | float = 0.0
    tooth_wear: Array | float = 0.0
    slot_softness: Array | float = 0.0
    tooth_softness: Array | float = 0.0
    tooth_along: Array | float = 0.0

    def __add__(self, other: Flaws) -> Flaws:
        return Flaws(**{name: value + getattr(other, name) for name, value in vars(self).items()})

    @property
    def of_teeth(self) -> bool:
        """Whether a tooth of the flexspline differs from the others."""
        return any(np.any(each) for each in (self.tooth_wear, self.tooth_softness, self.tooth_along))

    def of(self, design: Design) -> Flaws:
        """These flaws as arrays with one value for each tooth and slot of a design."""
        shapes = {"slot": (design.slots,), "tooth": (design.teeth,)}
        full = {
            name: np.broadcast_to(value, (2,) * name.endswith("wear") + shapes[name.split("_")[0]])
            for name, value in vars(self).items()
        }
        return Flaws(**full)


def _closed_by_moving_along(design: Design, pose: Pose, node: NDArray[np.intp], found: Clearance) -> Array:
    """Rotation [rad/m] by which a + flank closes when its tooth moves along the neutral curve.

    A tooth that moves along the curve also leans with it: it turns about the gear's axis, then a translation
    returns it to the curve.
    """
    direction = np.unwrap(np.arctan2(pose.axis[1], pose.axis[0]))
    turn = np.gradient(direction, design.tooth_pitch / STEPS) + design.teeth / design.slots
    lean = turn / design.ring_radius
    x = pose.along[0] + lean * pose.origin[1]
    y = pose.along[1] - lean * pose.origin[0]
    return lean[node] - found.by_dx * x[node] - found.by_dy * y[node]


class Gear:
    """Clearances of a drive over a turn of the wave generator, from which torsion follows.

    Tables have shape (slot, fraction of a slot pitch, pair). Each pair is a lobe, a slot relative to the slot
    under that lobe, and a flank. A + flank holds cup torque when the torsion exceeds its clearance.
    """

    def __init__(self, base: Base, flaws: Flaws | None = None) -> None:
        self.base, self.design = base, base.design
        self.flaws = (flaws or Flaws()).of(base.design)
        place = np.arange(-reach(self.design), reach(self.design) + 1)
        lobe, place, flank = (g.ravel() for g in np.meshgrid([0, 1], place, [1, -1], indexing="ij"))
        slot = np.arange(self.design.slots)[:, None, None] + place + lobe * (self.design.slots // 2)
        node = place * STEPS - _FRACTIONS[:, None]
        dx, dy = self._displacement(slot % self.design.slots, lobe, node)
        node, dx, dy = np.broadcast_arrays(node, dx, dy)
        mirrored = node * flank - nodes(self.design)[0]
        plane = at_datum(self.design, self.base.datum)
        found = interpolated(plane, mirrored, dx, dy * flank, self.design.module)
        pose = ideal_pose(self.design)
        arm = 1 / np.hypot(found.by_dx, found.by_dy)
        side = (flank < 0).astype(int)
        worn = self.flaws.slot_wear[side, slot % self.design.slots] / arm
        near = (found.rotation + worn).min(axis=(0, 1)) < WIDEST
        self.lobe, self.place, self.flank = lobe[near], place[near], flank[near]
        self._rotation = (found.rotation + worn)[..., near]
        self._arm = arm[..., near]
        self._along = _closed_by_moving_along(self.design, pose, mirrored, found)[..., near]
        placed = Pose(pose.origin[:, mirrored], pose.axis[:, mirrored])
        # Radial overlap of the tooth's tip with the slot's [m]; without overlap a pair cannot touch.
        beyond = tip(self.design, placed, dx, dy * flank) - self.design.shape.circular_spline_tip_radius
        self._reach = beyond[..., near]

    def _displacement(self, slot: NDArray[np.intp], lobe: Array, node: Array) -> tuple[Array, Array]:
        """Translation [m] of the tooth in its slot's frame, from assembly errors and slot displacement."""
        b, axis = self.base, slot * self.design.slot_pitch
        # Angle of the runout in the slot's frame.
        ahead = -node / STEPS * self.design.slot_pitch + np.pi * lobe + b.runout_psi
        dx = b.e * np.cos(b.psi - axis) + b.runout * np.cos(ahead) - self.flaws.slot_out[slot]
        dy = b.e * np.sin(b.psi - axis) + b.runout * np.sin(ahead) - self.flaws.slot_along[slot]
        return dx, dy

    def clearance(self, wave_generator_angle: Array) -> tuple[Array, Array]:
        """Clearance [rad] and stiffness about the axis [N m/rad], both (n, pairs), at angles (n,) [rad]."""
        turns = wave_generator_angle / self.design.slot_pitch
        whole = np.floor(turns).astype(int)
        position = (turns - whole) * STEPS
        cell = np.clip(np.floor(position).astype(int), 0, STEPS - 1)
        t = position - cell
        row = whole % self.design.slots
        b = sum(w[:, None] * self._rotation[row, cell + i] for i, w in enumerate(weights(t)))
        arm = self._linear(self._arm, row, cell, t)
        b = np.where(self._linear(self._reach, row, cell, t) > 0, b, NEVER)
        softness = self.flaws.slot_softness[(whole[:, None] + self._slot) % self.design.slots]
        if self.flaws.of_teeth:
            tooth = (whole[:, None] + self._slot - self.lobe) % self.design.teeth
            along = self._linear(self._along, row, cell, t)
            b -= self.flank * self.flaws.tooth_along[tooth] * along
            b += self.flaws.tooth_wear[(self.flank < 0).astype(int), tooth] / arm
            softness = softness + self.flaws.tooth_softness[tooth]
        return b, arm**2 / (self.base.compliance * (1 + softness))

    @property
    def _slot(self) -> Array:
        return self.place + self.lobe * (self.design.slots // 2)

    @staticmethod
    def _linear(table: Array, row: Array, cell: Array, t: Array) -> Array:
        return table[row, cell + 1] * (1 - t)[:, None] + table[row, cell + 2] * t[:, None]

    def torsion(self, wave_generator_angle: Array, cup_torque: Array) -> Array:
        """Torsion (n,) [rad] at angles (n,) [rad] and cup torques (n,) [N m]; unloaded, a gap's middle."""
        angle, torque = np.broadcast_arrays(np.atleast_1d(wave_generator_angle), np.atleast_1d(cup_torque))
        beta = np.empty(len(angle))
        for start in range(0, len(angle), _CHUNK):
            part = slice(start, start + _CHUNK)
            beta[part] = balanced(*self.clearance(angle[part]), self.flank, torque[part])
        return beta


def balanced(b: Array, stiffness: Array, flank: Array, torque: Array) -> Array:
    """Torsion (n,) [rad] at which flanks of clearance b and stiffness (n, pairs) hold a torque (n,) [N m]."""
    plus, minus = flank > 0, flank < 0
    gap = b[:, plus].min(axis=1), b[:, minus].min(axis=1)
    middle = (gap[0] - gap[1]) / 2
    free = (torque == 0) & (gap[0] + gap[1] > 0)
    edge = b * flank  # torsion at which a flank begins to carry load
    low, high = np.full(len(b), -0.05), np.full(len(b), 0.05)
    # Start past the gap: at least one pair carries load there, so the slope is not zero.
    beta = np.where(torque > 0, gap[0], np.where(torque < 0, -gap[1], middle)) + torque / 4e4
    todo = np.flatnonzero(~free)
    for _ in range(60):
        push = np.maximum((beta[todo, None] - edge[todo]) * flank, 0)
        loaded = np.where(push > 0, stiffness[todo], 0)
        excess = (push * loaded) @ flank - torque[todo]
        low[todo] = np.where(excess < 0, beta[todo], low[todo])
        high[todo] = np.where(excess > 0, beta[todo], high[todo])
        slope = loaded.sum(axis=1)
        newton = beta[todo] - excess / np.where(slope > 0, slope, np.nan)
        inside = (newton >= low[todo]) & (newton <= high[todo])
        step = np.where(inside, newton, (low[todo] + high[todo]) / 2) - beta[todo]
        beta[todo] += step
        todo = todo[np.abs(step) > 1e-13]
        if not len(todo):
            break
    return np.where(free, middle, beta)
