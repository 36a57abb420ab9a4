"""Findings before the fit: a wrong ratio, swapped joints, steps between the encoders."""

import dataclasses

import numpy as np
import pytest
from joint_records import ARCSEC, RATIO, columns, joint, prepared

from hd_diag.diagnosis.findings import check_ratio, find_steps
from hd_diag.diagnosis.record import Record

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
    assert (check_ratio(record, RATIO), findings) == (None, [])
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
