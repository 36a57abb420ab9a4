"""Spectra over an angle: weights of samples at rest, lines of long records, prominent lines."""

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from hd_diag.effects.order_spectrum import line_width, peaks, prominence, spectrum, top, travelled

TURN = 2.0 * np.pi


@pytest.mark.parametrize("moving", [0, 1, 5, 150])
def test_weights_of_a_record_that_rests_are_those_of_its_motion(moving: int) -> None:
    angle = np.minimum(np.arange(1000.0), float(moving))
    weights = travelled(angle)
    assert weights.mean() == pytest.approx(1.0)
    assert_array_equal(weights[moving + 1 :] > 0.0, moving == 0)
    assert 0.0 < line_width(angle, 0.1) <= 1.0


def test_the_width_of_a_line_is_one_over_the_turns() -> None:
    """For even samples: the side lobes of a rectangle's transform are below 0.1 from the third on."""
    for turns in (50.0, 400.0, 1600.0):
        width = line_width(np.linspace(0.0, TURN * turns, 20_000), 0.1)
        assert width * turns == pytest.approx(2.7, abs=0.3)


def test_memory_is_bounded_for_any_number_of_turns() -> None:
    """A thousand million turns: their bins alone would take 8 GB."""
    angle = np.linspace(0.0, 1e9 * TURN, 1000)
    tracemalloc.start()
    width = line_width(angle, 0.1)
    order, strength = spectrum(angle, np.cos(angle), 8.0)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 0.0 < width < 1.0
    assert order[-1] <= 8.0
    assert np.isfinite(strength).all()
    assert most < 500e6


@pytest.mark.parametrize("true", [3.37, 17.043, 33.3])
def test_a_line_stands_out_at_its_own_order(true: float) -> None:
    """Accurate to a fiftieth of the resolution of 40 turns, in noise that falls with the order."""
    rng = np.random.default_rng(1)
    angle = TURN * 40.0 * (np.arange(40_000) + rng.random(40_000)) / 40_000
    noise = np.cumsum(rng.normal(size=angle.size)) * 0.02
    order, strength = spectrum(angle, 2.0 * np.cos(true * angle + 0.4) + noise, 40.0)
    best = int(np.argmax(prominence(strength, 50)))
    assert top(order, strength, best) == pytest.approx(true, abs=0.02 / 40.0)
    assert strength[best] == pytest.approx(2.0, rel=0.05)
    assert best in peaks(strength, 50)[:2]


def test_prominence_is_a_ratio_to_the_median_around_and_peaks_stand_apart() -> None:
    level = np.repeat([1.0, 4.0], 101)
    level[50], level[151] = 3.0, 16.0
    raised = prominence(level, 50)
    assert (raised[50], raised[151]) == (pytest.approx(3.0), pytest.approx(4.0))
    assert peaks(np.array([0.0, 2.0, 1.9, 0.0, 3.0, 1.0, 0.0]), 3).tolist() == [4]
    assert peaks(np.array([0.0, 2.0, 1.9, 0.0, 3.0, 1.0, 0.0]), 1).tolist() == [4, 1]
    assert peaks(np.zeros(5), 1).size == 0
    assert prominence(np.array([2.0]), 50).tolist() == [1.0]
    assert top(np.array([1.5]), np.array([2.0]), 0) == 1.5
