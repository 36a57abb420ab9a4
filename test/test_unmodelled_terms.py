"""Shapes without a cause: their columns on small records, and what they ask of a record."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.diagnosis.search.unmodelled_terms import UNMODELLED_TERMS, UnmodelledTerm
from hd_diag.effects import CATALOGUE
from hd_diag.effects.contact_table import contact_table
from hd_diag.effects.contact_weights import ContactWeights
from hd_diag.effects.signals import Signals

NAMES = ("even_torque", "sided_torque", "creep", "drift", "rests", "place", "square_speed")
BY_NAME = {term.name: term for term in UNMODELLED_TERMS}
RATE = 50.0  # [Hz]
FEW = 600


def made(speed: np.ndarray, torque: np.ndarray | float = 20.0, run: np.ndarray | None = None) -> Signals:
    """A record of a speed of the input [rad/s] and a torque [N m], from angle zero."""
    none = np.zeros(speed.size)
    angle = np.cumsum(speed) / RATE
    load = np.broadcast_to(torque, speed.shape).astype(np.float64)
    return Signals(
        time=np.arange(speed.size) / RATE,
        wave_generator_angle=-angle,
        output_angle=angle / 100.0,
        speed=speed,
        torque=load,
        temperature=None,
        run=np.zeros(speed.size, dtype=np.int64) if run is None else run,
        predicted=none,
        predicted_torque_slope=none,
        predicted_rate=none,
        contact=ContactWeights(contact_table(CONFIGURED, 60.0), -angle, load),
    )


def both_ways(seconds: float = 12.0) -> np.ndarray:
    """Speed [rad/s] that turns round every three seconds, without a rest."""
    time = np.arange(round(seconds * RATE)) / RATE
    return np.where(time // 3.0 % 2 == 0, 40.0, -30.0)


def wave(seconds: float = 12.0) -> np.ndarray:
    """Torque of both signs [N m]."""
    return 25.0 * np.sin(2.0 * np.pi * np.arange(round(seconds * RATE)) / RATE / 5.0)


def columns(name: str, signals: Signals) -> np.ndarray:
    return BY_NAME[name].columns(signals, ())


def has_none(name: str, signals: Signals) -> bool:
    """Whether a record has no columns of a term, which is then not testable."""
    found, (possible, reason) = columns(name, signals), BY_NAME[name].testable(signals)
    assert found.shape[0] == signals.size
    assert possible == bool(found.shape[1])
    assert possible or "nothing of the kind" in reason
    return not possible


# All of them ---


def test_names_and_which_are_predictive() -> None:
    assert tuple(term.name for term in UNMODELLED_TERMS) == NAMES
    assert not set(NAMES) & {effect.name for effect in CATALOGUE}
    assert {term.name for term in UNMODELLED_TERMS if not term.predictive} == {"drift", "rests"}
    assert all(len(term.cause) > 10 for term in UNMODELLED_TERMS)


@pytest.mark.parametrize("term", UNMODELLED_TERMS, ids=NAMES)
def test_columns_are_finite_and_of_order_one(term: UnmodelledTerm) -> None:
    speed = both_ways(24.0) * (np.arange(24 * 50) % 300 > 40)
    signals = made(np.abs(speed) * 3.0, wave(24.0))
    if term.name == "sided_torque":
        signals = made(both_ways(24.0), wave(24.0))
    if term.name == "rests":
        signals = made(speed, wave(24.0))
    if term.name == "place":
        signals = made(np.full(1200, 400.0))
    assert term.testable(signals)[0]
    found = term.columns(signals, term.starts(signals).points[0])
    assert found.shape[0] == signals.size
    assert np.isfinite(found).all()
    assert_allclose(np.abs(found).max(axis=0), 1.0, rtol=0.05)


@pytest.mark.parametrize("term", UNMODELLED_TERMS, ids=NAMES)
def test_an_empty_record(term: UnmodelledTerm) -> None:
    nothing = made(both_ways()).part(slice(0, 0))
    assert term.columns(nothing, (0.0, 0.06) if term.name == "place" else ()).shape[0] == 0
    assert not term.testable(nothing)[0]


# Torque and speed ---


def test_even_torque_is_alike_under_either_sign() -> None:
    torque = wave()
    found = columns("even_torque", made(both_ways(), torque))
    assert_allclose(found, columns("even_torque", made(both_ways(), -torque)))
    full = np.abs(torque) / np.abs(torque).max()
    assert_allclose(found, np.stack((full, full**2), axis=1))


@pytest.mark.parametrize("torque", [np.abs(wave()), -np.abs(wave()) - 1.0, 0.0, 0.02 + np.abs(wave())])
def test_a_torque_of_one_sign_has_no_even_part(torque: np.ndarray | float) -> None:
    """The model itself takes it for its own."""
    assert has_none("even_torque", made(both_ways(), torque))


def test_sided_torque_changes_sign_with_the_direction() -> None:
    torque, speed = wave(), both_ways()
    found = columns("sided_torque", made(speed, torque))
    full = torque / np.abs(torque).max()
    expected = np.sign(speed)[:, None] * np.stack((full, np.abs(full)), axis=1)
    assert_allclose(found, expected)


@pytest.mark.parametrize(
    ("speed", "torque"), [(np.full(FEW, 30.0), wave()), (both_ways(), 20.0), (np.full(FEW, -30.0), 20.0)]
)
def test_one_direction_or_one_torque_has_no_sides(speed: np.ndarray, torque: np.ndarray | float) -> None:
    assert has_none("sided_torque", made(speed, torque))


def test_square_speed() -> None:
    speed = both_ways()
    found = columns("square_speed", made(speed))
    assert_allclose(found[speed > 0.0], 1.0)
    assert_allclose(found[speed < 0.0], [[0.75**2, -(0.75**2)]] * int(np.sum(speed < 0.0)))
    assert_array_equal(columns("square_speed", made(np.zeros(FEW))), 0.0)


# Creep ---


def test_creep_grows_with_the_way_in_either_direction() -> None:
    speed = both_ways()
    signals = made(speed, 20.0)
    found = columns("creep", signals)
    way = np.cumsum(np.abs(speed)) - abs(speed[0])
    assert found.shape == (FEW, 2)
    assert_allclose(found, np.stack((way, way), axis=1) / way[-1], atol=1e-12)
    turned = columns("creep", made(speed, np.where(np.arange(FEW) < FEW // 2, 20.0, -20.0)))
    assert_allclose(turned[:, 0], found[:, 0])
    assert abs(turned[-1, 1]) < 0.01


def test_creep_starts_anew_with_every_stretch() -> None:
    """What has crept before is not known: zero there, with a constant for every stretch but the first."""
    run = np.repeat([0, 4, 9], [200, 100, 300])
    found = columns("creep", made(both_ways(), 20.0, run))
    assert found.shape == (FEW, 4)
    begins = [0, 200, 300]
    assert_array_equal(found[begins, :2], 0.0)
    assert np.all(np.diff(found[:, 0])[np.diff(run) == 0] > 0.0)
    assert_array_equal(found[:, 2:], np.stack((run == 4, run == 9), axis=1))


def test_a_record_in_very_many_stretches_shows_no_creep() -> None:
    run = np.arange(FEW) // 40
    assert run[-1] == 14
    assert has_none("creep", made(both_ways(), 20.0, run))
    assert not has_none("creep", made(both_ways(), 20.0, run // 2))


# Drift and rests ---


def test_drift_bends_at_knots_and_begins_at_nothing() -> None:
    """Any broken line over seven knots that begins at zero is a sum of the columns."""
    signals = made(both_ways())
    found = columns("drift", signals)
    assert found.shape == (FEW, 6)
    assert_array_equal(found[0], 0.0)
    values = np.array([0.0, 2.0, -1.0, 0.5, 3.0, 1.0, 2.0])
    knots = np.linspace(signals.time[0], signals.time[-1], 7)
    assert_allclose(found @ values[1:], np.interp(signals.time, knots, values), atol=1e-12)


def test_drift_is_of_every_stretch_by_itself() -> None:
    """Of those of five seconds and more; four at most."""
    run = np.repeat([0, 1, 2], [300, 30, 270])
    found = columns("drift", made(both_ways(), 20.0, run))
    assert found.shape == (FEW, 12)
    assert not found[run == 1].any()
    assert not found[run != 0, :6].any()
    assert not found[run != 2, 6:].any()
    assert has_none("drift", made(both_ways(), 20.0, np.arange(FEW) // 200))
    assert columns("drift", made(both_ways(60.0), 20.0, np.arange(3000) // 300)).shape == (3000, 24)


def rested(*lengths: int) -> np.ndarray:
    """Speed of runs of these lengths with a rest of half a second before each but the first [rad/s]."""
    parts = [
        np.concatenate((np.zeros(25 * (index > 0)), np.full(n, 30.0))) for index, n in enumerate(lengths)
    ]
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("speed", "lengths"),
    [
        (rested(200, 150, 100, 300), (212, 175, 125, 313)),
        # A stop and start of some samples is no rest, and what comes of it no run.
        (np.concatenate((rested(200, 150), np.repeat([0.0, 30.0], [2, 3]), rested(0, 300))), (212, 180, 313)),
        (rested(3, 200, 150, 300), (28 + 212, 175, 313)),  # nor at the very beginning
    ],
)
def test_a_constant_for_every_run_between_rests_but_the_first(
    speed: np.ndarray, lengths: tuple[int, ...]
) -> None:
    number = np.repeat(np.arange(len(lengths)), lengths)
    assert_array_equal(columns("rests", made(speed)), number[:, None] == np.arange(1, len(lengths)))


def test_a_slow_run_is_no_longer_rest_than_a_fast_one() -> None:
    """Its ramp is below a share of the greatest speed for longer."""
    ramp = np.linspace(0.0, 1.0, 41)[1:]
    speed = np.concatenate(
        (np.full(200, 30.0), 30.0 * ramp[::-1], np.zeros(20), 0.6 * ramp, np.full(99, 0.6))
    )
    found = columns("rests", made(np.concatenate((speed, np.zeros(20), np.full(200, 30.0)))))
    assert int(np.flatnonzero(found[:, 0])[0]) == pytest.approx(200 + 40 + 10, abs=2)


def test_a_gap_is_a_rest_that_nobody_saw() -> None:
    signals = made(np.full(FEW, 30.0), 20.0, np.arange(FEW) // 200)
    assert_array_equal(columns("rests", signals), (signals.run[:, None] == [1, 2]).astype(float))


def test_two_runs_or_very_many_are_not_looked_at() -> None:
    assert has_none("rests", made(rested(200, 300)))
    assert has_none("rests", made(rested(*[60] * 61)))
    assert not has_none("rests", made(rested(*[60] * 60)))


# Place ---


@pytest.fixture(scope="module")
def turning() -> Signals:
    """The output through two turns and a half, forth and back."""
    return made(np.concatenate((np.full(2000, 39.3), np.full(800, -39.3))))


def test_bump_is_at_its_place_every_turn(turning: Signals) -> None:
    place = BY_NAME["place"]
    bump = place.columns(turning, (2.0, 0.15))[:, 0]
    assert bump.shape == (2800,)
    away = np.mod(turning.output_angle - 2.0 + np.pi, 2.0 * np.pi) - np.pi
    assert_allclose(bump, np.exp(-((away / 0.15) ** 2)), rtol=1e-9, atol=1e-300)
    assert_allclose(bump[np.argmin(np.abs(np.abs(away) - 0.15))], np.exp(-1.0), rtol=0.06)


@pytest.mark.parametrize("position", [0.03, 1.7, 4.4, 6.26])
@pytest.mark.parametrize("width", [0.06, 0.15])
def test_scan_finds_a_bump(turning: Signals, position: float, width: float) -> None:
    """Of a size of the noise, to a cell of the scan's, beside an offset."""
    place = BY_NAME["place"]
    noise = np.random.default_rng(1).normal(0.0, 1.0, turning.size)
    rest = 3.0 + noise + 1.0 * place.columns(turning, (position, width))[:, 0]
    found = {wide: at for at, wide in place.starts(turning, rest).points}
    assert set(found) == {0.06, 0.15}
    away = abs(np.angle(np.exp(1j * (found[width] - position))))
    assert away < 2.0 * np.pi / 240.0 * (2.0 if width == 0.06 else 3.0)


def test_scan_looks_only_where_the_output_was() -> None:
    """Over a part of the turn; a hollow is found as well as a bump."""
    signals = made(np.full(1500, 30.0))
    place = BY_NAME["place"]
    assert np.ptp(signals.output_angle) == pytest.approx(9.0, rel=0.01)
    signals = signals.part(signals.output_angle < 2.0)
    rest = -5.0 * place.columns(signals, (0.8, 0.06))[:, 0]
    for position, _ in place.starts(signals, rest).points:
        assert position == pytest.approx(0.8, abs=0.03)


def test_place_asks_for_motion_and_counts_its_trials(turning: Signals) -> None:
    place = BY_NAME["place"]
    assert place.testable(turning) == (True, "the output moves by less than half a radian")
    still = dataclasses.replace(turning, output_angle=0.01 * turning.output_angle)
    assert not place.testable(still)[0]
    found, trials = place.starts(turning, np.zeros(turning.size))
    assert (len(found), trials) == (2, 480)
