"""``hd-diag topics``: what it finds in bags of other robots makes the mapping by which they are read."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import robot_messages as robots
from bag_samples import STRING, string_cdr
from cli_runner import hd_diag
from joint_records import RATIO, columns, prepared
from numpy.testing import assert_allclose
from robot_messages import DYNAMIC, FRANKA, KUKA, START, Messages
from test_recording import NAMES, states, write

from hd_diag.config.configuration import load
from hd_diag.records.joint_record import read_bags


@pytest.fixture(scope="module")
def given() -> dict[str, np.ndarray]:
    return columns(seconds=6.0)


def found_in(path: Path, folder: Path) -> tuple[dict[str, Any], Any]:
    """The JSON, and the configuration that the mapping is."""
    target = folder / "topics.json"
    result = hd_diag("topics", path, "--json", target)
    assert result.exit_code == 0, result.stderr
    content = json.loads(target.read_text())
    assert content["mapping"] in result.output
    file = folder / "pasted.yaml"
    file.write_text(content["mapping"])
    return content, load(file)


def test_ros2_control_and_its_mapping(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    messages = Messages(DYNAMIC)
    path = messages.write(tmp_path / "a.mcap", "/d", robots.dynamic_states(messages, given))
    content, config = found_in(path, tmp_path)
    (topic,) = content["topics"]
    assert (topic["type"], topic["messages"]) == (DYNAMIC.type_name, given["time"].size)
    assert topic["rate"] == pytest.approx(200.0)
    assert topic["joints"] == ["elbow", "shoulder"]
    assert topic["numbers"][-1] == {
        "field": "interface_values[elbow].values[effort]",
        "kind": "torque",
        "unit": "N m",
        "least": given["torque"].min(),
        "greatest": given["torque"].max(),
    }
    (joint,) = config.joints
    assert (joint.name, round(content["joints"][0]["slope"])) == ("elbow", 100)
    record, expected = read_bags([path], joint), prepared(given)
    assert_allclose(record.input_angle, expected.input_angle, rtol=0, atol=1e-9)
    assert_allclose(record.reported_torque, expected.reported_torque, rtol=0, atol=1e-9)


def test_franka_has_two_encoders_at_one_side(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    messages = Messages(FRANKA)
    path = messages.write(tmp_path / "a.mcap", "/f", robots.franka_states(messages, given, RATIO))
    content, config = found_in(path, tmp_path)
    (joint,) = config.joints
    assert joint.input_divided
    assert joint.signals.input.field == "measured_joint_motor_state.position[fr3_joint4]"
    assert joint.signals.output.field == "measured_joint_state.position[fr3_joint4]"
    assert joint.signals.torque.field == "measured_joint_state.effort[fr3_joint4]"
    record = read_bags([path], joint)
    assert_allclose(record.output_angle, prepared(given).output_angle, rtol=0, atol=1e-9)
    assert "two encoders" in content["joints"][0]["said"]


@pytest.mark.parametrize("bits", [16, 13])
def test_a_motor_that_counts_is_told_with_its_counts(
    given: dict[str, np.ndarray], tmp_path: Path, bits: int
) -> None:
    """8192 to the turn, of 16 bits that run over or anew each turn; the user knows the ratio."""
    told = np.mod(np.rint(given["input"] / (2 * np.pi) * 8192) + 60_000, 2.0**bits)
    path = write(tmp_path / "a.mcap", states(given["time"], ("a/x", "a/y"), (told, given["output"])))
    result = hd_diag("topics", path, "--json", tmp_path / "t.json")
    (found,) = json.loads((tmp_path / "t.json").read_text())["joints"]
    assert (found["mapping"]["input.field"], found["mapping"]["input.unit"]) == ("position[a/x]", "counts/?")
    assert found["mapping"]["output_signal.field"] == "position[a/y]"
    counts = float(found["said"].split()[0])
    assert counts / RATIO == pytest.approx(8192, rel=2e-3)
    assert "'?'" in result.output


def test_one_angle_is_told(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    messages = Messages(KUKA)
    path = messages.write(tmp_path / "a.mcap", "/lbr/state", robots.kuka_states(messages, given))
    content, config = found_in(path, tmp_path)
    assert content["joints"][0]["said"] == "one angle: see hd-diag ripple"
    assert config.joints[0].signals.output.field == "measured_joint_position[3]"
    assert config.joints[0].signals.torque.field == "measured_torque[3]"


def test_motors_in_degrees_that_wrap_beside_links(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    """On two topics; temperatures and currents are known by their names, other messages are named."""
    wrapped = np.degrees(given["input"]) % 360.0
    warm = given["torque"] + 20.0
    path = write(
        tmp_path / "a.mcap",
        states(given["time"], NAMES[1:], (wrapped,), topic="/motors/joint_states"),
        states(given["time"], NAMES[1:], (given["output"],), (given["torque"],), topic="/links/joint_states"),
        states(given["time"], NAMES[1:], (warm,), topic="/temperatures"),
        [("/note", STRING, string_cdr("x"), START)],
    )
    content, config = found_in(path, tmp_path)
    rates = {topic["name"]: topic["rate"] for topic in content["topics"]}
    assert (rates["/links/joint_states"], rates["/note"]) == (pytest.approx(200.0), None)
    (joint,) = config.joints
    assert joint.signals.input.topic == "/motors/joint_states"
    record = read_bags([path], joint)
    assert_allclose(np.diff(record.input_angle), np.diff(prepared(given).input_angle), rtol=0, atol=1e-9)
    assert content["joints"][0]["mapping"]["input.unit"] == "deg"


def test_a_bag_without_angles(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [("/note", STRING, string_cdr("x"), START)])
    result = hd_diag("topics", path)
    assert (result.exit_code, result.output.splitlines()[-1][:20]) == (0, "no angle that moves:")
    result = hd_diag("topics", tmp_path / "none.mcap")
    assert (result.exit_code, result.stderr) == (2, f"hd-diag: {tmp_path / 'none.mcap'}: does not exist\n")
