"""Bins, envelopes and peaks against brute force."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.report.stages import band, envelope, strongest


def samples(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return np.sort(rng.uniform(0.0, 10.0, count)), rng.standard_normal(count)


@given(st.integers(0, 50), st.integers(1, 400))
def test_bands_are_those_of_each_bin_s_samples(seed: int, count: int) -> None:
    place, value = samples(seed, count)
    mixed = np.random.default_rng(seed).permutation(count)
    edges = np.linspace(1.0, 9.0, 9)
    found = band(place[mixed], value[mixed], edges)
    for row, (low, high) in enumerate(pairwise(edges.tolist())):
        own = value[(place >= low) & (place < high)]
        assert found.samples[row] == own.size
        if own.size < 5:
            assert np.isnan([found.mean[row], found.low[row], found.high[row]]).all()
        else:
            expected = (own.mean(), *np.quantile(own, (0.1, 0.9)))
            assert_allclose((found.mean[row], found.low[row], found.high[row]), expected, atol=1e-12)


@given(st.integers(0, 50), st.integers(2, 500), st.integers(1, 60))
def test_an_envelope_loses_no_extreme(seed: int, count: int, stretches: int) -> None:
    place, value = samples(seed, count)
    found = envelope(place, value, stretches)
    assert found.center.size == stretches
    assert_array_equal([np.nanmin(found.low), np.nanmax(found.high)], [value.min(), value.max()])
    width = (place[-1] - place[0]) / stretches
    for each, low, high in zip(found.center, found.low, found.high, strict=True):
        near = value[np.abs(place - each) < 0.5 * width * (1.0 - 1e-9)]
        assert near.size == 0 or (low <= near.min() and near.max() <= high)


def test_ends_gaps_and_nan() -> None:
    """The last bin includes its end; a stretch without samples is nan, and nan samples do not count."""
    found = band(np.repeat([0.0, 1.0, 2.0], 5), np.ones(15), np.array([0.0, 1.0, 2.0]))
    assert_array_equal(found.samples, [5, 10])
    found = envelope(np.array([0.0, 0.1, 9.9, 10.0]), np.array([1.0, np.nan, 3.0, 2.0]), 4)
    assert_array_equal(found.low, [1.0, np.nan, np.nan, 2.0])
    assert_array_equal(found.high, [1.0, np.nan, np.nan, 3.0])


@given(st.integers(0, 50), st.integers(1, 500))
def test_a_thinned_spectrum_keeps_the_greatest_of_every_interval(seed: int, count: int) -> None:
    place, value = samples(seed, count)
    value = np.abs(value)
    kept_place, kept = strongest(place, value, 10.0, 20)
    assert kept.size <= 20
    assert kept.max() == value.max()
    for low in np.arange(0.0, 10.0, 0.5):
        own = value[(place >= low) & (place < low + 0.5)]
        taken = kept[(kept_place >= low) & (kept_place < low + 0.5)]
        assert_array_equal(taken, [own.max()] if own.size else [])
