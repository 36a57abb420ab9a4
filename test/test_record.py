"""A record's cleaning: what is taken out, what is put back, where runs begin."""

from collections.abc import Callable

import numpy as np
import pytest
from joint_records import ARCSEC, RATIO, columns, joint, prepared
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.diagnosis.noise import ORDER
from hd_diag.diagnosis.record import MINIMUM_SAMPLES, RecordError
from hd_diag.diagnosis.screening import screened

TURN = 2.0 * np.pi


@pytest.fixture
def given() -> dict[str, np.ndarray]:
    return columns()


def without(given: dict[str, np.ndarray], rows: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.delete(column, rows) for name, column in given.items()}


def test_clean_columns_stay_and_speed_is_the_derivative(given: dict[str, np.ndarray]) -> None:
    record = prepared(given)
    assert (record.dropped, record.extent.runs, record.has_torque) == (0, 1, True)
    # 2 arcsec of noise has no sample at 8 deviations of its own neighbourhood.
    assert (record.outliers, record.size) == (0, given["time"].size)
    for found, name in ((record.input_angle, "input"), (record.output_angle, "output")):
        assert_array_equal(found, given[name])
    assert_array_equal(record.reported_torque, given["torque"])
    assert record.extent.duration == pytest.approx(given["time"][-1])
    assert record.extent.input_turns == pytest.approx(8 * 60.0 / TURN, rel=1e-3)
    assert_allclose(record.speed, 60.0 * TURN / 10.0 * np.cos(TURN * record.time / 10.0), atol=0.01)


def test_noise_of_the_torque_is_smoothed_without_phase(given: dict[str, np.ndarray]) -> None:
    true = given["torque"].copy()
    given["torque"] = true + np.random.default_rng(1).normal(0.0, 0.5, true.size)
    record = prepared(given)
    assert np.std(record.torque - true) < 0.5 * 0.5
    lagged = [
        np.std(record.torque - np.interp(record.time - lag, record.time, true)) for lag in (-0.02, 0, 0.02)
    ]
    assert lagged[1] == min(lagged)
    assert_array_equal(record.reported_torque, given["torque"])


@pytest.mark.parametrize("name", ["time", "input", "output", "torque"])
def test_nan_stretches_are_taken_out(given: dict[str, np.ndarray], name: str) -> None:
    given[name][500:520] = np.nan
    record = prepared(given)
    assert record.dropped == (20 if name != "time" else 21)  # the next stamp has nothing to follow
    assert record.extent.runs == 2
    for column in (record.time, record.input_angle, record.output_angle, record.torque, record.speed):
        assert np.isfinite(column).all()


@pytest.mark.parametrize(("torque", "expected"), [(np.nan, 7.0), (12.0, 12.0)])
def test_a_torque_that_is_nan_throughout_is_none(
    given: dict[str, np.ndarray], torque: float, expected: float
) -> None:
    given["torque"][:] = torque
    record = prepared(given, assumed_torque=7.0)
    assert record.has_torque == np.isfinite(torque)
    assert_allclose(record.torque, np.full(record.size, expected), rtol=1e-12)
    assert record.dropped == 0


def test_dropouts_of_more_than_five_samples_make_runs(given: dict[str, np.ndarray]) -> None:
    record = prepared(without(given, np.r_[1000:1003, 2000:2020, 3000:3005]))
    assert record.extent.runs == 3
    edges = record.time[np.flatnonzero(np.diff(record.run))]
    assert_allclose(edges, given["time"][[1999, 2999]])


@pytest.mark.parametrize(
    ("lost", "outliers"),
    [
        ((), {row: 300.0 * (-1.0) ** row for row in range(100, 4000, 99)}),
        ((), {700: 900.0, 701: 300.0, 1500: -60.0}),  # beside each other
        ((), {700: 900.0, 701: 880.0, 1500: -60.0, 1501: -75.0, 2500: 1900.0, 2501: 1640.0}),  # alike
        ((*range(1956, 1996), *range(2002, 2042)), {2000: 2000.0}),  # few between gaps
    ],
)
def test_outliers_are_taken_out_and_nothing_else(
    given: dict[str, np.ndarray], lost: tuple[int, ...], outliers: dict[int, float]
) -> None:
    for row, size in outliers.items():
        given["output"][row] += size * ARCSEC
    record = prepared({name: np.delete(values, lost) for name, values in given.items()})
    assert record.outliers == len(outliers)
    assert not set(given["time"][list(outliers)]) & set(record.time)
    assert record.extent.runs == (3 if lost else 1)


