"""Cleaning of a record: samples removed, angles unwrapped, beginnings of runs."""

from collections.abc import Callable

import numpy as np
import pytest
from joint_records import ARCSEC, RATIO, columns, joint, prepared
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.diagnosis.noise import ORDER
from hd_diag.diagnosis.record import MINIMUM_SAMPLES, RecordError
from hd_diag.diagnosis.screening import screened

TURN = 2.0 * np.pi
ROWS = np.arange(4000)
Columns = dict[str, np.ndarray]
Of = Callable[..., np.ndarray]


@pytest.fixture
def given() -> Columns:
    return columns()


def without(given: Columns, rows: np.ndarray) -> Columns:
    return {name: np.delete(column, rows) for name, column in given.items()}


def test_clean_columns_stay_and_speed_is_the_derivative(given: Columns) -> None:
    record = prepared(given)
    assert (record.dropped, record.extent.runs, record.has_torque) == (0, 1, True)
    # Noise of 2 arcsec has no sample at 8 deviations from its neighbours.
    assert (record.outliers, record.size) == (0, given["time"].size)
    kept = {"input": record.input_angle, "output": record.output_angle, "torque": record.reported_torque}
    for name, found in kept.items():
        assert_array_equal(found, given[name])
    assert record.extent.duration == pytest.approx(given["time"][-1])
    assert record.extent.input_turns == pytest.approx(8 * 60.0 / TURN, rel=1e-3)
    assert_allclose(record.speed, 60.0 * TURN / 10.0 * np.cos(TURN * record.time / 10.0), atol=0.01)


def test_noise_of_the_torque_is_smoothed_without_phase(given: Columns) -> None:
    true = given["torque"].copy()
    given["torque"] = true + np.random.default_rng(1).normal(0.0, 0.5, true.size)
    record = prepared(given)
    assert np.std(record.torque - true) < 0.5 * 0.5
    late = [np.interp(record.time - lag, record.time, true) for lag in (-0.02, 0, 0.02)]
    assert np.argmin(np.std(record.torque - late, axis=1)) == 1
    assert_array_equal(record.reported_torque, given["torque"])


@pytest.mark.parametrize("name", ["time", "input", "output", "torque"])
def test_nan_stretches_are_taken_out(given: Columns, name: str) -> None:
    given[name][500:520] = np.nan
    record = prepared(given)
    assert record.dropped == (20 if name != "time" else 21)  # the stamp after the gap has no predecessor
    assert record.extent.runs == 2
    for column in (record.time, record.input_angle, record.output_angle, record.torque, record.speed):
        assert np.isfinite(column).all()


def test_dropouts_of_more_than_five_samples_make_runs(given: Columns) -> None:
    kept = without(given, np.r_[1000:1003, 2000:2033, 3000:3005])  # one turn at full speed, no wrap
    record = prepared(kept)
    assert record.extent.runs == 3
    assert_array_equal(record.input_angle, kept["input"])
    edges = record.time[np.flatnonzero(np.diff(record.run))]
    assert_allclose(edges, given["time"][[1999, 2999]])


@pytest.mark.parametrize(
    ("lost", "outliers"),
    [
        ((), {row: 300.0 * (-1.0) ** row for row in range(100, 4000, 99)}),
        ((), {700: 900.0, 701: 300.0, 1500: -60.0}),  # next to each other
        ((), {700: 900.0, 701: 880.0, 1500: -60.0, 1501: -75.0, 2500: 1900.0, 2501: 1640.0}),  # similar
        ((*range(1956, 1996), *range(2002, 2042)), {2000: 2000.0}),  # few samples between gaps
    ],
)
def test_outliers_are_taken_out_and_nothing_else(
    given: Columns, lost: tuple[int, ...], outliers: dict[int, float]
) -> None:
    for row, size in outliers.items():
        given["output"][row] += size * ARCSEC
    record = prepared({name: np.delete(values, lost) for name, values in given.items()})
    assert record.outliers == len(outliers)
    assert not set(given["time"][list(outliers)]) & set(record.time)
    assert record.extent.runs == (3 if lost else 1)


@pytest.mark.parametrize("size", [1e3, -1e5, 1e160])
@pytest.mark.parametrize("every", [1, 10, 4000])  # rows per reported torque: all, some, constant
def test_a_torque_far_off_is_taken_out(given: Columns, size: float, every: int) -> None:
    given["torque"] = np.repeat(given["torque"][::every], every)
    assert prepared(given).outliers == 0
    count = {1: 1, 10: 10, 4000: 1}[every]
    given["torque"][1230 : 1230 + count] = size
    record = prepared(given)
    assert record.outliers == count
    assert np.abs(record.torque).max() < 60.0


