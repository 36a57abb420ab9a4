"""Detectability of effects in a record: stated least sizes, and reasons for effects without one."""

import functools
import math

import numpy as np
import pytest
from benches import EFFECTS, Part, bench, of, swinging
from joint_records import NOISE

from hd_diag.diagnosis import detectability
from hd_diag.diagnosis.calibration import LEAST_SIZE, NAMED
from hd_diag.diagnosis.detectability import NOT_PROVED, Detectability
from hd_diag.diagnosis.evidence.search import begun, candidates
from hd_diag.diagnosis.evidence.sets import Set

SECONDS = 20.0
ODDS = math.log(NAMED / (1.0 - NAMED))
BY_PARAMETERS = "the model's own parameters imitate it: this record cannot tell them apart"
FRICTION = {"friction": 1.0, "way": 1e-3, "creep_speed": 0.1, "stribeck": 0.0, "stribeck_speed": 1.0}


@functools.cache
def plain(seconds: float = SECONDS) -> Set:
    return begun(bench(record=swinging(seconds)))


def judged(best: Set, **undecided: str) -> dict[str, Detectability]:
    return {test.name: test for test in detectability.testability(best, undecided)}


@functools.cache
def stated(seconds: float = SECONDS) -> dict[str, Detectability]:
    return judged(plain(seconds))


def shown(found: dict[str, Detectability]) -> dict[str, float]:
    return {name: test.least_size for name, test in found.items() if test.testable}


def gain(name: str, part: Part) -> float:
    return next(one.gain for one in candidates(begun(bench(part))) if one.name == name)


def with_friction() -> Set:
    before = begun(bench(of(EFFECTS["coulomb_windup"], **FRICTION)))
    best = candidates(before)[0]
    assert best.name == "coulomb_windup"
    return before.beside(best.item, best.widths).settled().relearned


def test_least_sizes_are_positive_and_finite() -> None:
    assert list(stated()) == [effect.name for effect in plain().fit.data.searched]
    sizes = shown(stated())
    assert len(sizes) > 12
    assert all(LEAST_SIZE <= size < math.inf for size in sizes.values())
    assert {stated()[name].reason for name in sizes} == {"tested"}


OTHERS = ("output_runout", "encoder_interpolation", "torque_offset")
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in OTHERS]


@pytest.mark.parametrize("name", ["tooth_damage", "coulomb_windup", *SLOW])
def test_at_the_least_size_the_evidence_names_it_and_far_below_it_does_not(name: str) -> None:
    effect = next(one for one in plain().fit.data.searched if one.name == name)
    points = effect.starts(plain().fit.signals).points
    part = effect.response(plain().fit.signals, effect.usual, points[len(points) // 2])
    part = part * stated()[name].least_size / np.std(part)
    assert gain(name, lambda _: part) > ODDS
    assert gain(name, lambda _: 0.25 * part) < ODDS


def test_a_larger_record_shows_smaller_effects() -> None:
    half, whole, double = (stated(times * SECONDS) for times in (0.5, 1.0, 2.0))
    for shorter, longer in ((half, whole), (whole, double)):
        assert shown(shorter).keys() <= shown(longer).keys()
        for name, size in shown(shorter).items():
            assert longer[name].least_size < size
        # At most the root of the length: remainders imitate a part of it at any length.
        ratio = shorter["coulomb_windup"].least_size / longer["coulomb_windup"].least_size
        assert 1.2 < ratio < 1.05 * math.sqrt(2.0)


def test_noise_hides_effects() -> None:
    noise = 10.0 * NOISE * np.random.default_rng(5).standard_normal(plain().fit.data.record.size)
    noisy = judged(begun(bench(lambda _: noise)))
    assert shown(noisy).keys() < shown(stated()).keys()
    larger = [noisy[name].least_size / size for name, size in shown(stated()).items()]
    assert min(larger) > 1.0
    assert max(larger) < 10.1  # no remainder hides more than before


def test_what_is_undecided_has_no_least_size_and_says_why() -> None:
    found = judged(plain(), hysteresis=NOT_PROVED, thermal_drift=NOT_PROVED)
    undecided = found["hysteresis"]
    assert (undecided.testable, math.isnan(undecided.least_size)) == (False, True)
    assert undecided.reason == NOT_PROVED
    assert "no temperature is measured" in found["thermal_drift"].reason  # what the user can fix comes first
    others = {name: test for name, test in found.items() if name not in ("hysteresis", "thermal_drift")}
    assert all(test == stated()[name] for name, test in others.items() if not math.isnan(test.least_size))


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("torque_gain", BY_PARAMETERS),  # compliances act like a gain of the torque
        ("wear_backlash", BY_PARAMETERS),  # the datum is the backlash
        ("coupling_misalignment", "function of speed, of which any joint has some, imitates it"),
        ("thermal_drift", "no temperature is measured"),
    ],
)
def test_why_a_cause_cannot_be_shown_is_told(name: str, reason: str) -> None:
    assert not stated()[name].testable
    assert reason != BY_PARAMETERS or math.isnan(stated()[name].least_size)
    assert reason in stated()[name].reason


def test_what_was_found_is_no_question_and_what_it_imitates_has_to_be_larger() -> None:
    rubs = with_friction()
    beside, without = judged(rubs), judged(rubs.without("coulomb_windup"))
    found = beside["coulomb_windup"]
    assert (found.testable, found.least_size, found.reason) == (True, LEAST_SIZE, "found")
    assert beside["viscous_windup"].least_size > 1.1 * without["viscous_windup"].least_size
    assert beside["output_runout"].least_size == pytest.approx(without["output_runout"].least_size, rel=0.02)
