"""The last steps of a fit: nonlinear values and their covariance, on records with a known effect."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED, EFFECTS, POINT, bench, of, swinging
from joint_records import joint, prepared
from numpy.testing import assert_allclose

from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.fit_parameters import DATUM
from hd_diag.diagnosis.fit.joint_refinement import _within, covariance, free, polished, settle, slopes
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit, linearise
from hd_diag.effects.effect import Effect

HARDENING, LOOP = (-6e-6, 8e-6, 11.0, 30.0, 0.1), (1e-4, 6e-5, 9.0, 1.6, 2.0, 1.5)
TRUTH = {"torsional_hardening": HARDENING, "hysteresis": LOOP}
PARAMETERS = fit_parameters.count(CONFIGURED)
MODEL = PARAMETERS + 1  # with the encoders' offset


Case = tuple[Effect, tuple[float, ...], LinearisedFit]


@pytest.fixture(scope="module", params=TRUTH)
def case(request: pytest.FixtureRequest) -> Case:
    effect, values = EFFECTS[request.param], TRUTH[request.param]
    names = (quantity.name for quantity in effect.quantities)
    return effect, values, bench(of(effect, **dict(zip(names, values, strict=True))))


def test_nonlinear_values_are_returned(case: Case) -> None:
    """From the worst start that a search leaves, values end within four (small) standard deviations."""
    effect, expected, start = case
    near = np.array(expected[2:]) * np.resize([1.1, 0.93], len(expected) - 2)
    found, chosen = polished(start, ((effect, tuple(near)),))
    spread, (place,) = covariance(found, chosen)
    deviation = np.sqrt(np.diag(spread))[place]
    values = np.concatenate((found.fit(chosen)[0][place[:2]], chosen[0][1]))
    assert np.all(np.abs(values - expected) < 4.0 * deviation)
    assert np.all(deviation < 0.25 * np.abs(expected))
    moved = found.fit(chosen)[0][:PARAMETERS] + found.parameters - start.parameters
    assert np.all(np.abs(moved) < 4.0 * np.sqrt(np.diag(spread))[:PARAMETERS])


def test_a_fit_reaches_the_end_of_a_valley() -> None:
    """A pitch error's harmonics imitate an eccentricity: each step of either covers only part of the way."""
    effect, size = EFFECTS["circular_spline_pitch"], np.zeros(16)
    size[[0, 2, 3]] = 3e-6, -3e-6, 1e-6
    chosen = ((effect, ()),)
    away = POINT + np.array([0.0, 0.0, 0.0, 0.0, 6.0, 0.0, 0.0])
    fit = bench(lambda signals: effect.response(signals, size, ())).moved(away).corrected(chosen)
    found = settle(fit, chosen, rounds=8, learn=False)
    # At the end, the columns describe the effect at its size.
    assert found.cost(chosen) - found.design(chosen).deviance() < 20.0


@pytest.mark.parametrize("farther", [*(pytest.param(um, marks=pytest.mark.slow) for um in (6.0, 10.0)), 14.0])
def test_worn_teeth_and_a_datum_that_hide_each_other_are_told_apart(farther: float) -> None:
    """Along the valley, a step of the datum alone raises the cost: the wear must change with it."""
    wear = EFFECTS["wear_backlash"]
    away, chosen = POINT.copy(), ((wear, ()),)
    away[DATUM] += farther
    begin = bench(of(wear, clearance=4e-6), record=swinging(40.0)).moved(away).corrected(chosen)
    found = settle(begin, chosen, rounds=8, learn=False)
    assert abs(found.parameters[DATUM] - POINT[DATUM]) < 0.6


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (12.0, -9.0, 0.0), (-20.0, 10.0, 20.0)])
def test_a_step_that_makes_a_fit_worse_is_shortened_or_left(away: tuple[float, float, float]) -> None:
    """With the wrong cause, the model is nonlinear over steps of many deviations."""
    record = swinging()
    read = 15e-3 * np.cos(record.input_angle - 2.0) + 4e-3 * np.cos(2.0 * record.input_angle + 1.0)
    made = bench(record=dataclasses.replace(record, input_angle=record.input_angle + read))
    chosen = ((EFFECTS["circular_spline_pitch"], ()),)
    step = np.array([*away[:2], 0.0, 0.0, away[2], 0.0, 0.0])
    begin = made.moved(fit_parameters.admissible(POINT + step, CONFIGURED)).corrected(chosen)
    end = settle(begin, chosen, rounds=2, learn=False)
    assert end.cost(chosen) < begin.cost(chosen)


def test_slopes_are_those_of_the_response(case: Case) -> None:
    effect, values, made = case
    nonlinear = values[2:]
    chosen = ((EFFECTS["output_runout"], ()), (effect, nonlinear))
    found = slopes(made, chosen)
    fitted = made.fit(chosen)[0][MODEL + 2 :]
    for column, step in zip(found.T, 1e-3 * np.eye(len(nonlinear)), strict=True):
        ends = [effect.columns(made.signals, tuple(np.array(nonlinear) + s * step)) for s in (1.0, -1.0)]
        expected = (ends[0] - ends[1]) @ fitted / 2e-3
        assert column @ expected / (expected @ expected) == pytest.approx(1.0, rel=0.02)
    assert found.shape[1] == len(nonlinear)
    assert slopes(made, chosen[:1]).shape == (made.data.record.size, 0)


