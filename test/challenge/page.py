"""Joints drawn from a catalogue page: they have no teeth, so nothing here is shaped like the mesh model.

The torsion is the page's, piecewise linear from zero over T1 and T2 (K1, K2, K3). Other effects of a real
joint are added as functions of torque, place or time, by laws that the package does not contain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from challenge.cause import Cause, Scene
from challenge.design import Array
from challenge.truth import Base


@dataclass(frozen=True)
class Page:
    """A row of a catalogue: size [0.1 inch], ratio, rated torque, K1 to K3 [N m/rad], T1 and T2 [N m]."""

    name: str
    size: float
    ratio: int
    rated: float
    k1: float
    k2: float
    k3: float
    t1: float
    t2: float

    @property
    def strength(self) -> float:
        """Rated torque divided by that of a size 25, ratio 100."""
        return self.rated / 87.0

    def scale(self, unit: str) -> float:
        """Factor from the size of a fault in a size 25, ratio 100 to its size here, by unit."""
        return {"N m": self.strength, "1/strength": 1 / self.strength}.get(unit, 1.0)

    def torsion(self, torque: Array) -> Array:
        """Torsion angle (n,) [rad] under a torque (n,) [N m]."""
        corners = np.array([0.0, self.t1, self.t2, 1e3 * self.t2])
        angles = np.r_[0.0, np.cumsum(np.diff(corners) / (self.k1, self.k2, self.k3))]
        return np.sign(torque) * np.interp(np.abs(torque), corners, angles)


# Harmonic Drive SE component sets, as tabulated in AimanHaidar/harmonic-drive-selector, commit e1df012
# (Apache-2.0), data/reducers_tables.py.
PAGES = (
    Page("CSG-14-50", 14, 50, 7.0, 3.4e3, 4.7e3, 5.7e3, 2.0, 6.9),
    Page("CSG-20-100", 20, 100, 52.0, 1.6e4, 2.5e4, 2.9e4, 7.0, 25.0),
    Page("SHG-17-80", 17, 80, 29.0, 1.0e4, 1.4e4, 1.6e4, 3.9, 12.0),
    Page("CSG-25-160", 25, 160, 87.0, 3.1e4, 5.0e4, 5.7e4, 14.0, 48.0),
    Page("SHG-32-50", 32, 50, 99.0, 5.4e4, 7.8e4, 9.8e4, 29.0, 108.0),
    Page("CSG-32-120", 32, 120, 178.0, 6.7e4, 1.1e5, 1.2e5, 29.0, 108.0),
    Page("CSG-14-100", 14, 100, 10.0, 4.7e3, 6.1e3, 7.1e3, 2.0, 6.9),
    Page("SHG-40-100", 40, 100, 345.0, 1.3e5, 2.0e5, 2.3e5, 54.0, 196.0),
    Page("SHG-20-160", 20, 160, 52.0, 1.6e4, 2.5e4, 2.9e4, 7.0, 25.0),
    Page("CSG-58-120", 58, 120, 969.0, 4.0e5, 6.1e5, 7.1e5, 168.0, 598.0),
    Page("HFUC-80-80", 80, 80, 1320.0, 1.0e6, 1.62e6, 1.85e6, 430.0, 1570.0),
)


@dataclass(frozen=True)
class Spring:
    """Torsion of a page, used in place of a mesh."""

    page: Page

    def torsion(self, _turn: Array, torque: Array) -> Array:
        """Cup angle (n,) [rad] under cup torques (n,) [N m]; the wave generator's angle has no effect."""
        return self.page.torsion(torque)


@dataclass(frozen=True)
class PageJoint(Base):
    """A joint with the torsion of a catalogue page, without teeth."""

    design: Page = field(default=PAGES[0])  # type: ignore[assignment]


def page_joint(rng: np.random.Generator, page: Page) -> PageJoint:
    """Joint of a page with a random encoder offset."""
    return PageJoint(offset=rng.uniform(-5e-4, 5e-4), design=page)


# Effects of every joint, usual or too large ---


@dataclass(frozen=True)
class Wave(Cause, name="usual_wave", sizes=("amplitude",)):
    """Wave [rad] at an order of the input that falls with the torque, by one of three laws."""

    amplitude: float
    order: int
    phase: float
    law: str
    torque: float

    def added(self, scene: Scene) -> Array:
        load = np.abs(scene.torque) / self.torque
        share = {
            "reciprocal": 1 / (1 + load),
            "exponential": np.exp(-load),
            "straight": np.maximum(1 - 0.4 * load, 0.2),
        }[self.law]
        return self.amplitude * share * np.cos(self.order * scene.motor - self.phase)


class LargeWave(Wave, name="input_wave", known=False):
    """Wave larger than in any new gear."""

    # Moved slots or a shifted wave generator also make a wave that falls with load.
    may_be = ("circular_spline_pitch", "circular_spline_form", "coupling_misalignment")


@dataclass(frozen=True)
class OutputWave(Cause, name="usual_output_wave", sizes=("amplitude",)):
    """Wave [rad] at an order of the output, as of a flange that circles."""

    amplitude: float
    order: int
    phase: float

    may_be = ("output_runout", "output_encoder_eccentricity")

    def added(self, scene: Scene) -> Array:
        return self.amplitude * np.cos(self.order * scene.output - self.phase)


class LargeOutputWave(OutputWave, name="output_runout"):
    """Output wave of a flange off its centre."""

    may_be = ()


@dataclass(frozen=True)
class Loop(Cause, name="usual_loop", sizes=("half_width",)):
    """Hysteresis by Preisach: many relays that switch on at an upper torque and off at a lower torque.

    Half width of the loop [rad], torque [N m] over which it builds up. Preisach, Z. Physik 94, 1935.
    """

    half_width: float
    reach: float

    may_be = ("hysteresis",)

    def added(self, scene: Scene) -> Array:
        torque = scene.torque
        span = max(float(np.abs(torque).max()), self.reach)
        widths = self.reach * (np.arange(12) + 0.5) / 12
        centers = span * np.linspace(-1, 1, 181)
        upper = (centers[:, None] + widths).ravel()
        lower = (centers[:, None] - widths).ravel()
        state = np.where(torque[0] > 0.5 * (upper + lower), 1.0, -1.0)
        out = np.empty_like(torque)
        for n, load in enumerate(torque.tolist()):
            state[upper <= load] = 1.0
            state[lower >= load] = -1.0
            out[n] = state.mean()
        # The part in proportion to the torque belongs to the spring.
        anhysteretic = np.clip(torque / span, -1, 1)
        lag = anhysteretic * np.polyfit(anhysteretic, out, 1)[0] - out
        lag -= 0.5 * (lag.max() + lag.min())
        return self.half_width * lag / max(float(lag.max()), 1e-12)


class LargeLoop(Loop, name="hysteresis"):
    """Loop wider than in any new gear."""

    may_be = ()


@dataclass(frozen=True)
class SlowDrift(Cause, name="usual_drift", sizes=("amplitude",)):
    """The zero of an encoder wanders [rad] over tens of seconds to minutes."""

    amplitude: float
    seed: int

    def added(self, scene: Scene) -> Array:
        rng = np.random.default_rng(self.seed)
        periods, phases = np.exp(rng.uniform(np.log(40), np.log(400), 3)), rng.uniform(0, 2 * np.pi, 3)
        waves = (np.sin(2 * np.pi * scene.time / p + q) for p, q in zip(periods, phases, strict=True))
        return self.amplitude / 3 * np.asarray(sum(waves))
