"""Stamps that jitter: which of them tell when a sample was taken, and which do not."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from hd_diag.diagnosis.stamps import without_jitter

RATE, COUNT = 500.0, 5000  # [Hz]
EVEN = np.arange(COUNT) / RATE
JITTER = 0.1  # of a step
ONE = np.zeros(COUNT, dtype=np.int64)


def angle(time: np.ndarray) -> np.ndarray:
    """A swing of some turns [rad]."""
    return 30.0 * np.sin(2.0 * np.pi * 0.3 * time)


def jittered(seed: int = 0) -> np.ndarray:
    return EVEN + np.random.default_rng(seed).normal(0.0, JITTER / RATE, COUNT)


def test_jitter_of_stamps_alone_is_taken_out() -> None:
    """What is left of it is the mean over half a second: a tenth of it and less."""
    stamps = jittered()
    found = without_jitter(stamps, angle(EVEN), ONE)
    assert np.std(found - EVEN) < 0.1 * JITTER / RATE
    assert np.abs(np.diff(found) * RATE - 1.0).max() < 0.02


def test_samples_that_were_taken_unevenly_keep_their_stamps() -> None:
    stamps = jittered()
    assert without_jitter(stamps, angle(stamps), ONE) is stamps


@pytest.mark.parametrize("counts", [2**12, 2**20])
def test_an_encoder_that_counts_tells_as_well(counts: int) -> None:
    step = 2.0 * np.pi / counts
    even, uneven = (np.round(angle(time) / step) * step for time in (EVEN, jittered()))
    assert np.std(without_jitter(jittered(), even, ONE) - EVEN) < 0.1 * JITTER / RATE
    assert_array_equal(without_jitter(jittered(), uneven, ONE), jittered())


def test_samples_that_are_lost_are_no_jitter() -> None:
    kept = np.random.default_rng(1).random(COUNT) > 0.05
    found = without_jitter(jittered()[kept], angle(EVEN)[kept], ONE[kept])
    assert np.std(found - EVEN[kept]) < 0.15 * JITTER / RATE


def test_every_stretch_has_a_clock_of_its_own() -> None:
    """After a gap the stamps may be off by any share of a step."""
    stretch = np.arange(COUNT) // 1000
    moved = EVEN + 3.37 * stretch / RATE + 5.0 * stretch
    found = without_jitter(jittered() + (moved - EVEN), angle(EVEN), stretch)
    assert np.std(found - moved) < 0.15 * JITTER / RATE


def test_stamps_that_do_not_jitter_stay() -> None:
    assert without_jitter(EVEN, angle(EVEN), ONE) is EVEN


def test_stamps_that_jump_by_half_a_step_and_more_stay() -> None:
    """Which sample was taken when cannot be told."""
    stamps = np.sort(EVEN + np.random.default_rng(2).normal(0.0, 1.0 / RATE, COUNT))
    assert without_jitter(stamps, angle(EVEN), ONE) is stamps