def test_places_in_the_covariance(case: Case) -> None:
    effect, values, made = case
    lines = EFFECTS["encoder_interpolation"]
    linear = ((EFFECTS["torque_offset"], ()), (lines, (64.0,)))
    assert polished(made, linear)[1] == linear
    chosen = (lines, (64.0,)), (effect, values[2:]), (EFFECTS["viscous_windup"], (1.0,))
    spread, places = covariance(made, chosen)
    last = 7 + len(values) - 2
    expected = [[0, 1, 2, 3, -1 - MODEL], [4, 5, *range(7, last)], [6, last]]
    assert [(place - MODEL).tolist() for place in places] == expected
    assert spread.shape == (MODEL + last + 1,) * 2
    assert_allclose(spread, spread.T, rtol=1e-9, atol=0.0)
    assert (free(lines), free(effect)) == ([], list(range(len(values) - 2)))


def test_free_values_widen_what_is_known_of_the_coefficients(case: Case) -> None:
    effect, values, made = case
    chosen = ((effect, values[2:]),)
    alone = np.diag(made.fit(chosen)[1])
    together = np.diag(covariance(made, chosen)[0])[: alone.size]
    assert np.all(together[MODEL:] > 1.02 * alone[MODEL:])
    assert np.all(together > 0.999 * alone)


def test_a_value_stops_at_its_limit() -> None:
    effect = EFFECTS["viscous_windup"]
    made = bench(lambda signals: signals.contact.under_more_torque(2.0 * np.sign(signals.forward_speed)))
    assert polished(made, ((effect, (0.8,)),))[1][0][1] == (effect.nonlinear[0].low,)


def test_deviations_follow_the_scatter_of_recordings() -> None:
    """The eccentricity differs between recordings: the mean of four has half their scatter."""
    sizes = np.array([11.0, 12.0, 13.0, 12.0])
    drives = [joint(eccentricity__magnitude=1e-6 * x, eccentricity__direction=0.6).drive for x in sizes]
    given = [swinging(10.0, seed, drive) for seed, drive in enumerate(drives)]
    names = {"time": "time", "input": "input_angle", "output": "output_angle", "torque": "reported_torque"}
    rows = {name: np.concatenate([getattr(one, own) for one in given]) for name, own in names.items()}
    bag = np.repeat(np.arange(sizes.size), given[0].size)
    made = linearise(prepared(rows, bag), CONFIGURED, POINT).with_noise(())
    spread, _ = covariance(made, ())
    towards = POINT[:2] / np.hypot(*POINT[:2])
    expected = sizes.std(ddof=1) / np.sqrt(sizes.size)
    assert np.sqrt(towards @ spread[:2, :2] @ towards) == pytest.approx(expected, rel=0.25)


def test_deviations_follow_the_scatter_of_blocks(case: Case) -> None:
    """A disturbance in every third block that no column has widens what it affects; nothing gets narrower."""
    *_, made = case
    chosen = ((EFFECTS["stream_delay"], ()),)
    plain = np.sqrt(np.diag(made.fit(chosen)[1]))
    assert np.all(np.sqrt(np.diag(covariance(made, chosen)[0])) >= 0.999 * plain)
    shape = made.signals.speed / np.max(np.abs(made.signals.speed)) * (made.data.block % 3 == 0)
    uneven = dataclasses.replace(made)
    uneven.__dict__["residual"] = made.residual + 3e-5 * shape
    spread, (place,) = covariance(uneven, chosen)
    assert np.sqrt(spread[place[0], place[0]]) > 1.5 * plain[place[0]]


@pytest.mark.parametrize("near", [0.99, 1.0, 1.01])
def test_a_value_beside_that_of_a_grid_point_moves_as_far_as_any(near: float) -> None:
    """The step must not be the distance to that point: a refinement would stop at every grid point."""
    fit, loop = bench(), EFFECTS["hysteresis"]
    sharpness = np.unique([point[1] for point in fit.data.grid(loop)])
    steps = np.diff(sharpness)
    found = fit.data.grid_step(loop, (9.0, near * sharpness[1], 2.0, 1.5))
    assert found[1] in (steps[0], steps[1])
    assert fit.data.grid_step(EFFECTS["resonance"], (1.0, 50.0, 0.07))[2] == 0.03


def test_a_step_that_leaves_a_range_ends_on_it_and_the_others_follow() -> None:
    friction, rng = EFFECTS["coulomb_windup"], np.random.default_rng(2)
    chosen = ((friction, (0.1, 0.002, 0.5, 19.0)), (EFFECTS["viscous_windup"], (1.0,)))
    root = rng.standard_normal((5, 5))
    spread = root @ root.T / 25.0
    step = np.array([0.05, -0.3, 0.2, 4.0, 0.1])
    low, high = np.array([[*q.fitted] for effect, _ in chosen for q in effect.nonlinear]).T
    at = np.concatenate([values for _, values in chosen])

    def worse(there: np.ndarray) -> float:
        return float((there - step) @ np.linalg.solve(spread, there - step))

    found = _within(chosen, step, spread)
    assert np.all((low - at <= found) & (found <= high - at))
    for size in (1e-4, 1e-2, 1.0):
        others = np.clip(found + size * rng.standard_normal((200, 5)), low - at, high - at)
        assert min(map(worse, others)) >= worse(found) - 1e-6
    assert worse(np.clip(step, low - at, high - at)) > 1.5 * worse(found)
    np.testing.assert_array_equal(_within(chosen, 1e-4 * step, spread), 1e-4 * step)
