"""Remainders of any joint: their columns, also beyond their range, and models that contain them."""

import dataclasses
import json
from pathlib import Path

import drives
import numpy as np
import pytest
from models import OFFSET, RANGES, model, motion, own
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.config.configuration import ConfigError
from hd_diag.config.model_file import document, model_for, write
from hd_diag.drive import Drive
from hd_diag.effects.contact_weights import contact_weights
from hd_diag.effects.effect import Values
from hd_diag.effects.remainders import (
    EVEN,
    LINES,
    LOOP,
    ORDERS,
    PLACE,
    REMAINDERS,
    SPEED,
    TIME,
    TORQUE,
    Remainder,
)
from hd_diag.effects.signals import Signals
from hd_diag.extended_model import ExtendedModel, Term
from hd_diag.formatting import ARCSEC
from hd_diag.model.transmission_error import Kinematics

Array = np.ndarray
CHUNK_TOLERANCE = 1e-12  # [rad]
FILE_TOLERANCE = 1e-9  # [rad]
SIZE = 3.0
SATURATED = 1e-12
DRIVE = Drive(drives.mesh(), Kinematics(100.0), 56.0)
RANGE = dict.fromkeys((TORQUE, LOOP, PLACE, *ORDERS), (-40.0, 50.0))
RANGE |= {SPEED: (-60.0, 80.0), TIME: (0.0, 60.0)}
COUNT = {TORQUE: 16, LOOP: 4, SPEED: 16, PLACE: 12, TIME: 10} | dict.fromkeys(ORDERS, 14) | {EVEN: 2}
ALONG = dict.fromkeys(RANGE, "torque") | {SPEED: "speed", TIME: "time"}
CHANGING = tuple(one for one in ORDERS if one is not EVEN)
LASTING = tuple(one for one in REMAINDERS if one.lasting)


def signals(count: int = 301, **given: Array) -> Signals:
    """A minute of signals that cover all ranges up to their ends; ``given`` replaces columns."""
    share = np.linspace(0.0, 1.0, count)
    turned = 2.0 * np.pi * 7.3 * share
    columns = {
        "time": 60.0 * share,
        "wave_generator_angle": turned,
        "output_angle": turned / 20.0,
        "speed": -60.0 + 140.0 * share,
        "torque": -40.0 + 90.0 * share,
    } | given
    unknown = np.full(count, np.nan)
    return Signals(
        **columns,
        temperature=None,
        run=np.zeros(count, dtype=np.int64),
        predicted=unknown,
        predicted_torque_slope=unknown,
        predicted_rate=unknown,
        contact=contact_weights(DRIVE, columns["wave_generator_angle"], columns["torque"]),
    )


INSIDE = signals()


def columns(effect: Remainder, given: Signals = INSIDE, size: float = SIZE) -> Array:
    return effect.columns(given, (size, *RANGE[effect]))


@pytest.fixture(params=REMAINDERS, ids=lambda one: one.name)
def effect(request: pytest.FixtureRequest) -> Remainder:
    return request.param


def test_a_column_stands_for_each_coefficient(effect: Remainder) -> None:
    found = columns(effect)
    assert found.shape == (INSIDE.size, effect.size) == (INSIDE.size, COUNT[effect])
    assert np.isfinite(found).all()
    assert effect.nonlinear[0].name == "size"
    assert_array_equal(effect.usual, np.ones(effect.size))
    assert np.ptp(found, axis=0).min() > 0.0
    # Columns reach at most the size; for the torsion, the size times a torque segment.
    most, limit = np.abs(found).max(), SIZE * (50.0 / 8 if effect is TORQUE else 1.0)
    assert 0.9 * limit < most < (1.0 + 1e-12) * limit
    assert_allclose(columns(effect, size=5.0 * SIZE), 5.0 * found, rtol=1e-12)
    # Signals that are not in ``needs`` have no effect.
    names = {"time", "wave_generator_angle", "output_angle", "speed", "torque"} - set(effect.needs)
    other = dataclasses.replace(INSIDE, **{name: getattr(INSIDE, name)[::-1] for name in names})
    assert_array_equal(columns(effect, other), found)


