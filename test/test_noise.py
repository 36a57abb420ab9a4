"""Whitening of coloured noise: the result is white, and every run is whitened separately."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from hd_diag.diagnosis.noise import ORDER, Whitening, bounds, whitening

AR = (1.3, -0.4)  # poles at 0.87 and 0.46
INNOVATION = 3.0e-6  # [rad]


def coloured(count: int, seed: int) -> np.ndarray:
    innovations = INNOVATION * np.random.default_rng(seed).standard_normal(count + 500)
    return lfilter([1.0], [1.0, -AR[0], -AR[1]], innovations)[500:]


def runs(*lengths: int) -> np.ndarray:
    return np.repeat(np.arange(len(lengths)), lengths)


def test_model_of_known_noise() -> None:
    """Within five standard errors, 1/sqrt(n)."""
    run = runs(10_000, 5_000, 15_000)
    found = whitening(coloured(run.size, 0), run)
    assert_allclose(found.coefficients, [*AR, *np.zeros(ORDER - 2)], atol=5.0 / np.sqrt(run.size))
    assert found.scale == pytest.approx(INNOVATION, rel=5.0 / np.sqrt(2 * run.size))


@pytest.mark.parametrize(("slow", "kept"), [(0.0, 0.0), (2.0, 0.95)])
def test_noise_drawn_is_white_after_it(slow: float, kept: float) -> None:
    noise = Whitening(np.append(AR, np.zeros(ORDER - 2)), INNOVATION, slow, kept)
    run = runs(20_000)
    white = noise(noise.drawn(run.size, np.random.default_rng(3)), run)[ORDER:]
    assert np.std(white) == pytest.approx(1.0, rel=5.0 / np.sqrt(2 * run.size))
    for lag in range(1, 51):
        assert abs(white[lag:] @ white[:-lag]) < 5.0 / np.sqrt(run.size) * (white @ white)


def test_the_first_samples_of_a_run_count_by_what_is_known_before_them() -> None:
    run = runs(20_000)
    found, count = whitening(coloured(run.size, 4), run), 3 * ORDER
    response = found.scale * lfilter([1.0], np.append(1.0, -found.coefficients), np.eye(1, 4000)[0])
    covariance = toeplitz([response[lag:] @ response[: response.size - lag] for lag in range(count)])
    values, short = np.random.default_rng(5).standard_normal((count, 2)), ORDER // 3
    expected = np.linalg.solve(np.linalg.cholesky(covariance), values)
    assert_allclose(found(values, runs(count)), expected, rtol=1e-9)
    assert_allclose(found(values, runs(short, count - short))[:short], expected[:short], rtol=1e-9)


def test_every_run_is_filtered_on_its_own() -> None:
    run = runs(300, ORDER, 500)
    noise = coloured(run.size, 3)
    filtered = whitening(noise, run)
    whole = filtered(noise, run)
    assert bounds(run) == [(0, 300), (300, 300 + ORDER), (300 + ORDER, 800 + ORDER)]
    for begin, end in bounds(run):
        assert_allclose(whole[begin:end], filtered(noise[begin:end], np.zeros(end - begin, dtype=int)))


def test_steps_between_runs_do_not_change_the_model() -> None:
    run = runs(2000, 2000)
    noise = coloured(run.size, 6)
    stepped = whitening(noise + np.where(run == 1, 0.0, 1.0), run)
    assert_allclose(stepped.coefficients, whitening(noise, run).coefficients, atol=1e-6)


def test_columns_are_filtered_like_one_and_no_residual_at_all_is_finite() -> None:
    run = runs(200, 300)
    block = np.random.default_rng(7).standard_normal((run.size, 3))
    filtered = whitening(coloured(run.size, 7), run)
    assert_allclose(filtered(block, run), np.stack([filtered(c, run) for c in block.T], axis=1), rtol=1e-12)
    assert np.isfinite(whitening(np.zeros(500), run)(np.ones(500), run)).all()


def covariance(run: np.ndarray, slow: float, kept: float) -> np.ndarray:
    """Covariance of white noise with variance one plus slow noise, within runs."""
    apart = np.abs(np.subtract.outer(np.arange(run.size), np.arange(run.size)))
    return np.eye(run.size) + np.where(np.equal.outer(run, run), slow**2 * kept**apart, 0.0)


@pytest.mark.parametrize(("slow", "kept"), [(0.0, 0.0), (0.3, 0.9), (5.0, 0.998)])
def test_slow_noise_is_whitened_exactly(slow: float, kept: float) -> None:
    """Whitened columns have the products and the determinant of the dense covariance."""
    run = runs(40, 3, 57)
    whiten = Whitening(np.zeros(ORDER), 1.0, slow, kept)
    columns = np.random.default_rng(0).standard_normal((run.size, 3))
    dense = covariance(run, slow, kept)
    white = whiten(columns, run)
    assert_allclose(white.T @ white, columns.T @ np.linalg.solve(dense, columns), rtol=1e-9)
    assert whiten.logarithm(run) == pytest.approx(0.5 * np.linalg.slogdet(dense)[1], rel=1e-9)
