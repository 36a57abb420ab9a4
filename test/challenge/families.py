"""Families of records, one row each: motion x causes x sensors x drive, drawn from a seed.

Seeds of DEVELOPMENT may be looked at during development; those of FINAL are for the last count only.
A family draws amplitudes from the usual range, and never below three times the smallest findable size.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from challenge import faults, findability
from challenge import motion as motions
from challenge.cause import Cause
from challenge.design import OTHERS, SIZE_25, Design
from challenge.faults import Draw, Fault
from challenge.faults import draw as draw
from challenge.motion import Motion
from challenge.moves import point_to_point, there, there_and_back
from challenge.noise import FAMILIES as NOISES
from challenge.page import PAGES, Page, page_joint
from challenge.records import PLAIN, Record, Recording, simulate
from challenge.truth import Base, drawn, faultless

DEVELOPMENT = range(0, 1_000_000)
SPENT = range(1_000_000_000, 1_000_010_037)
"""Final seeds of earlier counts. Some of their records were looked at and are in tests, so they now serve for
development."""
FINAL = range(SPENT.stop, 1_001_000_000)

Names = Callable[[Draw, int], list[str]]
SAME_CLASS = (
    {"output_runout", "output_encoder_eccentricity"},
    {"input_encoder_eccentricity", "coupling_misalignment"},  # both twice a turn: encoder's 2nd harmonic
)


def generator(family: str, seed: int) -> np.random.Generator:
    """Random number generator for a family and seed; the same on every machine."""
    if not any(seed in seeds for seeds in (DEVELOPMENT, SPENT, FINAL)):
        raise ValueError(f"seed {seed} is neither a development seed nor a final one")
    return np.random.default_rng([*family.encode(), seed])


# Causes ---


def none(_rng: Draw, _seed: int) -> list[str]:
    """No cause."""
    return []


def by_turns(names: Sequence[str]) -> Names:
    """One cause, cycling through names by seed."""
    return lambda _rng, seed: [names[seed % len(names)]]


def several(count: int, names: Sequence[str]) -> Names:
    """Several distinguishable causes."""

    def chosen(rng: Draw, _seed: int) -> list[str]:
        found: list[str] = []
        while len(found) < count:
            new = str(rng.choice(names))
            clash = any(new in group and group & set(found) for group in SAME_CLASS)
            if new not in found and not clash:
                found.append(new)
        return found

    return chosen


def sometimes(names: Sequence[str]) -> Names:
    """One of the causes for odd seeds, none for even ones."""
    return lambda rng, seed: [str(rng.choice(list(names)))] if seed % 2 else []


# Sensors ---


def plain(_rng: Draw, _seed: int) -> Recording:
    """Encoders with the noise of a test bench."""
    return PLAIN


def noises_by_turns(_rng: Draw, seed: int) -> Recording:
    """Noise families, cycling by seed."""
    return Recording(noise=list(NOISES)[seed % len(NOISES)])


def of_a_robot(rng: Draw, _seed: int) -> Recording:
    """Quantised encoders, quieter than a bench's, in one recording or in several with their own offsets."""
    return Recording(
        noise=str(rng.choice(list(NOISES))),
        noise_scale=rng.uniform(0.2, 0.8),
        torque_noise=rng.uniform(0.05, 0.4),
        input_bits=int(rng.integers(12, 18)),
        output_bits=int(rng.choice([17, 18, 19, 19, 19])),
        jitter=float(rng.choice([0.0, 0.1e-3])),
        parts=int(rng.choice([1, 1, 3])),
        offset_spread=3e-4,
    )


def of_a_motor(rng: Draw, seed: int) -> Recording:
    """As `of_a_robot`, with motor current in place of torque."""
    return dataclasses.replace(of_a_robot(rng, seed), torque_constant=rng.uniform(4, 15))


