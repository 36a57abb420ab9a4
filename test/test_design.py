"""Least squares by blocks: held-out sums, F test, intervals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from hd_diag.arrays import Floats
from hd_diag.diagnosis.fit.design import design, f_test, holds, interval, inverse, lower_bound, solve

ROWS, BLOCKS = 240, 8


def problem(seed: int = 0, columns: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((ROWS, columns))
    y = x @ rng.standard_normal(columns) + rng.standard_normal(ROWS)
    return x, y, np.arange(ROWS) * BLOCKS // ROWS


def left(x: np.ndarray, y: np.ndarray, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    return y - x @ np.linalg.lstsq(x[rows], y[rows], rcond=None)[0]


def test_sums_are_those_of_fits_with_and_without_each_block() -> None:
    x, y, block = problem()
    assert design(x, y, block).deviance() == pytest.approx(np.sum(left(x, y) ** 2), rel=1e-12)
    expected = [np.sum(left(x, y, block != b)[block == b] ** 2) for b in range(BLOCKS)]
    assert_allclose(design(x, y, block).held_out(), expected, rtol=1e-10)


def test_columns_that_wander_are_fitted_anew_in_a_block_that_is_held_out() -> None:
    x, y, block = problem()
    ramp = np.where(block == 3, 1.0, np.where(block == 4, 1e-3, 0.0)) * np.linspace(0.5, 1.5, ROWS)
    built = design(np.column_stack((x, ramp)), y + 50.0 * (block == 4), block, wandering=np.array([5]))
    inside = [block == b for b in range(BLOCKS)]
    x, y = x.copy(), y + 50.0 * (block == 4)
    for rows in (inside[3], inside[4]):
        x[rows], y[rows] = left(ramp[rows, None], x[rows]), left(ramp[rows, None], y[rows])
    assert_allclose(built.held_out(), design(x, y, block).held_out(), rtol=1e-9)
    gains = built.held_out_gain(slice(0, 1))
    assert_allclose(gains, design(x, y, block).held_out_gain(slice(0, 1)), rtol=1e-8)


def test_a_column_of_zeros_beside_others_solves_to_nothing() -> None:
    x, y, _ = problem(columns=12)
    x[:, 5] = 0.0
    expected = np.linalg.lstsq(x, y, rcond=None)[0]
    found = solve(x.T @ x, x.T @ y)
    assert found[5] == 0.0
    assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_f_test_is_that_of_the_textbook() -> None:
    """For one column in 11 rows, F is the square of t."""
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((2, 11))
    fit = stats.linregress(x - x.mean(), y)
    before = np.sum((y - y.mean()) ** 2)
    after = before - fit.slope**2 * np.sum((x - x.mean()) ** 2)
    assert f_test(before, after, 1, 11, 2) == pytest.approx(fit.pvalue, rel=1e-9)


def test_lower_bound_is_above_a_mean_of_zero_once_in_a_hundred() -> None:
    draws = np.random.default_rng(3).standard_normal((4000, 24))
    share = np.mean([lower_bound(row) > 0.0 for row in draws])
    assert share == pytest.approx(0.01, abs=4 * np.sqrt(0.01 * 0.99 / 4000))
    assert lower_bound(np.array([5.0])) == -np.inf  # one block proves nothing


def test_bootstrap_interval_covers() -> None:
    """95 % for a mean of 24 skewed blocks; a bootstrap of so few covers 2 to 4 % less."""
    rng = np.random.default_rng(4)
    draws = rng.gamma(2.0, 1.0, (400, 24))
    bounds = np.array([interval(row, rng) for row in draws])
    covered = np.mean((bounds[:, 0] < 2.0) & (bounds[:, 1] > 2.0))
    assert 0.88 < covered < 0.97


@pytest.mark.parametrize("dropped", [slice(0, 1), slice(2, 4), slice(3, 5)])
def test_held_out_gain_is_that_of_refits(dropped: slice) -> None:
    x, y, block = problem()
    rest = np.delete(x, np.r_[dropped], axis=1)
    gain, predicted, variance = design(x, y, block).held_out_gain(dropped)
    for b in range(BLOCKS):
        here, others = block == b, block != b
        full, fewer = left(x, y, others)[here], left(rest, y, others)[here]
        assert gain[b] == pytest.approx(fewer @ fewer - full @ full, rel=1e-9)
        assert predicted[b] == pytest.approx(np.sum((full - fewer) ** 2), rel=1e-9)
        spread = np.linalg.inv(x[others].T @ x[others])
        along = x[here].T @ (full - fewer)
        assert variance[b] == pytest.approx(predicted[b] + along @ spread @ along, rel=1e-9)


def test_held_out_loss_is_that_of_the_same_fit_without_some_columns() -> None:
    x, y, block = problem()
    loss = design(x, y, block).held_out_loss(slice(2, 4))
    for b in range(BLOCKS):
        here, others = block == b, block != b
        beta = np.linalg.lstsq(x[others], y[others], rcond=None)[0]
        fewer = np.where(np.isin(np.arange(beta.size), (2, 3)), 0.0, beta)
        full, without = (y[here] - x[here] @ one for one in (beta, fewer))
        assert loss[b] == pytest.approx(without @ without - full @ full, rel=1e-9)


def test_a_column_of_one_block_says_nothing_of_it() -> None:
    """Held out, its block is predicted without that column; a filter's tail elsewhere is rounding error."""
    x, y, block = problem(columns=4)
    local = np.where(block == 3, 1.0 / 3.0 + x[:, 0], np.where(block == 4, 1e-10, 0.0))
    wide = design(np.column_stack((x, 1e-3 * local)), y, block)
    plain = design(x, y, block)
    keep = np.arange(BLOCKS) == 3
    assert_allclose(wide.held_out()[keep], plain.held_out()[keep], rtol=1e-9)
    gains = (one.held_out_gain(slice(1, 2)) for one in (wide, plain))
    for found, expected in zip(*gains, strict=True):
        assert_allclose(found[keep], expected[keep], rtol=1e-9)
        assert np.abs(found).max() < 1e3
    assert_allclose([one[3] for one in wide.held_out_gain(slice(4, 5))], 0.0, atol=1e-12)


