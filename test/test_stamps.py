"""Jittering stamps: which tell when a sample was taken, and which do not."""

import numpy as np
import pytest

from hd_diag.diagnosis.stamps import without_bursts, without_jitter

RATE, COUNT = 500.0, 5000  # [Hz]
EVEN = np.arange(COUNT) / RATE
JITTER = 0.1  # relative to a step
ONE = np.zeros(COUNT, dtype=np.int64)


def angle(time: np.ndarray) -> np.ndarray:
    """A swing over several turns [rad]."""
    return 30.0 * np.sin(2.0 * np.pi * 0.3 * time)


def jittered(seed: int = 0) -> np.ndarray:
    return EVEN + np.random.default_rng(seed).normal(0.0, JITTER / RATE, COUNT)


STEP = 2.0 * np.pi / 2**12
GAPS = np.random.default_rng(1).random(COUNT) > 0.05
STRETCH = np.arange(COUNT) // 1000


@pytest.mark.parametrize(
    ("time", "shown", "stretch", "most"),
    [
        (EVEN, angle(EVEN), ONE, 0.1),
        (EVEN, np.round(angle(EVEN) / STEP) * STEP, ONE, 0.1),
        (EVEN, np.round(angle(EVEN) / STEP * 256) * STEP / 256, ONE, 0.1),
        (EVEN[GAPS], angle(EVEN)[GAPS], ONE[GAPS], 0.15),
        (EVEN + 3.37 * STRETCH / RATE + 5.0 * STRETCH, angle(EVEN), STRETCH, 0.15),
    ],
    ids=["an angle", "counts", "fine counts", "samples are lost", "stretches have clocks of their own"],
)
def test_jitter_of_stamps_alone_is_taken_out(time, shown, stretch, most) -> None:
    """The remaining jitter is that of the mean over half a second: a tenth or less."""
    jitter = jittered() - EVEN
    found = without_jitter(time + (jitter[GAPS] if time.size < COUNT else jitter), shown, stretch)
    assert np.std(found - time) < most * JITTER / RATE
    assert stretch is not ONE or np.abs(np.diff(found) * RATE - 1.0).max() < 0.02


JUMPS = np.sort(EVEN + np.random.default_rng(2).normal(0.0, 1.0 / RATE, COUNT))


@pytest.mark.parametrize(
    ("stamps", "shown"),
    [
        (jittered(), angle(jittered())),
        (jittered(), np.round(angle(jittered()) / STEP) * STEP),
        (jittered(), np.round(angle(jittered()) / STEP * 256) * STEP / 256),
        (EVEN, angle(EVEN)),
        (JUMPS, angle(EVEN)),
    ],
    ids=["samples are uneven", "counts are", "fine counts are", "no jitter", "half a step and more"],
)
def test_other_stamps_stay(stamps, shown) -> None:
    """With jumps of half a step it is unknown which sample was taken when."""
    assert without_jitter(stamps, shown, ONE) is stamps


IN_BURST = np.arange(COUNT) % 8
BURSTS = EVEN + (7 - IN_BURST) * (1.0 / RATE - 20e-6)  # the recorder empties its buffer at every eighth row
PAUSED = BURSTS + 7.0 * (np.arange(COUNT) >= 2400)


def even(stamps: np.ndarray, shown: np.ndarray) -> tuple[np.ndarray, float]:
    return without_bursts(stamps, shown, ONE[: stamps.size])


NOW_AND_THEN = np.where(np.arange(COUNT) % 40 < 8, BURSTS, EVEN)


@pytest.mark.parametrize(
    "stamps", [BURSTS, PAUSED, NOW_AND_THEN], ids=["on and on", "with a pause", "now and then"]
)
def test_rows_stamped_in_bursts_were_sampled_evenly(stamps) -> None:
    found, rows = even(stamps, angle(EVEN))
    assert rows == 8.0
    late = found - EVEN - 7.0 * (stamps > EVEN + 1.0)
    assert np.ptp(late) < 1e-9


def test_lost_rows_shift_times_by_less_than_a_burst() -> None:
    found, _ = even(BURSTS[GAPS], angle(EVEN)[GAPS])
    assert np.max(np.abs(found - EVEN[GAPS])) < 8.0 / RATE
    assert np.all(np.diff(found) > 0.2 / RATE)


@pytest.mark.parametrize(
    "stamps", [EVEN, jittered(), EVEN[GAPS], BURSTS], ids=["even", "jitter", "gaps", "bursts"]
)
def test_rows_that_were_sampled_at_their_stamps_keep_them(stamps) -> None:
    found, rows = even(stamps, angle(stamps))
    assert found is stamps
    assert rows == 0.0
