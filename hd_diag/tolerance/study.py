"""A whole study of one joint: limits on the eccentricity, yield of assemblies, which tolerance matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.config.parameters import Value, nested, of_joint
from hd_diag.diagnosis.diagnosis import Allowed, Diagnosis
from hd_diag.diagnosis.judgement import Answer
from hd_diag.drive import Drive
from hd_diag.formatting import json_ready
from hd_diag.process_pool import ProcessPool
from hd_diag.tolerance import assembly, limit, sensitivity
from hd_diag.tolerance.assembly import FACTORS, Population, Share, Spread
from hd_diag.tolerance.evaluation import CRITERIA, NAMES, cup_torques, warm_up
from hd_diag.tolerance.limit import DisplacementLimit, first_excess
from hd_diag.tolerance.sensitivity import Indices

CHARTED = ("interference", "overlap", "peak_tooth_load")
"""Criteria in the chart of eccentricity against tilt: interference and load."""

# Takes a part of the work and its number of steps; returns a function to call after each step.
Progress = Callable[[str, int], Callable[[], None]]

_TOLERANCES = 13  # of a yield curve, from zero to twice the configured one, which is in the middle
_RAYS = 25  # rays of a chart, from a tilt against the eccentricity to one along it
_ALL_TEETH = 0.0  # [m]; beyond this overlap no rotation frees all teeth


def limits_and_spreads(flat: Mapping[str, Value], joint: str) -> tuple[dict[str, float], dict[str, Spread]]:
    """Limits by name of the criterion, and spreads by name of the quantity, of a configured joint."""
    own = nested(of_joint(flat, joint))["tolerance"]
    limits = own.pop("limits")
    return limits, {name: Spread(**each) for name, each in own.items()}


def with_allowed(found: Diagnosis, flat: Mapping[str, Value], joint: str) -> Diagnosis:
    """The diagnosis with the allowed eccentricity of the configured drive, as ``hd-diag tolerance`` gives it.

    It holds at the rated torque, for the joint's limits in `flat`, the parameters by full names. Nothing
    changes if no eccentricity is known, no limit is reached, or the teeth cannot bear the torque.
    """
    if not Answer(found).eccentricity > 0.0:
        return found
    drive, (limits, _) = found.configured, limits_and_spreads(flat, joint)
    warm_up()
    try:
        torque = float(cup_torques(drive, np.array([drive.rated_torque]))[0])
        least = limit.allowed(drive, torque, limits, limit.largest_eccentricity(drive))
    except ValueError:
        return found
    return replace(found, allowed=Allowed(*least)) if least else found


@dataclass(frozen=True)
class Question:
    """Input of a study of a drive.

    Torques on the link (q,) [N m]; limits by name of the criterion, in its unit; spreads by name of the
    quantity; the greatest eccentricity to search [m]; number of assemblies; number of samples of the
    sensitivity, a power of two (0 for either: none); seed of both; the share of assemblies that shall be
    within all limits.

    Raises ValueError naming the impossible value.
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
        limit.check_largest(self.drive, self.largest)
        cup_torques(self.drive, self.torque)

    @property
    def cup_torque(self) -> Floats:
        """M on the cup [N m], shape (q,)."""
        return cup_torques(self.drive, self.torque)


@dataclass(frozen=True)
class Interference:
    """Smallest eccentricity with interfering teeth [m], by three definitions; nan if there is none.

    `across`: the paper's own arrangement (:func:`limit.across_long_axis`), whose least backlash without
    eccentricity is `clearance` [m]. `any_direction`: the same lobe, over all directions and angles.
    `all_teeth`: no rotation of the cup frees all teeth, which is the interference flag of a mesh.
    """

    across: float
    clearance: float
    any_direction: DisplacementLimit
    all_teeth: DisplacementLimit


@dataclass(frozen=True)
class Yield:
    """Yield of assemblies.

    Eccentricity `tolerances` (t,), which 99.73 % of the assemblies do not exceed, and the `configured` one
    [m]; shares within all limits `together` and within `each`, in the order of `CRITERIA`; the largest
    tolerance with the target share, `at_target` [m], nan if there is none.
    """

    tolerances: Floats
    configured: float
    together: Share
    each: list[Share]
    at_target: float


@dataclass(frozen=True)
class Tilts:
    """Tilts that a drive in sections may have; `limits` as in a study, for a tilt alone.

    `chart`, by the names of :data:`CHARTED`, (2, rays): eccentricity [m] and tilt [rad] (negative: against
    the eccentricity) at which a limit is first exceeded at the first torque; nan where it is not exceeded.
    """

    largest: float
    limits: list[list[DisplacementLimit]]
    chart: dict[str, Floats]

    @property
    def allowed(self) -> DisplacementLimit | None:
        """The limit that is reached first, at any torque; none if none is reached."""
        return _least(self.limits)


