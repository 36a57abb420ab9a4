"""The last steps of a fit: nonlinear values and their covariance, on records with a known effect."""

import dataclasses

import numpy as np
import pytest
from benches import EFFECTS, bench, of
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.joint_refinement import covariance, free, polished, slopes
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit

HARDENING = {
    "first_compliance": -6e-6,
    "second_compliance": 8e-6,
    "first_knee": 11.0,
    "second_knee": 30.0,
}
HYSTERESIS = {"first_amplitude": 1e-4, "second_amplitude": 6e-5, "first_reach": 2.0, "second_reach": 9.0}
TRUTH = {"torsional_hardening": HARDENING, "hysteresis": HYSTERESIS}
MODEL = fit_parameters.COUNT + 1  # and the encoders' offset


@pytest.fixture(scope="module", params=TRUTH)
def case(request: pytest.FixtureRequest) -> tuple[str, LinearisedFit]:
    return request.param, bench(of(EFFECTS[request.param], **TRUTH[request.param]))


def test_nonlinear_values_are_returned(case: tuple[str, LinearisedFit]) -> None:
    """From a start as far off as a search may leave it; within four standard deviations, which are small."""
    name, start = case
    effect, expected = EFFECTS[name], np.array(list(TRUTH[name].values()))
    found, chosen = polished(start, ((effect, tuple(expected[2:] * [1.1, 0.93])),))
    spread, (place,) = covariance(found, chosen)
    deviation = np.sqrt(np.diag(spread))[place]
    values = np.concatenate((found.fit(chosen)[0][place[:2]], chosen[0][1]))
    assert np.all(np.abs(values - expected) < 4.0 * deviation)
    assert np.all(deviation < 0.05 * np.abs(expected))
    moved = found.fit(chosen)[0][: fit_parameters.COUNT] + found.parameters - start.parameters
    assert np.all(np.abs(moved) < 4.0 * np.sqrt(np.diag(spread))[: fit_parameters.COUNT])


def test_slopes_are_those_of_the_response(case: tuple[str, LinearisedFit]) -> None:
    name, made = case
    effect = EFFECTS[name]
    _, nonlinear = effect.from_physical(TRUTH[name])
    chosen = ((EFFECTS["viscous_windup"], ()), (effect, nonlinear))
    found = slopes(made, chosen)
    fitted = made.fit(chosen)[0][MODEL + 1 :]
    for index, column in enumerate(found.T):
        step = np.zeros(2)
        step[index] = 1e-3
        ends = [effect.columns(made.signals, tuple(np.array(nonlinear) + s * step)) for s in (1.0, -1.0)]
        expected = (ends[0] - ends[1]) @ fitted / 2e-3
        assert column @ expected / (expected @ expected) == pytest.approx(1.0, rel=0.02)
    assert found.shape[1] == 2
    assert slopes(made, chosen[:1]).shape == (made.data.record.size, 0)


def test_linear_effects_stay_as_they_are(case: tuple[str, LinearisedFit]) -> None:
    _, made = case
    chosen = ((EFFECTS["viscous_windup"], ()), (EFFECTS["encoder_interpolation"], (64.0,)))
    assert polished(made, chosen)[1] == chosen


def test_places_in_the_covariance(case: tuple[str, LinearisedFit]) -> None:
    """Coefficients effect by effect, then what is free; a discrete value has no place."""
    name, made = case
    lines = EFFECTS["encoder_interpolation"]
    chosen = (
        (lines, (64.0,)),
        (EFFECTS[name], EFFECTS[name].from_physical(TRUTH[name])[1]),
        (EFFECTS["coulomb_windup"], (0.6,)),
    )
    spread, places = covariance(made, chosen)
    expected = [[0, 1, -1 - MODEL], [2, 3, 6, 7], [4, 5, 8]]
    assert [(place - MODEL).tolist() for place in places] == expected
    assert spread.shape == (MODEL + 9, MODEL + 9)
    assert_allclose(spread, spread.T, rtol=1e-9, atol=0.0)
    assert (free(lines), free(EFFECTS[name])) == ([], [0, 1])


def test_free_values_widen_what_is_known_of_the_coefficients(case: tuple[str, LinearisedFit]) -> None:
    name, made = case
    chosen = ((EFFECTS[name], EFFECTS[name].from_physical(TRUTH[name])[1]),)
    alone = np.diag(made.fit(chosen)[1])
    together = np.diag(covariance(made, chosen)[0])[: alone.size]
    assert np.all(together[MODEL:] > 1.02 * alone[MODEL:])
    assert np.all(together > 0.999 * alone)


def test_a_value_stops_at_its_limit() -> None:
    """A sudden change of friction asks for a slower reversal than the effect allows."""
    effect = EFFECTS["coulomb_windup"]
    low = effect.nonlinear[0].low
    made = bench(lambda signals: -1e-4 * np.sign(signals.forward_speed))
    _, chosen = polished(made, ((effect, (low,)),))
    assert chosen[0][1][0] >= low
    assert_array_equal(np.isfinite(chosen[0][1]), [True])


def test_deviations_follow_the_scatter_of_blocks(case: tuple[str, LinearisedFit]) -> None:
    """A part that no column has, in one block in three, widens what it pulls at; nothing gets narrower."""
    _, made = case
    chosen = ((EFFECTS["viscous_windup"], ()),)
    plain = np.sqrt(np.diag(made.fit(chosen)[1]))
    assert np.all(np.sqrt(np.diag(covariance(made, chosen)[0])) >= 0.999 * plain)
    shape = made.signals.speed / np.max(np.abs(made.signals.speed)) * (made.data.block % 3 == 0)
    uneven = dataclasses.replace(made)
    uneven.__dict__["residual"] = made.residual + 3e-5 * shape
    spread, (place,) = covariance(uneven, chosen)
    assert np.sqrt(spread[place[0], place[0]]) > 1.5 * plain[place[0]]