def of_any_arm(rng: Draw, _seed: int) -> Recording:
    """Encoders of 12 to 20 bits at 100 to 1000 Hz, quiet or noisy."""
    return Recording(
        noise=str(rng.choice(list(NOISES))),
        noise_scale=rng.uniform(0.2, 1.0),
        torque_noise=rng.uniform(5e-4, 4e-3),  # as a share of the rated torque
        input_bits=int(rng.integers(12, 21)),
        output_bits=int(rng.integers(17, 21)),
        jitter=float(rng.choice([0.0, 0.1e-3])),
        rate=float(rng.choice([100.0, 250.0, 500.0, 1000.0])),
    )


def of_any_quality(rng: Draw, seed: int) -> Recording:
    """As `of_a_robot` in one recording, with torque noise of up to 1 N m."""
    return dataclasses.replace(of_a_robot(rng, seed), torque_noise=rng.uniform(0, 1), parts=1)


# Motion ---

Motions = Callable[[Draw, Design], Motion]


def on_a_bench(make: Callable[[Draw], Motion]) -> Motions:
    """Motion of a size 25 on a test bench."""
    return lambda rng, _design: make(rng)


_STANDARD = on_a_bench(motions.standard)


def moves(rng: Draw, design: Design) -> Motion:
    """Two minutes of a robot's motion."""
    return point_to_point(rng, design=design)


def journeys(rng: Draw, page: Page) -> Motion:
    """Usual motions of an arm: point to point, one way, or there and back; 1 s to two minutes."""
    kind = rng.integers(4)
    if kind == 0:
        return there(rng, page)
    if kind == 1:
        return there_and_back(rng, page)
    return point_to_point(rng, float(np.exp(rng.uniform(np.log(8), np.log(120)))), page)


def _of_any_length(rng: Draw, _design: Design) -> Motion:
    duration = float(np.exp(rng.uniform(np.log(2), np.log(120))))
    if rng.random() < 0.5:
        return point_to_point(rng, duration)
    whole = motions.standard(rng)
    share = duration / 120
    runs = tuple(dataclasses.replace(run, duration=max(10 * share, 2.0)) for run in whole.runs)
    return Motion(runs[: max(round(duration / runs[0].duration), 1)])


# Families ---


@dataclass(frozen=True)
class Family:
    """A row: what a record is drawn from.

    ``excused``: causes that, according to the diagnosis, the motion cannot show need no name. ``findable``:
    causes grow to three times the size findable in the record itself, or are replaced. ``usual``: causes that
    every such joint has; they need no name.
    """

    names: Names = none
    motion: Motions = _STANDARD
    recording: Callable[[Draw, int], Recording] = plain
    faults: dict[str, Fault] = dataclasses.field(default_factory=lambda: faults.FAULTS | faults.UNKNOWN)
    base: Callable[[Draw, Design], Base] = drawn
    designs: tuple[Design, ...] = (SIZE_25,)
    excused: bool = False
    findable: bool = False
    usual: tuple[str, ...] = ()


def _poor(motion: Callable[[Draw], Motion], names: Sequence[str], recording: Recording = PLAIN) -> Family:
    """Family of a motion or recording that cannot show some causes."""
    return Family(sometimes(names), on_a_bench(motion), lambda _rng, _seed: recording, excused=True)


POOR = {
    "short": _poor(  # four seconds, a few turns of the input
        motions.short, ("output_runout", "flexspline_pitch", "thermal_drift", "bearing_passage", "resonance")
    ),
    "one_direction": _poor(motions.one_direction, ("coulomb_windup",)),
    "one_speed": _poor(motions.one_speed, ("viscous_windup", "stream_delay", "resonance")),
    "unloaded": _poor(motions.unloaded, ("torsional_hardening", "hysteresis", "torque_offset")),
    "constant_torque": _poor(motions.constant_torque, ("torsional_hardening", "hysteresis")),
    "torque_unmeasured": _poor(  # torque acts, but is not reported
        motions.standard, ("torsional_hardening", "hysteresis", "torque_offset"), Recording(torque=False)
    ),
}
_ROUGH = Recording(dropouts=0.05, outliers=0.01, jitter=0.3e-3)
_BENCH = functools.partial(Family, faults=faults.MECHANISMS, findable=True)
_ROBOT = functools.partial(_BENCH, motion=moves, recording=of_a_robot)

