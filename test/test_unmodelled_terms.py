"""Shapes without a cause: their columns on small records, and their requirements on a record."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from benches import CONFIGURED
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.diagnosis.evidence.unmodelled_terms import OUTPUT_LINES, UNMODELLED_TERMS, UnmodelledTerm
from hd_diag.effects.contact_table import contact_table
from hd_diag.effects.contact_weights import ContactWeights
from hd_diag.effects.remainders import LINES
from hd_diag.effects.signals import Signals

NAMES = ("creep", "rests", "place", *(line.name for line in OUTPUT_LINES), "input_line")
BY_NAME = {term.name: term for term in UNMODELLED_TERMS}
PLACE, INPUT_LINE = BY_NAME["place"], BY_NAME["input_line"]
Array = np.ndarray
RATE = 50.0  # [Hz]
FEW = 600


def made(speed: Array, torque: Array | float = 20.0, run: Array | None = None) -> Signals:
    """Signals for an input speed [rad/s] and a torque [N m], starting at angle zero."""
    time, none = np.arange(speed.size) / RATE, np.zeros(speed.size)
    angle = np.cumsum(speed) / RATE
    load = np.broadcast_to(torque, speed.shape).astype(np.float64)
    runs = np.zeros(speed.size, dtype=np.int64) if run is None else run
    contact = ContactWeights(contact_table(CONFIGURED, 60.0), -angle, load)
    return Signals(time, -angle, angle / 100.0, speed, load, None, runs, none, none, none, contact)


def both_ways(seconds: float = 12.0) -> Array:
    time = np.arange(round(seconds * RATE)) / RATE
    return np.where(time // 3.0 % 2 == 0, 40.0, -30.0)


def wave(seconds: float = 12.0) -> Array:
    return 25.0 * np.sin(2.0 * np.pi * np.arange(round(seconds * RATE)) / RATE / 5.0)


def columns(name: str, signals: Signals) -> Array:
    return BY_NAME[name].columns(signals, ())


@pytest.mark.parametrize("term", UNMODELLED_TERMS, ids=NAMES)
def test_columns_are_finite_and_of_order_one(term: UnmodelledTerm) -> None:
    speed = both_ways(24.0) * (np.arange(24 * 50) % 300 > 40)
    speeds = {"rests": speed}
    speeds |= dict.fromkeys(("place", *(line.name for line in OUTPUT_LINES)), np.full(1200, 400.0))
    signals = made(speeds.get(term.name, np.abs(speed) * 3.0), CONFIGURED.rated_torque / 25.0 * wave(24.0))
    assert term.testable(signals)[0]
    start = term.starts(signals).points[0]
    found = term.columns(signals, start)
    assert found.shape[0] == signals.size
    assert np.isfinite(found).all()
    assert_allclose(np.abs(found).max(axis=0), 1.0, rtol=0.05)
    nothing = signals.part(slice(0, 0))
    assert term.columns(nothing, start).shape[0] == 0
    assert not term.testable(nothing)[0]


def test_creep_grows_with_the_way_in_either_direction() -> None:
    speed = both_ways()
    found = columns("creep", made(speed, 20.0))
    way = np.cumsum(np.abs(speed)) - abs(speed[0])
    assert_allclose(found, np.stack((way, way), axis=1) / way[-1], atol=1e-12)
    turned = columns("creep", made(speed, np.where(np.arange(FEW) < FEW // 2, 20.0, -20.0)))
    assert_allclose(turned[:, 0], found[:, 0])
    assert abs(turned[-1, 1]) < 0.01


def test_creep_starts_anew_with_every_stretch() -> None:
    run = np.repeat([0, 4, 9], [200, 100, 300])
    found = columns("creep", made(both_ways(), 20.0, run))
    assert found.shape == (FEW, 4)
    assert_array_equal(found[[0, 200, 300], :2], 0.0)
    assert np.all(np.diff(found[:, 0])[np.diff(run) == 0] > 0.0)
    assert_array_equal(found[:, 2:], np.stack((run == 4, run == 9), axis=1))


def rested(*lengths: int) -> Array:
    """Speed [rad/s] of runs with these lengths and rests of half a second between them."""
    parts = [np.repeat([0.0, 30.0], [25 * (index > 0), n]) for index, n in enumerate(lengths)]
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("speed", "lengths"),
    [
        (rested(200, 150, 100, 300), (212, 175, 125, 313)),
        # A stop of a few samples is no rest, and the few samples after it are no run.
        (np.concatenate((rested(200, 150), np.repeat([0.0, 30.0], [2, 3]), rested(0, 300))), (212, 180, 313)),
        (rested(3, 200, 150, 300), (28 + 212, 175, 313)),  # the same at the beginning
    ],
)
def test_a_constant_for_every_run_between_rests_but_the_first(speed: Array, lengths: tuple) -> None:
    number = np.repeat(np.arange(len(lengths)), lengths)
    assert_array_equal(columns("rests", made(speed)), number[:, None] == np.arange(1, len(lengths)))


def test_a_slow_run_is_no_longer_rest_than_a_fast_one() -> None:
    ramp, fast, rest = np.linspace(0.0, 1.0, 41)[1:], np.full(200, 30.0), np.zeros(20)
    speed = (fast, 30.0 * ramp[::-1], rest, 0.6 * ramp, np.full(99, 0.6), rest, fast)
    found = columns("rests", made(np.concatenate(speed)))
    assert int(np.flatnonzero(found[:, 0])[0]) == pytest.approx(200 + 40 + 10, abs=2)
    gaps = made(np.full(FEW, 30.0), 20.0, np.arange(FEW) // 200)  # rests without samples
    assert_array_equal(columns("rests", gaps), gaps.run[:, None] == [1, 2])


def test_what_begins_a_recording_has_no_constant_beside_its_encoder_s_zero() -> None:
    recording = np.repeat([0, 1], 300)
    stretches = made(both_ways(), 20.0, np.repeat([0, 4, 9], [200, 100, 300]))
    found = columns("creep", dataclasses.replace(stretches, recording=recording))
    assert_array_equal(found[:, 2:], (stretches.run == 4)[:, None])
    rests = made(rested(200, 50, 150, 150), 20.0, np.repeat([0, 1], [287, 338]))  # begins in a rest
    found = columns("rests", dataclasses.replace(rests, recording=rests.run))
    assert_array_equal(found.sum(axis=0), [75, 163])


STRETCHES = np.arange(FEW) // 40


@pytest.mark.parametrize(
    ("name", "speed", "torque", "run", "expected"),
    [
        # Too many stretches give no creep; two runs or too many give no rests.
        ("creep", both_ways(), 20.0, STRETCHES, True),
        ("creep", both_ways(), 20.0, STRETCHES // 2, False),
        ("rests", rested(200, 300), 20.0, None, True),
        ("rests", rested(*[60] * 61), 20.0, None, True),
        ("rests", rested(*[60] * 60), 20.0, None, False),
    ],
)
def test_records_that_have_none(name: str, speed: Array, torque: float, run: Any, expected: bool) -> None:
    signals = made(speed, torque, run)
    found, (possible, reason) = columns(name, signals), BY_NAME[name].testable(signals)
    assert found.shape[0] == signals.size
    assert (found.shape[1] == 0) is (not possible) is expected
    assert possible or "nothing of the kind" in reason


@pytest.fixture(scope="module")
def turning() -> Signals:
    return made(np.concatenate((np.full(2000, 39.3), np.full(800, -39.3))))


def test_bump_is_at_its_place_every_turn(turning: Signals) -> None:
    bump = PLACE.columns(turning, (2.0, 0.15))
    away = np.mod(turning.output_angle - 2.0 + np.pi, 2.0 * np.pi) - np.pi
    assert_allclose(bump, np.exp(-((away[:, None] / 0.15) ** 2)), rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("position", [0.03, 1.7, 4.4, 6.26])
@pytest.mark.parametrize("width", [0.06, 0.15])
def test_scan_finds_a_bump(turning: Signals, position: float, width: float) -> None:
    """A bump as large as the noise, with an offset, is found within a few cells of the scan."""
    noise = np.random.default_rng(1).normal(0.0, 1.0, turning.size)
    rest = 3.0 + noise + 1.0 * PLACE.columns(turning, (position, width))[:, 0]
    found = {wide: at for at, wide in PLACE.starts(turning, rest).points}
    assert set(found) == {0.06, 0.15}
    away = abs(np.angle(np.exp(1j * (found[width] - position))))
    assert away < 2.0 * np.pi / 240.0 * (2.0 if width == 0.06 else 3.0)


def test_scan_looks_only_where_the_output_was() -> None:
    signals = made(np.full(333, 30.0))
    assert np.ptp(signals.output_angle) == pytest.approx(2.0, rel=0.01)
    rest = -5.0 * PLACE.columns(signals, (0.8, 0.06))[:, 0]
    for position, _ in PLACE.starts(signals, rest).points:
        assert position == pytest.approx(0.8, abs=0.03)


def test_place_asks_for_motion_and_counts_its_trials(turning: Signals) -> None:
    assert PLACE.testable(turning) == (True, "the output moves by less than half a radian")
    still = dataclasses.replace(turning, output_angle=0.01 * turning.output_angle)
    assert not PLACE.testable(still)[0]
    for line in (LINE, INPUT_LINE):
        assert not line.testable(made(np.full(600, 0.1)))[0]
    found, trials = PLACE.starts(turning, np.zeros(turning.size))
    assert (len(found), trials) == (2, 480)


LINE = OUTPUT_LINES[0]


def test_a_line_of_the_output_is_found_over_part_of_its_turn() -> None:
    """Over 0.6 of a turn a spectrum blurs two orders, but a fit's residual does not."""
    signals = made(np.repeat([63.0, -63.0], 300))
    assert np.ptp(signals.output_angle) == pytest.approx(0.6 * 2.0 * np.pi, rel=0.01)
    line = np.cos(45.0 * signals.output_angle - 1.0)

    def left(start: tuple[float]) -> float:
        return float(np.linalg.lstsq(LINE.columns(signals, start), line, rcond=None)[1][0])

    assert min(LINE.starts(signals, line).points, key=left) == (45.0,)


