"""Limits of a torque record: waves that a filter removes, and a late torque."""

import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, filtfilt, lfilter

from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.ripple.ripple import Ripple, ripple
from hd_diag.diagnosis.ripple.verdict import as_json, sentence
from hd_diag.model.transmission_error import Kinematics

RATIO, SIZE, ORDER = 100.0, 0.3, 200.0
Array = np.ndarray
Filter = Callable[[Array, float, float], Array]


def first_order(values: Array, corner: float, rate: float) -> Array:
    pole = math.exp(-2.0 * math.pi * corner / rate)
    return np.asarray(lfilter([1.0 - pole], [1.0, -pole], values - values[0]) + values[0])


def butterworth(order: int, values: Array, corner: float, rate: float) -> Array:
    return np.asarray(lfilter(*butter(order, corner, fs=rate), values))


second_order, fourth_order = partial(butterworth, 2), partial(butterworth, 4)


def without_phase(values: Array, corner: float, rate: float) -> Array:
    return np.asarray(filtfilt(*butter(2, corner, fs=rate), values))


def moving_average(values: Array, corner: float, rate: float) -> Array:
    count = round(0.443 * rate / corner)
    return np.convolve(values, np.ones(count) / count, "same")


def moved(speed: float, rate: float, seed: int, noise: float = 0.05) -> tuple[Array, Array, Array]:
    """Time, angle and torque of moves to and fro: gravity, friction, a line, white sensor noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 24.0 / speed, 1.0 / rate)
    turn = np.sin(2.0 * np.pi * speed * time / 4.0)
    velocity = speed * np.sign(turn) * np.minimum(1.0, 4.0 * np.abs(turn))
    angle = np.cumsum(velocity) / rate
    torque = 5.0 * np.cos(angle) + 2.0 * np.tanh(velocity / 0.01) + 3.0 * velocity
    torque += SIZE * np.cos(ORDER * angle - 1.0) + noise * rng.standard_normal(time.size)
    return time, angle, torque


def seen(time: Array, angle: Array, torque: Array, record: Array | None = None) -> Ripple:
    number = np.zeros(time.size, np.int64) if record is None else record
    return ripple(time, RATIO * angle, torque, number, Kinematics(RATIO))


def is_honest(told: Ripple) -> bool:
    """Whether the statement on the line covers the truth: a size, a bound, or that it is invisible."""
    if ORDER in {one.order for one in told.unseen}:
        return all(line.filtered for line in told.lines if line.order == ORDER)
    (line,) = [line for line in told.lines if (line.order, line.reverses) == (ORDER, False)]
    reach = line.amplitude + 3.0 * line.std if line.found else line.least
    return reach > 0.85 * SIZE


CASES = [
    (first_order, 5.0, 500.0, 0.05, 0.0),
    (first_order, 3.0, 125.0, 0.05, 0.01),
    (second_order, 5.0, 250.0, 0.02, 1e-6),
    (second_order, 10.0, 500.0, 0.1, 0.01),
    (fourth_order, 4.0, 250.0, 0.05, 0.001),
    (without_phase, 5.0, 250.0, 0.05, 1e-7),
    (without_phase, 3.0, 1000.0, 0.05, 0.01),
    (moving_average, 5.0, 500.0, 0.05, 0.0),
    (moving_average, 10.0, 250.0, 0.05, 0.001),
]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("speed", [0.08, 0.5])
def test_what_a_filter_takes_off_is_not_denied(case: tuple, speed: float) -> None:
    filtered, corner, rate, noise, count = case
    time, angle, torque = moved(speed, rate, 1, noise)
    torque = filtered(torque, corner, rate)
    torque = count * np.rint(torque / count) if count else torque
    try:
        told = seen(time, angle, torque)
    except RecordError as error:
        said = "cannot be seen here: the torque is filtered at about .* move slower than"
        assert re.search(said, str(error))  # noqa: PT017
    else:
        assert is_honest(told)


@pytest.mark.parametrize("filtered", [first_order, second_order, without_phase])
def test_a_line_in_the_band_of_a_filter_is_found(filtered: Filter) -> None:
    """At 0.02 rad/s a line of 200 per turn has 0.64 Hz, below the corner of 5 Hz."""
    time, angle, torque = moved(0.02, 125.0, 2)
    told = seen(time, angle, filtered(torque, 5.0, 125.0))
    line = told.found[0]
    assert (line.order, line.filtered) == (ORDER, False)
    assert line.amplitude == pytest.approx(SIZE, rel=0.1)
    assert 2.0 < told.corner < 10.0


@pytest.mark.parametrize(
    ("noise", "count", "rate"),
    [(0.05, 0.0, 125.0), (0.02, 0.01, 500.0), (1e-3, 1e-6, 250.0), (0.3, 0.1, 1000.0)],
)
def test_white_noise_of_a_sensor_is_no_filter(noise: float, count: float, rate: float) -> None:
    time, angle, torque = moved(0.5, rate, 3, noise)
    torque = count * np.rint(torque / count) if count else torque
    told = seen(time, angle, torque)
    assert told.corner == math.inf
    assert {one.order for one in told.unseen} <= {400.0}  # 32 Hz is too fast for 125 samples per second
    assert told.delay is None
    assert is_honest(told)
    assert [line.order for line in told.found] == [ORDER]


def test_a_line_that_a_filter_has_left_is_said_to_be_larger() -> None:
    time, angle, torque = moved(0.5, 500.0, 4)
    told = seen(time, angle, first_order(torque, 5.0, 500.0))
    (line,) = [line for line in told.found if line.order == ORDER and not line.reverses]
    assert line.filtered
    assert line.amplitude < 0.5 * SIZE
    assert "(at least 0." in sentence(told)
    assert "per output turn cannot be seen here: the torque is filtered at about" in sentence(told)


def recordings(
    speeds: Sequence[float], phases: Sequence[float], delay: float, ways: Sequence[float] = (1.0,)
) -> tuple[Array, ...]:
    """Rows of recordings at constant speeds [rad/s] with a torque delay [s]."""
    rng, rate = np.random.default_rng(5), 500.0
    parts = []
    for number, (speed, phase) in enumerate(zip(speeds, phases, strict=True)):
        for way in ways:
            time = np.arange(0.0, 4.0 / speed, 1.0 / rate) + 1e3 * (2 * number + (way > 0.0))
            angle = way * speed * (time - time[0])
            before = angle - way * speed * delay
            torque = 0.2 * np.cos(200.0 * before - phase) + 0.1 * np.cos(400.0 * before - 2.0 * phase)
            torque += 2.0 * way + 0.05 * rng.standard_normal(time.size)
            parts.append((time, angle, torque, np.full(time.size, number)))
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


SPEEDS = (0.3, 0.5, 0.8, 1.0, 1.2, 1.5)
ONE_WAY, BOTH_WAYS = (1.0,), (-1.0, 1.0)
FAST = [(2.5e-3, ONE_WAY), (-4e-3, BOTH_WAYS), (12e-3, ONE_WAY)]
SLOW = [(2.5e-3, BOTH_WAYS), (-4e-3, ONE_WAY), (12e-3, BOTH_WAYS)]


@pytest.mark.parametrize(
    ("delay", "ways"), [*FAST, *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOW)]
)
def test_a_late_torque_is_said_and_its_lines_repeat(delay: float, ways: tuple[float, ...]) -> None:
    told = seen(*recordings(SPEEDS, [1.0] * 6, delay, ways))
    assert told.delay.value == pytest.approx(delay, abs=max(4.0 * told.delay.std, 1e-4))
    assert told.delay.std < 0.2e-3
    found = [(line.order, line.reverses, line.repeats) for line in told.found]
    assert found == [(200.0, False, True), (400.0, False, True)]
    for line, size, phase in zip(told.found, (0.2, 0.1), (1.0, 2.0), strict=True):
        assert line.amplitude == pytest.approx(size, rel=0.05)
        assert abs(math.remainder(line.phase - phase, 2.0 * math.pi)) < 0.2
    assert f"ms {'late' if delay > 0.0 else 'early'} against the angle" in sentence(told)
    assert as_json(told, "a")["delay"]["value"] == told.delay.value


@pytest.mark.parametrize("count", [3, 4, 6])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(one, marks=pytest.mark.slow) for one in range(2, 6))])
def test_no_delay_makes_phases_repeat_that_do_not(count: int, seed: int) -> None:
    """A few phases may agree by chance: a line repeats exactly where its own phases agree.

    A line repeats if its mean phase vector exceeds 0.8; the next lower one is 0.67, far beyond the noise.
    """
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, count)
    told = seen(*recordings(SPEEDS[:count], phases.tolist(), 0.0))
    assert told.delay is None
    for line in told.found:
        together = abs(np.mean(np.exp(1j * line.order / 200.0 * phases)))
        assert line.repeats is bool(together > 0.8)


def test_a_torque_that_is_not_late_has_no_delay() -> None:
    assert seen(*recordings(SPEEDS, [1.0] * 6, 0.0)).delay is None


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ({"torque": np.nan}, "no row has a time, an angle and a torque that are numbers"),
        ({"angle": np.nan}, "no row has"),
        ({"torque": 1.0}, "the torque never changes"),
        ({"angle": 1.0}, "too little motion"),
        ({"time": 1.0}, "too short: at least two stamps that rise"),
        ({"rows": 1}, "never changes"),
        ({"rows": 3}, "too little motion"),
        ({"rows": 0}, "no row has"),
        ({"runs": 7}, "too little motion"),
    ],
)
def test_what_is_no_motion_is_one_line(spoilt: dict[str, Any], said: str) -> None:
    time, angle, torque = moved(0.5, 125.0, 6)
    columns = {"time": time, "angle": angle, "torque": torque}
    columns |= {name: np.full(time.size, value) for name, value in spoilt.items() if name in columns}
    columns["record"] = np.arange(time.size) // spoilt.get("runs", time.size)
    rows = spoilt.get("rows", time.size)
    with pytest.raises(RecordError, match=said):
        seen(*(column[:rows] for column in columns.values()))
