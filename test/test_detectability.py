"""What a record could have shown: the least sizes that are stated, and what is neither found nor absent."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, bench, of, swinging
from joint_records import ARCSEC

from hd_diag.diagnosis import detectability
from hd_diag.diagnosis.detectability import NOT_PROVED, Detectability
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.gain import Rms
from hd_diag.diagnosis.search.acceptance import LEAST_SIZE
from hd_diag.diagnosis.evidence.solution import Search

AS_NOISE = Rms(*(ARCSEC * v for v in (20.0, 5.0, 2.0, 2.0, 2.0, 2.1, 2.0, 1.9, 2.1)))
MORE = Rms(*(ARCSEC * v for v in (20.0, 5.0, 3.0, 3.0, 3.0, 3.0, 2.0, 1.9, 2.9)))  # it may be noise, or not


@functools.cache
def plain() -> LinearisedFit:
    return bench()


def judged(fit: LinearisedFit, rms: Rms, **undecided: str) -> dict[str, Detectability]:
    return {test.name: test for test in detectability.testability(Search(fit, ()), rms, undecided)}


@functools.cache
def clean() -> Diagnosis:
    return diagnose(swinging(), CONFIGURED, np.random.default_rng(0))


@pytest.mark.parametrize(
    "name",
    [
        "coulomb_windup",
        pytest.param("tooth_damage", marks=pytest.mark.slow),
        pytest.param("output_encoder_eccentricity", marks=pytest.mark.slow),
    ],
)
def test_at_the_least_size_that_is_stated_an_effect_is_named_and_far_below_it_is_not(name: str) -> None:
    effect, record, signals = EFFECTS[name], swinging(), plain().signals
    stated = next(test for test in clean().testable if test.name == name)
    assert (stated.testable, stated.least_size > LEAST_SIZE) == (True, True)
    nonlinear = effect.starts(signals, plain().remainder(())).points[0]
    part = effect.response(signals, effect.usual, nonlinear)
    part = np.interp(record.time, plain().data.record.time, part) * stated.least_size / np.std(part)
    for share in (1.0, 0.25):
        moved = dataclasses.replace(record, output_angle=record.output_angle + share * part)
        found = diagnose(moved, CONFIGURED, np.random.default_rng(0))
        assert [name in cause.alike for cause in found.causes] == [True] * (share == 1.0)


def test_what_is_plainly_there_and_not_named_is_not_absent() -> None:
    rubbed = bench(
        of(
            EFFECTS["coulomb_windup"],
            friction=1.0,
            way=1e-3,
            creep_speed=0.1,
            stribeck=0.0,
            stribeck_speed=1.0,
        )
    )
    test = judged(rubbed, AS_NOISE)["coulomb_windup"]
    assert (test.testable, test.reason) == (False, NOT_PROVED)
    assert judged(plain(), AS_NOISE)["coulomb_windup"].testable


def test_what_is_undecided_has_no_least_size() -> None:
    test = judged(plain(), AS_NOISE, hysteresis="why")["hysteresis"]
    assert (test.testable, math.isnan(test.least_size), test.reason) == (False, True, "why")


def test_where_more_than_noise_may_be_left_all_must_be_larger_than_that() -> None:
    before, after = judged(plain(), AS_NOISE), judged(plain(), MORE)
    larger = [after[name].least_size / one.least_size for name, one in before.items() if one.testable]
    assert len(larger) > 15
    assert min(larger) > 1.0  # where the smoothed torque already asks for more it grows little
    assert np.median(larger) > MORE.misfit.value
    assert min(test.least_size for test in after.values() if test.testable) > MORE.beyond_noise


def test_parameters_that_stay_as_configured_imitate_an_effect_all_the_same() -> None:
    held = judged(dataclasses.replace(plain(), held=(4, 5, 6)), AS_NOISE)
    for name, one in judged(plain(), AS_NOISE).items():
        assert held[name].least_size == pytest.approx(one.least_size, rel=1e-6, nan_ok=True)


def test_a_record_of_half_the_length_asks_for_larger_effects() -> None:
    half = linearise(swinging(10.0), CONFIGURED, POINT).with_noise(())
    before, after = judged(plain(), AS_NOISE), judged(half, AS_NOISE)
    lines = ("encoder_interpolation", "coulomb_windup", "torque_sensor_ripple")
    assert all(after[name].least_size > 1.2 * before[name].least_size for name in lines)
