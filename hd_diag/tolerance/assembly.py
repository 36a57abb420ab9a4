"""Assemblies drawn from tolerances, their worst values over a turn, and the share within the limits."""

from __future__ import annotations

import cmath
import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from hd_diag.arrays import Floats
from hd_diag.drive import Drive
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance.evaluation import evaluate, over_turns, reference_stiffness

FACTORS = (
    "eccentricity",
    "eccentricity.direction",
    "runout",
    "runout.direction",
    "circular_spline_datum",
    "pitch",
    "tooth_compliance",
    "cup_compliance",
)
"""Factors that vary between assemblies; each is a function of its own number between 0 and 1."""

WITHIN = 0.9973
"""Share of assemblies whose eccentricity is within the tolerance: three sigma of a normal distribution."""

ANGLES = 96
"""Wave generator angles per turn at which an assembly is evaluated; 202 slots meet them in 48 phases."""

_CONFIDENCE = 0.95
_EDGE = 1e-6  # draws keep this distance from 0 and 1, where a distribution is unbounded
_CHUNK = 4  # assemblies per task: some tenths of a second

# Quantiles of distributions of size 1. Magnitudes begin at zero.
_MAGNITUDE: Mapping[str, Callable[[Floats], Floats]] = {
    "fixed": np.ones_like,
    "uniform": np.asarray,
    "normal": lambda share: ndtri(0.5 + 0.5 * share),
    "rayleigh": lambda share: np.sqrt(-2.0 * np.log1p(-share)),
}
_DEVIATION: Mapping[str, Callable[[Floats], Floats]] = {
    "fixed": np.ones_like,
    "uniform": lambda share: 2.0 * share - 1.0,
    "normal": ndtri,
    "triangular": lambda share: np.where(
        share < 0.5, np.sqrt(2.0 * share) - 1.0, 1.0 - np.sqrt(2.0 - 2.0 * share)
    ),
}
_MAGNITUDES = ("eccentricity", "runout", "cup_compliance")


@dataclass(frozen=True)
class Spread:
    """How a quantity differs between assemblies: name of the distribution, and its size in its unit."""

    distribution: str
    size: float


@dataclass(frozen=True)
class Assembly:
    """One drive as assembled: `drive` has its own runout, datum and compliances, without eccentricity.

    `eccentricity` is x + iy over its tolerance [-]; `slot_angle` (Z_G,) is the counter-clockwise deviation of
    each slot from its place [rad].
    """

    drive: Drive
    eccentricity: complex
    slot_angle: Floats


@dataclass(frozen=True)
class Population:
    """Distribution that assemblies are drawn from, and conditions that they are judged at.

    The drive as designed, whose eccentricity and runout are ignored; spreads by name of the quantity; torques
    on the cup (q,) [N m]; number of wave generator angles per turn.
    """

    drive: Drive
    spreads: Mapping[str, Spread]
    cup_torque: Floats
    angles: int = ANGLES

    @functools.cached_property
    def reference(self) -> Floats:
        """Least stiffness of a perfect assembly [N m/rad], shape (q,)."""
        return reference_stiffness(self.drive, self.cup_torque)

    @property
    def tolerance(self) -> float:
        """Eccentricity that a share :data:`WITHIN` of the configured distribution does not exceed [m]."""
        spread = self.spreads["eccentricity"]
        return spread.size * float(_unit("eccentricity", spread, WITHIN))


@dataclass(frozen=True)
class Share:
    """Share of assemblies within limits, with confidence bounds (Wilson, 95 %), each (t,)."""

    share: Floats
    low: Floats
    high: Floats


def draw(population: Population, numbers: Floats) -> Assembly:
    """The assembly for numbers (8,) between 0 and 1, one per factor of :data:`FACTORS`.

    Raises ValueError if it cannot be assembled.
    """
    u = dict(zip(FACTORS, np.clip(numbers, _EDGE, 1.0 - _EDGE), strict=True))

    def drawn(name: str) -> float:
        spread = population.spreads[name]
        return spread.size * float(_unit(name, spread, u[name]))

    drive, mesh, geometry = population.drive, population.drive.mesh, population.drive.mesh.geometry
    datum = geometry.circular_spline_datum + drawn("circular_spline_datum")
    own = dataclasses.replace(
        mesh,
        geometry=dataclasses.replace(geometry, circular_spline_datum=datum),
        tooth_compliance=mesh.tooth_compliance * (1.0 + drawn("tooth_compliance")),
        eccentricity=0.0,
        runout=cmath.rect(drawn("runout"), 2.0 * math.pi * u["runout.direction"]),
    )
    shape = population.spreads["eccentricity"]
    size, within = _unit("eccentricity", shape, np.array([u["eccentricity"], WITHIN]))
    # Every slot has its own deviation, from a random stream that one number seeds.
    stream = np.random.default_rng(int(u["pitch"] * 2.0**53)).random(geometry.circular_spline_teeth)
    radius = geometry.curve.radius + 0.5 * (geometry.flexspline_root + geometry.flexspline_tip)
    pitch = population.spreads["pitch"]
    return Assembly(
        dataclasses.replace(drive, mesh=own, cup_compliance=drive.cup_compliance + drawn("cup_compliance")),
        cmath.rect(float(size / within), 2.0 * math.pi * u["eccentricity.direction"]),
        pitch.size / radius * _unit("pitch", pitch, np.clip(stream, _EDGE, 1.0 - _EDGE)),
    )


