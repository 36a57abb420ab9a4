"""Signals outside joint states: messages of other robots in their own units."""

import dataclasses
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import robot_messages as robots
import yaml
from cli_runner import assert_one_line_error, hd_diag
from faults import parameter_file
from joint_records import RATIO, columns, joint, prepared
from logs import content, replayed
from numpy.testing import assert_allclose, assert_array_equal
from robot_messages import DYNAMIC, FRANKA, KUKA, Messages
from test_recording import NAMES, states, whole, write

from hd_diag.bag import BagError, BagReader
from hd_diag.bag.typestore import store_of
from hd_diag.config.configuration import load, resolve
from hd_diag.config.parameter_file import read
from hd_diag.config.parameters import flatten
from hd_diag.diagnosis.record import RecordError
from hd_diag.messages.fields import FieldReader
from hd_diag.messages.schemas import jazzy, serialize
from hd_diag.records.joint_record import read_bags, read_motion
from hd_diag.records.joint_topics import JointTopics
from hd_diag.replay.replay import replay
from hd_diag.streams.columns import JointStates
from hd_diag.streams.signals import Signal, Unit, unit

RECIPES = Path(__file__).resolve().parent.parent / "config/other_robots.yaml"


@pytest.fixture(scope="module")
def given() -> dict[str, np.ndarray]:
    return columns(seconds=6.0)


def assert_same(record: Any, expected: Any) -> None:
    for name in ("input_angle", "output_angle", "reported_torque"):
        assert_allclose(getattr(record, name), getattr(expected, name), rtol=0, atol=1e-9, err_msg=name)
    assert record.has_torque


@pytest.fixture(scope="module")
def recipes() -> dict[str, Any]:
    return {each.name: each for each in load(RECIPES).joints}


def test_franka(given: dict[str, np.ndarray], recipes: dict[str, Any], tmp_path: Path) -> None:
    messages, topic = Messages(FRANKA), "/franka_robot_state_broadcaster/robot_state"
    path = messages.write(tmp_path / "a.mcap", topic, robots.franka_states(messages, given, RATIO))
    franka = recipes["fr3_joint4"]
    assert_same(read_bags([path], franka), prepared(given))
    elsewhere = dataclasses.replace(franka.signals.output, name="joint_4")
    with pytest.raises(RecordError, match=f"measured_joint_state.position of {topic}, 'joint_4'"):
        read_bags([path], dataclasses.replace(franka, signals=franka.signals._replace(output=elsewhere)))


def test_kuka(given: dict[str, np.ndarray], recipes: dict[str, Any], tmp_path: Path) -> None:
    """One angle and the torque without a header: reception times serve as stamps."""
    messages, kuka = Messages(KUKA), recipes["lbr_A4"]
    path = messages.write(tmp_path / "a.mcap", "/lbr/state", robots.kuka_states(messages, given))
    one_angle = dataclasses.replace(kuka, signals=kuka.signals._replace(input=kuka.signals.output))
    motion = read_motion([path], one_angle)
    assert_allclose(motion.time, given["time"], rtol=0, atol=1e-9)
    assert_array_equal(motion.input_angle, given["output"])
    assert_array_equal(motion.torque, -given["torque"])
    with pytest.raises(RecordError, match="one angle has no transmission error"):
        read_bags([path], kuka)


def test_a_ur(given: dict[str, np.ndarray], recipes: dict[str, Any], tmp_path: Path) -> None:
    """The velocity is the motor's, referred to the joint's side; efforts are motor currents."""
    speed, current = np.gradient(given["input"], given["time"]) / RATIO, given["torque"] / 11.2
    names, ur = ["elbow_joint", "wrist_1_joint"], recipes["ur_elbow"]
    blocks = ((column, 2.0 * column) for column in (given["output"], current, speed))
    path = write(tmp_path / "a.mcap", states(given["time"], names, *blocks))
    assert (ur.signals.is_velocity, ur.signals.is_current, ur.input_divided) == (True, True, True)
    with BagReader(path) as reader:
        topics = JointTopics(reader, {ur.name: ur.signals})
        (mixed,) = reader.mixed(topics.types, topics.is_read)
        (found,) = topics.columns(mixed)[0]
    assert found.keys == ("ur_elbow.input", "ur_elbow.torque")
    assert_allclose(found.signals, np.stack((speed, given["torque"]), axis=1), rtol=1e-14)


