"""Periods of a rate by stamps alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from hd_diag.streams.alignment import kernel
from hd_diag.streams.rules import NEVER

SECOND = 1_000_000_000


def taken(
    stamps: np.ndarray, rate: float, shift: float, size: int, last: np.ndarray | None = None
) -> list[int]:
    """Stamps at which a period begins, looked at some at a time; one at a time as a live stream is."""
    period = round(1e9 / rate)
    offset, found = np.array([round(shift * period)]), []
    last = np.array([NEVER]) if last is None else last
    for begin in range(0, stamps.size, size):
        part = stamps[begin : begin + size]
        nothing = np.zeros(part.size, np.int64)
        found += part[kernel().begun(part, nothing, nothing, period, offset, last)].tolist()
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
    assert taken(stamps, rate, shift, 1) == taken(stamps, rate, shift, size)


@pytest.mark.parametrize("size", [1, 10])
def test_the_first_stamp_and_then_one_of_every_period_is_due(size: int) -> None:
    stamps = np.arange(5 * SECOND, 7 * SECOND, SECOND // 1000)
    assert_array_equal(taken(stamps, 20.0, 0.0, size), np.arange(5 * SECOND, 7 * SECOND, SECOND // 20))
    shifted = taken(stamps, 20.0, 0.5, size)
    assert_array_equal(shifted[1:], np.arange(5 * SECOND + SECOND // 40, 7 * SECOND, SECOND // 20))


def test_another_rate_is_seen_at_once() -> None:
    last, stamps = np.array([NEVER]), np.arange(0, SECOND, SECOND // 100)
    assert len(taken(stamps, 1.0, 0.0, 1, last)) == 1
    assert len(taken(SECOND + stamps, 50.0, 0.0, 1, last)) == 50
