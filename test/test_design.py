"""Least squares by blocks: held-out sums, the F test's size, intervals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats
from scipy.signal import lfilter

from hd_diag.criticism.design import design, f_test, interval, lower_bound, solve
from hd_diag.criticism.noise import ORDER, whitening

ROWS, BLOCKS = 240, 8


def problem(seed: int = 0, columns: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((ROWS, columns))
    y = x @ rng.standard_normal(columns) + rng.standard_normal(ROWS)
    return x, y, np.arange(ROWS) * BLOCKS // ROWS


def built(x: np.ndarray, y: np.ndarray, block: np.ndarray):
    return design(x, y, block, np.ones(y.size, dtype=bool))


def left(x: np.ndarray, y: np.ndarray, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    return y - x @ np.linalg.lstsq(x[rows], y[rows], rcond=None)[0]


def test_deviance_is_that_of_a_fit() -> None:
    x, y, block = problem()
    assert built(x, y, block).deviance() == pytest.approx(np.sum(left(x, y) ** 2), rel=1e-12)


def test_held_out_is_a_refit_without_the_block() -> None:
    x, y, block = problem()
    expected = [np.sum(left(x, y, block != b)[block == b] ** 2) for b in range(BLOCKS)]
    assert_allclose(built(x, y, block).held_out(), expected, rtol=1e-10)


def test_columns_of_any_scale_and_alike() -> None:
    x, y, block = problem()
    expected = built(x, y, block).held_out()
    scaled = np.concatenate((x * 10.0 ** np.array([-9, 3, 0, -4, 6]), x[:, :1]), axis=1)
    assert_allclose(built(scaled, y, block).held_out(), expected, rtol=1e-6)


def test_rows_that_do_not_count() -> None:
    x, y, block = problem()
    counted = np.arange(ROWS) % 30 >= 10
    assert design(x, y, block, counted).rows == 160


def test_a_column_of_zeros_solves_to_nothing() -> None:
    gram = np.diag([4.0, 0.0])
    assert_allclose(solve(gram, np.array([8.0, 0.0])), [2.0, 0.0])


def test_f_test_is_that_of_the_textbook() -> None:
    """One column added to none in 11 rows: F is the square of t."""
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((2, 11))
    fit = stats.linregress(x - x.mean(), y)
    before = np.sum((y - y.mean()) ** 2)
    after = before - fit.slope**2 * np.sum((x - x.mean()) ** 2)
    assert f_test(before, after, 1, 11, 2) == pytest.approx(fit.pvalue, rel=1e-9)


def test_f_test_has_its_size_under_coloured_noise() -> None:
    """Waves tried on AR(1) noise, whitened by its own model: p is uniform."""
    count, rng = 3000, np.random.default_rng(2)
    run = np.repeat([0, 1, 2], count // 3)
    phase = 0.01 * np.arange(count) * np.arange(3, 23)[:, None]
    found = []
    for _ in range(20):
        noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal(count + 200))[200:]
        filtered = whitening(noise, run)
        y, one = filtered(noise, run), filtered(np.ones((count, 1)), run)
        before = np.sum(left(one, y) ** 2)
        for wave in phase:
            x = np.concatenate((one, filtered(np.stack((np.cos(wave), np.sin(wave)), axis=1), run)), axis=1)
            found.append(f_test(before, np.sum(left(x, y) ** 2), 2, count - 3 * ORDER, 3))
    assert stats.kstest(found, "uniform").pvalue > 0.01
    assert np.mean(np.array(found) < 0.05) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / len(found)))


def test_lower_bound_is_above_a_mean_of_zero_once_in_a_hundred() -> None:
    draws = np.random.default_rng(3).standard_normal((4000, 24))
    share = np.mean([lower_bound(row) > 0.0 for row in draws])
    assert share == pytest.approx(0.01, abs=4 * np.sqrt(0.01 * 0.99 / 4000))


def test_lower_bound_of_one_block_says_nothing() -> None:
    assert lower_bound(np.array([5.0])) == -np.inf


def test_bootstrap_interval_covers() -> None:
    """95 % of a mean of 24 skewed blocks; a bootstrap of so few is known to cover 2 to 4 % less."""
    rng = np.random.default_rng(4)
    draws = rng.gamma(2.0, 1.0, (400, 24))
    bounds = np.array([interval(row, rng) for row in draws])
    covered = np.mean((bounds[:, 0] < 2.0) & (bounds[:, 1] > 2.0))
    assert 0.88 < covered < 0.97


def test_bootstrap_interval_is_about_the_mean() -> None:
    gains = np.random.default_rng(5).normal(3.0, 1.0, 24)
    low, high = interval(gains, np.random.default_rng(6))
    half = 1.96 * gains.std() / np.sqrt(24)
    assert_allclose([low, high], gains.mean() + half * np.array([-1.0, 1.0]), atol=0.15 * half)
