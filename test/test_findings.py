"""Findings before the fit: a wrong ratio, swapped joints, steps between the encoders."""

import dataclasses

import numpy as np
import pytest
from challenge import families
from joint_records import ARCSEC, RATIO, columns, generated, joint, prepared

from hd_diag.diagnosis.findings import check_ramp, check_ratio, find_steps
from hd_diag.diagnosis.record import Record
from hd_diag.simulation import Motion, Noise, SimulatedJoint, simulate

PITCH = joint().drive.mesh.geometry.tooth_pitch


@pytest.fixture(scope="module")
def record() -> Record:
    given = columns(seconds=100.0)
    given["output"] = given["output"] + 1.5 * given["input"] / RATIO
    given["input"] = 2.5 * given["input"]
    return prepared(given, np.arange(given["time"].size) // 2000)


def stepped(record: Record, size: float, at: int = 9000) -> Record:
    output = record.output_angle.copy()
    output[at:] += size
    return dataclasses.replace(record, output_angle=output)


def scaled(record: Record, factor: float) -> Record:
    return dataclasses.replace(record, input_angle=factor * record.input_angle)


@pytest.mark.parametrize("true", [101.0, 99.0, 50.0, -100.0, 120.0, -101.0])
def test_a_wrong_ratio_is_found_with_its_size(record: Record, true: float) -> None:
    found = check_ratio(scaled(record, true / RATIO), RATIO)
    assert (found.name, found.fatal) == ("ratio_error", True)
    assert found.value == pytest.approx(true, rel=1e-3)
    assert f"not the configured {RATIO:g}" in found.text


@pytest.mark.parametrize("held", [4, 10])
def test_an_output_that_is_held_between_its_own_samples_has_its_ratio(held: int) -> None:
    """The output comes at a fraction of the input's rate, and each row repeats its last value."""
    given = columns(seconds=100.0)
    last = held * (np.arange(given["time"].size) // held)
    assert check_ratio(prepared(given | {"output": given["output"][last]}), RATIO) is None


@pytest.mark.parametrize("fraction", [1.2e-4, 1e-4, -3e-4, 1e-3])
def test_a_ratio_that_is_slightly_wrong_is_found_as_a_ramp(record: Record, fraction: float) -> None:
    """Also with dropouts: half a second shows too little slope, but a recording's pieces share one zero."""
    wrong = scaled(record, 1.0 + fraction)
    assert check_ratio(wrong, RATIO) is None
    pieces = dataclasses.replace(wrong, run=np.arange(record.size) // 100)
    for given in (wrong, pieces) if fraction == 1.2e-4 else (wrong,):
        found = check_ramp(given, RATIO)
        assert found.value == pytest.approx(RATIO * (1.0 + fraction), abs=RATIO * 1e-5)


@pytest.mark.parametrize("seconds", [17.5, 24.0, 47.0])
def test_a_large_eccentricity_over_a_part_of_a_turn_is_no_ramp(seconds: float) -> None:
    """One direction, one load: ripple over any part of its turn must not look like a slope."""
    count = round(250.0 * seconds)
    drive = joint(eccentricity__magnitude=18e-6).drive
    motion = Motion(60.0, 250.0, (13.2,), (14.0,), both_directions=False, ramp_share=0.01, rest_share=0.0)
    run = simulate(SimulatedJoint(drive, Noise(white=ARCSEC)), motion, np.random.default_rng(0))
    time = 1e-9 * (run.stamp - run.stamp[0])
    given = {"time": time, "input": run.input_angle, "output": run.output_angle, "torque": run.torque}
    record = prepared({name: column[:count] for name, column in given.items()})
    assert check_ratio(record, RATIO) is None
    assert check_ramp(record, RATIO) is None


@pytest.mark.parametrize("phase", [0.5, 2.0, -1.0])
def test_an_encoder_disc_off_centre_is_no_ramp(record: Record, phase: float) -> None:
    """Over half a turn, orders 1 and 2 of the output together look like a slope."""
    turn = record.input_angle / RATIO - phase
    error = 45.0 * ARCSEC * (np.cos(turn) + 0.3 * np.cos(2.0 * turn - 1.0))
    disc = dataclasses.replace(record, output_angle=record.output_angle + error)
    assert check_ramp(disc, RATIO) is None
    assert check_ramp(scaled(disc, 1.001), RATIO) is not None


@pytest.mark.parametrize(
    ("family", "seed"), [("robot_single", 716), pytest.param("robot_pair", 4001, marks=pytest.mark.slow)]
)
def test_torsion_that_goes_with_position_is_no_ramp(family: str, seed: int) -> None:
    """A robot's arm over half a turn: the residual of its spring's law looks like a ramp."""
    arm = generated(families.made(family, seed))
    assert check_ratio(arm, RATIO) is None
    assert check_ramp(arm, RATIO) is None
    assert check_ramp(scaled(arm, 1.001), RATIO) is not None


def test_torsion_of_a_spring_under_a_noisy_torque_is_no_ramp(record: Record) -> None:
    """Torque and torsion follow the angle, and noise reduces only the torque's fitted share."""
    noise = np.random.default_rng(0).standard_normal((2, record.size))
    turned = record.input_angle / RATIO
    torque = 20.0 * turned / float(np.max(np.abs(turned)))
    output = turned - 4e-5 * torque + 1e-6 * noise[0]
    sprung = dataclasses.replace(record, torque=torque + 0.5 * noise[1], output_angle=output)
    assert check_ratio(sprung, RATIO) is None
    assert check_ramp(sprung, RATIO) is None


def test_a_ramp_is_not_looked_for_where_nothing_tells_it_from_torsion(record: Record) -> None:
    wrong = scaled(record, 1.0003)
    assert check_ramp(dataclasses.replace(wrong, has_torque=False), RATIO) is None


def test_swapped_joints_and_angles_that_have_nothing_to_do_with_each_other(record: Record) -> None:
    swapped = dataclasses.replace(record, input_angle=record.output_angle, output_angle=record.input_angle)
    other = dataclasses.replace(record, output_angle=np.sin(3.0 * record.time))
    turned, unrelated = (check_ratio(made, RATIO) for made in (swapped, other))
    assert turned.value == pytest.approx(1.0 / RATIO, rel=1e-3)
    assert "swapped joints" in turned.text
    assert np.isnan(unrelated.value)
    assert "does not follow the input at any fixed ratio" in unrelated.text


def test_a_right_ratio_without_steps_is_not_mentioned(record: Record) -> None:
    correction, findings = find_steps(record, RATIO, PITCH)
    assert (check_ratio(record, RATIO), check_ramp(record, RATIO), findings) == (None, None, [])
    assert not correction.any()
    # A step between runs is a hub that slipped at rest.
    assert find_steps(stepped(record, PITCH, 8000), RATIO, PITCH)[1] == []


@pytest.mark.parametrize(
    ("teeth", "said"),
    [
        (1, "1 tooth skipped"),
        (-1, "-1 tooth skipped"),
        (3, "3 teeth skipped"),
        (0.4, "encoder counts lost, or a hub slipped: no whole tooth"),
    ],
)
def test_skipped_teeth_are_counted(record: Record, teeth: float, said: str) -> None:
    wrong = stepped(record, teeth * PITCH)
    assert check_ratio(wrong, RATIO) is None
    correction, findings = find_steps(wrong, RATIO, PITCH)
    (finding,) = findings
    assert (finding.name, finding.fatal) == ("tooth_skip", False)
    assert finding.value == pytest.approx(teeth * PITCH, abs=10.0 * ARCSEC)
    assert finding.text.endswith(f"at {wrong.time[9000]:.3f} s: {said}")
    # An error in the size of a step would remain as a drift.
    off = 1e-9 if teeth == round(teeth) else 10.0 * ARCSEC
    assert np.max(np.abs(wrong.output_angle - correction - record.output_angle)) < off


def test_a_tooth_is_skipped_as_the_torque_gives_way(record: Record) -> None:
    """The drive springs back meanwhile, by more than the tolerance for a whole-tooth step."""
    rows = np.arange(record.size)
    torque = np.where((rows > 8970) & (rows < 9000), 150.0, 0.0)
    twisted = dataclasses.replace(record, torque=torque, output_angle=record.output_angle - 2e-5 * torque)
    wrong = stepped(twisted, PITCH)
    (misread,) = find_steps(wrong, RATIO, PITCH)[1]
    assert misread.text.endswith("no whole tooth")
    correction, (finding,) = find_steps(wrong, RATIO, PITCH, lambda angle, torque: -2e-5 * torque)
    assert finding.value == pytest.approx(PITCH, abs=10.0 * ARCSEC)
    assert finding.text.endswith("1 tooth skipped")
    assert np.max(np.abs(wrong.output_angle - correction - twisted.output_angle)) < 1e-9


def test_two_steps_in_a_run(record: Record) -> None:
    wrong = stepped(stepped(record, PITCH, 9000), -2.0 * PITCH, 9500)
    correction, findings = find_steps(wrong, RATIO, PITCH)
    assert sorted(round(f.value / PITCH) for f in findings) == [-2, 1]
    assert np.max(np.abs(wrong.output_angle - correction - record.output_angle)) < 10.0 * ARCSEC


@pytest.mark.parametrize(("runs", "turned"), [(1, 1.0), (700, 1.0), (1800, 1.0), (1800, -1.0)])
def test_the_ratio_is_checked_in_runs_of_any_length(record: Record, runs: int, turned: float) -> None:
    """20,000 samples in up to 1800 runs: a run of 11 is shorter than the usual stretch of the check."""
    given = scaled(record, 3.0 * turned)
    pieces = dataclasses.replace(given, run=np.arange(record.size) * runs // record.size)
    found = check_ratio(pieces, RATIO * turned)
    assert found.value == pytest.approx(3.0 * turned * RATIO, rel=0.02)


def test_where_nothing_moves_within_a_run_no_ratio_is_found(record: Record) -> None:
    rows = np.arange(record.size)
    pieces = dataclasses.replace(record, run=rows, input_angle=np.floor(record.input_angle))
    found = check_ratio(pieces, RATIO)
    assert np.isnan(found.value)
