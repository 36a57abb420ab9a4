"""Orders of the residual while a joint runs: which repeat, which do not; also on independent records."""

import dataclasses
import itertools

import numpy as np
import pytest
from challenge import motion, records
from challenge.records import Record, Recording
from challenge.truth import NOMINAL
from live import START, config, map_of_two, states
from scipy.signal import lfilter

from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.comparison import SAMPLE
from hd_diag.monitor.publications import Status
from hd_diag.monitor.residual_orders import Order, ResidualOrders

RATIO, TURN = 100.0, 2.0 * np.pi
STEP = 2e-3  # [s]
TIME = STEP * np.arange(30_000)


def fed(angle: np.ndarray, residual: np.ndarray, torque: float | np.ndarray = 1.0) -> dict[str, Order]:
    """Orders found in samples with these angles [rad], one every 2 ms."""
    stamp = START + np.round(STEP * 1e9 * np.arange(angle.size)).astype(np.int64)
    load = np.broadcast_to(torque, angle.shape).astype(np.float64)
    orders = ResidualOrders()
    orders.add(samples(stamp, angle, angle / RATIO, load, residual), 0)
    return {order.name: order for order in orders.known()}


def samples(*columns: np.ndarray) -> np.ndarray:
    """Samples of joint 0: stamps, input and output angles, torques, residuals."""
    made = np.zeros(columns[0].size, SAMPLE)
    names = "stamp", "input_angle", "output_angle", "torque", "residual"
    for name, column in zip(names, columns, strict=True):
        made[name] = column
    return made


def noise(seed: int, size: float) -> np.ndarray:
    """White noise plus slow noise, each with this rms [rad]."""
    white, steps = np.random.default_rng(seed).standard_normal((2, TIME.size))
    return size * (white + lfilter([np.sqrt(1.0 - 0.97**2)], [1.0, -0.97], steps))


def test_orders_are_told_apart_and_forgotten() -> None:
    time = STEP * np.arange(60_000)
    angle = 50.0 * time
    wave = np.where(time < 60.0, 3.0 * np.cos(2.0 * angle), 1.0 * np.sin(angle)) + 7.0
    early, late = (fed(angle[:n], wave[:n]) for n in (30_000, 60_000))
    assert early["input 2"].amplitude == pytest.approx(3.0, rel=1e-3)
    assert early["input 1"].amplitude < 0.01
    recent = (1.0 - np.exp(-2.0)) / (1.0 - np.exp(-4.0))  # weight of the second minute of two
    assert late["input 2"].amplitude == pytest.approx(3.0 * (1.0 - recent), rel=0.02)
    assert late["input 1"].amplitude == pytest.approx(recent, rel=0.005)
    assert (early["input 2"].repeats, late["input 1"].repeats, late["input 2"].repeats) == (True, True, False)


@pytest.mark.parametrize("speed", [0.8, 3.0, 20.0])
@pytest.mark.parametrize("order", [1, 2, 4])
def test_amplitude_and_phase_are_within_their_deviation(order: int, speed: float) -> None:
    """Amplitude 8 in noise of rms 7, at speeds [turns/s]; ``std`` is that of a mean over the windows."""
    angle = TURN * speed * TIME + 0.4
    wave = 8.0 * np.cos(order * angle - 1.1)
    found = [fed(angle, wave + noise(seed, 5.0))[f"input {order}"] for seed in range(4)]
    assert all(each.repeats for each in found)
    off = np.array([each.amplitude * np.exp(1j * each.phase) - 8.0 * np.exp(1.1j) for each in found])
    std = np.array([each.std for each in found])
    assert np.all(np.abs(off) < 4.0 * std)
    assert 0.3 < np.sqrt(np.mean(np.abs(off) ** 2) / 2.0) / np.mean(std) < 2.0


def test_rest_is_not_motion() -> None:
    angle = np.where(TIME < 20.0, 50.0 * TIME, 1000.0)
    moving = TIME <= 20.0
    wave = np.cos(2.0 * angle)
    assert str(fed(angle, wave)) == str(fed(angle[moving], wave[moving]))  # as text: nan differs from nan


