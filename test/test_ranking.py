"""Candidates: the gain is that of a fit, the best is first, a family is counted once."""

import numpy as np
import pytest
from benches import EFFECTS, bench, of

from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.search.ranking import Projector, candidates, family_size, ranked
from hd_diag.diagnosis.search.unmodelled_terms import UNMODELLED_TERMS

RUBBED, DRY = EFFECTS["hysteresis"], EFFECTS["coulomb_windup"]


@pytest.fixture(scope="module")
def made() -> LinearisedFit:
    return bench(of(RUBBED, first_amplitude=1e-4, second_amplitude=6e-5, first_reach=2.0, second_reach=9.0))


def deviance(columns: np.ndarray, target: np.ndarray) -> float:
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return float(np.sum((target - scaled @ np.linalg.lstsq(scaled, target, rcond=None)[0]) ** 2))


@pytest.mark.parametrize("chosen", [(), ((DRY, (0.6,)),)])
def test_gain_is_that_of_a_fit(made: LinearisedFit, chosen: tuple) -> None:
    projector, white = Projector(made, chosen), made.white(RUBBED, (2.0, 9.0))
    fixed = np.concatenate((made.always_white, *(made.white(*item) for item in chosen)), axis=1)
    before = deviance(fixed, made.residual_white)
    after = deviance(np.concatenate((fixed, white), axis=1), made.residual_white)
    assert projector.deviance == pytest.approx(before, rel=1e-9)
    assert projector.gain(white) == pytest.approx(before - after, rel=1e-6)
    assert projector.fitted == fixed.shape[1]
    coefficients, _ = projector.fit(white)
    assert coefficients == pytest.approx([1e-4, 6e-5], rel=0.15)


def test_what_is_fitted_already_gains_nothing(made: LinearisedFit) -> None:
    projector = Projector(made, ((RUBBED, (2.0, 9.0)),))
    again = made.white(RUBBED, (2.0, 9.0)) @ np.array([[1.0, 2.0, -0.3], [0.5, -1.0, 7.0]])
    coefficients, _ = projector.fit(again)
    assert coefficients.tolist() == [0.0, 0.0, 0.0]
    assert projector.gain(again) == 0.0


def test_the_cause_is_first_at_its_best_grid_point_of_all_that_are_testable(made: LinearisedFit) -> None:
    found = candidates(made, ())
    unmodelled = ranked(made, (), UNMODELLED_TERMS)
    assert 2 <= len(unmodelled) <= len(UNMODELLED_TERMS)
    assert max(one.gain for one in unmodelled) < found[0].gain
    assert found[0].effect is RUBBED
    assert found[0].nonlinear in RUBBED.starts(made.signals).points
    assert [one.surprise for one in found] == sorted((one.surprise for one in found), reverse=True)
    assert found[0].p_value < 1e-100
    testable = [effect for effect in made.data.searched if made.data.testable(effect)[0]]
    assert {one.effect.name for one in found} == {effect.name for effect in testable}
    assert len(testable) < len(made.data.searched)
    assert family_size(made) == sum(effect.starts(made.signals).trials for effect in testable)


def test_what_is_chosen_is_no_candidate(made: LinearisedFit) -> None:
    beside = ranked(made, ((RUBBED, (2.0, 9.0)),), [RUBBED, DRY])
    assert [one.effect for one in beside] == [DRY]
    alone = next(one for one in ranked(made, (), [RUBBED, DRY]) if one.effect is DRY)
    assert beside[0].gain < 0.1 * alone.gain


def test_what_the_motion_does_not_show_takes_part_on_request(made: LinearisedFit) -> None:
    drift = EFFECTS["thermal_drift"]
    assert not made.data.testable(drift)[0]
    assert ranked(made, (), [drift]) == []
    assert [one.effect for one in ranked(made, (), [drift], {"thermal_drift"})] == [drift]
