"""``hd-diag topics``: its findings in other robots' bags give the mapping that reads them."""

import json
import re
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
from test_recording import NAMES, states, whole, write

from hd_diag.bag import BagReader, BagWriter
from hd_diag.config.configuration import load
from hd_diag.messages.schemas import Definition, jazzy, serialize
from hd_diag.records.joint_record import read_bags

Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def given() -> Columns:
    return columns(seconds=6.0)


def found_in(path: Path, folder: Path) -> tuple[dict[str, Any], Any]:
    """The JSON, and the configuration from its proposed mapping."""
    target = folder / "topics.json"
    result = hd_diag("topics", path, "--json", target)
    assert result.exit_code == 0, result.stderr
    content = json.loads(target.read_text())
    assert content["mapping"] in result.output
    file = folder / "pasted.yaml"
    file.write_text(content["mapping"])
    return content, load(file)


def test_ros2_control_and_its_mapping(given: Columns, tmp_path: Path) -> None:
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
        "first": given["torque"][0],
        "least": given["torque"].min(),
        "greatest": given["torque"].max(),
    }
    (joint,) = config.joints
    assert (joint.name, round(content["joints"][0]["slope"])) == ("elbow", 100)
    record, expected = read_bags([path], joint), prepared(given)
    assert_allclose(record.input_angle, expected.input_angle, rtol=0, atol=1e-9)
    assert_allclose(record.reported_torque, expected.reported_torque, rtol=0, atol=1e-9)


def test_franka_has_two_encoders_at_one_side(given: Columns, tmp_path: Path) -> None:
    messages = Messages(FRANKA)
    path = messages.write(tmp_path / "a.mcap", "/f", robots.franka_states(messages, given, RATIO))
    content, config = found_in(path, tmp_path)
    (joint,) = config.joints
    fields = [getattr(joint.signals, name).field for name in ("input", "output", "torque")]
    places = "motor_state.position", "state.position", "state.effort"
    assert joint.input_divided
    assert fields == [f"measured_joint_{place}[fr3_joint4]" for place in places]
    record = read_bags([path], joint)
    assert_allclose(record.output_angle, prepared(given).output_angle, rtol=0, atol=1e-9)
    assert "two encoders" in content["joints"][0]["said"]


@pytest.mark.parametrize("bits", [16, 13])
def test_a_motor_that_counts_is_told_with_its_counts(given: Columns, tmp_path: Path, bits: int) -> None:
    """8192 counts per turn, in 16 bits that overflow or 13 bits that wrap; the user knows the ratio."""
    told = np.mod(np.rint(given["input"] / (2 * np.pi) * 8192) + 60_000, 2.0**bits)
    path = write(tmp_path / "a.mcap", states(given["time"], ("a/x", "a/y"), (told, given["output"])))
    result = hd_diag("topics", path, "--json", tmp_path / "t.json")
    (found,) = json.loads((tmp_path / "t.json").read_text())["joints"]
    assert (found["mapping"]["input.field"], found["mapping"]["input.unit"]) == ("position[a/x]", "counts/?")
    assert found["mapping"]["output_signal.field"] == "position[a/y]"
    counts = float(found["said"].split()[0])
    assert counts / RATIO == pytest.approx(8192, rel=2e-3)
    assert "'?'" in result.output


def test_one_angle_is_told(given: Columns, tmp_path: Path) -> None:
    messages = Messages(KUKA)
    path = messages.write(tmp_path / "a.mcap", "/lbr/state", robots.kuka_states(messages, given))
    content, config = found_in(path, tmp_path)
    assert content["joints"][0]["said"] == (
        "one angle, diagnose needs two; hd-diag ripple looks for the gear in its torque"
    )
    assert config.joints[0].signals.output.field == "measured_joint_position[3]"
    assert config.joints[0].signals.torque.field == "measured_torque[3]"


def test_motors_in_degrees_that_wrap_beside_links(given: Columns, tmp_path: Path) -> None:
    """Joints on two topics. Names identify temperatures and currents; other messages are only listed."""
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


def test_all_publishers_of_a_topic_are_told(given: Columns, tmp_path: Path) -> None:
    """A gripper's joints come first, at another rate; the arm's joints are a gear's."""
    few = given["time"][::4]
    fingers = states(few + 1e-4, ("finger_l", "finger_r"), (np.sin(few), np.cos(few)))
    path = write(tmp_path / "a.mcap", fingers, whole(given))
    content, _ = found_in(path, tmp_path)
    (topic,) = content["topics"]
    assert topic["joints"] == ["finger_l", "finger_r", "joint_1", "joint_1_motor"]
    by_joint = {tuple(each["joints"]): (each["messages"], each["rate"]) for each in topic["publishers"]}
    assert by_joint == {
        ("finger_l", "finger_r"): (few.size, pytest.approx(50.0)),
        ("joint_1_motor", "joint_1"): (4 * few.size, pytest.approx(200.0)),
    }
    assert "of one publisher, finger_l, finger_r: 300 messages, 50.0 Hz" in hd_diag("topics", path).stdout
    assert content["joints"][0]["mapping"]["input.field"] == "position[joint_1_motor]"


def test_names_with_interfaces_and_nothing_behind_them(given: Columns, tmp_path: Path) -> None:
    """Each interface is a name with nan in all other columns; nan columns are never proposed."""
    nothing = np.full(given["time"].size, np.nan)
    names = ("joint_1_motor/position", "joint_1/position", "joint_1/effort")
    position, effort = (given["input"], given["output"], nothing), (nothing, nothing, given["torque"])
    path = write(tmp_path / "a.mcap", states(given["time"], names, position, effort))
    content, config = found_in(path, tmp_path)
    assert config.joints[0].signals.torque.field == "effort[joint_1/effort]"
    told = {n["field"]: n["least"] for n in content["topics"][0]["numbers"]}
    assert told["effort[joint_1/position]"] is None
    assert "effort[joint_1/position]: torque, NaN throughout" in hd_diag("topics", path).stdout
    record = read_bags([path], config.joints[0])
    assert_allclose(record.reported_torque, prepared(given).reported_torque, rtol=0, atol=1e-9)