@pytest.mark.parametrize("number", [3, 64, 72, 98, 100, 128, 180, 195])
def test_a_line_is_not_the_gear_s_nor_an_encoder_s(number: int) -> None:
    """Orders next to the gear's own remain, because torque widens a ripple of the gear."""
    signals = made(np.repeat([63.0, -63.0], 300))
    starts = LINE.starts(signals, np.cos(number * signals.output_angle - 1.0)).points
    assert ((float(number),) in starts) is (number == 98)
    assert number != 98 or {(97.0,), (99.0,)} <= {*starts}


@pytest.mark.parametrize("number", [3.0, 7.0, 17.0])
def test_a_line_of_the_input_is_the_strongest_that_no_gear_must_have(number: float) -> None:
    signals = made(np.full(FEW, 1.3))
    waves = [np.cos(order * signals.wave_generator_angle) for order in (number, *LINES)]
    starts = INPUT_LINE.starts(signals, waves[0] + 5.0 * np.sum(waves[1:], axis=0)).points
    assert starts[0] == (number, 0.0)
    assert not {(float(order), 0.0) for order in LINES} & {*starts}
    wave = INPUT_LINE.columns(signals, (number, 0.0))[:, 0]
    assert_allclose(wave, np.cos(number * signals.wave_generator_angle))


@pytest.mark.parametrize("member", [0.0, 1.0])
def test_a_line_of_the_teeth_falls_with_the_load_and_has_a_further_part(member: float) -> None:
    """A flexspline's wave has 2.02 periods per input turn at a ratio of 100."""
    signals = made(np.concatenate((np.full(2000, 39.3), np.full(800, -39.3))), wave(56.0))
    angle = (signals.wave_generator_angle, signals.flexspline_angle)[int(member)]
    number = 2.0 if member else 6.0
    load = np.sqrt(np.abs(signals.torque) / signals.rated_torque)
    rest = (1.0 - 0.5 * load) * np.cos(number * angle - 0.7) + 0.3 * np.cos((number + 2.0) * angle)
    columns = INPUT_LINE.columns(signals, (number, member))
    assert_allclose(columns @ np.linalg.lstsq(columns, rest, rcond=None)[0], rest, atol=1e-9)
    assert (number, member) in INPUT_LINE.starts(signals, rest).points
    periods = np.polyfit(signals.input_angle, number * angle, 1)[0]
    assert INPUT_LINE.order(signals, (number, member)) == pytest.approx(abs(periods))
