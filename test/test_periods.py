"""Periods of a rate by stamps alone."""

import numpy as np
import pytest
from hd_diag.monitor.periods import Periods
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

SECOND = 1_000_000_000


def taken(periods: Periods, stamps: np.ndarray, rate: float, sizes: int) -> list[int]:
    """Stamps at which a period begins, looked at some at a time; one at a time as a live stream is."""
    found: list[int] = []
    for begin in range(0, stamps.size, sizes):
        part = stamps[begin : begin + sizes]
        if sizes == 1 and periods.within(int(part[0])):
            continue
        found += part[periods.begun(part, rate)].tolist()
    return found


@given(
    steps=st.lists(st.integers(1, 300_000_000), min_size=1, max_size=60),
    rate=st.sampled_from([0.5, 7.0, 20.0, 1000.0]),
    shift=st.sampled_from([0.0, 1.0 / 3.0, 6.0 / 7.0]),
    size=st.integers(2, 60),
)
def test_one_by_one_gives_what_many_at_once_give(
    steps: list[int], rate: float, shift: float, size: int
) -> None:
    stamps = np.cumsum(np.array(steps, np.int64))
    assert taken(Periods(shift), stamps, rate, 1) == taken(Periods(shift), stamps, rate, size)


def test_the_first_stamp_and_then_one_of_every_period_is_due() -> None:
    stamps = np.arange(5 * SECOND, 7 * SECOND, SECOND // 1000)
    assert_array_equal(taken(Periods(0.0), stamps, 20.0, 1), np.arange(5 * SECOND, 7 * SECOND, SECOND // 20))
    shifted = taken(Periods(0.5), stamps, 20.0, 1)
    assert_array_equal(shifted[1:], np.arange(5 * SECOND + SECOND // 40, 7 * SECOND, SECOND // 20))


def test_another_rate_is_seen_once_told() -> None:
    periods, stamps = Periods(0.0), np.arange(0, SECOND, SECOND // 100)
    assert len(taken(periods, stamps, 1.0, 1)) == 1
    assert not taken(periods, stamps[-3:], 50.0, 1)
    periods.change()
    assert len(taken(periods, SECOND + stamps, 50.0, 1)) == 50


@pytest.mark.parametrize("size", [1, 10])
def test_at_rate_zero_nothing_is_due(size: int) -> None:
    assert not taken(Periods(0.0), np.arange(0, 10 * SECOND, SECOND // 10), 0.0, size)