def test_without_a_column_others_go_farther_from_their_prior() -> None:
    """A similar column, held near zero by its prior, grows; checked by ridge regressions with and without."""
    x, y, block = problem()
    x[:, 1] = x[:, 0] + 0.1 * x[:, 1]
    y = y + 2.0 * x[:, 0]
    precision = np.array([0.0, 400.0, 0.0, 1.0, 1.0])
    pull = np.array([0.0, 0.1, 0.0, 0.0, -0.2])

    def fitted(columns: list[int]) -> Floats:
        own, weight, centre = x[:, columns], precision[columns], pull[columns]
        beta = np.zeros(5)
        beta[columns] = np.linalg.solve(own.T @ own + np.diag(weight), own.T @ y + weight * centre)
        return beta

    def square(beta: Floats) -> float:
        return float(np.sum((y - x @ beta) ** 2))

    fewer, whole = fitted([1, 2, 3, 4]), fitted([0, 1, 2, 3, 4])
    expected = precision @ ((fewer - pull) ** 2 - (whole - pull) ** 2)
    assert expected > 10.0
    gain, moved = design(x, y, block, precision, pull).prior_gain(slice(0, 1))
    assert gain == pytest.approx(expected)
    # The column's total gain, from data and prior, equals its predicted gain.
    brought = square(fewer) - square(whole) + gain
    assert brought == pytest.approx(float(np.sum((x @ (whole - fewer)) ** 2)) + moved)


