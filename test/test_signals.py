"""Signals that stand elsewhere than in joint states: messages of other robots, in their units."""

import dataclasses
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import robot_messages as robots
import yaml
from cli_runner import assert_one_line_error, hd_diag
from joint_records import RATIO, columns, joint, prepared
from logs import content
from numpy.testing import assert_allclose, assert_array_equal
from robot_messages import DYNAMIC, FRANKA, KUKA, Messages
from test_recording import NAMES, states, whole, write

from hd_diag.bag import BagError, BagReader
from hd_diag.bag.typestore import store_of
from hd_diag.config.configuration import ConfigError, load, resolve
from hd_diag.config.parameter_file import read
from hd_diag.config.parameters import flatten
from hd_diag.diagnosis.record import RecordError
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.records.joint_record import read_bags, read_motion
from hd_diag.records.joint_topics import JointTopics
from hd_diag.replay.replay import replay
from hd_diag.streams.signals import Signal, Unit, unit

ROOT = Path(__file__).resolve().parent.parent
ELBOW = {"type": "control_msgs/DynamicJointState", "topic": "/dynamic_joint_states", "name": "elbow"}
FIELDS = {
    "input": "interface_values.values[motor_position]",
    "output_signal": "interface_values[{name}].values[position]",
    "torque_signal": "interface_values[elbow].values[effort]",
}
ROS2_CONTROL = {
    f"joint_1.{owner}.{name}": value
    for owner, field in FIELDS.items()
    for name, value in {**ELBOW, "field": field}.items()
}


@pytest.fixture(scope="module")
def given() -> dict[str, np.ndarray]:
    return columns(seconds=6.0)


def assert_same(record: Any, expected: Any, torque: bool = True) -> None:
    for name in ("input_angle", "output_angle", *(["reported_torque"] if torque else [])):
        assert_allclose(getattr(record, name), getattr(expected, name), rtol=0, atol=1e-9, err_msg=name)
    assert record.has_torque


# Recipes of the docs ---


@pytest.fixture(scope="module")
def recipes() -> dict[str, Any]:
    """Joints of the file that is there to copy from."""
    return {each.name: each for each in load(ROOT / "config/other_robots.yaml").joints}


def test_ros2_control(given: dict[str, np.ndarray], recipes: dict[str, Any], tmp_path: Path) -> None:
    messages = Messages(DYNAMIC)
    path = messages.write(
        tmp_path / "a.mcap", "/dynamic_joint_states", robots.dynamic_states(messages, given)
    )
    assert_same(read_bags([path], recipes["elbow"]), prepared(given))


def test_franka(given: dict[str, np.ndarray], recipes: dict[str, Any], tmp_path: Path) -> None:
    messages, topic = Messages(FRANKA), "/franka_robot_state_broadcaster/robot_state"
    path = messages.write(tmp_path / "a.mcap", topic, robots.franka_states(messages, given, RATIO))
    franka = recipes["fr3_joint4"]
    assert_same(read_bags([path], franka), prepared(given))
    elsewhere = dataclasses.replace(franka.signals.output, name="joint_4")
    with pytest.raises(RecordError, match=f"measured_joint_state.position of {topic}, 'joint_4'"):
        read_bags([path], dataclasses.replace(franka, signals=franka.signals._replace(output=elsewhere)))


def test_kuka(given: dict[str, np.ndarray], recipes: dict[str, Any], tmp_path: Path) -> None:
    """One angle and the torque, without a header: stamps are the times of reception."""
    messages, kuka = Messages(KUKA), recipes["lbr_A4"]
    path = messages.write(tmp_path / "a.mcap", "/lbr/state", robots.kuka_states(messages, given))
    one_angle = dataclasses.replace(kuka, signals=kuka.signals._replace(input=kuka.signals.output))
    motion = read_motion([path], one_angle)
    assert motion is not None
    assert_allclose(motion.time, given["time"], rtol=0, atol=1e-9)
    assert_array_equal(motion.input_angle, given["output"])
    assert_array_equal(motion.torque, -given["torque"])
    with pytest.raises(RecordError, match="one angle has no transmission error"):
        read_bags([path], kuka)


