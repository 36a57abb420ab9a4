"""A whole study of one joint: limits on the eccentricity, what assemblies yield, which tolerance matters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.config.parameters import Value, nested, of_joint
from hd_diag.drive import Drive
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance import assembly, sensitivity
from hd_diag.tolerance.assembly import FACTORS, Population, Share, Spread
from hd_diag.tolerance.criteria import NAMES, cup_torques
from hd_diag.tolerance.evaluation import warm_up
from hd_diag.tolerance.limit import EccentricityLimit, across_long_axis, check_largest, first_excess
from hd_diag.tolerance.sensitivity import Indices

# Is given a part of the work and its number of steps; gives what is called after each step.
Progress = Callable[[str, int], Callable[[], None]]

TOLERANCES = 13
"""Eccentricity tolerances of a yield curve, from zero to twice the configured one, the middle one."""

_ALL_TEETH = 0.0  # [m]; overlap from which no rotation frees all teeth


def limits_and_spreads(flat: Mapping[str, Value], joint: str) -> tuple[dict[str, float], dict[str, Spread]]:
    """Limits by the names of the criteria, spreads by those of the quantities, of a configured joint."""
    own = nested(of_joint(flat, joint))["tolerance"]
    limits = own.pop("limits")
    return limits, {name: Spread(**each) for name, each in own.items()}


@dataclass(frozen=True)
class Question:
    """What is asked of a drive.

    Torques on the link (q,) [N m]; limits by the names of the criteria, in their units; spreads by the names
    of the quantities; the greatest eccentricity to look at [m]; numbers of assemblies and, a power of two, of
    samples of the sensitivity (0: none) with the seed of both; the share of assemblies that shall be within
    all limits.

    Raises ValueError naming what cannot be.
    """

    drive: Drive
    torque: Floats
    limits: Mapping[str, float]
    spreads: Mapping[str, Spread]
    largest: float
    samples: int
    sensitivity_samples: int
    seed: int
    target: float

    def __post_init__(self) -> None:
        check_largest(self.drive, self.largest)
        cup_torques(self.drive, self.torque)

    @property
    def cup_torque(self) -> Floats:
        """M on the cup [N m], shape (q,)."""
        return cup_torques(self.drive, self.torque)


@dataclass(frozen=True)
class Interference:
    """Eccentricity at which teeth first interfere [m], nan where they do not; three readings.

    `across`: the paper's own arrangement (:func:`across_long_axis`), whose least backlash without
    eccentricity is `clearance` [m]. `any_direction`: the same lobe, over all directions and angles.
    `all_teeth`: no rotation of the cup frees all teeth, the interference flag of a mesh.
    """

    across: float
    clearance: float
    any_direction: EccentricityLimit
    all_teeth: EccentricityLimit


@dataclass(frozen=True)
class Yield:
    """What assemblies come out like.

    Eccentricity `tolerances` (t,) that 99.73 % of the assemblies keep within, and the `configured` one [m];
    shares within all limits `together` and within `each`, in the order of ``criteria.CRITERIA``; the largest
    tolerance `at_target` [m], nan if there is none.
    """

    tolerances: Floats
    configured: float
    together: Share
    each: list[Share]
    at_target: float


@dataclass(frozen=True)
class Study:
    """Answers to a question; `limits` by torque, in the order of ``criteria.CRITERIA``."""

    question: Question
    interference: Interference
    limits: list[list[EccentricityLimit]]
    assemblies: Yield | None
    sensitivity: Indices | None

    @property
    def allowed(self) -> EccentricityLimit | None:
        """The limit that is reached first, at any torque; none if none is reached."""
        reached = [limit for row in self.limits for limit in row if limit.reached]
        return min(reached, key=lambda limit: limit.eccentricity, default=None)


def study(question: Question, pool: ProcessPool, progress: Progress) -> Study:
    """Answer a question; `progress` gets each part of the work and its number of steps.

    Raises ValueError if the teeth cannot bear a torque, or a drawn assembly cannot be assembled.
    """
    warm_up()  # here first: other processes then read the kernels from the disk
    population = Population(question.drive, question.spreads, question.cup_torque)
    if question.samples or question.sensitivity_samples:
        assembly.check(population, float(_tolerances(question, population)[-1]))
    interference, limits = _limits(question, pool, progress)
    assemblies = _yield(question, population, pool, progress) if question.samples else None
    indices = _sensitivity(question, population, pool, progress) if question.sensitivity_samples else None
    return Study(question, interference, limits, assemblies, indices)


def _limits(
    question: Question, pool: ProcessPool, progress: Progress
) -> tuple[Interference, list[list[EccentricityLimit]]]:
    torques = question.cup_torque
    free = [("interference", 0.0), ("overlap", _ALL_TEETH)]
    asked = [(torques[0], *one) for one in free]
    asked += [(torque, name, question.limits[name]) for torque in torques for name in NAMES]
    tasks = [(question.drive, *one, question.largest) for one in asked]
    found = pool.map(_first_excess, tasks, progress("limits", len(tasks)))
    rows = [found[k : k + len(NAMES)] for k in range(len(free), len(found), len(NAMES))]
    return Interference(*across_long_axis(question.drive, question.largest), *found[: len(free)]), rows


def _first_excess(task: tuple[Drive, float, str, float, float]) -> EccentricityLimit:
    return first_excess(*task)


def _tolerances(question: Question, population: Population) -> Floats:
    """Of a yield curve; without a configured eccentricity it goes as far as limits are looked for."""
    return np.linspace(0.0, 2.0 * population.tolerance or question.largest, TOLERANCES)


def _yield(question: Question, population: Population, pool: ProcessPool, progress: Progress) -> Yield:
    tolerances = _tolerances(question, population)
    numbers = np.random.default_rng(question.seed).random((question.samples, len(FACTORS)))
    done = progress("assemblies", assembly.chunks(question.samples))
    values = assembly.judged(pool, population, numbers, tolerances, done)
    together, each = assembly.yields(values, np.array([question.limits[name] for name in NAMES]))
    at_target = assembly.tolerance_at(together, tolerances, question.target)
    return Yield(tolerances, population.tolerance, together, each, at_target)


def _sensitivity(
    question: Question, population: Population, pool: ProcessPool, progress: Progress
) -> Indices:
    samples, factors = question.sensitivity_samples, len(FACTORS)
    done = progress("sensitivity", assembly.chunks(sensitivity.evaluations(samples, factors)))
    configured = np.array([population.tolerance])

    def model(numbers: Floats) -> Floats:
        return assembly.judged(pool, population, numbers, configured, done)[:, :, 0]

    return sensitivity.indices(model, factors, samples, np.random.default_rng(question.seed))