def check(population: Population, largest: float) -> None:
    """Raise ValueError if a draw cannot be assembled, up to a `largest` eccentricity [m]."""
    for end in (0.0, 1.0):
        assembly = draw(population, np.full(len(FACTORS), end))
        dataclasses.replace(assembly.drive.mesh, eccentricity=largest * assembly.eccentricity)


def worst(population: Population, assembly: Assembly, tolerances: Floats) -> Floats:
    """Worst value of every criterion over a turn and all torques (6, t).

    The assembly's eccentricity is scaled by each tolerance (t,) [m].
    """
    mesh, n, turns = assembly.drive.mesh, population.angles, tolerances.size
    turn = np.tile(2.0 * np.pi * np.arange(n, dtype=np.float64) / n, turns)
    center = np.repeat(tolerances, n) * assembly.eccentricity + mesh.displacement(turn)
    found = evaluate(mesh, turn, center, population.cup_torque, assembly.slot_angle)
    values = over_turns(found, turns, assembly.drive.cup_compliance, population.reference)
    return np.asarray(values.max(axis=2))


def judged(
    pool: ProcessPool,
    population: Population,
    numbers: Floats,
    tolerances: Floats,
    done: Callable[[], None] = lambda: None,
) -> Floats:
    """Worst value of every criterion for many assemblies (samples, 6, t); `done` is called after every chunk.

    Numbers (samples, 8) as for :func:`draw`; tolerances (t,) [m].
    """
    tasks = [(population, numbers[i : i + _CHUNK], tolerances) for i in range(0, len(numbers), _CHUNK)]
    return np.concatenate(pool.map(_judged, tasks, done))


def chunks(samples: int) -> int:
    """Number of tasks for so many assemblies."""
    return -(-samples // _CHUNK)


def yields(values: Floats, limits: Floats) -> tuple[Share, list[Share]]:
    """Share of assemblies within all limits, and within each of them (criteria,).

    Values (samples, criteria, t) as of :func:`judged`.
    """
    within = values <= limits[:, None]
    return _share(np.asarray(within.all(axis=1))), [_share(within[:, k]) for k in range(limits.size)]


def tolerance_at(share: Share, tolerances: Floats, target: float) -> float:
    """Largest tolerance whose share reaches the target, linear between rising tolerances (t,) [m].

    nan if even the least tolerance misses the target; the greatest tolerance if none misses it.
    """
    below = np.flatnonzero(share.share < target)
    if not below.size:
        return float(tolerances[-1])
    first = int(below[0])
    if first == 0:
        return math.nan
    ends = slice(first - 1, first + 1)
    return float(np.interp(-target, -share.share[ends], tolerances[ends]))


def _unit(name: str, spread: Spread, numbers: float | Floats) -> Floats:
    """Quantiles of a distribution of size 1."""
    family = _MAGNITUDE if name in _MAGNITUDES else _DEVIATION
    return np.asarray(family[spread.distribution](np.asarray(numbers)), dtype=np.float64)


def _judged(task: tuple[Population, Floats, Floats]) -> Floats:
    population, numbers, tolerances = task
    return np.stack([worst(population, draw(population, row), tolerances) for row in numbers])


def _share(within: npt.NDArray[np.bool_]) -> Share:
    """Share of true values in booleans (samples, t), with its bounds."""
    from scipy.stats import binomtest  # imported here: it takes half a second

    count, samples = within.sum(axis=0), within.shape[0]
    bounds = [binomtest(int(k), samples).proportion_ci(_CONFIDENCE, "wilson") for k in count]
    low, high = np.array([(found.low, found.high) for found in bounds]).T
    return Share(count / samples, low, high)