@dataclass(frozen=True)
class Study:
    """Answers to a question; `limits` by torque, in the order of `CRITERIA`; `tilts` if it has sections."""

    question: Question
    interference: Interference
    limits: list[list[DisplacementLimit]]
    tilts: Tilts | None
    assemblies: Yield | None
    sensitivity: Indices | None

    @property
    def allowed(self) -> DisplacementLimit | None:
        """The limit that is reached first, at any torque; none if none is reached."""
        return _least(self.limits)


def _least(limits: list[list[DisplacementLimit]]) -> DisplacementLimit | None:
    reached = [each for row in limits for each in row if each.reached]
    # Each list varies either eccentricity or tilt, and the other is zero: the sum is the one that varies.
    return min(reached, key=lambda each: each.eccentricity + each.tilt, default=None)


def study(question: Question, pool: ProcessPool, progress: Progress) -> Study:
    """Answer a question; `progress` gets each part of the work and its number of steps.

    Raises ValueError if the teeth cannot bear a torque, or a drawn assembly cannot be assembled.
    """
    warm_up()  # here first: other processes then read the kernels from the disk
    population = Population(question.drive, question.spreads, question.cup_torque)
    # Without a configured eccentricity the yield curve covers the search range of the limits.
    tolerances = np.linspace(0.0, 2.0 * population.tolerance or question.largest, _TOLERANCES)
    if question.samples or question.sensitivity_samples:
        assembly.check(population, float(tolerances[-1]))
    interference, limits = _limits(question, pool, progress)
    leans = question.drive.mesh.geometry.sections > 1
    tilts = _tilts(question, pool, progress) if leans else None
    drawn = indices = None
    if question.samples:
        numbers = np.random.default_rng(question.seed).random((question.samples, len(FACTORS)))
        done = progress("assemblies", assembly.chunks(question.samples))
        values = assembly.judged(pool, population, numbers, tolerances, done)
        together, each = assembly.yields(values, np.array([question.limits[name] for name in NAMES]))
        at_target = assembly.tolerance_at(together, tolerances, question.target)
        drawn = Yield(tolerances, population.tolerance, together, each, at_target)
    if samples := question.sensitivity_samples:
        step = progress("sensitivity", assembly.chunks(sensitivity.evaluations(samples, len(FACTORS))))
        configured = np.array([population.tolerance])

        def model(numbers: Floats) -> Floats:
            return assembly.judged(pool, population, numbers, configured, step)[:, :, 0]

        rng = np.random.default_rng(question.seed)
        indices = sensitivity.indices(model, len(FACTORS), samples, rng)
    return Study(question, interference, limits, tilts, drawn, indices)


def _limits(
    question: Question, pool: ProcessPool, progress: Progress
) -> tuple[Interference, list[list[DisplacementLimit]]]:
    torque = question.cup_torque[0]
    free = [(torque, "interference", 0.0), (torque, "overlap", _ALL_TEETH)]
    first, rows = _excesses(question, pool, progress, "limits", 0.0, free)
    across = limit.across_long_axis(question.drive, question.largest)
    return Interference(*across, *first), rows


def _excesses(
    question: Question,
    pool: ProcessPool,
    progress: Progress,
    part: str,
    leaning: float,
    free: Sequence[tuple[float, str, float]] = (),
) -> tuple[list[DisplacementLimit], list[list[DisplacementLimit]]]:
    """First excess for each `free` torque, criterion and limit, then for those of the question by torque."""
    limits = [(torque, name, question.limits[name]) for torque in question.cup_torque for name in NAMES]
    tasks = [(question.drive, *one, question.largest, leaning) for one in (*free, *limits)]
    found = pool.map(_first_excess, tasks, progress(part, len(tasks)))
    edges = range(len(free), len(found), len(NAMES))
    return found[: len(free)], [found[k : k + len(NAMES)] for k in edges]


def _tilts(question: Question, pool: ProcessPool, progress: Progress) -> Tilts:
    drive, torque, largest = question.drive, question.cup_torque[0], question.largest
    _, rows = _excesses(question, pool, progress, "tilt", 1.0)
    limits = {name: question.limits[name] for name in CHARTED}
    rays = [(drive, torque, limits, largest, leaning) for leaning in np.linspace(-1.0, 1.0, _RAYS)]
    shown = pool.map(_frontier, rays, progress("chart", len(rays)))
    chart = {name: np.array([ray[name] for ray in shown]).T for name in CHARTED}
    return Tilts(limit.divided(drive.mesh.geometry, largest, 1.0)[1], rows, chart)


def _first_excess(task: tuple[Drive, float, str, float, float, float]) -> DisplacementLimit:
    return first_excess(*task)


def _frontier(task: tuple[Drive, float, dict[str, float], float, float]) -> dict[str, tuple[float, float]]:
    return limit.frontier(*task)