def test_orders_that_the_motion_does_not_show_are_left_out() -> None:
    """A sender that breaks off every half turn shows no orders either."""
    time = TIME[:3000]
    found = fed(20.0 * time, np.cos(40.0 * time))
    assert "output 1" not in found
    assert found["input 2"].amplitude == pytest.approx(1.0, rel=1e-3)
    assert fed(0.1 * np.sin(time), np.ones(time.size)) == {}
    assert fed(20.0 * time[:50], np.ones(50)) == {}
    number, orders = np.arange(400), ResidualOrders()
    stamp, angle = START + number * 2_000_000 + (number // 20) * 10**9, 0.15 * number
    orders.add(samples(stamp, angle, angle, np.ones(400), np.cos(angle)), 0)
    assert orders.known() == []


def test_the_sides_that_the_torque_loads_are_followed_apart() -> None:
    """An eccentricity's order shifts by half a period with the torque's sign; a common mean would cancel."""
    angle = 40.0 * TIME
    side = np.where(np.floor(TIME / 5.0) % 2 == 0, 1.0, -1.0)
    found = fed(angle, 5.0 * side * np.cos(2.0 * angle), 20.0 * side)["input 2"]
    assert (found.amplitude, found.repeats) == (pytest.approx(5.0, rel=0.02), True)
    assert fed(angle, 5.0 * side * np.cos(2.0 * angle), 20.0)["input 2"].repeats is False


@pytest.mark.parametrize("cuts", [(1, 2, 700, 701, 15_000), tuple(range(250, 30_000, 256))])
def test_samples_in_pieces_are_samples_together(cuts: tuple[int, ...]) -> None:
    """Bit for bit, including the state."""
    angle = strokes(8.3)
    columns = START + 2_000_000 * np.arange(TIME.size), angle, angle / RATIO, np.sin(TIME), noise(3, 1.0)
    given = samples(*columns)
    whole, parts = ResidualOrders(), ResidualOrders()
    whole.add(given, 0)
    for first, last in itertools.pairwise((0, *cuts, TIME.size)):
        parts.add(given[first:last], 0)
    assert [array.tobytes() for array in parts.state] == [array.tobytes() for array in whole.state]
    assert len(whole.known()) >= 3


def strokes(turns: float, speed: float = 3.0) -> np.ndarray:
    """Angles [rad] of a robot that moves to and fro between two rests."""
    phase = TIME * speed / (2.0 * turns) % 1.0
    way = np.minimum(2.0 * phase, 2.0 - 2.0 * phase)
    return np.asarray(TURN * turns * way**3 * (10.0 - 15.0 * way + 6.0 * way**2) + 1.3)


@pytest.mark.parametrize("turns", [1.2, 2.0, 3.0, 8.3])
def test_a_torque_that_comes_back_with_the_motion_does_not_repeat(turns: float) -> None:
    """A stiffness error, 48 arcsec at both ends of a stroke, comes back at the same angles each time."""
    angle = strokes(turns)
    push = np.gradient(np.gradient(angle))
    push /= np.abs(push).max()
    found = fed(angle, 48.0 * push + noise(0, 2.0), 40.0 * push)
    assert not any(order.repeats and order.amplitude > 8.0 for order in found.values())


JOLT = np.where(np.abs(TIME - 55.0) < 0.4, 500.0 * np.cos(80.0 * TIME), 0.0)


# Orders of the flexspline, of twice its speed, and one that is not followed.
WAVES = [(20.0 * np.cos(order * 40.0 * TIME), 1.0) for order in (2.02, 4.04, 3.0)]
WAVES += [(JOLT, 0.0), *((noise(seed, 20.0), 0.0) for seed in range(3))]


@pytest.mark.parametrize(("wave", "least"), WAVES)
def test_another_wave_is_not_taken_for_an_order_of_these(wave: np.ndarray, least: float) -> None:
    found = fed(40.0 * TIME, wave + noise(2, 1.0))
    assert found
    assert not any(each.repeats and each.amplitude > least for each in found.values())


def reports(record: Record) -> list[Status]:
    """Status messages, one per second, of a monitor with the drive as configured for a record."""
    monitor = Monitor(config(array_rate=0.0))
    assert monitor.use_map("joint_1", map_of_two())  # of a drive that is the same
    stamp = START + np.rint(record.time * 1e9).astype(np.int64)
    torque = np.full(stamp.size, np.nan) if record.torque is None else record.torque
    position = np.stack((record.input_angle, record.output_angle), axis=1)
    messages = states(("joint_1_motor", "joint_1"), stamp, position, np.stack((0.0 * torque, torque), axis=1))
    said, ends = [], np.searchsorted(record.time, range(int(record.time[-1])))
    for second, (begin, end) in enumerate(itertools.pairwise(ends), 1):
        monitor.mixed_states(stamp[begin:end], (messages.between(begin, end),))
        said += monitor.tick(START + second * 10**9, START, {}).statuses
    return said


@pytest.mark.parametrize("moves", [pytest.param("standard", marks=pytest.mark.slow), "one_direction"])
def test_an_eccentric_joint_is_named_within_a_minute(moves: str) -> None:
    """18 um that are not configured, noise of 3 arcsec rms; the residual's rms stays below its own limit."""
    rng = np.random.default_rng(5)
    base = dataclasses.replace(NOMINAL, e=18e-6, psi=0.7)
    said = reports(records.simulate(base, (), getattr(motion, moves)(rng), rng))
    assert max(float(each.values["residual_rms_arcsec"]) for each in said) < 31.0
    first = next(each for each in said[:60] if each.level)
    assert (first.level, first.values["fault_codes"]) == (1, "RESIDUAL")
    assert first.values["residual_order"] == "input 2"
    assert "twice per input turn" in first.message
    names = ("amplitude", "limit", "std")
    amplitude, limit, std = (float(first.values[f"residual_order_{name}_arcsec"]) for name in names)
    assert amplitude > limit
    assert std < 2.0


ROUGH = Recording(noise="heavy", dropouts=0.05, jitter=3e-4)


@pytest.mark.parametrize(
    ("moves", "recording"),
    [
        ("standard", Recording(noise="pink", noise_scale=4.0)),
        pytest.param("one_speed", ROUGH, marks=pytest.mark.slow),
        ("short", Recording()),
        ("one_direction", Recording(torque=False, noise_scale=2.0, output_bits=18)),
    ],
    ids=["pink 13 arcsec", "heavy, gaps", "short", "no torque, 18 bits"],
)
def test_no_order_of_a_faultless_joint_is_named(moves: str, recording: Recording) -> None:
    rng = np.random.default_rng(11)
    said = reports(records.simulate(NOMINAL, (), getattr(motion, moves)(rng), rng, recording))
    assert said
    assert not any("repeats" in each.message for each in said)
    if recording.torque:
        assert {each.values["fault_codes"] for each in said} == {"OK"}


def test_the_limit_goes_with_the_accuracy_and_a_large_eccentricity() -> None:
    """The prediction itself is inaccurate by a share of a configured eccentricity's effect."""

    def limit(**given: float) -> float:
        (joint,) = config(**{f"joint_1__{name}": value for name, value in given.items()}).joints
        return joint.limits["residual_order"].warn

    assert limit() == 5e-5
    assert limit(accuracy=2.181660e-4) == pytest.approx(2.5e-5, rel=1e-3)
    assert limit(eccentricity__magnitude=18e-6) == 5e-5
    assert limit(eccentricity__magnitude=60e-6) == pytest.approx(9.5e-5, rel=0.02)
    assert limit(eccentricity__magnitude=60e-6, limits__residual_order__warn=1e-5) == 1e-5
    predicted = 70.0 * ARCSEC  # largest amplitude of order 2 for 60 um, at the rated torque (brute force)
    assert limit(eccentricity__magnitude=60e-6) == pytest.approx(0.25 * predicted, rel=0.2)
