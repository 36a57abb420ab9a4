"""Spectra over an angle: weights of samples that rest, lines of records that go far."""

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from hd_diag.effects.order_spectrum import line_width, spectrum, travelled

TURN = 2.0 * np.pi


@pytest.mark.parametrize("moving", [0, 1, 5, 150])
def test_weights_of_a_record_that_rests_are_those_of_its_motion(moving: int) -> None:
    """Of 1000 samples; all count alike where none moves."""
    angle = np.minimum(np.arange(1000.0), float(moving))
    weights = travelled(angle)
    assert weights.mean() == pytest.approx(1.0)
    assert_array_equal(weights[moving + 1 :] > 0.0, moving == 0)
    assert 0.0 < line_width(angle, 0.1) <= 1.0


def test_the_width_of_a_line_is_one_over_the_turns() -> None:
    """Of even samples: side lobes of a rectangle's transform are below 0.1 from the third on."""
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