_OF_TORQUE_SENSOR = ("torque_offset", "torque_sensor_ripple")  # not in a motor current
_BY_CURRENT = {name: fault for name, fault in faults.MECHANISMS.items() if name not in _OF_TORQUE_SENSOR}

_PAGE = functools.partial(
    Family,
    motion=journeys,
    recording=of_any_arm,
    faults=faults.PAGE | faults.PAGE_USUAL,
    base=page_joint,
    designs=PAGES,
    usual=tuple(faults.PAGE_USUAL),
    excused=True,
)

FAMILIES: dict[str, Family] = {
    "wrong_parameters": Family(recording=noises_by_turns),
    "one_effect": Family(by_turns(faults.NAMED)),
    "pair": Family(several(2, faults.COMBINED)),
    "triple": Family(several(3, faults.COMBINED)),
    "unknown": Family(by_turns(list(faults.UNKNOWN))),
    **POOR,
    "degraded": Family(by_turns(faults.NAMED), recording=lambda _rng, _seed: _ROUGH),
    "faultless": Family(motion=_of_any_length, recording=of_any_quality, base=faultless),
    "robot_none": _ROBOT(sometimes(list(faults.OPTIONAL)), faults=faults.OPTIONAL, findable=False),
    "robot_single": _ROBOT(by_turns(list(faults.MECHANISMS))),
    "robot_pair": _ROBOT(several(2, list(faults.MECHANISMS))),
    "robot_gears": _ROBOT(by_turns(list(faults.MECHANISMS)), designs=OTHERS),
    "robot_current": _ROBOT(by_turns(list(_BY_CURRENT)), recording=of_a_motor, faults=_BY_CURRENT),
    "robot_lines": _ROBOT(by_turns(list(faults.UNNAMED)), faults=faults.UNNAMED),
    "bench_single": _BENCH(by_turns(list(faults.MECHANISMS))),
    "bench_pair": _BENCH(several(2, list(faults.MECHANISMS))),
    "page_none": _PAGE(),
    "page_single": _PAGE(by_turns(list(faults.PAGE))),
}


def made(family: str, seed: int) -> Record:
    """The record of a family and seed."""
    row, rng = FAMILIES[family], generator(family, seed)
    design = row.designs[seed % len(row.designs)]
    names = [*row.names(rng, seed), *row.usual]
    motion = row.motion(rng, design)
    found = [faults.sized(rng, row.faults[name], motion) for name in names]
    base = row.base(rng, design)
    recording = row.recording(rng, seed)
    if isinstance(design, Page):
        recording = dataclasses.replace(recording, torque_noise=recording.torque_noise * design.rated)
    if row.findable:
        found = _enlarged(rng, row.faults, found, base, motion, recording)
    causes = [cause for cause, _ in found]
    if recording.torque_constant:
        causes.append(faults.motor_current(rng, recording.torque_constant, design))
    return simulate(base, causes, motion, rng, recording, (*faults.NEED_NO_NAME, *row.usual))


def _enlarged(
    rng: Draw,
    kinds: dict[str, Fault],
    found: list[tuple[Cause, float]],
    base: Base,
    motion: Motion,
    recording: Recording,
) -> list[tuple[Cause, float]]:
    """Causes three times as large as this record can show. Causes that cannot get so large are replaced."""
    untried = [name for name in rng.permutation(list(kinds)) if name not in {c.name for c, _ in found}]
    columns = findability.columns(base, motion, recording) if found else None
    while untried:
        causes = [cause for cause, _ in found]
        shares = findability.shares(base, causes, motion, recording, columns)
        if min(shares, default=math.inf) >= faults.TIMES_LEAST:
            break
        for i, ((cause, room), share) in enumerate(zip(found, shares, strict=True)):
            factor = 1.05 * faults.TIMES_LEAST / share
            if 1.0 < factor <= room:
                found[i] = cause.scaled(factor), room / factor
            elif factor > room:
                found[i] = faults.sized(rng, kinds[untried.pop()], motion)
    return found