@pytest.mark.parametrize(
    "torque",
    [
        lambda t: 40.0 * np.sign(np.sin(t)),
        lambda t: np.where(np.sin(t) > 0.99, 30.0, 0.0) * np.sin(60.0 * t),
        lambda t: 5.0 * np.random.default_rng(1).standard_t(4, t.size),
        lambda t: np.interp(t, t[::20], np.random.default_rng(2).normal(size=t[::20].size)),
    ],
)
def test_torques_that_a_joint_has_are_no_outliers(given: Columns, torque: Of) -> None:
    """Two-sided, a burst, long-tailed noise, linear between reported values: hardly a sample is removed."""
    given["torque"] = torque(given["time"])
    assert prepared(given).outliers <= 4


def ripple(given: Columns) -> np.ndarray:
    """Output with a 60 arcsec wave of 13 samples in one stretch only, and a step within two samples."""
    wave = np.where(given["time"] > 14.0, np.cos(0.48 * ROWS), 0.0)
    step = np.interp(given["time"], [5.0, 5.005], [0.0, 80.0])
    return given["output"] + (60.0 * wave + step) * ARCSEC


def counted(counts: int) -> Of:
    step = TURN / counts
    return lambda given: step * np.rint(given["output"] / step)


@pytest.mark.parametrize(
    "output",
    [
        ripple,
        *map(counted, (2**12, 2**16, 2**20)),
        lambda given: given["output"][np.where((ROWS > 1000) & (ROWS < 1750), 1000, ROWS)],  # stuck
    ],
)
def test_outputs_that_a_joint_has_are_neither_outliers_nor_held(given: Columns, output: Of) -> None:
    record = prepared(given | {"output": output(given)})
    assert (record.outliers, record.dropped) == (0, 0)


def test_jitter_is_no_gap(given: Columns) -> None:
    step = np.median(np.diff(given["time"]))
    given["time"] = given["time"] + np.random.default_rng(2).uniform(-0.4, 0.4, given["time"].size) * step
    record = prepared(given)
    assert (record.extent.runs, record.dropped) == (1, 0)


@pytest.mark.parametrize(
    ("names", "low", "lost", "bags"),
    [
        (("input", "output"), 0.0, slice(0, 0), 1),
        (("input", "output"), -np.pi, slice(980, 1060), 3),
        (("input",), -np.pi, slice(980, 1060), 1),
        (("input",), 0.0, slice(0, 0), 3),
    ],
)
def test_wrapped_angles_are_unwrapped_over_gaps_and_bags(
    given: Columns, names: tuple[str, ...], low: float, lost: slice, bags: int
) -> None:
    """At 37 rad/s a gap of 0.4 s hides more than two input turns; the output reveals them."""
    kept = {name: np.delete(column, lost) for name, column in given.items()}
    bag = np.arange(kept["time"].size) * bags // kept["time"].size
    expected = prepared(kept, bag)
    for name in names:
        kept[name] = np.mod(kept[name] - low, TURN) + low
    found = prepared(kept, bag)
    shift = (found.output_angle - expected.output_angle) - (found.input_angle - expected.input_angle) / RATIO
    assert_allclose(shift - shift[0], 0.0, atol=1e-12)


