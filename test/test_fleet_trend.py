"""Steps and drifts are found where they exist; constant series raise no more alarms than stated."""

import math
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats

from hd_diag.fleet.series import Series
from hd_diag.fleet.trend import FALSE_ALARM, LEAST, Trend, gains, least_values, segments
from hd_diag.fleet.trend import trends as trends_of

DAY = 86_400.0  # [s]
START = 1.767e9  # [s]
SIGMA = 0.1


def series(value: np.ndarray, std: np.ndarray | float = SIGMA, limit: float = math.nan) -> Series:
    time = START + DAY * np.arange(value.size)
    return Series("", "joint_1", "eccentricity", "m", time, value, np.broadcast_to(std, value.shape), limit)


def trends(many: list[Series]) -> list[Trend]:
    return trends_of(many, np.random.default_rng(0))


def trend_of(value: np.ndarray, std: np.ndarray | float = SIGMA, limit: float = math.nan) -> Trend:
    return trends([series(value, std, limit)])[0]


def noise(seed: int, size: int, std: np.ndarray | float = SIGMA) -> np.ndarray:
    return std * np.random.default_rng(seed).standard_normal(size)


def most_of(count: int) -> int:
    """Limit that false alarms of `count` constant series exceed with 0.1 % probability at the stated rate."""
    return int(stats.binom.isf(1e-3, count, FALSE_ALARM))


# Constant ---


@pytest.mark.parametrize("kind", ["equal", "uneven", "understated", "heavy tails"])
def test_false_alarms_are_as_rare_as_stated(kind: str) -> None:
    """Also if deviations differ, are ten times too small, or the noise is not Gaussian."""
    count, size, alarms = 150, 20, 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        std = SIGMA * rng.uniform(0.3, 3.0, size) if kind == "uneven" else np.full(size, SIGMA)
        value = rng.standard_t(3, size) if kind == "heavy tails" else rng.standard_normal(size)
        alarms += trend_of(5.0 + std * value, std / 10.0 if kind == "understated" else std).form != "constant"
    assert alarms <= most_of(count)


def test_false_alarms_of_a_whole_run_are_as_rare() -> None:
    """Twelve series together raise an alarm no more often than one alone."""
    runs = 25
    found = [trends([series(noise(100 * run + i, 15)) for i in range(12)]) for run in range(runs)]
    assert sum(any(t.form != "constant" for t in each) for each in found) <= most_of(runs)


# Steps ---


@pytest.mark.parametrize("seed", range(8))
def test_a_step_is_found_where_it_is(seed: int) -> None:
    value = noise(seed, 30) + np.where(np.arange(30) < 18, 0.0, 4.0 * SIGMA)
    found = trend_of(value)
    (change,) = found.changes
    assert found.form == "steps"
    assert change.low <= START + 17.5 * DAY <= change.high
    assert abs((change.after - START) / DAY - 18) <= 1
    assert change.after - change.before == DAY
    assert change.size_low < change.size < change.size_high
    assert abs(change.size - 4.0 * SIGMA) < 4.0 * SIGMA * math.sqrt(1 / 18 + 1 / 12)
    assert change.p_value == pytest.approx(0.001)
    place = np.arange(45)
    two = trend_of(noise(seed, 45) + np.select([place < 15, place < 30], [0.0, 8.0 * SIGMA], 3.0 * SIGMA))
    assert [round((c.after - START) / DAY) for c in two.changes] == [15, 30]
    assert [np.sign(c.size) for c in two.changes] == [1.0, -1.0]


def test_intervals_of_a_step_hold_as_often_as_they_say() -> None:
    count, step = 50, np.where(np.arange(24) < 12, 0.0, 3.0 * SIGMA)
    found = [trend_of(noise(seed, 24) + step).changes for seed in range(count)]
    single = [change for (change,) in (c for c in found if len(c) == 1)]
    assert len(single) > 0.8 * count
    least = stats.binom.ppf(1e-3, len(single), 0.95)
    assert sum(c.low <= START + 11.5 * DAY <= c.high for c in single) > least
    assert sum(c.size_low <= 3.0 * SIGMA <= c.size_high for c in single) > least


def test_poor_values_hide_no_step_and_a_wild_one_is_none() -> None:
    """They would hide the step if they had the same weight as the others."""
    value = noise(1, 20)
    value[10] += 30.0 * SIGMA
    assert trend_of(value).form == trend_of(np.full(20, 3.0), 0.0).form == "constant"
    std = np.where(np.arange(40) % 2 == 0, SIGMA, 40.0 * SIGMA)
    value = noise(0, 40, std) + np.where(np.arange(40) < 20, 0.0, 4.0 * SIGMA)
    assert trend_of(value, std).form == "steps"
    assert trend_of(value, math.nan).form == "constant"


PAIRS = st.tuples(st.floats(-1e3, 1e3), st.floats(0.01, 100.0))