@pytest.mark.parametrize("size", [1e3, -1e5, 1e160])
@pytest.mark.parametrize("every", [1, 10, 4000])  # rows for which a reported torque stands: all, constant
def test_a_torque_far_off_is_taken_out(given: dict[str, np.ndarray], size: float, every: int) -> None:
    given["torque"] = np.repeat(given["torque"][::every], every)
    clean = prepared(given)
    assert clean.outliers == 0
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
def test_torques_that_a_joint_has_are_no_outliers(
    given: dict[str, np.ndarray], torque: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Two-sided, a burst, noise with long tails, the last between reported ones: hardly a sample goes."""
    given["torque"] = torque(given["time"])
    assert prepared(given).outliers <= 4


def test_ripple_and_changes_of_flank_are_no_outliers(given: dict[str, np.ndarray]) -> None:
    """60 arcsec with 13 samples a wave in one stretch and nothing in the rest; a step within two samples."""
    wave = np.where(given["time"] > 14.0, np.cos(0.48 * np.arange(given["time"].size)), 0.0)
    step = np.interp(given["time"], [5.0, 5.005], [0.0, 80.0])
    given["output"] += (60.0 * wave + step) * ARCSEC
    assert prepared(given).outliers == 0


def test_jitter_is_no_gap(given: dict[str, np.ndarray]) -> None:
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
    given: dict[str, np.ndarray], names: tuple[str, ...], low: float, lost: slice, bags: int
) -> None:
    """At 37 rad/s a gap of 0.4 s hides more than two turns of the input: the output tells them."""
    kept = {name: np.delete(column, lost) for name, column in given.items()}
    bag = np.arange(kept["time"].size) * bags // kept["time"].size
    expected = prepared(kept, bag)
    for name in names:
        kept[name] = np.mod(kept[name] - low, TURN) + low
    found = prepared(kept, bag)
    shift = (found.output_angle - expected.output_angle) - (found.input_angle - expected.input_angle) / RATIO
    assert_allclose(shift - shift[0], 0.0, atol=1e-12)


def test_a_gap_in_a_continuous_angle_is_no_wrap(given: dict[str, np.ndarray]) -> None:
    kept = without(given, np.r_[2000:2033])  # one turn at full speed
    assert_array_equal(prepared(kept).input_angle, kept["input"])


def test_pauses_make_runs() -> None:
    given = columns(seconds=20.0)
    rest = np.clip(given["time"] - 10.0, 0.0, 1.0)  # one second at rest after ten
    moving = given["time"] - rest
    given["input"] = np.interp(moving, given["time"], given["input"])
    given["output"] = np.interp(moving, given["time"], given["output"])
    record = prepared(given)
    assert record.extent.runs == 2
    assert 10.0 < record.time[np.flatnonzero(np.diff(record.run))[0]] < 11.0


def test_bags_are_runs_and_rows_keep_theirs(given: dict[str, np.ndarray]) -> None:
    bag = np.arange(given["time"].size) // 1500
    record = prepared(given, bag)
    assert_array_equal(record.run, bag)
    assert_array_equal(record.bag, bag)
    part = record.select(record.run == 1)
    assert (part.size, set(part.run), part.temperature) == (1500, {1}, None)


def test_what_remembers_goes_on_from_a_recording_to_one_that_follows_at_once(
    given: dict[str, np.ndarray],
) -> None:
    """A gear that warms up does not begin anew; an angle that is the integral of a velocity does."""
    bag = np.arange(given["time"].size) // 1500
    assert not prepared(given, bag).stretch.any()
    assert_array_equal(prepared(given, bag, by_velocity=True).stretch, bag)
    later = given | {"time": given["time"] + 60.0 * bag}
    assert_array_equal(prepared(later, bag).stretch, bag)


@pytest.mark.parametrize(
    ("name", "rows", "factor", "said"),
    [
        ("input", slice(MINIMUM_SAMPLES - 1, None), np.nan, r"^too short: 199 usable samples, "),
        ("input", slice(None), 0.02, r"^no motion: the input turns by 2\.4 rad, at "),
        (
            "output",
            slice(2010),
            np.nan,
            "2010 of 4000 samples are not finite or their stamps contradict each other: output angle has "
            "2010 without a value",
        ),
    ],
)
def test_records_that_cannot_be_judged(
    given: dict[str, np.ndarray], name: str, rows: slice, factor: float, said: str
) -> None:
    given[name][rows] *= factor
    with pytest.raises(RecordError, match=said):
        prepared(given)


def test_swapped_angles_are_said_where_the_input_hardly_moves(given: dict[str, np.ndarray]) -> None:
    given["input"], given["output"] = given["output"], given["input"]
    with pytest.raises(RecordError, match=r"no motion: .*: are input and output swapped"):
        prepared(given)


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
def test_a_torque_that_is_none_is_told(given: dict[str, np.ndarray], torque: float, told: str) -> None:
    """It is as if it were not in the record."""
    given["torque"][:] = torque
    record = prepared(given, assumed_torque=7.0)
    assert (record.no_torque, record.has_torque) == (told, not told)
    assert_allclose(record.torque, np.full(record.size, 7.0 if told else 12.0), rtol=1e-12)
    (finding,) = screened(record, joint().drive).findings[:1] or (None,)
    assert (finding is not None) is bool(told)
    if finding is not None:
        said = f"the torque {told}: it counts as not measured, and 7 N m as configured is assumed"
        assert (finding.name, finding.text, finding.fatal) == ("no_torque", said, False)
    given["torque"][::2] = 3.0
    assert prepared(given).no_torque == ""


@pytest.mark.parametrize(("piece", "judged"), [(ORDER + 1, True), (ORDER, False), (2, False)])
def test_a_record_in_pieces_too_short_to_tell_noise_is_refused(
    given: dict[str, np.ndarray], piece: int, judged: bool
) -> None:
    given["time"] = given["time"] + np.arange(given["time"].size) // piece
    if judged:
        assert prepared(given).extent.runs > 100
    else:
        with pytest.raises(
            RecordError, match=r"torn: 4000 usable samples .* 0 of them are in pieces of more"
        ):
            prepared(given)


@pytest.mark.parametrize("still", [0.3, -1e5, 0.0])
def test_an_output_that_never_moves_is_refused(given: dict[str, np.ndarray], still: float) -> None:
    given["output"][:] = still
    with pytest.raises(RecordError, match=f"no motion: the output angle is {still:.6g} rad throughout"):
        prepared(given)


@pytest.mark.parametrize(("turns", "judged"), [(1.0, True), (200.0, True), (2000.0, False), (1e9, False)])
def test_an_impossibly_fast_input_is_refused_early(
    given: dict[str, np.ndarray], turns: float, judged: bool
) -> None:
    """A mean of 24 rad/s, that many times."""
    given["input"], given["output"] = turns * given["input"], turns * given["output"]
    if judged:
        assert prepared(given).extent.input_turns == pytest.approx(76.4 * turns, rel=1e-3)
    else:
        with pytest.raises(RecordError, match="rad/s in the mean, and no drive's faster than 10000 rad/s"):
            prepared(given)


@pytest.mark.parametrize("bits", [10, 16, 24])
def test_counts_of_an_encoder_are_left_to_a_finding(given: dict[str, np.ndarray], bits: int) -> None:
    """However fast they make the input; those of no encoder are refused before anything is spread out."""
    counted = prepared(given | {"input": np.round(given["input"] * 2.0**bits / TURN)})
    found = screened(counted, joint().drive).findings[0]
    assert found.fatal
    assert f"the input angle is in counts of {bits} bits a turn" in found.text


def test_more_counts_than_any_encoder_has_are_refused(given: dict[str, np.ndarray]) -> None:
    with pytest.raises(RecordError, match="no drive's faster than 10000 rad/s"):
        prepared(given | {"input": given["input"] * 2.0**30 / TURN})


def test_an_output_that_is_held_between_its_own_samples_counts_once() -> None:
    """Its topic comes at a quarter of the input's rate, and every row repeats the last that came."""
    given = columns(seconds=40.0)
    rows = np.arange(given["time"].size)
    whole = prepared(given)
    slow = given | {"output": given["output"][4 * (rows // 4)]}
    found = prepared(slow)
    assert found.size == pytest.approx(0.25 * whole.size, abs=10)
    assert found.dropped == pytest.approx(0.75 * whole.size, abs=10)
    assert_allclose(found.output_angle, given["output"][::4][: found.size], atol=1e-4)


@pytest.mark.parametrize("counts", [2**12, 2**16, 2**20])
def test_an_encoder_that_counts_is_not_held(counts: int) -> None:
    given = columns(seconds=40.0)
    step = 2.0 * np.pi / counts
    found = prepared(given | {"output": step * np.rint(given["output"] / step)})
    assert found.dropped == 0


def test_an_output_that_is_stuck_for_a_while_is_not_held() -> None:
    given = columns(seconds=40.0)
    output = given["output"].copy()
    output[2000:3500] = output[2000]
    assert prepared(given | {"output": output}).dropped == 0
