"""An input known by its velocity: integrated along the streams, and only from a separate sensor."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from challenge.one_angle import OneAngle, record
from cli_runner import hd_diag
from numpy.testing import assert_array_equal
from report_samples import generated
from scipy.signal import lfilter
from test_recording import Message, states, write

from hd_diag.config.configuration import resolve
from hd_diag.diagnosis.diagnosis import diagnose
from hd_diag.diagnosis.drift import check_velocity, drift_columns, without_drift
from hd_diag.diagnosis.record import Record, prepare
from hd_diag.diagnosis.screening import screened
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.settings import MonitorConfig
from hd_diag.records.joint_record import read_bags
from hd_diag.streams.alignment import Aligned, Alignment, Names
from hd_diag.streams.columns import JointStates

Array = np.ndarray
RATIO = 100.0
LINE = 60e-6  # error at 200 per output turn [rad]
NAMES = Names("motor", "link", keys=("-", "", "", "v"), input_factor=RATIO, velocity_ratio=RATIO)
JOINT = resolve({"joint_1.input": "velocity"}).joints[0]


def taken(time: Array, angle: Array, speed: Array, at_once: int, names: Names = NAMES) -> Aligned:
    streams, stamp = Alignment([names]), np.rint(1e9 * time).astype(np.int64)
    parts = []
    for begin in range(0, time.size, at_once):
        rows = slice(begin, begin + at_once)
        count = np.arange(stamp[rows].size)
        given = angle[rows, None], None, None, speed[rows, None], ("v",)
        parts.append(streams.take(stamp[rows], [JointStates(count, stamp[rows], ("link",), "", *given)]))
    return Aligned(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def swung() -> tuple[Array, Array, Array]:
    """Times, link angle with a line of error, and the motor's velocity divided by the ratio."""
    time = np.arange(4000) / 500.0
    motor = 0.8 * np.sin(0.9 * time)
    return time, motor + LINE * np.cos(200.0 * motor), 0.8 * 0.9 * np.cos(0.9 * time)


def test_the_integral_is_the_motor_s_angle() -> None:
    time, angle, speed = swung()
    found = taken(time, angle, speed, time.size)
    error = found.output_angle - found.input_angle / RATIO
    expected = LINE * np.cos(200.0 * 0.8 * np.sin(0.9 * time))
    assert np.std(without_drift(error - expected, time, np.zeros(time.size, np.int64))) < 0.02 * LINE
    assert_array_equal(found.speed, RATIO * speed)


def test_messages_one_by_one_give_the_same() -> None:
    time, angle, speed = (column[:400] for column in swung())
    whole = taken(time, angle, speed, time.size)
    for at_once in (1, 7):
        for one, other in zip(whole[1:], taken(time, angle, speed, at_once)[1:], strict=True):
            assert_array_equal(one, other)
    unknown = np.full(time.size, np.nan)  # a velocity alone gives no angle
    assert taken(time, unknown, speed, time.size).row.size == 0
    assert taken(time, angle, unknown, time.size).row.size == 0


def test_errors_of_a_velocity_are_forgotten_gaps_left_out() -> None:
    time = np.arange(0.0, 300.0, 0.02)
    found = taken(time, np.zeros(time.size), np.full(time.size, 1e-4), time.size)
    assert found.input_angle[-1] / RATIO == pytest.approx(1e-4 * 30.0, rel=1e-3)  # velocity error times 30 s
    time, angle, speed = swung()
    kept = (time < 3.0) | (time > 4.0)
    found = taken(time[kept], angle[kept], speed[kept], time.size)
    assert np.ptp(found.output_angle - found.input_angle / RATIO) < 4.0 * LINE


def test_drift_is_what_goes_straight_between_knots() -> None:
    time, record_of = np.arange(0.0, 40.0, 0.1), np.repeat([0, 1], 200)
    columns = drift_columns(time, record_of)
    assert columns.sum(axis=1) == pytest.approx(1.0)
    slow = np.where(record_of, 3.0 - 0.1 * time, 0.5 * time)
    fast = np.sin(20.0 * time)
    left = without_drift(slow + np.where(time == 7.0, np.nan, fast), time, record_of)
    assert np.nanstd(left - fast) < 0.1


def reported(made: OneAngle, speed: Array) -> list[Message]:
    return states(made.time, ("joint_1",), (made.angle,), (made.torque,), (speed,))