@given(st.lists(PAIRS, min_size=2 * LEAST, max_size=20), st.floats(-1e6, 1e6))
def test_gains_are_the_fall_of_the_squares(pairs: list[tuple[float, float]], shift: float) -> None:
    """Checked split by split, for any zero of the values."""
    value, weight = np.array(pairs).T

    def squares(rows: slice) -> float:
        mean = np.average(value[rows], weights=weight[rows])
        return float(np.sum(weight[rows] * (value[rows] - mean) ** 2))

    every = range(LEAST, value.size - LEAST + 1)
    expected = [squares(slice(None)) - squares(slice(0, k)) - squares(slice(k, None)) for k in every]
    scale = float(np.sum(weight * value**2)) + float(np.sum(weight)) * (1e-8 * abs(shift)) ** 2 + 1e-9
    assert_allclose(gains(value + shift, weight), expected, rtol=0, atol=1e-8 * scale + 1e-6 * max(expected))


def test_segments_have_the_least_penalised_cost() -> None:
    """Against every possible division of a short series."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        value, weight = rng.standard_normal(11).cumsum(), rng.uniform(0.5, 2.0, 11)

        def cost(edges: tuple[int, ...], value: np.ndarray = value, weight: np.ndarray = weight) -> float:
            parts = [slice(a, b) for a, b in pairwise((0, *edges, 11))]
            means = np.concatenate([0.0 * value[p] + np.average(value[p], weights=weight[p]) for p in parts])
            return float(weight @ (value - means) ** 2) + 2.0 * len(edges)

        allowed = [(), *((k,) for k in range(3, 9)), *((j, k) for j in range(3, 6) for k in range(j + 3, 9))]
        assert tuple(segments(value, weight, 2.0)) == min(allowed, key=cost)


# Too few ---


def test_too_few_values_tell_nothing_and_say_how_many_are_needed() -> None:
    clear = np.where(np.arange(9) < 4, 0.0, 100.0)
    assert (trend_of(clear[:8]).form, trend_of(clear[:8]).needed) == ("unknown", 9)
    assert math.isnan(trend_of(clear[:8]).step_p)
    assert trend_of(clear + noise(0, 9)).form == "steps"
    assert trends([]) == []
    assert trend_of(np.empty(0)).form == "unknown"


def test_the_clearest_step_of_so_few_is_just_rare_enough() -> None:
    """Over all orders of its values: with one value fewer, no step could be reported."""

    def least_p(number: int) -> float:
        value = np.where(np.arange(number) < number // 2, 0.0, 1.0)
        best = gains(value, np.ones(number)).max()
        orders = np.array(list(set(permutations(value.astype(int).tolist()))), dtype=float)
        return float(np.mean(gains(orders, np.ones(orders.shape)).max(axis=1) >= best - 1e-9))

    number = least_values(2)
    assert least_p(number) <= FALSE_ALARM / 2 < least_p(number - 1)
    assert [least_values(tests) for tests in (2, 6, 40, 400)] == [9, 10, 13, 17]


# Drifts ---


def test_a_drift_is_reported_with_its_slope_and_the_day_of_the_limit() -> None:
    slope = 0.5 * SIGMA  # per day
    count, slopes, days = 20, 0, 0
    for seed in range(count):
        found = trend_of(slope * np.arange(30) + noise(seed, 30), limit=slope * 50)
        assert (found.form, found.changes) == ("drift", ())
        slopes += found.line.low_slope * DAY < slope < found.line.high_slope * DAY
        when, low, high = ((time - START) / DAY for time in found.crossing)
        assert low < when < high
        days += low < 50 < high
    assert min(slopes, days) >= stats.binom.ppf(1e-3, count, 0.95)


def test_a_limit_that_nothing_moves_to_has_no_day() -> None:
    slope = 0.5 * SIGMA * np.arange(30)
    assert trend_of(-slope + noise(0, 30), limit=1.0).crossing is None
    assert trend_of(slope + noise(0, 30)).crossing is None
    assert trend_of(noise(0, 30), limit=1.0).crossing is None
    far, passed = (trend_of(slope + noise(0, 30), limit=limit) for limit in (1e3, slope[10]))
    assert (far.form, far.crossing) == ("drift", None)
    assert passed.crossing[0] == pytest.approx(START + 10 * DAY, abs=3 * DAY)


def test_p_values_are_resolved_as_far_as_many_series_ask() -> None:
    """One clear step among a hundred constant series."""
    many = [series(noise(seed, 25)) for seed in range(1, 100)]
    stepped = series(noise(0, 25) + np.where(np.arange(25) < 12, 0.0, 5.0 * SIGMA))
    found = trends([*many, stepped])
    assert found[-1].form == "steps"
    assert found[-1].step_p < FALSE_ALARM / (2 * 100)
    assert sum(t.form != "constant" for t in found[:-1]) <= 1
    assert FALSE_ALARM == 0.05