def test_a_ur(given: dict[str, np.ndarray], recipes: dict[str, Any], tmp_path: Path) -> None:
    """Its velocity is the motor's at the joint's side, its efforts are the motors' currents."""
    speed, current, ur = (
        np.gradient(given["input"], given["time"]) / RATIO,
        given["torque"] / 11.2,
        recipes["ur_elbow"],
    )
    names = ["elbow_joint", "wrist_1_joint"]
    blocks = ((column, 2.0 * column) for column in (given["output"], current, speed))
    path = write(tmp_path / "a.mcap", states(given["time"], names, *blocks))
    assert (ur.signals.is_velocity, ur.signals.is_current, ur.input_divided) == (True, True, True)
    with BagReader(path) as reader:
        topics = JointTopics(reader, {ur.name: ur.signals})
        (found,) = (
            s for mixed in reader.mixed(topics.types, topics.is_read) for s in topics.columns(mixed)[0]
        )
    assert found.keys == ("ur_elbow.input", "ur_elbow.torque")
    assert_allclose(found.signals, np.stack((speed, given["torque"]), axis=1), rtol=1e-14)


def test_a_torque_by_current(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    amperes = {**given, "torque": given["torque"] / 11.2}
    path = write(tmp_path / "a.mcap", whole(amperes))
    record = read_bags([path], joint(torque_signal__unit="mA", torque_signal__scale=11200.0))
    assert record.by_current
    assert_same(record, prepared(given))


# Joint states under other names, on other topics ---


def test_motors_and_links_with_the_same_names_on_two_topics(
    given: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """In degrees and in counts of the other sign; temperatures in another message beside them."""
    links = given["output"] * -8192 / (2 * np.pi)
    path = write(
        tmp_path / "a.mcap",
        states(given["time"], NAMES[1:], (np.degrees(given["input"]),), topic="/motors/joint_states"),
        states(given["time"], NAMES[1:], (links,), (given["torque"],), topic="/links/joint_states"),
    )
    own = """
        input: {topic: /motors/joint_states, unit: deg, name: joint_1}
        output_signal: {topic: /links/joint_states, unit: counts/8192, sign: -1}
        torque_signal: {topic: /links/joint_states}
        temperature_signal: {topic: links/joint_states, type: sensor_msgs/JointState, field: effort, unit: K}
    """
    record = read_bags([path], joint(**dict(flatten(yaml.safe_load(own)))))
    expected = prepared({**given, "temperature": given["torque"] - 273.15})
    assert_same(record, expected)
    assert_allclose(record.temperature, expected.temperature, rtol=0, atol=1e-9)


def test_a_torque_of_another_joint_name(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    """What is not mapped keeps its place; a message that is cut off is counted."""
    names = (*NAMES, "sensor")
    zero = np.zeros_like(given["torque"])
    path = write(
        tmp_path / "a.mcap",
        states(given["time"], names, (given["input"], given["output"], zero), (zero, zero, given["torque"])),
    )
    assert_same(read_bags([path], joint(torque_signal__name="sensor")), prepared(given))


def test_an_input_that_wraps_is_the_same_record(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Turns that a gap hides follow from the output."""
    kept = np.r_[0:500, 560 : given["time"].size]
    given = {name: column[kept] for name, column in given.items()}
    wrapped = {**given, "input": np.mod(given["input"] + np.pi, 2 * np.pi) - np.pi}
    record = read_bags([write(tmp_path / "a.mcap", whole(wrapped))], joint())
    turns = (record.input_angle - prepared(given).input_angle) / (2 * np.pi)
    assert_allclose(turns, turns[0], rtol=0, atol=1e-9)
    assert_same(record, prepared(wrapped))


# Replay ---


def test_a_replay_predicts_from_other_messages_as_from_joint_states(
    given: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """Its outputs are the same, and it copies the messages with their definition."""
    messages = Messages(DYNAMIC)
    sent = robots.dynamic_states(messages, given)
    other = messages.write(tmp_path / "other.mcap", "/dynamic_joint_states", sent)
    usual = write(tmp_path / "usual.mcap", whole(given))
    outputs = []
    for number, (path, own) in enumerate(((usual, {}), (other, ROS2_CONTROL))):
        out = tmp_path / f"{number}.mcap"
        result = replay(path, out, resolve(own))
        assert result.joints == ("joint_1",)
        outputs.append(content(out))
        again = tmp_path / f"again{number}.mcap"
        replay(out, again)
        assert content(again) == outputs[-1]
    for topic in ("/hd_diag/transmission_error", "/hd_diag/residual", "/hd_diag/joint_1/load"):
        assert outputs[0][topic] == outputs[1][topic]
        assert outputs[0][topic]
    assert len(outputs[1]["/dynamic_joint_states"]) == len(sent)


def test_a_temperature_in_the_messages_is_reported_as_it_changes(
    given: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """However many messages are read at once, a report tells the last one before it."""
    warm = np.floor(given["time"]) + 20.0
    blocks = (given["input"], given["output"], warm)
    path = write(tmp_path / "a.mcap", states(given["time"], (*NAMES, "heat"), blocks))
    own = {"type": "sensor_msgs/JointState", "field": "position[heat]", "topic": "/joint_states"}
    parameters = {f"joint_1.temperature_signal.{name}": value for name, value in own.items()}
    replay(path, tmp_path / "out.mcap", resolve({**parameters, "diagnostics_rate": 2.0}))
    told = [
        next(pair.value for pair in status.values if pair.key == "temperature_C")
        for message in decoded(tmp_path / "out.mcap", "/diagnostics")
        for status in message.status
    ]
    assert [float(text) for text in told[:11]] == [20, 20, 21, 21, 22, 22, 23, 23, 24, 24, 25]


def decoded(path: Path, topic: str) -> list[Any]:
    with BagReader(path) as reader:
        return [m for batch in reader.batches([topic]) for _, m in reader.deserialize(batch)[0]]


# What cannot be ---


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        (
            {"field": "interface_value[0].values[0]"},
            "no field 'interface_value'; the nearest is 'interface_values'",
        ),
        (
            {"field": "interface_values[0].values[0].x"},
            "values of control_msgs/msg/InterfaceValue has no fields",
        ),
        ({"field": "interface_values[0]"}, "is not a number; it has interface_names, values"),
        ({"field": "header.frame_id"}, "frame_id of std_msgs/msg/Header is not a number"),
        ({"field": "header[0].stamp.sec"}, "header of control_msgs/msg/DynamicJointState is not an array"),
        ({"field": "joint_names..x"}, "is not a path such as position"),
        (
            {"topic": "/states"},
            r"no topic /states for joint_1; it has /d (control_msgs/msg/DynamicJointState)",
        ),
        ({"type": "sensor_msgs/JointState"}, "not sensor_msgs/msg/JointState as mapped for joint_1"),
    ],
)
def test_what_is_not_there_is_told_with_what_there_is(
    signal: dict[str, str], said: str, given: dict[str, np.ndarray], tmp_path: Path
) -> None:
    messages = Messages(DYNAMIC)
    few = {name: column[:3] for name, column in given.items()}
    path = messages.write(tmp_path / "a.mcap", "/d", robots.dynamic_states(messages, few))
    own = {"topic": "/d", "type": "control_msgs/DynamicJointState", "field": "interface_values[0].values[0]"}
    with pytest.raises(BagError) as caught:
        read_bags([path], joint(**{f"input__{name}": value for name, value in (own | signal).items()}))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (
            {"input.unit": "degree Celsius"},
            "joint_1.input.unit: 'degree Celsius' is not a unit of input; there are",
        ),
        ({"output_signal.unit": "rad/s"}, "joint_1.output_signal.unit: 'rad/s' is not a unit of output"),
        ({"torque_signal.unit": "counts/4096"}, "is not a unit of torque; there are N m, N mm, A, mA"),
        ({"input.sign": 0}, "joint_1.input.sign: expected one of -1, 1, not 0"),
        ({"input.type": "a/b/c/d"}, "joint_1.input.type: expected a type such as"),
        ({"input.type": "control_msgs/DynamicJointState"}, "joint_1.input.topic: the topic"),
        (
            {"input.type": "a/B", "input.topic": "/x"},
            "joint_1.input.field: the field of a/msg/B must be named",
        ),
        ({"input": "speed"}, "joint_1.input: expected 'velocity' or topic, field, ..., not 'speed'"),
        (
            {"input.filed": "x"},
            "unknown parameter 'joint_1.input.filed'; the nearest known is 'joint_1.input.field'",
        ),
    ],
)
def test_a_bad_mapping_is_refused_by_its_name(parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        resolve({f"joint_1.{name}": value for name, value in parameters.items()})
    assert said in str(caught.value)


def test_check_knows_the_fields_of_ros_own_types(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text("hd_diag: {ros__parameters: {joint_1: {input: {field: postion}}}}")
    result = hd_diag("check", file)
    said = f"{file}: joint_1.input.field: sensor_msgs/msg/JointState has no field 'postion'; the nearest is"
    assert_one_line_error(result, said)


def test_a_file_says_it_nested_or_in_a_word(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    for text in ("input: velocity", "input_divided: true\n      input: {field: velocity}"):
        file.write_text(f"hd_diag:\n  ros__parameters:\n    joint_1:\n      {text}\n")
        assert (
            resolve(read(file)).joints[0].signals == resolve({"joint_1.input": "velocity"}).joints[0].signals
        )


@pytest.mark.parametrize(
    ("role", "name", "value", "expected"),
    [
        ("input", "deg", 180.0, np.pi),
        ("input", "turns", 0.5, np.pi),
        ("output", "counts/4096", 1024.0, np.pi / 2),
        ("input", "rpm", 60.0, 2 * np.pi),
        ("torque", "mA", 1500.0, 1.5),
        ("torque", "Nm", 2.0, 2.0),
        ("temperature", "K", 300.0, 26.85),
        ("time", "ms", 5.0, 0.005),
    ],
)
def test_units(role: str, name: str, value: float, expected: float) -> None:
    known = unit(role, name)
    assert value * known.factor + known.offset == pytest.approx(expected, abs=1e-12)


# Fields of any message ---


def reader_of(messages: Messages, **fields: str) -> FieldReader:
    signals = {
        key: Signal("/t", messages.known.type_name, field, "elbow", Unit(1.0))
        for key, field in fields.items()
    }
    return FieldReader(store_of(messages.known.type_name, messages.known), messages.known.type_name, signals)


def test_columns_are_those_of_rosbags_whatever_the_lengths() -> None:
    """Random interfaces and names, both byte orders; a name that is absent gives nothing."""
    messages, chance = Messages(DYNAMIC), np.random.default_rng(3)
    reader = reader_of(messages, a="interface_values.values[position]", b="interface_values[0].values[0]")
    sent, expected = [], []
    for row in range(300):
        other = "x" * int(chance.integers(9))
        names = [[other, "elbow", "wrist"][i] for i in chance.permutation(3)]
        values = [
            messages.of("InterfaceValue", interfaces, chance.normal(size=len(interfaces)))
            for interfaces in [
                list(chance.permutation(["position", "effort", "v"])[: chance.integers(1, 4)]) for _ in names
            ]
        ]
        message = messages.of("DynamicJointState", messages.header(row * 10**7), names, values)
        sent.append(messages.data(message, little_endian=bool(chance.integers(2))))
        own = values[names.index("elbow")]
        named = dict(zip(own.interface_names, own.values, strict=True))
        expected.append(
            {"b": values[0].values[0]} | ({"a": named["position"]} if "position" in named else {})
        )
    for size in (1, 300):
        found: dict[int, dict[str, float]] = {}
        for begin in range(0, 300, size):
            states, rejected = reader.columns(sent[begin : begin + size], np.zeros(size, np.int64))
            assert not rejected
            for each in states:
                for i, row in enumerate(each.row.tolist()):
                    assert each.stamp[i] == (begin + row) * 10**7
                    found[begin + row] = dict(zip(each.keys, each.signals[i].tolist(), strict=True))
        assert [found[row] for row in range(300)] == expected
    for row, (data, values) in enumerate(zip(sent, expected, strict=True)):
        one = reader.one(data, np.zeros(1, np.int64))
        assert (dict(zip(one.keys, one.signals[0].tolist(), strict=True)), one.stamp[0]) == (
            values,
            row * 10**7,
        )


def test_a_single_float_is_converted_in_double_however_many_come() -> None:
    """Live and in a replay a number in degrees is the same radians, to the last bit."""
    types, kind = jazzy().types, "sensor_msgs/msg/PointCloud"
    stamp = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "")
    value = np.float32(1.2345678)
    channel = types["sensor_msgs/msg/ChannelFloat32"]("elbow", np.array([value]))
    data = serialize(types[kind](stamp, [], [channel]), kind)
    signal = Signal("/t", kind, "channels[elbow].values[0]", "elbow", unit("input", "deg"))
    reader = FieldReader(jazzy(), kind, {"a.input": signal})
    (many,), _ = reader.columns([data, data], np.zeros(2, np.int64))
    expected = float(value) * unit("input", "deg").factor
    assert many.signals is not None
    assert many.signals.dtype == np.float64
    assert many.signals.tolist() == [[expected]] * 2
    assert reader.one(data, np.zeros(1, np.int64)).signals.tolist() == [[expected]]


def test_messages_that_are_cut_off_or_hostile_are_rejected() -> None:
    messages = Messages(DYNAMIC)
    few = {name: np.array([1.0]) for name in ("time", "input", "output", "torque")}
    data = messages.data(robots.dynamic_states(messages, few)[0][1])
    reader = reader_of(messages, a="interface_values.values[position]", b="interface_values[1].values[2]")
    chance = np.random.default_rng(1)
    spoiled = [data[:n] for n in range(len(data))]
    for _ in range(2000):
        flipped = bytearray(data)
        flipped[chance.integers(len(data))] = chance.integers(256)
        spoiled.append(bytes(flipped))
    huge = bytearray(data)
    huge[16:20] = struct.pack("<I", 2**32 - 1)
    spoiled.append(bytes(huge))
    states, rejected = reader.columns(spoiled, np.zeros(len(spoiled), np.int64))
    rows = [*(row for each in states for row in each.row.tolist()), *(each.row for each in rejected)]
    assert sorted(rows) == list(range(len(spoiled)))
    reasons = {each.row: each.reason for each in rejected}
    assert reasons[0] == "is not a CDR message"
    assert reasons[len(data) // 2] == "is cut off"
    late = bytearray(data)
    late[8:12] = struct.pack("<I", 2 * 10**9)
    for _ in range(2):
        with pytest.raises(ValueError, match="has a stamp with 2000000000 nanoseconds"):
            reader.one(bytes(late), np.zeros(1, np.int64))
    late = messages.data(messages.of("DynamicJointState", messages.header(0), ["elbow"], []))
    assert "elements of interface_values" in reader.columns([late], np.zeros(1, np.int64))[1][0].reason
