"""Recursions over samples."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.effects import recursions
from hd_diag.effects.recursions import follow, relax, slip

COUNT = 5000
RNG = np.random.default_rng(0)
CHANGE = RNG.normal(0.0, 0.4, COUNT)
DECAY = 0.97 * np.exp(1j * RNG.uniform(0.1, 0.4, COUNT))
ADDED = RNG.normal(0.0, 1.0, COUNT) + 1j * RNG.normal(0.0, 1.0, COUNT)
VALUES = RNG.normal(0.0, 1.0, (COUNT, 3))
STEPS = DECAY[1:], ADDED[1:], 0.5 * ADDED[:-1]
START = VALUES[0] * (0.3 - 0.7j)


def test_compiled_is_plain_to_the_bit() -> None:
    assert_array_equal(slip(0.3, CHANGE), recursions._slip(0.3, CHANGE))
    assert_array_equal(relax(0.2 - 1.0j, DECAY, ADDED), recursions._relax(0.2 - 1.0j, DECAY, ADDED))


def test_an_even_step_is_that_of_every_row() -> None:
    even = tuple(one[:1] for one in STEPS)
    every = tuple(np.repeat(one, COUNT - 1) for one in even)
    assert_array_equal(follow(START, even, VALUES), follow(START, every, VALUES))


def test_columns_are_what_relax_gives_of_each() -> None:
    decay, constant, rising = STEPS
    for column, start, found in zip(VALUES.T, START, follow(START, STEPS, VALUES).T, strict=True):
        expected = relax(start, decay, constant * column[:-1] + rising * np.diff(column))
        assert_allclose(found, np.concatenate(([start], expected)).real, atol=1e-12)


def test_columns_without_rows() -> None:
    assert follow(START, tuple(one[:1] for one in STEPS), VALUES[:0]).shape == (0, 3)


def test_slip_is_a_play_between_two_stops() -> None:
    found = slip(0.0, np.array([0.4, 0.4, 0.4, -0.5, -2.0, 0.0, 0.3]))
    assert_allclose(found, [0.4, 0.8, 1.0, 0.5, -1.0, -1.0, -0.7])


def test_slip_forgets_where_it_began() -> None:
    """Once both have met a stop they are the same."""
    one, other = slip(0.9, CHANGE), slip(-0.9, CHANGE)
    met = np.flatnonzero(one == other)[0]
    assert 0 < met < 200
    assert_array_equal(one[met:], other[met:])
    assert np.abs(one).max() == 1.0


def test_relax_is_the_sum_of_all_that_was_added() -> None:
    found = relax(2.0 + 1.0j, DECAY[:50], ADDED[:50])
    left = np.array([[np.prod(DECAY[k + 1 : n + 1]) for k in range(50)] for n in range(50)])
    expected = np.tril(left) @ ADDED[:50] + (2.0 + 1.0j) * np.cumprod(DECAY[:50])
    assert_allclose(found, expected, rtol=1e-10)


def test_relax_towards_rest() -> None:
    """A constant input ends in its own steady state."""
    decay = np.full(400, math.exp(-0.1) + 0.0j)
    assert_allclose(relax(0.0, decay, np.full(400, 1.0 + 2.0j))[-1], (1.0 + 2.0j) / (1.0 - math.exp(-0.1)))


@pytest.mark.parametrize("cut", [1, 17, COUNT - 1])
def test_chunks_are_the_whole(cut: int) -> None:
    first, second = slip(0.3, CHANGE[:cut]), relax(1.0j, DECAY[:cut], ADDED[:cut])
    assert_array_equal(np.concatenate((first, slip(float(first[-1]), CHANGE[cut:]))), slip(0.3, CHANGE))
    rest = relax(complex(second[-1]), DECAY[cut:], ADDED[cut:])
    assert_array_equal(np.concatenate((second, rest)), relax(1.0j, DECAY, ADDED))


def test_every_other_sample_of_an_array() -> None:
    """Arrays that are not contiguous."""
    assert_array_equal(slip(0.0, CHANGE[::2]), slip(0.0, CHANGE[::2].copy()))
    assert slip(0.0, np.empty(0)).shape == relax(0.0, DECAY[:0], ADDED[:0]).shape == (0,)
