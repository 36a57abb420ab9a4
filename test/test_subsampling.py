"""Long records in stretches: rows kept, memory of effects between them, the verdict, and memory use."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from challenge import records
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_records import ARCSEC, columns, joint, prepared
from report_samples import generated

from hd_diag.config.configuration import resolve
from hd_diag.diagnosis import blocks, subsampling
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit.linearised_fit import linearise
from hd_diag.diagnosis.judgement import Answer
from hd_diag.diagnosis.noise import ORDER, bounds
from hd_diag.diagnosis.record import Record, extent, prepare
from hd_diag.diagnosis.screening import screened
from hd_diag.diagnosis.subsampling import LIMIT, subsample
from hd_diag.diagnosis.verdict import as_json, sentence
from hd_diag.effects.recursions import slip
from hd_diag.records.joint_record import read_bags
from hd_diag.simulation import Motion, Noise, SimulatedJoint, write_bag

ROWS = 60_000
SOME = 12_000
RATE = 1000.0  # [Hz]


def moved(runs: int = 6, seed: int = 0, bags: int = 1, rows: int = ROWS) -> Record:
    """Record of runs to and fro under a wandering torque; angles and torque have no noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) / RATE
    run = np.arange(rows) * runs // rows
    knots = rng.uniform(-40.0, 40.0, rows // 500)
    torque = np.interp(np.arange(rows), np.linspace(0, rows, knots.size), knots)
    speed = np.where(run % 2, -1.0, 1.0) * (5.0 + 20.0 * (run // 2 % 3))
    angle = np.cumsum(speed) / RATE
    bag = np.arange(rows) * bags // rows
    motion = time, angle, angle / 100.0, torque, speed, None, run
    rest = bag, torque, None, bag, extent(time, angle, run), np.zeros(rows)
    return Record(*motion, True, 3, 5, *rest)


def dense(record: Record) -> list[tuple[int, int]]:
    """Stretches of consecutive rows."""
    place = np.rint(record.time * RATE).astype(np.int64)
    return [(a, b) for a, b in bounds(np.cumsum(np.diff(place, prepend=place[0]) != 1)) if b - a > 1]


def test_rows_of_a_subsample_are_neighbours_and_spread() -> None:
    short = moved(rows=LIMIT)
    assert subsample(short) is short
    whole = moved(bags=2)
    record = subsample(whole, SOME)
    # Memory continues, but not into another recording.
    assert np.array_equal(record.stretch, record.bag)
    assert set(record.bag.tolist()) == {0, 1}
    assert 0.9 * SOME < record.size <= SOME
    rows = np.rint(record.time * RATE).astype(np.int64)
    step = np.diff(rows)
    assert np.all(step > 0)
    assert step[step > 1].min() > 20  # no filter treats these rows as neighbours
    for name in ("time", "input_angle", "output_angle", "torque", "speed", "run", "bag", "reported_torque"):
        assert np.array_equal(getattr(record, name), getattr(whole, name)[rows])
    assert sum(b - a for a, b in dense(record)) > 0.9 * record.size
    assert min(b - a for a, b in dense(record)) > 10 * ORDER


@pytest.mark.parametrize("runs", [6, 600])
def test_every_part_of_every_run_is_seen(runs: int) -> None:
    record = subsample(moved(runs=runs), SOME)
    found = dense(record)
    apart = np.diff([0.0, *(record.time[(a + b) // 2] for a, b in found), ROWS / RATE])
    assert record.size <= SOME
    if runs == 6:
        assert {int(record.run[a]) for a, _ in found} == set(range(6))
        assert np.max(apart) <= 2.0 * ROWS / RATE / len(found)
    assert np.max(apart) < 0.25 * ROWS / RATE  # with 600 runs only some can have a stretch


def test_what_is_rare_is_seen_too() -> None:
    whole = moved(runs=12)
    record = subsample(whole, SOME)
    for name, low, high in (("torque", -40.0, 40.0), ("speed", -45.0, 45.0), ("output_angle", -0.6, 0.6)):
        edges = np.linspace(low, high, 13)
        before, after = (np.histogram(getattr(r, name), edges)[0] / r.size for r in (whole, record))
        assert np.all(after[before > 0.01] > 0.0)


def test_it_tells_what_the_whole_covers() -> None:
    whole = moved()
    record = subsample(whole, SOME)
    assert record.extent == whole.extent
    assert (record.outliers, record.dropped) == (whole.outliers, whole.dropped)
    written = as_json(Diagnosis(record, joint().drive, ()), "joint_1")
    assert written["record"]["samples"] == ROWS
    assert f"fitted to {record.size} of {ROWS} samples" in written["verdict"]
    assert "fitted to" not in sentence(Answer(Diagnosis(whole, joint().drive, ())))


@settings(max_examples=10)
@given(st.integers(0, 1000), st.floats(0.5, 12.0))
def test_friction_remembers_as_if_it_had_seen_every_row(seed: int, reach: float) -> None:
    """A slip element on the kept torques matches the full one, except for reversals of the least size."""
    whole = moved(seed=seed, rows=30_000)
    record = subsample(whole, 6000)
    full = slip(0.0, np.diff(whole.torque, prepend=0.0) / reach)
    few = slip(0.0, np.diff(record.torque, prepend=0.0) / reach)
    rows = np.rint(record.time * RATE).astype(np.int64)
    neighbours = np.concatenate((np.diff(rows) == 1, [False]))
    off = np.abs(few - full[rows])[neighbours]
    # Torque change that single rows can miss: 30 of the 500 rows between two knots.
    assert off.max() <= 2.5 * 80.0 * 30.0 / 500.0 / reach
    assert np.mean(off) < 0.1 / min(reach, 1.0)


def test_memory_goes_on_through_a_pause_without_torque() -> None:
    """Rows without torque are not fitted, but friction remembers across these 2 s."""
    made = columns(seconds=12.0)
    made["torque"] = np.where(np.abs(made["time"] - 6.0) < 1.0, 0.0, made["torque"])
    drive = joint().drive
    bench = linearise(prepared(made), drive, fit_parameters.vector(drive, drive))
    assert bench.data.record.size < 12.0 * 200.0 - 350
    assert np.max(np.diff(bench.data.record.time)) > 1.8
    assert set(bench.signals.run.tolist()) == {0}
    assert len(set(bench.data.run.tolist())) > 1  # filters stop at these gaps


@pytest.fixture(scope="module")
def rough() -> dict[str, np.ndarray]:
    made = columns(seconds=30.0)
    made["output"][np.arange(100, 6000, 271)] += 300.0 * ARCSEC
    made["torque"] += np.random.default_rng(1).normal(0.0, 0.3, 6000)
    made["temperature"] = 20.0 + made["time"]
    kept = (made["time"] < 11.0) | (made["time"] > 11.5)
    return {name: (np.mod(c, 2.0 * np.pi) if name == "input" else c)[kept] for name, c in made.items()}


def test_a_record_is_the_same_in_blocks(rough: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    expected = prepared(rough)
    monkeypatch.setattr(blocks, "BLOCK", 700)
    record = prepared(rough)
    assert record.outliers == expected.outliers == 21  # one more lies in the gap
    assert (record.dropped, record.extent.runs) == (0, expected.extent.runs)
    for name in ("time", "input_angle", "output_angle", "torque", "speed", "temperature", "run"):
        np.testing.assert_allclose(getattr(record, name), getattr(expected, name), rtol=1e-12, atol=1e-11)


def test_a_skipped_tooth_at_the_edge_of_a_block_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "BLOCK", 700)
    made, drive = columns(seconds=30.0), joint().drive
    for at in (714, 715, 1414, 3000):
        output = made["output"] + drive.mesh.geometry.tooth_pitch * (np.arange(6000) >= at)
        found = screened(prepared({**made, "output": output}), drive, limit=1500)
        assert [finding.name for finding in found.findings] == ["tooth_skip"]
        assert f"at {at / 200.0:.3f} s: 1 tooth skipped" in found.findings[0].text
        assert found.record.size <= 1500
        assert np.ptp(found.record.output_angle - found.record.input_angle / 100.0) < 2e-3


@pytest.mark.slow
def test_a_subsample_has_the_verdict_of_the_whole() -> None:
    """Hysteresis on half the rows: only the torque between kept rows distinguishes it from other causes."""
    made = generated("one_effect", 9, "hysteresis", run=10.0)
    data = (made.time, made.input_angle, made.output_angle, made.torque, made.temperature)
    record = prepare(*data, np.zeros(made.time.size, dtype=np.int64), 100.0)
    fewer = screened(record, joint().drive, limit=record.size // 2)
    assert fewer.record.size <= record.size // 2
    amplitude = float(np.std(records.added_by(made, "hysteresis")))
    whole, half = (diagnose(each, joint().drive, np.random.default_rng(0)) for each in (record, fewer))
    for found in (whole, half):
        assert [cause.effect.name for cause in found.causes] == ["hysteresis"]
        assert found.unexplained == ()
        assert found.causes[0].amplitude == pytest.approx(amplitude, rel=0.1)
    assert half.gain.low < whole.gain.high
    assert whole.gain.low < half.gain.high
    assert half.rms.extended == pytest.approx(whole.rms.extended, rel=0.15)


def needed(path: Path, seconds: float) -> tuple[int, int]:
    """Peak and remaining memory [byte] of reading and screening a bag at 1 kHz."""
    config = resolve({"joints": ["joint_1"]})
    own = config.joints[0]
    noise = {"joint_1": SimulatedJoint(own.drive, Noise(white=2.0 * ARCSEC, torque=0.3))}
    write_bag(path, config, Motion(duration=seconds, sample_rate=RATE), np.random.default_rng(0), noise)
    tracemalloc.start()
    try:
        found = screened(read_bags([path], own), own.drive)
        left, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.record.size <= LIMIT
    assert found.record.extent.samples == round(seconds * RATE)
    return most, left


@pytest.mark.slow
def test_memory_does_not_grow_with_the_record(tmp_path: Path) -> None:
    """An hour at 1 kHz takes half a gibibyte before the fit, which always gets at most `LIMIT` rows.

    Both records are longer than one block of processing.
    """
    short, long = (needed(tmp_path / f"{s}.mcap", s) for s in (560.0, 840.0))
    each = (long[0] - short[0]) / 280_000
    assert long[0] + each * (3_600_000 - 840_000) < 2**29
    assert long[1] < 1.1 * short[1]
    assert long[1] < 130 * subsampling.LIMIT
