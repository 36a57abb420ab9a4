"""Smoothing keeps the joint's torque and removes its noise; the data choose the window."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from hd_diag.diagnosis.smoothing import best_width, best_widths, rate, settled, smooth

STEP = 2e-3
TIME = STEP * np.arange(20_000)
WHOLE = np.zeros(TIME.size, dtype=np.int64)


def torque(frequency):
    return 40.0 * np.sin(2 * np.pi * frequency * TIME) + 5.0 * np.sin(5.3 * 2 * np.pi * frequency * TIME)


def noisy(frequency, size=0.15):
    return torque(frequency) + size * np.random.default_rng(4).standard_normal(TIME.size)


def test_a_quadratic_stays_as_it_is_to_its_ends():
    quadratic = 3.0 - 2.0 * TIME + 0.5 * TIME**2
    np.testing.assert_allclose(smooth(quadratic, WHOLE, STEP, 0.1), quadratic, atol=1e-9)
    np.testing.assert_allclose(rate(quadratic, WHOLE, STEP, 0.03), -2.0 + TIME, atol=1e-6)


@pytest.mark.parametrize("window", [5, 31, 501])
def test_a_rate_is_that_of_a_savitzky_golay_filter(window):
    values = noisy(1.0)[:1000]
    found = rate(values, WHOLE[:1000], STEP, (window + 0.5) * STEP)
    expected = savgol_filter(values, window, 2, deriv=1, delta=STEP)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("frequency", [0.1, 0.3, 1.0])
def test_the_chosen_window_is_nearly_the_best(frequency):
    values = noisy(frequency)
    widths = [best_width(values, WHOLE, STEP), *(0.01 * 1.1 ** np.arange(36))]
    found, *others = (np.std(smooth(values, WHOLE, STEP, width) - torque(frequency)) for width in widths)
    assert found < 1.15 * min(others)


def test_the_window_follows_the_noise():
    assert best_width(noisy(0.3, 1.0), WHOLE, STEP) > best_width(noisy(0.3, 0.02), WHOLE, STEP)
    assert best_width(torque(1.0), WHOLE, STEP) < 0.015


def test_segments_do_not_mix_and_those_of_a_few_samples_stay():
    segment = np.repeat([0, 1], TIME.size // 2)
    values = np.where(segment == 0, 1.0, 9.0)
    np.testing.assert_allclose(smooth(values, segment, STEP, 0.1), values, atol=1e-12)
    np.testing.assert_allclose(rate(values, segment, STEP, 0.03), 0.0, atol=1e-9)
    segment = np.repeat(np.arange(5), [1, 2, 3, 4, TIME.size - 10])
    values = noisy(0.3)
    np.testing.assert_array_equal(smooth(values, segment, STEP, 0.1)[:6], values[:6])
    assert np.isfinite(rate(values, segment, STEP, 0.03)).all()


@pytest.mark.parametrize(("mean", "expected"), [(0.0, 0.0), (2.0, 2.0)])
def test_noise_about_a_constant_is_the_constant(mean, expected):
    values = mean + 0.15 * np.random.default_rng(1).standard_normal(TIME.size)
    width = best_width(values, WHOLE, STEP)
    found = settled(values, smooth(values, WHOLE, STEP, width), STEP, width)
    assert np.ptp(found) == 0.0
    assert found[0] == pytest.approx(expected, abs=0.01)
    assert expected or found[0] == 0.0


def test_a_small_swing_above_the_noise_stays():
    values = noisy(0.3, 0.15) / 200.0 + 0.15 * np.random.default_rng(2).standard_normal(TIME.size)
    width = best_width(values, WHOLE, STEP)
    smoothed = smooth(values, WHOLE, STEP, width)
    np.testing.assert_array_equal(settled(values, smoothed, STEP, width), smoothed)


def test_a_quick_stretch_has_a_narrower_window_of_its_own():
    """A joint creeps for half a minute and hurries once: a common window would distort that."""
    true = torque(0.05) + 20.0 * np.sin(2 * np.pi * np.clip((TIME - 20.0) / 0.4, 0.0, 1.0))
    values = true + 0.15 * np.random.default_rng(4).standard_normal(TIME.size)
    quick = np.abs(TIME - 20.2) < 0.25
    widths = best_widths(values, WHOLE, STEP)
    found, before = (smooth(values, WHOLE, STEP, one) - true for one in (widths, widths.max()))
    assert np.std(found[quick]) < 0.5 * np.std(before[quick])
    assert np.mean(widths < widths.max()) < 0.03
    narrow = true + 9.0 * np.sin(2 * np.pi * np.clip((TIME - 30.0) / 0.05, 0.0, 1.0))
    values, short = narrow + values - true, np.abs(TIME - 30.025) < 0.03
    hurried = smooth(values, WHOLE, STEP, best_widths(values, WHOLE, STEP)) - narrow
    assert np.std(hurried[short]) < 0.2 * np.std(smooth(values, WHOLE, STEP, widths) - narrow, where=short)
    values = true + values - narrow
    pair = smooth(np.stack((values, -values), axis=1), WHOLE, STEP, widths)
    np.testing.assert_allclose(pair, np.stack((found + true, -found - true), axis=1), atol=1e-9)