def test_motors_and_links_with_the_same_names_on_two_topics(given, tmp_path: Path) -> None:
    """Angles in degrees and in counts of opposite sign; temperatures in another message."""
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


def test_a_torque_by_the_current_of_another_joint(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Signals that are not mapped keep their place."""
    zero, own = np.zeros_like(given["torque"]), {"name": "sensor", "unit": "mA", "scale": 11200.0}
    angles, efforts = (given["input"], given["output"], zero), (zero, zero, given["torque"] / 11.2)
    path = write(tmp_path / "a.mcap", states(given["time"], (*NAMES, "sensor"), angles, efforts))
    record = read_bags([path], joint(**{f"torque_signal__{name}": value for name, value in own.items()}))
    assert record.by_current
    assert_same(record, prepared(given))


def test_an_input_that_wraps_is_the_same_record(given: dict[str, np.ndarray], tmp_path: Path) -> None:
    """The output gives the turns that a gap hides."""
    kept = np.r_[0:500, 560 : given["time"].size]
    given = {name: column[kept] for name, column in given.items()}
    wrapped = {**given, "input": np.mod(given["input"] + np.pi, 2 * np.pi) - np.pi}
    record = read_bags([write(tmp_path / "a.mcap", whole(wrapped))], joint())
    turns = (record.input_angle - prepared(given).input_angle) / (2 * np.pi)
    assert_allclose(turns, turns[0], rtol=0, atol=1e-9)
    assert_same(record, prepared(wrapped))


def test_a_replay_predicts_from_other_messages_as_from_joint_states(given, tmp_path: Path) -> None:
    messages = Messages(DYNAMIC)
    sent = robots.dynamic_states(messages, given)
    other = messages.write(tmp_path / "other.mcap", "/dynamic_joint_states", sent)
    usual = write(tmp_path / "usual.mcap", whole(given, ("elbow_motor", "elbow")))
    recipe = {name: value for name, value in load(RECIPES).flat.items() if name.startswith("elbow.")}
    outputs = []
    for number, (path, own) in enumerate(((usual, {}), (other, recipe))):
        out = tmp_path / f"{number}.mcap"
        assert replay(path, out, resolve({"joints": ["elbow"], **own})).joints == ("elbow",)
        outputs.append(replayed(out))
    for topic in ("/hd_diag/transmission_error", "/hd_diag/residual", "/hd_diag/elbow/load"):
        assert outputs[0][topic] == outputs[1][topic] != []
    assert len(outputs[1]["/dynamic_joint_states"]) == len(sent)


def test_a_temperature_in_the_messages_is_reported_as_it_changes(given, tmp_path: Path) -> None:
    """A report has the last temperature before it, however many messages are read at once."""
    warm = np.floor(given["time"]) + 20.0
    blocks = (given["input"], given["output"], warm)
    path = write(tmp_path / "a.mcap", states(given["time"], (*NAMES, "heat"), blocks))
    own = {"type": "sensor_msgs/JointState", "field": "position[heat]", "topic": "/joint_states"}
    parameters = {f"joint_1.temperature_signal.{name}": value for name, value in own.items()}
    replay(path, tmp_path / "out.mcap", resolve({**parameters, "diagnostics_rate": 2.0}))
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    reports = (jazzy().deserialize_cdr(d, kind) for _, d in content(tmp_path / "out.mcap")["/diagnostics"])
    told = [{pair.key: pair.value for pair in report.status[0].values}["temperature_C"] for report in reports]
    assert [float(text) for text in told[:11]] == [20, 20, 21, 21, 22, 22, 23, 23, 24, 24, 25]


@pytest.mark.parametrize(
    ("what", "value", "said"),
    [
        ("field", "interface_value[0].x", "no field 'interface_value'; the nearest is 'interface_values'"),
        ("field", "interface_values[0].values[0].x", "of control_msgs/msg/InterfaceValue has no fields"),
        ("field", "interface_values[0]", "is not a number; it has interface_names, values"),
        ("field", "header.frame_id", "frame_id of std_msgs/msg/Header is not a number"),
        ("field", "header[0].stamp.sec", "header of control_msgs/msg/DynamicJointState is not an array"),
        ("field", "joint_names..x", "is not a path such as position"),
        ("topic", "/states", "no topic /states for joint_1; it has /d (control_msgs/msg/DynamicJointState)"),
        ("type", "sensor_msgs/JointState", "not sensor_msgs/msg/JointState as mapped for joint_1"),
    ],
)
def test_what_is_not_there_is_told_with_what_there_is(what, value, said, given, tmp_path: Path) -> None:
    messages = Messages(DYNAMIC)
    few = {name: column[:3] for name, column in given.items()}
    path = messages.write(tmp_path / "a.mcap", "/d", robots.dynamic_states(messages, few))
    own = {"topic": "/d", "type": "control_msgs/DynamicJointState", "field": "interface_values[0].values[0]"}
    own[what] = value
    with pytest.raises(BagError, match=re.escape(said)):
        read_bags([path], joint(**{f"input__{name}": value for name, value in own.items()}))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"input.unit": "degree Celsius"}, "input.unit: 'degree Celsius' is not a unit of input; there are"),
        ({"output_signal.unit": "rad/s"}, "output_signal.unit: 'rad/s' is not a unit of output"),
        ({"torque_signal.unit": "counts/4096"}, "is not a unit of torque; there are N m, N mm, A, mA"),
        ({"input.sign": 0}, "input.sign: expected one of -1, 1, not 0"),
        ({"input.type": "a/b/c/d"}, "input.type: expected a type such as"),
        ({"input.type": "control_msgs/DynamicJointState"}, "input.topic: the topic"),
        ({"input.type": "a/B", "input.topic": "/x"}, "input.field: the field of a/msg/B must be named"),
        ({"input": "speed"}, "input: expected 'velocity' or topic, field, ..., not 'speed'"),
        ({"input.filed": "x"}, "'joint_1.input.filed'; the nearest known is 'joint_1.input.field'"),
        ({"input.field": "postion"}, "input.field: sensor_msgs/msg/JointState has no field 'postion'; the "),
    ],
)
def test_a_bad_mapping_is_refused_by_its_name(given: dict[str, Any], said: str, tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text(parameter_file(**{f"joint_1.{name}": value for name, value in given.items()}))
    assert_one_line_error(hd_diag("check", file), said)


def test_a_file_says_it_nested_or_in_a_word(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    (expected,) = resolve({"joint_1.input": "velocity"}).joints
    for text in ("input: velocity", "input_divided: true\n      input: {field: velocity}"):
        file.write_text(f"hd_diag:\n  ros__parameters:\n    joint_1:\n      {text}\n")
        assert resolve(read(file)).joints[0].signals == expected.signals


UNITS = [("input", "deg", 180.0, np.pi), ("input", "turns", 0.5, np.pi), ("input", "rpm", 60.0, 2 * np.pi)]
UNITS += [("output", "counts/4096", 1024.0, np.pi / 2), ("torque", "mA", 1500.0, 1.5)]
UNITS += [("torque", "Nm", 2.0, 2.0), ("temperature", "K", 300.0, 26.85), ("time", "ms", 5.0, 0.005)]


@pytest.mark.parametrize(("role", "name", "value", "expected"), UNITS)
def test_units(role: str, name: str, value: float, expected: float) -> None:
    known = unit(role, name)
    assert value * known.factor + known.offset == pytest.approx(expected, abs=1e-12)


def reader_of(messages: Messages, **fields: str) -> FieldReader:
    kind = messages.known.type_name
    signals = {key: Signal("/t", kind, field, "elbow", Unit(1.0)) for key, field in fields.items()}
    return FieldReader(store_of(kind, messages.known), kind, signals)


def test_columns_are_those_of_rosbags_whatever_the_lengths() -> None:
    """Random interfaces and names in both byte orders; an absent name gives no column."""
    messages, chance, count = Messages(DYNAMIC), np.random.default_rng(3), 200
    reader = reader_of(messages, a="interface_values.values[position]", b="interface_values[0].values[0]")
    sent, expected = [], []
    for row in range(count):
        names = [["x" * int(chance.integers(9)), "elbow", "wrist"][i] for i in chance.permutation(3)]
        values = []
        for _ in names:
            interfaces = list(chance.permutation(["position", "effort", "v"])[: chance.integers(1, 4)])
            values.append(messages.of("InterfaceValue", interfaces, chance.normal(size=len(interfaces))))
        message = messages.of("DynamicJointState", messages.header(row * 10**7), names, values)
        sent.append(messages.data(message, little_endian=bool(chance.integers(2))))
        own = values[names.index("elbow")]
        named = dict(zip(own.interface_names, own.values, strict=True))
        known = {"a": named["position"]} if "position" in named else {}
        expected.append((row * 10**7, {"b": values[0].values[0]} | known))

    def told(states: JointStates, row: int = 0) -> tuple[int, dict[str, float]]:
        return states.stamp[row], dict(zip(states.keys, states.signals[row].tolist(), strict=True))

    states, rejected = reader.columns(sent, np.zeros(count, np.int64))
    assert not rejected
    found = {row: told(each, i) for each in states for i, row in enumerate(each.row.tolist())}
    assert [found[row] for row in range(count)] == expected
    assert [told(reader.one(data, np.zeros(1, np.int64))) for data in sent] == expected


def test_a_single_float_is_converted_in_double_however_many_come() -> None:
    """Live and in a replay, a number in degrees gives the same radians, bit for bit."""
    types, kind = jazzy().types, "sensor_msgs/msg/PointCloud"
    stamp = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "")
    value = np.float32(1.2345678)
    channel = types["sensor_msgs/msg/ChannelFloat32"]("elbow", np.array([value]))
    data = serialize(types[kind](stamp, [], [channel]), kind)
    signal = Signal("/t", kind, "channels[elbow].values[0]", "elbow", unit("input", "deg"))
    reader = FieldReader(jazzy(), kind, {"a.input": signal})
    (many,), _ = reader.columns([data, data], np.zeros(2, np.int64))
    expected = float(value) * unit("input", "deg").factor
    assert (many.signals.dtype, many.signals.tolist()) == (np.float64, [[expected]] * 2)
    assert reader.one(data, np.zeros(1, np.int64)).signals.tolist() == [[expected]]


def test_messages_that_are_cut_off_or_hostile_are_rejected() -> None:
    messages = Messages(DYNAMIC)
    few = {name: np.array([1.0]) for name in ("time", "input", "output", "torque")}
    data = messages.data(robots.dynamic_states(messages, few)[0][1])
    reader = reader_of(messages, a="interface_values.values[position]", b="interface_values[1].values[2]")
    chance = np.random.default_rng(1)
    spoiled = [data[:n] for n in range(len(data))]
    for at in chance.integers(len(data), size=2000).tolist():
        spoiled.append(data[:at] + chance.bytes(1) + data[at + 1 :])
    spoiled.append(data[:16] + struct.pack("<I", 2**32 - 1) + data[20:])
    states, rejected = reader.columns(spoiled, np.zeros(len(spoiled), np.int64))
    rows = [*(row for each in states for row in each.row.tolist()), *(each.row for each in rejected)]
    assert sorted(rows) == list(range(len(spoiled)))
    reasons = {each.row: each.reason for each in rejected}
    assert (reasons[0], reasons[len(data) // 2]) == ("is not a CDR message", "is cut off")
    late = data[:8] + struct.pack("<I", 2 * 10**9) + data[12:]
    for _ in range(2):
        with pytest.raises(ValueError, match="has a stamp with 2000000000 nanoseconds"):
            reader.one(late, np.zeros(1, np.int64))
    late = messages.data(messages.of("DynamicJointState", messages.header(0), ["elbow"], []))
    assert "elements of interface_values" in reader.columns([late], np.zeros(1, np.int64))[1][0].reason
