"""Candidates: the gain is that of a fit, the best is first, a family is counted once."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, bench, of

from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.diagnosis.search.ranking import Projector, candidates, family_size, ranked
from hd_diag.diagnosis.evidence.unmodelled_terms import UNMODELLED_TERMS, UnmodelledTerm
from hd_diag.effects.effect import Stage

RUBBED, DRY = EFFECTS["hysteresis"], EFFECTS["coulomb_windup"]


@pytest.fixture(scope="module")
def made() -> LinearisedFit:
    reaches = {"bending_reach": 9.0, "sharpness": 1.6, "slipping_reach": 2.0, "spread": 1.5}
    return bench(of(RUBBED, bending_amplitude=1e-4, slipping_amplitude=6e-5, **reaches))


def deviance(columns: np.ndarray, target: np.ndarray) -> float:
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return float(np.sum((target - scaled @ np.linalg.lstsq(scaled, target, rcond=None)[0]) ** 2))


@pytest.mark.parametrize("chosen", [(), ((DRY, (0.2, 0.0, 0.5, 5.0)),)])
def test_gain_is_that_of_a_fit(made: LinearisedFit, chosen: tuple) -> None:
    projector, white = Projector(made, chosen), made.white(RUBBED, (9.0, 1.6, 2.0, 1.5))
    fixed = np.concatenate((made.always_white, *(made.white(*item) for item in chosen)), axis=1)
    held, steps = made.on_bounds(chosen)
    precision, pull = made.prior(chosen)
    target = np.concatenate((made.residual_white - fixed[:, held] @ steps, np.sqrt(precision) * pull))
    fixed = np.concatenate((fixed, np.diag(np.sqrt(precision))))
    fixed[:, held], white = 0.0, np.concatenate((white, np.zeros((precision.size, 2))))
    before, after = deviance(fixed, target), deviance(np.concatenate((fixed, white), axis=1), target)
    white = white[: made.residual_white.size]
    assert projector.deviance == pytest.approx(before, rel=1e-9)
    assert projector.gain(white) == pytest.approx(before - after, rel=1e-6)
    assert projector.fitted == fixed.shape[1]
    coefficients, _ = projector.fit(white)
    assert coefficients == pytest.approx([1e-4, 6e-5], rel=0.15)


def test_what_is_fitted_already_gains_nothing(made: LinearisedFit) -> None:
    projector = Projector(made, ((RUBBED, (9.0, 1.6, 2.0, 1.5)),))
    again = made.white(RUBBED, (9.0, 1.6, 2.0, 1.5)) @ np.array([[1.0, 2.0, -0.3], [0.5, -1.0, 7.0]])
    coefficients, _ = projector.fit(again)
    assert coefficients.tolist() == [0.0, 0.0, 0.0]
    assert projector.gain(again) == 0.0


def test_the_cause_is_first_at_its_best_grid_point_of_all(made: LinearisedFit) -> None:
    found = candidates(made, ())
    unmodelled = ranked(made, (), UNMODELLED_TERMS)
    assert 2 <= len(unmodelled) <= len(UNMODELLED_TERMS)
    assert max(one.gain for one in unmodelled) < found[0].gain
    assert found[0].effect == RUBBED
    assert found[0].nonlinear in RUBBED.starts(made.signals).points
    assert [one.surprise for one in found] == sorted((one.surprise for one in found), reverse=True)
    assert found[0].p_value < 1e-100
    assert {one.effect.name for one in found} == {effect.name for effect in made.data.searched}
    assert family_size(made) == sum(effect.starts(made.signals).trials for effect in made.data.searched)


def test_what_is_chosen_is_no_candidate(made: LinearisedFit) -> None:
    beside = ranked(made, ((RUBBED, (9.0, 1.6, 2.0, 1.5)),), [RUBBED, DRY])
    assert [one.effect for one in beside] == [DRY]
    alone = next(one for one in ranked(made, (), [RUBBED, DRY]) if one.effect is DRY)
    assert beside[0].gain < 0.1 * alone.gain


def test_a_shape_that_only_the_fitted_rows_have_is_no_candidate(made: LinearisedFit) -> None:
    """Of all rows more rests are seen: too many for a constant each."""
    rows = np.arange(made.data.source.size) < 3000
    made = linearise(made.data.source, CONFIGURED, POINT, rows).with_noise(())
    fitted = made.data.at.size
    few = UnmodelledTerm(
        name="few",
        cause="",
        frame="time",
        remembers=True,
        shape=lambda signals: np.ones((signals.size, int(signals.size <= fitted))),
    )
    assert made.data.testable(few)[0]
    assert ranked(made, (), [few]) == []


def test_without_a_measured_torque_only_what_the_motion_proves_takes_part(made: LinearisedFit) -> None:
    """What acts under a torque that nobody knows cannot be computed."""
    blind = linearise(dataclasses.replace(made.data.record, has_torque=False), CONFIGURED, POINT).with_noise(
        ()
    )
    found = {one.effect.name for one in candidates(blind, ())}
    proved = {effect.name for effect in blind.data.searched if blind.data.testable(effect)[0]}
    assert found == {name for name in proved if EFFECTS[name].stage != Stage.TORQUE}
    assert {"coulomb_windup", "thermal_drift", "input_encoder_eccentricity"} & found == {
        "input_encoder_eccentricity"
    }


def test_a_grid_point_is_the_best_within_the_parameters_bounds() -> None:
    """By a compliance below zero another would explain more."""
    harder = EFFECTS["torsional_hardening"]
    fit = bench(lambda signals: 4e-6 * signals.torque * np.exp(-np.abs(signals.torque) / 10.0))
    points = harder.starts(fit.signals).points
    gains = [fit.deviance(()) - fit.deviance(((harder, point),)) for point in points]
    free = [Projector(fit, ()).gain(fit.white(harder, point)) for point in points]
    assert np.argmax(free) != np.argmax(gains)
    (found,) = ranked(fit, (), [harder])
    assert found.nonlinear == points[int(np.argmax(gains))]
    assert found.gain == pytest.approx(max(gains), rel=1e-6)
    assert found.gain < 0.9 * max(free)
