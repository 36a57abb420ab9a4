"""Rows of a second publisher are reported and left out; a joint's own behaviour stays."""

from pathlib import Path

import numpy as np
import pytest
from joint_records import RATIO, columns, joint, prepared
from numpy.testing import assert_allclose
from test_recording import COLUMNS, NAMES, states, write, write_table

from hd_diag.records.joint_record import read_bags, read_motion
from hd_diag.records.tables import Table, read_table_motion, read_tables
from hd_diag.streams.second_publisher import other_rows

NOTHING = np.zeros(1200, np.int64)


@pytest.fixture(scope="module")
def given() -> dict[str, np.ndarray]:
    """Six seconds at 200 Hz from 2.6 rad of the output: beyond half a turn, as a robot's joint moves."""
    made = columns(seconds=6.0)
    return {**made, "output": made["output"] + 2.6, "input": made["input"] + 2.6 * RATIO}


def of_both(given: dict[str, np.ndarray], every: int, value: float, effort: float | None):
    """Rows with a value between the joint's own, a millisecond after each ``every``-th row."""
    time = given["time"][::every] + 1e-3
    order = np.argsort(np.concatenate((given["time"], time)), kind="stable")
    torque = given["torque"][::every] if effort is None else 0 * time + effort
    foreign = {"time": time, "input": 0 * time + value, "output": 0 * time + value, "torque": torque}
    return {name: np.concatenate((given[name], foreign[name]))[order] for name in foreign}


OTHERS = [(1, 0.0, 0.0), (1, -1.25, 0.0), (4, 0.0, None), (20, -1.25, 0.0), (20, 0.0, None)]


@pytest.mark.parametrize(("every", "value", "effort"), OTHERS)
def test_rows_of_another_are_left_out_and_told(every, value, effort, given, tmp_path: Path) -> None:
    """Zeros, another pose, or angles only; from bag and table, for `diagnose` and `ripple`."""
    mixed, expected = of_both(given, every, value, effort), prepared(given)
    time, angles, torque = mixed["time"], (mixed["input"], mixed["output"]), mixed["torque"]
    bag = write(tmp_path / "a.mcap", states(time, NAMES, angles, (0.0 * torque, torque)))
    table = write_table(tmp_path / "a.csv", mixed)
    count = given["time"][::every].size
    turned = given["input"] - given["input"][0]
    for record in (read_bags([bag], joint()), read_tables([table], Table(COLUMNS), joint())):
        assert_allclose(record.input_angle - record.input_angle[0], turned, 0, 1e-6)
        assert_allclose(record.reported_torque, expected.reported_torque, rtol=0, atol=1e-9)
        (said,) = record.stamps.others
        assert said.startswith(f"{count} rows with ")
        assert f"output {value % (2 * np.pi):g} rad" in said
    one = {"time": "t", "output": "link", "torque": "tau"}
    alone = write(tmp_path / "o.mcap", states(time, NAMES[1:], angles[1:], (torque,)))
    turned = RATIO * (given["output"] - given["output"][0])
    for motion in (read_motion([alone], joint()), read_table_motion([table], Table(one), joint())):
        assert_allclose(motion.input_angle - motion.input_angle[0], turned, rtol=0, atol=1e-6)
        assert motion.stamps.others


@pytest.mark.parametrize("column", ["input", "output", "torque"])
def test_zeros_in_one_column(column: str, given: dict[str, np.ndarray], tmp_path: Path) -> None:
    changed = given[column].copy()
    changed[10::25] = 0.0
    table = write_table(tmp_path / "a.csv", {**given, column: changed})
    record = read_tables([table], Table(COLUMNS), joint())
    assert record.size == given["time"].size - changed[10::25].size
    assert f"48 rows with {column} 0" in record.stamps.others[0]


def own(seed: int) -> dict[str, np.ndarray]:
    """Signals of a normal joint: wrapping counts, rests at zero, lasting steps, spikes, held values."""
    rng = np.random.default_rng(seed)
    time = np.arange(1200) / 200.0
    angle = 0.8 * np.sin(2.0 * time) * (rng.uniform(size=4).repeat(300) > 0.5)
    return {
        "angle": angle,
        "counts": np.round(angle / 1e-3) * 1e-3,
        "steps": angle + 0.031 * (time > 3.0),
        "wrapped": (40.0 * time + np.pi) % (2.0 * np.pi) - np.pi,
        "spikes": np.where(rng.uniform(size=1200) < 0.01, rng.normal(size=1200), angle),
        "torque": np.round(20.0 * np.sin(3.0 * time) + rng.normal(size=1200)),
        "torque under a brake": np.where(np.sin(9.0 * time) > 0.0, 20.0, 0.0),
    }


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", own(0))
def test_what_a_joint_does_itself_stays(name: str, seed: int) -> None:
    time, column = np.arange(1200) / 200.0, own(seed)[name]
    role = "torque" if name.startswith("torque") else "input"
    rows, said = other_rows(time, NOTHING, {role: column}, {"input": 2 * np.pi} if name == "wrapped" else {})
    assert (rows.any(), said) == (False, "")


def test_an_encoder_that_wraps_and_a_second_publisher() -> None:
    time = np.arange(1200) / 200.0
    wrapped = (7.0 * time + np.pi) % (2.0 * np.pi) - np.pi
    wrapped[5::10] = 0.5
    rows, _ = other_rows(time, NOTHING, {"input": wrapped}, {"input": 2 * np.pi})
    assert np.flatnonzero(rows).size > 100
    assert set(np.flatnonzero(rows)) <= set(range(5, 1200, 10))