# For others ---


def document(joint: str, found: Study) -> dict[str, Any]:
    """Content that `hd-diag tolerance --json` writes; SI units, null where a limit is not reached."""
    question, first, allowed = found.question, found.interference, found.allowed
    drawn, indices, tilts = found.assemblies, found.sensitivity, found.tilts

    largest = {"eccentricity": question.largest, "tilt": tilts.largest if tilts else 0.0}

    def told(one: DisplacementLimit, of: str = "eccentricity") -> dict[str, Any]:
        angle = limit.input_angle(question.drive, one.worst.wave_generator_angle)
        degrees = math.degrees(one.worst.direction)
        return {
            "limit": one.limit,
            "reached": one.reached,
            of: getattr(one, of),
            "value_without": one.without,
            "worst": {**asdict(one.worst), "direction_deg": degrees, "input_angle": angle},
            "curve": {of: one.scanned[0] * largest[of] / question.largest, "value": one.scanned[1]},
        }

    def by_torque(rows: list[list[DisplacementLimit]], of: str) -> list[dict[str, Any]]:
        return [
            {"torque": torque, "criteria": {one.criterion: told(one, of) for one in row}}
            for torque, row in zip(question.torque, rows, strict=True)
        ]

    content = {
        "schema": "hd_diag/tolerance/1",
        "joint": joint,
        "torques": question.torque,
        "largest_eccentricity": question.largest,
        "resolution": {
            "eccentricity_step": question.largest / limit.STEPS,
            "eccentricity_step_of_jumps": question.largest / limit.STEPS / limit.FINE_STEPS,
            "eccentricity_root": limit.ROOT_TOLERANCE,
            "angle_from_long_axis": limit.RESOLUTION[0],
            "wave_generator_angle": limit.RESOLUTION[1] * question.drive.mesh.geometry.slot_pitch,
        },
        "interference": {
            "across_long_axis": {"eccentricity": first.across, "clearance": first.clearance},
            "any_direction": told(first.any_direction),
            "all_teeth": told(first.all_teeth),
        },
        "limits": by_torque(found.limits, "eccentricity"),
        "allowed": allowed and {"eccentricity": allowed.eccentricity, "criterion": allowed.criterion},
        "tilt": tilts
        and {
            "largest_tilt": tilts.largest,
            "limits": by_torque(tilts.limits, "tilt"),
            "allowed": tilts.allowed and {"tilt": tilts.allowed.tilt, "criterion": tilts.allowed.criterion},
            "chart": {
                "torque": question.torque[0],
                "criteria": {n: {"eccentricity": e, "tilt": t} for n, (e, t) in tilts.chart.items()},
            },
        },
        "assemblies": drawn
        and {
            "samples": question.samples,
            "seed": question.seed,
            "angles_per_turn": assembly.ANGLES,
            "tolerances": drawn.tolerances,
            "configured_tolerance": drawn.configured,
            "target": question.target,
            "tolerance_at_target": drawn.at_target,
            "yield": dict(zip(("all", *NAMES), map(asdict, (drawn.together, *drawn.each)), strict=True)),
            "spreads": {name: asdict(spread) for name, spread in question.spreads.items()},
        },
        "sensitivity": indices
        and {
            "samples": question.sensitivity_samples,
            "criteria": {
                criterion: {
                    factor: {
                        order: {name: values[k, i] for name, values in vars(estimate).items()}
                        for order, estimate in vars(indices).items()
                    }
                    for i, factor in enumerate(FACTORS)
                }
                for k, criterion in enumerate(NAMES)
            },
        },
        "units": {
            "eccentricity": "m",
            "tilt": "rad; negative in the chart: against the eccentricity",
            "direction": "rad, in the housing",
            "angle": "rad",
            "torque": "N m",
            **{criterion.name: criterion.unit for criterion in CRITERIA},
        },
    }
    return dict(json_ready(content))


def yielded(question: Question, drawn: Yield) -> str:
    """Yield of assemblies in one sentence; too few assemblies may leave it unknown."""
    share, t = f"{100 * question.target:g} % of the assemblies are", drawn.together
    if math.isfinite(drawn.at_target):
        place = f"{share} within all limits up to a tolerance of {drawn.at_target * 1e6:.2f} µm"
        configured = f"{drawn.configured * 1e6:.2f} µm configured"
        return f"{place} ({100 * assembly.WITHIN:g} % of eccentricities are within it; {configured})."
    if t.high[0] < question.target:
        return f"{share} not within all limits even without eccentricity."
    found, low, high = (f"{100 * each[0]:.1f}" for each in (t.share, t.low, t.high))
    few = f"{question.samples} assemblies do not tell: {found} % are ({low} to {high} %)"
    return f"Whether {share} within all limits without eccentricity, {few}; draw more (--samples)."
