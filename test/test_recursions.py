"""Recursions over samples."""

import math

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.effects.recursions import relax, slip

COUNT = 5000
RNG = np.random.default_rng(0)
CHANGE = RNG.normal(0.0, 0.4, COUNT)
DECAY = 0.97 * np.exp(1j * RNG.uniform(0.1, 0.4, COUNT))
ADDED = RNG.normal(0.0, 1.0, (COUNT, 3)) + 1j * RNG.normal(0.0, 1.0, (COUNT, 3))
START = np.array([2.0 + 1.0j, -1.0j, 0.5])


def test_slip_is_a_play_between_two_stops() -> None:
    found = slip(0.0, np.array([0.4, 0.4, 0.4, -0.5, -2.0, 0.0, 0.3]))
    assert_allclose(found, [0.4, 0.8, 1.0, 0.5, -1.0, -1.0, -0.7])


def test_slip_forgets_where_it_began() -> None:
    one, other = slip(0.9, CHANGE), slip(-0.9, CHANGE)
    met = np.flatnonzero(one == other)[0]
    assert 0 < met < 200
    assert_array_equal(one[met:], other[met:])
    assert np.abs(one).max() == 1.0


def test_relax_is_the_sum_of_all_that_was_added() -> None:
    found = relax(START, DECAY[:50], ADDED[:50])
    share = np.array([[np.prod(DECAY[k + 1 : n + 1]) for k in range(50)] for n in range(50)])
    expected = np.tril(share) @ ADDED[:50] + START * np.cumprod(DECAY[:50])[:, None]
    assert_allclose(found, expected, rtol=1e-10)
    one_for_all = np.array([math.exp(-0.1) + 0j])
    steady = relax(np.zeros(1) + 0j, one_for_all, np.full((400, 1), 1.0 + 2.0j))[-1]
    assert_allclose(steady, (1.0 + 2.0j) / (1.0 - one_for_all))


def test_arrays_of_any_layout_and_none() -> None:
    assert_array_equal(slip(0.0, CHANGE[::2]), slip(0.0, CHANGE[::2].copy()))
    assert_array_equal(relax(START, DECAY, ADDED[:, ::-1]), relax(START, DECAY, ADDED[:, ::-1].copy()))
    assert slip(0.0, np.empty(0)).shape == (0,)
    assert relax(START, DECAY[:1], ADDED[:0]).shape == (0, 3)