HALF = (
    "2010 of 4000 samples are not finite or their stamps contradict each other: "
    "output angle has 2010 without a value"
)
SHORT, SWAPPED = "^too short: 199 usable samples, ", "no motion: .*: are input and output swapped"
TOO_FAST = "rad/s in the mean, and no drive's faster than 10000 rad/s"
TORN = "torn: 4000 usable samples .* 0 of them are in pieces of more"
STILL = "no motion: the output angle is {:.6g} rad throughout"


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda g: {"input": np.where(ROWS < MINIMUM_SAMPLES - 1, g["input"], np.nan)}, SHORT),
        (lambda g: {"input": 0.02 * g["input"]}, r"^no motion: the input turns by 2\.4 rad, at "),
        (lambda g: {"output": np.where(ROWS < 2010, np.nan, g["output"])}, HALF),
        (lambda g: {"input": g["output"], "output": g["input"]}, SWAPPED),
        (lambda g: {"input": g["input"] * 2.0**30 / TURN}, TOO_FAST),  # counts of no real encoder
        (lambda g: {name: 2000.0 * g[name] for name in ("input", "output")}, TOO_FAST),
        (lambda g: {name: 1e9 * g[name] for name in ("input", "output")}, TOO_FAST),
        *((lambda g, at=at: {"output": 0.0 * ROWS + at}, STILL.format(at)) for at in (0.3, -1e5, 0.0)),
        *((lambda g, piece=piece: {"time": g["time"] + ROWS // piece}, TORN) for piece in (ORDER, 2)),
    ],
)
def test_records_that_cannot_be_judged(given: Columns, changed: Callable[..., Columns], said: str) -> None:
    with pytest.raises(RecordError, match=said):
        prepared(given | changed(given))


def test_what_is_near_to_such_records_can_be(given: Columns) -> None:
    """Pieces just long enough to measure noise, or an input 200 times as fast (24 rad/s), can be judged."""
    torn = prepared(given | {"time": given["time"] + ROWS // (ORDER + 1)})
    assert torn.extent.runs > 100
    for turns in (1.0, 200.0):
        fast = prepared(given | {name: turns * given[name] for name in ("input", "output")})
        assert fast.extent.input_turns == pytest.approx(76.4 * turns, rel=1e-3)


def test_pauses_make_runs() -> None:
    given = columns(seconds=20.0)
    rest = np.clip(given["time"] - 10.0, 0.0, 1.0)  # one second at rest after ten
    moving = given["time"] - rest
    given["input"] = np.interp(moving, given["time"], given["input"])
    given["output"] = np.interp(moving, given["time"], given["output"])
    record = prepared(given)
    assert record.extent.runs == 2
    assert 10.0 < record.time[np.flatnonzero(np.diff(record.run))[0]] < 11.0


def test_bags_are_runs_and_rows_keep_theirs(given: Columns) -> None:
    bag = np.arange(given["time"].size) // 1500
    record = prepared(given, bag)
    assert_array_equal(record.run, bag)
    assert_array_equal(record.bag, bag)
    part = record.select(record.run == 1)
    assert (part.size, set(part.run), part.temperature) == (1500, {1}, None)


def test_what_remembers_goes_on_to_a_recording_that_follows_at_once(given: Columns) -> None:
    """A warming gear continues in the next recording; an integrated velocity restarts."""
    bag = np.arange(given["time"].size) // 1500
    assert not prepared(given, bag).stretch.any()
    assert_array_equal(prepared(given, bag, by_velocity=True).stretch, bag)
    later = given | {"time": given["time"] + 60.0 * bag}
    assert_array_equal(prepared(later, bag).stretch, bag)


@pytest.mark.parametrize(
    ("torque", "told"),
    [
        (0.0, "is zero throughout"),
        (-5e-324, "is never beyond 4.94e-324 N m"),
        (1e-9, "is never beyond 1e-09 N m"),
        (np.nan, "is not a number throughout"),
        (-1.0, "is -1 N m throughout"),
        (999.0, "is 999 N m throughout"),
        (12.0, ""),  # may be a weight
    ],
)
def test_a_torque_that_is_none_is_told(given: Columns, torque: float, told: str) -> None:
    given["torque"][:] = torque
    record = prepared(given, assumed_torque=7.0)
    assert (record.no_torque, record.has_torque) == (told, not told)
    assert_allclose(record.torque, np.full(record.size, 7.0 if told else 12.0), rtol=1e-12)
    assert record.dropped == 0
    (finding,) = screened(record, joint().drive).findings[:1] or (None,)
    assert (finding is not None) is bool(told)
    if finding is not None:
        said = f"the torque {told}: it counts as not measured, and 7 N m as configured is assumed"
        assert (finding.name, finding.text, finding.fatal) == ("no_torque", said, False)
    given["torque"][::2] = 3.0
    assert prepared(given).no_torque == ""


@pytest.mark.parametrize("bits", [10, 16, 24])
def test_counts_of_an_encoder_are_left_to_a_finding(given: Columns, bits: int) -> None:
    """Encoder counts pass at any speed; impossible counts are refused before spectra become large."""
    counted = prepared(given | {"input": np.round(given["input"] * 2.0**bits / TURN)})
    found = screened(counted, joint().drive).findings[0]
    assert found.fatal
    assert f"the input angle is in counts of {bits} bits a turn" in found.text


def test_an_output_that_is_held_between_its_own_samples_counts_once() -> None:
    """The output comes at a quarter of the input's rate, and its last value repeats in every row."""
    given = columns(seconds=40.0)
    rows = np.arange(given["time"].size)
    whole = prepared(given)
    slow = given | {"output": given["output"][4 * (rows // 4)]}
    found = prepared(slow)
    assert found.size == pytest.approx(0.25 * whole.size, abs=10)
    assert found.dropped == pytest.approx(0.75 * whole.size, abs=10)
    assert_allclose(found.output_angle, given["output"][::4][: found.size], atol=1e-4)