def velocity_of(angle: Array, time: Array) -> Array:
    return np.diff(angle, prepend=angle[0]) / np.diff(time, prepend=2.0 * time[0] - time[1])


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Bags of a joint with a gear error: velocity of the motor's encoder, or of the link's, filtered."""
    folder, made = tmp_path_factory.mktemp("velocity"), record(3)
    step = 2.0 * np.pi / 2**14 / RATIO
    motor = step * np.rint((made.angle - LINE * np.cos(200.0 * made.angle)) / step)
    behind = lfilter([0.2], [1.0, -0.8], velocity_of(made.angle, made.time))
    own = write(folder / "own.mcap", reported(made, velocity_of(motor, made.time)))
    return {"own": own, "filtered": write(folder / "filtered.mcap", reported(made, behind))}


def of(bag: Path) -> Record:
    return read_bags([bag], JOINT)


def test_a_second_encoder_is_used(bags: dict[str, Path]) -> None:
    found = of(bags["own"])
    assert found.by_velocity
    assert check_velocity(found, JOINT.drive.kinematics) is None
    assert not any(finding.fatal for finding in screened(found, JOINT.configured).findings)
    known = dataclasses.replace(found, by_velocity=False)
    assert check_velocity(known, JOINT.drive.kinematics) is None


def test_a_filtered_position_is_refused_in_words(bags: dict[str, Path], tmp_path: Path) -> None:
    assert check_velocity(of(bags["filtered"]), JOINT.drive.kinematics).fatal
    config = tmp_path / "arm.yaml"
    config.write_text("hd_diag: {ros__parameters: {joints: [joint_1], joint_1: {input: velocity}}}\n")
    done = hd_diag("diagnose", bags["filtered"], "--config", config)
    assert done.exit_code == 2
    assert "not shown to be a sensor of its own. It is that angle, filtered: " in done.stdout
    assert "ms late" in done.stdout


def test_the_monitor_measures_the_error_of_the_gear(bags: dict[str, Path]) -> None:
    """As in node and replay: message by message, the line that the link's velocity would hide."""
    made = record(3)
    rows = np.flatnonzero(np.abs(made.speed) > 0.1)[:300]
    motor = made.angle - LINE * np.cos(200.0 * made.angle)
    monitor, stamp = Monitor(MonitorConfig((JOINT,), 0.0, 0.0)), np.rint(1e9 * made.time).astype(np.int64)
    given = made.angle[rows, None], made.torque[rows, None], velocity_of(motor, made.time)[rows, None]
    position, effort, velocity = given
    signals = velocity, tuple(JOINT.mapped)
    states = JointStates(np.arange(300), stamp[rows], ("joint_1",), "", position, None, effort, *signals)
    published = monitor.mixed_states(stamp[rows], (states,))
    (errors,) = [each for each in published if each.topic.endswith("/measured_transmission_error")]
    line = LINE * np.cos(200.0 * made.angle[rows])
    found = np.polyfit(line - line.mean(), errors.position[:, 0], 1)[0]
    assert found == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_a_cause_is_named_by_a_velocity() -> None:
    """The motor's eccentric encoder, despite a drifting velocity; differentiating the angle makes it late."""
    made = generated("one_effect", 12, "input_encoder_eccentricity")
    rng = np.random.default_rng(0)
    drift = np.cumsum(1e-6 * rng.standard_normal(made.time.size))  # [rad]
    speed = velocity_of(made.input_angle / RATIO + drift, made.time)
    found = taken(made.time, made.output_angle, speed, made.time.size)
    time, number = 1e-9 * (found.stamp - found.stamp[0]), np.zeros(found.row.size, np.int64)
    columns = time, found.input_angle, found.output_angle, made.torque, None, number
    prepared = prepare(*columns, RATIO, by_velocity=True)
    told = diagnose(screened(prepared, JOINT.configured), JOINT.configured, np.random.default_rng(0))
    sizes = {cause.effect.name: cause for cause in told.causes}
    assert set(sizes) == {"input_encoder_eccentricity", "stream_delay"}
    cause = sizes["input_encoder_eccentricity"]
    values = cause.effect.to_physical(cause.coefficients, cause.nonlinear)
    size = made.truth["effects"][cause.effect.name]["offset"]
    assert values["amplitude"][0] == pytest.approx(size, rel=0.2)
    assert told.gain.fraction > 0.9