def test_units_are_those_of_what_it_goes_by(effect: Remainder) -> None:
    """Other units of torque and speed keep the shape; columns of a compliance scale with the torque."""
    size, low, high = effect.nonlinear
    unit = {"torque": "N m", "speed": "rad/s", "time": "s"}[ALONG[effect]]
    assert (low.unit, high.unit) == (unit, unit)
    assert size.unit == ("rad/(N m)" if effect is TORQUE else "rad")
    assert {one.unit for one in effect.linear} == {"-"}
    if (
        effect is not TIME and effect not in ORDERS
    ):  # their loads, and the speed's, are relative to the rated torque
        given = {} if effect is SPEED else {"torque": 7.0 * INSIDE.torque}
        scaled = dataclasses.replace(INSIDE, speed=7.0 * INSIDE.speed, **given)
        found = effect.columns(scaled, (SIZE, *(7.0 * end for end in RANGE[effect])))
        assert_allclose(found, columns(effect) * (7.0 if effect is TORQUE else 1.0), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("factor", [1.01, 3.0])
@pytest.mark.parametrize("side", [0, 1])
def test_beyond_its_range_it_goes_on_as_it_ends(effect: Remainder, side: int, factor: float) -> None:
    """A torsion keeps the slope of its last segment; a line stays as at the greatest torque of that sign."""
    end = (-50.0, 50.0)[side] if effect in (PLACE, *ORDERS) else RANGE[effect][side]
    past = end + (factor - 1.0) * (100.0 if side else -100.0)
    ends = (dataclasses.replace(INSIDE, **{ALONG[effect]: np.full(INSIDE.size, x)}) for x in (end, past))
    at, further = (columns(effect, there) for there in ends)
    if effect is TORQUE:
        more = np.zeros(16)
        more[7 if side else 15] = SIZE * (past - end)
        assert_allclose(further - at, np.broadcast_to(more, at.shape), atol=1e-9)
    else:
        assert_allclose(further, at, rtol=0.0, atol=SIZE * SATURATED)


def test_segments_of_the_torque_sum_to_the_torque() -> None:
    torque = np.linspace(-120.0, 150.0, INSIDE.size)
    found = columns(TORQUE, dataclasses.replace(INSIDE, torque=torque))
    assert_allclose(found.sum(axis=1), SIZE * torque, rtol=1e-12, atol=1e-12)
    assert np.count_nonzero(found[torque > 0.0][:, 8:]) == np.count_nonzero(found[torque < 0.0][:, :8]) == 0
    inside = (torque > 0.0) & (torque < 50.0)
    assert found[inside].max(axis=0)[:8] == pytest.approx(SIZE * 50.0 / 8, rel=0.2)
    of_one_sign = TORQUE.columns(INSIDE, (SIZE, 0.0, 50.0))
    assert np.ptp(of_one_sign[:, :8], axis=0).min() > 0.0
    assert not of_one_sign[:, 8:].any()


def test_friction_changes_its_sign_with_the_direction() -> None:
    """Odd laws, even laws, and odd laws that grow with the load; all are zero at rest."""
    speed, torque = np.array([-60.0, -8.0, 0.0, 8.0, 60.0]), np.array([14.0, 7.0, 5.0, 7.0, 14.0])
    found = columns(SPEED, signals(5, speed=speed, torque=torque), 1.0)
    assert_allclose(found[:, :5], -found[::-1, :5], atol=1e-15)
    assert_allclose(found[:, 5:10], found[::-1, 5:10], atol=1e-15)
    assert_allclose(found[:, 5:10], np.sign(speed)[:, None] * found[:, :5], atol=1e-15)
    load = torque[:, None] / DRIVE.rated_torque
    for number, law in enumerate((load, load, np.sqrt(load))):
        places = slice(10 + 2 * number, 12 + 2 * number)
        assert_allclose(found[:, places], law * found[:, :2], atol=1e-15)
    assert not found[2].any()


def test_laws_of_friction_are_constant_in_proportion_or_their_own() -> None:
    """Covariance of two speeds: a constant, a part in proportion to both, and a part of each speed alone."""
    at = np.array([0.01, 0.03, 0.1, 0.3, 1.0])
    found = columns(SPEED, signals(5, speed=80.0 * at), 1.0)[:, :5]
    assert_allclose(found @ found.T, 0.9 + np.outer(at, at) + 0.1 * np.eye(5), atol=1e-12)


def test_a_loop_slips_where_the_torque_turns_round() -> None:
    """Each element sticks over its share of the range and starts relaxed."""
    torque = np.concatenate([np.linspace(0.0, 45.0, 451), np.linspace(45.0, -40.0, 851)])
    found = columns(LOOP, signals(torque.size, torque=torque), 1.0)
    for z, reach in zip(found.T, 90.0 * np.array([0.02, 0.06, 0.2, 0.6]), strict=True):
        assert_allclose(z[:451], np.minimum(torque[:451] / reach, 1.0), atol=1e-9)
        assert_allclose(z[451:], np.maximum(z[450] - (45.0 - torque[451:]) / reach, -1.0), atol=1e-9)


def test_a_place_has_three_waves_of_the_output_evenly_and_with_the_torque() -> None:
    found, angle = columns(PLACE, size=1.0), INSIDE.output_angle
    waves = np.stack([f(k * angle) for k in (1, 2, 3) for f in (np.cos, np.sin)], axis=1)
    assert_allclose(found[:, :6], waves, atol=1e-12)
    assert_allclose(found[:, 6:], waves * INSIDE.torque[:, None] / 50.0, atol=1e-12)


@pytest.mark.parametrize(
    ("seconds", "knots"), [(0.0, 0), (2.0, 0), (4.9, 0), (5.0, 2), (12.0, 3), (60.0, 10), (6000.0, 10)]
)
def test_a_drift_has_knots_at_least_five_seconds_apart(seconds: float, knots: int) -> None:
    """A record of a few seconds has none."""
    long = signals(time=np.linspace(3.0, 3.0 + seconds, INSIDE.size))
    found = TIME.columns(long, (1.0, 3.0, 3.0 + seconds))
    assert np.count_nonzero(found.any(axis=0)) == knots
    if not knots:
        return
    assert_allclose(found.sum(axis=1), 1.0, rtol=1e-12)
    every = found[:, :knots] @ np.linspace(3.0, 3.0 + seconds, knots)
    assert_allclose(every, long.time, rtol=1e-9)  # linear between knots


@pytest.mark.parametrize(("order", "effect"), list(zip(LINES, CHANGING, strict=True)))
def test_a_line_changes_with_the_magnitude_of_the_torque(order: int, effect: Remainder) -> None:
    """Five even columns, alike at similar torques (order 1: unrelated), and two odd ones a fifth as large."""
    at = 60.0 * np.array([0.0, 1.0, 2.0, 3.0, 4.0]) ** 2 / 16.0  # denser near zero
    apart = np.abs(np.subtract.outer(np.arange(5), np.arange(5)))
    changing = 1.0 if order == 1 else 0.25
    expected = 1.0 - changing + changing * (1.0 - changing) ** apart
    for quarter, first in ((0.0, 0), (0.5 * np.pi, 7)):
        given = signals(5, torque=at, output_angle=np.full(5, quarter / order / 100.0))
        own = effect.columns(given, (1.0, -40.0, 60.0))[:, first : first + 7]
        even, odd = np.split(own, [5], axis=1)
        assert_allclose(even @ even.T, expected, atol=1e-12)
        assert_allclose(odd, 0.2 * np.stack((at / 60.0, np.sqrt(at / 60.0)), axis=1), atol=1e-12)
    mirrored = columns(effect, dataclasses.replace(INSIDE, torque=-INSIDE.torque), 1.0)
    sign = np.where(np.arange(14) % 7 < 5, 1.0, -1.0)
    assert_allclose(mirrored, sign * columns(effect, size=1.0), atol=1e-15)


def test_a_wave_that_is_alike_is_the_same_under_any_torque() -> None:
    angle = np.linspace(0.0, 7.0, INSIDE.size)
    for torque in (0.0 * angle, INSIDE.torque):
        found = EVEN.columns(signals(torque=torque, output_angle=angle / 100.0), (SIZE, -40.0, 50.0))
        assert_allclose(found, SIZE * np.stack((np.cos(2.0 * angle), np.sin(2.0 * angle)), axis=1))


@pytest.mark.parametrize("effect", CHANGING)
def test_a_line_changes_by_the_rated_torque_however_little_a_record_has(effect: Remainder) -> None:
    """A tooth wave that is constant over small torques is not yet a wave of a coupling."""
    little = signals(torque=np.linspace(-5.0, 5.0, INSIDE.size))
    found = [effect.columns(little, (1.0, -most, most)) for most in (5.0, 50.0)]
    assert_array_equal(*found)


def nonlinear(effect: Remainder) -> Values:
    return (1e-7 if effect is TORQUE else 2.0 * ARCSEC, *RANGE[effect])


def holding(*effects: Remainder) -> ExtendedModel:
    sizes = (tuple((np.arange(one.size) % 5 - 1.5).tolist()) for one in effects)
    terms = [Term(one, size, nonlinear(one)) for one, size in zip(effects, sizes, strict=True)]
    return ExtendedModel(model().drive, tuple(terms), OFFSET, RANGES)


def run(made: ExtendedModel, at_once: bool, count: int = 200) -> Array:
    time, angle, torque, heat = motion(count)
    state, parts, step = made.start(), [], count if at_once else 1
    for low in range(0, count, step):
        rows = slice(low, low + step)
        part, state = made.step(state, time[rows], angle[rows], None, torque[rows], heat[rows])
        parts.append(part)
    return np.concatenate(parts)


@pytest.mark.parametrize("effects", [*zip(LASTING, strict=True), LASTING], ids=len)
def test_row_by_row_a_model_runs_as_at_once(effects: tuple[Remainder, ...]) -> None:
    made = holding(*effects)
    whole = run(made, True)
    assert_allclose(run(made, False), whole, rtol=0.0, atol=CHUNK_TOLERANCE)
    assert np.std(whole - run(model(), True)) > 0.1 * ARCSEC


def content(made: ExtendedModel) -> dict[str, object]:
    effects = [({}, (term.effect.name,)) for term in made.effects]
    return document("joint_1", own(), made, {}, effects, {"bags": [], "samples": 1}, "0")


def test_a_file_holds_each_of_them(tmp_path: Path) -> None:
    made, path = holding(*LASTING), tmp_path / "m.json"
    write(path, content(made))
    read = model_for(path.read_text(), own())
    assert [term.effect.name for term in read.effects] == [one.name for one in LASTING]
    assert [term.nonlinear for term in read.effects] == [nonlinear(one) for one in LASTING]
    assert_allclose(run(read, True), run(made, True), rtol=0.0, atol=FILE_TOLERANCE)


@pytest.mark.parametrize(
    ("effects", "said"),
    [((PLACE, PLACE), "a name appears twice"), ((TIME,), "a running model cannot hold it")],
)
def test_a_file_holds_none_twice_and_no_drift(effects: tuple[Remainder, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        model_for(json.dumps(content(holding(*effects))), own())