def test_points_of_drawings_are_no_angles(given: Columns, tmp_path: Path) -> None:
    kind, types = "geometry_msgs/msg/Pose", jazzy().types
    point = types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    pose = types[kind](point, types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0))
    path = write(tmp_path / "a.mcap", [("/p", kind, serialize(pose, kind), START)])
    result = hd_diag("topics", path)
    assert (result.exit_code, "angle," in result.stdout) == (0, False)


@pytest.mark.parametrize("seed", range(12))
def test_what_is_proposed_is_taken(seed: int, given: Columns, tmp_path: Path) -> None:
    """Bags of many kinds: topics, rates, units, names, other joints, arrays of nan, and no torque."""
    rng = np.random.default_rng(seed)
    pick = lambda *choices: choices[rng.integers(len(choices))]  # noqa: E731
    end, time = pick("", "/position"), given["time"]
    degrees = pick(False, True)
    shown = (np.degrees(given["input"]) + 180.0) % 360.0 - 180.0 if degrees else given["input"]
    nothing = np.full(time.size, np.nan)
    efforts = (pick(nothing, given["torque"], 0.0 * time), pick(given["torque"], nothing))
    motor, link = f"a_motor{end}", f"a{end}"
    if rng.integers(2):
        parts = [states(time, (motor, link), (shown, given["output"]), pick(None, efforts))]
    else:
        late = pick(0.0, 0.0013)
        keep = slice(None, None, int(pick(1, 2, 2 if degrees else 5)))
        parts = [
            states(time[keep], (motor,), (shown[keep],), topic=pick("/m", "/joint_states")),
            states(time + late, (link,), (given["output"],), pick(None, efforts[1:])),
        ]
    if rng.integers(2):
        parts.append(states(time[::3] + 2e-4, ("finger",), (np.sin(time[::3]),)))
    if rng.integers(2):
        slow = np.sin(time[::4])
        parts.append(states(time[::4], ("slow", "slower"), (100.0 * slow, slow)))
    path = write(tmp_path / "a.mcap", *parts)
    _, config = found_in(path, tmp_path)
    pairs = [joint for joint in config.joints if joint.signals.input is not None]
    assert "a" in [re.sub(r"_position$", "", joint.name) for joint in pairs]
    for joint in pairs:
        record = read_bags([path], joint)
        assert record.size > 200
        if record.has_torque:
            assert np.isfinite(record.torque).all()


def test_a_bag_without_angles(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [("/note", STRING, string_cdr("x"), START)])
    result = hd_diag("topics", path)
    assert (result.exit_code, result.output.splitlines()[-1][:20]) == (0, "no angle that moves:")
    result = hd_diag("topics", tmp_path / "none.mcap")
    assert (result.exit_code, result.stderr) == (2, f"hd-diag: {tmp_path / 'none.mcap'}: does not exist\n")


def test_all_topics_are_read_in_two_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two passes suffice for any number of topics. One message shows its value; a bad topic ends alone."""
    asked: list[int] = []
    own = BagReader.batches

    def counted(reader: BagReader, topics: Any = None, **how: Any) -> Any:
        asked.append(len(topics))
        return own(reader, topics, **how)

    monkeypatch.setattr(BagReader, "batches", counted)
    with BagWriter(tmp_path / "a.mcap") as writer:
        for k in range(300):
            value = np.float64(k).tobytes()
            writer.write(f"/t{k}", "std_msgs/msg/Float64", b"\0\1\0\0" + value, START + k)
        unknown = Definition("a/msg/B", "NoSuchType x\n")
        writer.write("/unknown", "a/msg/B", b"\0\1\0\0" + value, START, known=unknown)
        writer.write("/odd", "std_msgs/msg/Float64", b"\0\1\0\0", START)
    hd_diag("topics", tmp_path / "a.mcap", "--json", tmp_path / "t.json")
    *found, unknown, odd = json.loads((tmp_path / "t.json").read_text())["topics"]
    assert asked == [301, 301]
    assert [(topic["numbers"][0]["first"], topic["problem"]) for topic in found] == [
        (k, "") for k in range(300)
    ]
    assert "cannot be understood" in unknown["problem"]
    assert "no message can be read; the last " in odd["problem"]


def test_numbers_that_no_joint_can_have_are_none(tmp_path: Path) -> None:
    """Columns with infinities and numbers near the largest cause no warning in the output."""
    rows = [f"{0.01 * k},{k},{0.01 * k},{('inf', '-inf', '1e308', '-1e308')[k % 4]}" for k in range(300)]
    (tmp_path / "a.csv").write_text("\n".join(["t,x,y,q", *rows]))
    result = hd_diag("topics", tmp_path / "a.csv")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "time=t,input=x,output=y" in result.stdout


def test_the_rate_of_a_table_is_that_of_each_of_its_recordings(tmp_path: Path) -> None:
    """Four recordings of one second at 100 Hz, each with times from zero."""
    rows = [f"{0.01 * k},{r},{k},{0.01 * k}" for r in range(4) for k in range(101)]
    (tmp_path / "a.csv").write_text("\n".join(["t,record,x,y", *rows]))
    told = json.loads(hd_diag("topics", tmp_path / "a.csv", "--json", "-").stdout)
    assert told["duration"] == pytest.approx(4.0)
    assert told["topics"][0]["rate"] == pytest.approx(100.0, rel=0.01)