def noise_gain(seed: int, blocks: int = 24, size: float = 0.0, rows: slice = slice(None)) -> bool:
    """Whether a noise column is accepted; `size` adds a true wave, and `rows` limits it to some blocks."""
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal((720, 3)), rng.standard_normal(720)
    block = np.arange(720) * blocks // 720
    x[:, 2] *= np.isin(block, np.arange(blocks)[rows])
    return holds(*design(x, y + size * x[:, 2], block).held_out_gain(slice(2, 3)))


def test_noise_alone_hardly_ever_holds() -> None:
    assert np.mean([noise_gain(seed) for seed in range(300)]) < 0.02 + 3.0 * np.sqrt(0.02 / 300)


@pytest.mark.parametrize(("size", "rows"), [(0.4, slice(None)), (1.5, slice(3, 5))])
def test_a_cause_in_all_or_in_two_blocks_holds(size: float, rows: slice) -> None:
    assert all(noise_gain(seed, size=size, rows=rows) for seed in range(20))


@pytest.mark.parametrize(
    ("gain", "predicted", "expected"),
    [
        ((60.0, 45.0), (60.0, 45.0), True),  # although the mean is within the blocks' scatter
        ((180.0, 20.0), (100.0, 100.0), True),
        ((180.0, -20.0), (100.0, 100.0), False),  # an equally weighted block loses part of the gain
        ((2.5, 0.5), (2.5, 0.5), False),  # 3.0 in all; the noise of the prediction is 2 sqrt(3)
    ],
)
def test_two_of_many_blocks_hold(gain: tuple, predicted: tuple, expected: bool) -> None:
    many = np.zeros((2, 24))
    many[:, :2] = gain, predicted
    assert lower_bound(many[0]) < 0.0
    assert holds(*many, many[1]) is expected


@pytest.mark.parametrize(("size", "expected"), [(0.4, False), (0.6, True), (1.8, True), (2.3, False)])
def test_a_cause_is_half_to_twice_as_large_as_blocks_foretell(size: float, expected: bool) -> None:
    foretold = np.full(24, 100.0)
    assert holds((2.0 * size - 1.0) * foretold, foretold, foretold) is expected


def test_blocks_count_by_what_is_foretold_of_them() -> None:
    """A torque's zero that a few motor turns show: the scatter of the gains exceeds their mean."""
    gain = np.fromstring("-15 0 15 60 35 55 -1 -17 10 6 0 1 -3 6 -5 4 25 186 12 10 8 4 5 168", sep=" ")
    foretold = np.fromstring("31 5 6 100 14 36 6 5 3 2 3 3 5 5 3 12 22 136 5 5 4 5 5 75", sep=" ")
    assert lower_bound(gain) < 0.0
    assert holds(gain, foretold, foretold)
    assert not holds(gain - foretold, foretold, foretold)
    turned = np.where(foretold == 136.0, -gain, gain)
    assert not holds(turned, foretold, foretold)
    # A block that the others do not determine counts little.
    open_there = np.where(foretold == 136.0, 100.0, 1.0) * foretold
    assert holds(turned, foretold, open_there)
    assert not holds(turned - np.where(foretold == 136.0, 200.0, 0.0), foretold, open_there)


def test_inverse_of_columns_of_any_scale() -> None:
    x, _, _ = problem()
    scale = 10.0 ** np.array([-9, 3, 0, -4, 6])
    expected = np.linalg.inv(x.T @ x) / np.outer(scale, scale)
    assert_allclose(inverse((x * scale).T @ (x * scale)), expected, rtol=1e-10)


def test_inverse_shares_out_between_columns_that_are_alike() -> None:
    x, y, _ = problem()
    twice = np.concatenate((x, 1e-6 * x[:, :1]), axis=1)
    fit = twice @ inverse(twice.T @ twice) @ twice.T @ y
    assert_allclose(fit, y - left(x, y), rtol=1e-8)
    assert np.isfinite(inverse(np.zeros((3, 3)))).all()
