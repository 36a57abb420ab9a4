"""A torque is smoothed as broadly as the data allow; the sensor's ripple of the lobes stays."""

import numpy as np
import pytest

from hd_diag.diagnosis.smoothing import best_widths, smooth
from hd_diag.diagnosis.torque_smoothing import smoothed_torque

STEP, RATIO, NOISE = 2e-3, 100.0, 0.3
TIME = STEP * np.arange(18_000)
WHOLE = np.zeros(TIME.size, dtype=np.int64)
# In both directions at up to 8 turns per second, under gravity.
ANGLE = 100.0 * np.sin(2 * np.pi * TIME / 12.0)
LOAD = 20.0 * np.sin(2 * np.pi * TIME / 30.0) + 8.0


def reported(true: np.ndarray) -> np.ndarray:
    return true + NOISE * np.random.default_rng(1).standard_normal(true.size)


def off(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.std(found - true))


@pytest.mark.parametrize("turns", [1.0, 1.0 + 1.0 / RATIO, 1.0 - 1.0 / RATIO])
def test_a_ripple_of_the_lobes_stays_and_narrows_no_window(turns: float) -> None:
    """Lobes in the frame of the housing or of either member."""
    angle = turns * ANGLE
    wave = 0.4 * np.cos(2 * angle + 0.3) + 0.1 * np.sin(4 * angle) + 0.1 * np.cos(angle)
    true = LOAD * (1.0 + 0.05 * np.cos(2 * angle - 1.0)) + wave
    given = reported(true)
    found = smoothed_torque(given, ANGLE, RATIO, WHOLE, STEP)
    assert found.with_waves
    plain = smooth(given, WHOLE, STEP, best_widths(given, WHOLE, STEP))
    assert off(found.torque, true) < 0.3 * off(plain, true)
    assert np.median(found.window) > 0.5 * np.median(best_widths(reported(LOAD), WHOLE, STEP))


def test_without_a_ripple_it_is_smoothed_and_nothing_else() -> None:
    given = reported(LOAD)
    found = smoothed_torque(given, ANGLE, RATIO, WHOLE, STEP)
    assert not found.with_waves
    np.testing.assert_array_equal(found.window, best_widths(given, WHOLE, STEP))
    np.testing.assert_array_equal(found.torque, smooth(given, WHOLE, STEP, found.window))


def test_waves_of_another_order_are_no_ripple_of_the_lobes() -> None:
    given = reported(LOAD + 0.4 * np.cos(3.3 * ANGLE))
    assert not smoothed_torque(given, ANGLE, RATIO, WHOLE, STEP).with_waves
    at_rest = smoothed_torque(reported(LOAD), np.full(TIME.size, 0.3), RATIO, WHOLE, STEP)
    assert not at_rest.with_waves
    assert off(at_rest.torque, LOAD) < 0.1 * NOISE


def test_jumps_are_no_ripple() -> None:
    for noise in (0.0, NOISE):
        true = np.where(np.abs(TIME - 31.0) < 1.0, 0.0, LOAD)
        given = true + noise / NOISE * (reported(LOAD) - LOAD)
        found = smoothed_torque(given, ANGLE, RATIO, WHOLE, STEP)
        assert not found.with_waves
        assert np.max(np.abs(found.torque[np.abs(TIME - 31.0) < 0.8])) < 0.1 + noise


def test_segments_and_few_samples_are_smoothed_as_they_are() -> None:
    segment = np.repeat(np.arange(4), [3, 2000, 7000, TIME.size - 9003])
    true = LOAD + 0.5 * np.cos(2 * ANGLE)
    found = smoothed_torque(reported(true), ANGLE, RATIO, segment, STEP)
    assert found.with_waves
    assert off(found.torque, true) < 0.2 * NOISE
    few = smoothed_torque(reported(true)[:300], ANGLE[:300], RATIO, WHOLE[:300], STEP)
    assert few.torque.shape == few.window.shape == (300,)
    assert np.isfinite(few.torque).all()


def test_a_torque_without_any_noise_or_change_is_what_it_is() -> None:
    for given in (np.zeros(TIME.size), np.full(TIME.size, 7.0), LOAD):
        found = smoothed_torque(given, ANGLE, RATIO, WHOLE, STEP)
        np.testing.assert_allclose(found.torque, given, atol=1e-3)


@pytest.mark.parametrize("turns", [0.9, 5.0])
def test_a_second_of_one_move_makes_no_waves_of_its_torque(turns: float) -> None:
    """At 100 Hz, with and without noise: so many waves would fit anything and grow without limit."""
    time = 0.01 * np.arange(100)
    angle = np.pi * turns * (1.0 - np.cos(np.pi * time))
    for noise in (0.0, NOISE):
        true = 30.0 * np.sin(2.0 * time) + 12.0 * np.tanh(20.0 * (time - 0.3)) + 5.0 * np.cos(7.0 * time**2)
        given = true + noise / NOISE * (reported(np.zeros(time.size)))
        found = smoothed_torque(given, angle, RATIO, np.zeros(time.size, dtype=np.int64), 0.01)
        assert not found.with_waves
        assert np.max(np.abs(found.torque)) < 1.2 * np.max(np.abs(given))
