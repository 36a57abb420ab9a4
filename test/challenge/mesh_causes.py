"""Faults of teeth and slots, as geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from challenge.cause import Cause, Scene
from challenge.contact import Flaws
from challenge.design import Array, Design

PITCH_POINT = 0.6193e-3  # [m] above the neutral layer, t + hf of the paper's Table 1; scales with module


@dataclass(frozen=True)
class CircularSplinePitch(Cause, name="circular_spline_pitch"):
    """Slots displaced along the circumference [m] in ``order`` waves around it (cumulative pitch error)."""

    amplitude: float
    phase: float
    order: int = 2

    def flaws(self, design: Design) -> Flaws:
        angle = np.arange(design.slots) * design.slot_pitch
        return Flaws(slot_along=self.amplitude * np.cos(self.order * angle - self.phase))


@dataclass(frozen=True)
class FlexsplinePitch(Cause, name="flexspline_pitch"):
    """Teeth displaced along the circumference [m] in ``order`` waves, measured at the pitch circle."""

    amplitude: float
    phase: float
    order: int = 2

    def flaws(self, design: Design) -> Flaws:
        angle = np.arange(design.teeth) * design.tooth_pitch
        radius = design.ring_radius
        neutral = radius / (radius + PITCH_POINT * design.module) * self.amplitude
        return Flaws(tooth_along=neutral * np.cos(self.order * angle - self.phase))


@dataclass(frozen=True)
class CircularSplineForm(Cause, name="circular_spline_form"):
    """Ring out of round, with ``order`` lobes of a radial amplitude [m].

    ``bent`` = 1: the ring is squeezed in its seat, its circumference keeps its length and slots move along
    it, too. ``bent`` = 0: the ring is cut out of round; slots only move outwards and inwards.
    """

    amplitude: float
    phase: float
    order: int = 4
    bent: float = 1.0

    def flaws(self, design: Design) -> Flaws:
        wave = self.order * np.arange(design.slots) * design.slot_pitch - self.phase
        along = -self.bent * self.amplitude / self.order * np.sin(wave)
        return Flaws(slot_out=self.amplitude * np.cos(wave), slot_along=along)


@dataclass(frozen=True)
class ToothDamage(Cause, name="tooth_damage"):
    """One tooth (``member`` "flexspline") or slot ("circular_spline"), worn to a depth [m] or softer."""

    depth: float
    index: int
    member: str = "circular_spline"
    softness: float = 0.0

    def flaws(self, design: Design) -> Flaws:
        kind, count = ("tooth", design.teeth) if self.member == "flexspline" else ("slot", design.slots)
        here = np.arange(count) == self.index % count
        return Flaws(
            **{f"{kind}_wear": np.tile(self.depth * here, (2, 1)), f"{kind}_softness": self.softness * here}
        )


@dataclass(frozen=True)
class WearBacklash(Cause, name="wear_backlash"):
    """All flanks of the flexspline worn by a thickness [m]."""

    thickness: float

    def flaws(self, design: Design) -> Flaws:
        return Flaws(tooth_wear=self.thickness)


@dataclass(frozen=True)
class ToothSkip(Cause, name="tooth_skip", sizes=("sign",)):
    """The flexspline jumps by one tooth at a moment [s], in the direction of the load (sign)."""

    time: float
    sign: float

    def added(self, scene: Scene) -> Array:
        return self.sign * scene.design.tooth_pitch * (scene.time >= self.time)


@dataclass(frozen=True)
class UnevenSlots(Cause, name="circular_spline_pitch"):
    """Cumulative pitch error of a machined circular spline: mainly twice around, with all harmonics up to 8.

    ``amplitude`` [m] of the second harmonic; harmonic k has 2/k of the fraction ``rest`` of it.
    """

    amplitude: float
    rest: float
    seed: int

    def flaws(self, design: Design) -> Flaws:
        rng, angle = np.random.default_rng(self.seed), np.arange(design.slots) * design.slot_pitch
        size = np.array([self.rest * 2 / k if k != 2 else 1.0 for k in range(1, 9)])
        phase = rng.uniform(-np.pi, np.pi, 8)
        waves = (a * np.cos(k * angle - p) for k, a, p in zip(range(1, 9), size, phase, strict=True))
        return Flaws(slot_along=self.amplitude * sum(waves, np.zeros(design.slots)))
