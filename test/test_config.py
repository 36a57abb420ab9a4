"""Configuration: files, checks of single values and of the whole, hostile input."""

import contextlib
import math
import os
import re
import socket
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node

from hd_diag.config.configuration import ConfigError, dump, load, resolve
from hd_diag.config.parameter_file import for_any_node, is_for, read
from hd_diag.config.parameters import parameters

ROOT = Path(__file__).resolve().parent.parent
FILES = [ROOT / f"config/{name}.yaml" for name in ("example_drive", "node", "other_robots", "seven_joints")]
EXAMPLE = FILES[0]
KNOWN = parameters(["joint_1"])


def refusal(values: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as caught:
        resolve(values)
    text = str(caught.value)
    assert len(text.splitlines()) == 1
    return text


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def file_refusal(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert len(text.splitlines()) == 1
    assert len(text) < len(str(path)) + 500
    return text


def section(text: str) -> str:
    return f"hd_diag: {{ros__parameters: {{{text}}}}}"


# The files of the package ---


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_file_survives_dump_and_load(path: Path, tmp_path: Path) -> None:
    config = load(path)
    again = load(written(tmp_path / "again.yaml", dump(config)))
    assert again == config
    assert again.flat == config.flat


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_ros_reads_the_same_from_the_file(path: Path) -> None:
    """Values and types from ROS's own parser."""
    context = rclpy.Context()
    context.init(["--ros-args", "--params-file", str(path)])
    try:
        node = Node("hd_diag", context=context, automatically_declare_parameters_from_overrides=True)
        given = {name: p.value for name, p in node.get_parameters_by_prefix("").items()}
        node.destroy_node()
    finally:
        context.shutdown()
    for name, value in read(path).items():
        assert (list(given[name]) if isinstance(value, list) else given[name]) == value, name


def test_example_holds_every_parameter_with_its_default() -> None:
    assert read(EXAMPLE) == resolve({}).flat
    assert set(read(EXAMPLE)) == set(KNOWN)


def test_example_states_every_unit() -> None:
    lines = EXAMPLE.read_text().splitlines()
    tree = yaml.compose("\n".join(lines))
    places = dict(leaves(tree.value[0][1].value[0][1]))
    assert set(places) == set(KNOWN)
    units = {name: KNOWN[name].unit for name in places}
    assert [name for name, unit in units.items() if unit and f"[{unit}]" not in lines[places[name]]] == []


def leaves(node: yaml.MappingNode, prefix: str = "") -> Any:
    """Full name and line number of every value."""
    for key, value in node.value:
        if isinstance(value, yaml.MappingNode):
            yield from leaves(value, f"{prefix}{key.value}.")
        else:
            yield prefix + key.value, value.start_mark.line


def test_seven_joints_differ_as_written() -> None:
    joints = load(ROOT / "config/seven_joints.yaml").joints
    assert [joint.name for joint in joints] == [f"joint_{number}" for number in range(1, 8)]
    assert joints[1].drive.mesh.eccentricity == pytest.approx(12e-6j, abs=1e-11)
    assert (joints[2].drive.kinematics.ratio, joints[5].drive.kinematics.output) == (-100, "circular_spline")


# Single values ---


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("array_rat", "array_rate"),
        ("joint_1.flexspline_tooth.addendum_centre", "joint_1.flexspline_tooth.addendum_center"),
        ("joint_2.ratio", "joint_1.ratio"),
        ("joint_1.excentricity.magnitude", "joint_1.eccentricity.magnitude"),
        ("joint_1.ecc.magnitude", "joint_1.eccentricity.magnitude"),
        ("residual_rms", "joint_1.limits.residual_rms.warn"),
        ("logpath", "log.path"),
        ("Diagnostics_Rate", "diagnostics_rate"),
        *((name, None) for name in ("nonsense", "joint_1.nonsense", "x" * 3000, "7")),
    ],
    ids=lambda value: value and value[:40],
)
def test_unknown_parameter_names_the_nearest(name: str, near: str | None) -> None:
    told = refusal({name: 1.0})
    if near is None:
        assert told.endswith(", and none that is known is like it")
    else:
        assert told == f"unknown parameter '{name}'; the nearest known is '{near}'"


@pytest.mark.parametrize(
    ("section", "own", "others"),
    [
        ("hd_diag", ["/hd_diag"], ["/arm/hd_diag"]),
        ("arm/hd_diag", ["/arm/hd_diag"], ["/hd_diag", "/a/b/hd_diag"]),
        ("/*/hd_diag", ["/arm/hd_diag"], ["/hd_diag", "/a/b/hd_diag"]),
        ("/**/hd_diag", ["/hd_diag", "/arm/hd_diag", "/a/b/hd_diag"], ["/hd_dag"]),
        ("/**", ["/hd_diag", "/a/b/hd_diag"], []),
        ("/arm/*", ["/arm/hd_diag"], ["/hd_diag", "/leg/hd_diag"]),
    ],
)
def test_sections_are_for_the_nodes_of_ros(section: str, own: list[str], others: list[str]) -> None:
    """As rclpy of Jazzy assigns them."""
    assert [is_for(section, node) for node in own + others] == [True] * len(own) + [False] * len(others)


SECTION = "{}: {{ros__parameters: {{a: 1e-6}}}}"


@pytest.mark.parametrize("text", [f"{SECTION} # as written\n", f"{{{{x: {{{{}}}}, {SECTION}}}}}"])
@pytest.mark.parametrize("name", ["hd_diag", "/hd_diag", '"hd_diag"'])
def test_a_file_for_any_node_differs_in_the_key_alone(tmp_path: Path, text: str, name: str) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(text.format(name))
    assert for_any_node(file) == text.format("'/**'")


def test_whole_and_real_numbers_serve_for_each_other_and_any_text_for_a_path() -> None:
    config = resolve({"joint_1.rated_torque": 56, "array_rate": 0, "log.path": "x\n" * 1000})
    assert (config.log.path, config.array_rate) == ("x\n" * 1000, 0.0)
    assert type(config.flat["joint_1.rated_torque"]) is float
    assert resolve({"joint_1.flexspline_teeth": 200.0}).flat["joint_1.flexspline_teeth"] == 200


NOT_A_NUMBER = [math.nan, math.inf, -math.inf, "56", "", True, None, [56.0], 10**400, 10**9000, 1 + 2j]
NOT_WHOLE = [200.5, math.nan, "200", True, [200]]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        *(("joint_1.rated_torque", value, "expected a number [N m], not ") for value in NOT_A_NUMBER),
        *(("joint_1.flexspline_teeth", value, "expected a whole number [-], not ") for value in NOT_WHOLE),
        ("joint_1.rated_torque", -1.0, "expected a number [N m] from 0.001 to 100000, not -1.0"),
        ("joint_1.flexspline_teeth", 10, "expected a whole number [-] from 20 to 640, not 10"),
        ("joint_1.output", "cup", "expected one of flexspline, circular_spline, not 'cup'"),
        ("joint_1.input_joint", 3, "expected a text, not 3"),
        ("log.overwrite", 1, "expected true or false, not 1"),
        ("joint_1.flexspline_tooth.addendum_center", 0.1, "expected two numbers [x, y] [m], not 0.1"),
        ("joint_1.flexspline_tooth.addendum_center", [0.1], "expected two numbers [x, y] [m], not 1"),
        ("joint_1.flexspline_tooth.addendum_center", [0.1, "0"], "expected a number [m], not '0'"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_value_of_the_wrong_type_or_out_of_range(name: str, value: Any, expected: str) -> None:
    assert refusal({name: value}).startswith(f"{name}: {expected}")


# The whole ---


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"ratio": 101.0}, "must be 100; output: circular_spline has this ratio"),
        ({"circular_spline_slot.addendum_radius": 0.2e-3}, "circular_spline_slot.addendum_radius"),
        ({"neutral_curve.semi_major": 0.035}, "flexspline"),
        ({"neutral_curve.semi_major": 0.0297, "neutral_curve.semi_minor": 0.0303}, ""),
        ({"circular_spline_tip_radius": 0.040}, "circular_spline_slot"),
        ({"limits.overlap.warn": 1e-3}, "limits.overlap: error (8.5e-05) must not be below warn (0.001)"),
        ({"model_file": "x.json"}, "model_file: 'x.json'"),
        ({"output_joint": "joint_1_motor"}, "output_joint: 'joint_1_motor' is already joint_1.input_joint"),
    ],
)
def test_configuration_that_cannot_be(values: dict[str, Any], reason: str) -> None:
    text = refusal({f"joint_1.{name}": value for name, value in values.items()})
    assert text.startswith("joint_1")
    assert reason in text


@pytest.mark.parametrize(
    "joints",
    [
        *([], "joint_1", None, [1], ["a", "a"], {"a": 1}),
        *([name] for name in ("a.b", "a b", "ä", "1a", "", "log", "use_sim_time")),
    ],
    ids=repr,
)
def test_joints_that_cannot_be(joints: Any) -> None:
    assert refusal({"joints": joints}).startswith("joints: ")


# Files ---


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "expected 'hd_diag: ros__parameters: ...' at the top"),
        ("[1, 2]", "expected 'hd_diag: ros__parameters: ...' at the top"),
        ("other_node: {ros__parameters: {}}", "expected 'hd_diag: ros__parameters: ...' at the top"),
        ("hd_diag: {array_rate: 1.0}", "'hd_diag' holds no 'ros__parameters'"),
        ("hd_diag: {ros__parameters: 3}", "'hd_diag' holds no 'ros__parameters'"),
        (section("array_rat: 1.0"), "unknown parameter 'array_rat'; the nearest known is 'array_rate'"),
        (section("array_rate: .nan"), "array_rate: expected a number [Hz], not nan"),
        (section("array_rate: 1, array_rate: 2"), "not YAML: line 1: 'array_rate' appears twice below it"),
        (section("joint_1: 3"), "unknown parameter 'joint_1'"),
        (section("? [a, b] : 3"), "not YAML: "),
        (section(f"{'x' * 900}: 2"), "unknown parameter 'xxx"),
        (section(f"array_rate: {'9' * 5000}"), "not YAML: "),
        (section(f"array_rate: [{'1, ' * 5000}]"), "array_rate: expected a number [Hz], not [1, 1"),
        ("hd_diag: [", "not YAML: "),
        ("hd_diag: !!python/object:os.system {}", "not YAML: "),
        ("a: &a {x: 1}\nb: *a", "not YAML: line 2: an alias (*name), which ROS does not take"),
        ("a: &a [*a]", "not YAML: line 1: an alias"),
        ("[" * 100_000, "not YAML: "),
        ("a: 1\n---\nb: 2", "not YAML: "),
        ("#" * 2_000_000, "longer than 1000000 bytes"),
        (b"\xff\xfe\x00", "not a text in UTF-8: "),
        (b"hd_diag\x00: 1", "not YAML: "),
    ],
)
def test_file_that_cannot_be(content: str | bytes, reason: str, tmp_path: Path) -> None:
    path = written(tmp_path / "drive.yaml", content)
    assert file_refusal(path).removeprefix(f"{path}: ").startswith(reason)


@pytest.mark.parametrize(
    ("text", "value"), [("1e-3", 1e-3), ("1E2", 100.0), ("09", 9.0), ("+.5", 0.5), ("2.", 2.0), ("0", 0.0)]
)
def test_numbers_are_those_of_ros(text: str, value: float, tmp_path: Path) -> None:
    """YAML 1.1 reads 1e-3 as text and does not read 09 as a number; a node of ROS reads both as numbers."""
    assert load(written(tmp_path / "f.yaml", section(f"array_rate: {text}"))).array_rate == value
    assert load(written(tmp_path / "f.yaml", section("log: {path: 2026-01-01}"))).log.path == "2026-01-01"


@pytest.mark.timeout(20)
@pytest.mark.parametrize("what", ["pipe", "link to a pipe", "device", "socket"])
def test_only_regular_files_are_read(what: str, tmp_path: Path) -> None:
    """This holds for a parameter file and for a model file it names; reading a pipe would block."""
    path = Path("/dev/zero") if what == "device" else tmp_path / what
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link to a pipe").symlink_to("pipe")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(tmp_path / "socket"))
    assert file_refusal(path).endswith("cannot be read: it is no regular file")
    own = written(tmp_path / "f.yaml", section(f"joint_1: {{model_file: '{path}'}}"))
    assert file_refusal(own).endswith("cannot be read: it is no regular file")


@pytest.mark.parametrize("name", ["hd_diag", "/hd_diag", "/arm/hd_diag", "/**"])
def test_sections_are_merged_parameter_by_parameter(name: str, tmp_path: Path) -> None:
    """This holds for any node name; parameters that every node of ROS has are no error."""
    ros = "use_sim_time: true, qos_overrides: {/parameter_events: {publisher: {depth: 1}}}"
    text = "/**: {ros__parameters: {joint_1: {torque: 3.0, rated_torque: 50.0}}}\n"
    if name != "/**":
        text += section(f"joint_1: {{torque: 4.0}}, {ros}").replace("hd_diag", f"'{name}'", 1)
    joint = load(written(tmp_path / "f.yaml", text)).joints[0]
    assert (joint.torque, joint.drive.rated_torque) == (3.0 if name == "/**" else 4.0, 50.0)


# Hostile input ---

USUAL = [0.0, 1e-3, 0.03, 1.0, 100.0, 200, 202, "flexspline", "circular_spline", ["joint_1"], 10**4000]
PLAIN = (st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20), st.binary(max_size=5))
SCALARS = st.one_of(*PLAIN, st.sampled_from(USUAL))
KEYS = st.one_of(st.text(max_size=10), st.integers(), st.none(), st.sampled_from(sorted(KNOWN)))
JUNK = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(KEYS, inner, max_size=6)),
    max_leaves=20,
)


def of_parameter(name: str) -> st.SearchStrategy[Any]:
    """Any value, and numbers within the range."""
    spec = KNOWN[name]
    if type(spec.default) is not float:
        return SCALARS
    near = st.floats(0.5, 2.0).map(lambda factor: min(max(factor * spec.default, spec.low), spec.high))
    return st.one_of(SCALARS, st.floats(spec.low, spec.high), near)


@given(st.sets(st.sampled_from(sorted(KNOWN)), max_size=8), st.data())
def test_any_value_of_a_known_parameter_is_refused_or_taken(names: set[str], data: st.DataObject) -> None:
    with contextlib.suppress(ConfigError):
        config = resolve({name: data.draw(of_parameter(name)) for name in sorted(names)})
        assert all(type(config.flat[name]) is type(spec.default) for name, spec in KNOWN.items())


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("junk") / "junk.yaml"


@given(st.binary(max_size=300) | st.text(max_size=300).map(str.encode), JUNK)
def test_any_file_is_refused_and_junk_in_one_is_refused_or_taken(
    scratch: Path, content: bytes, junk: Any
) -> None:
    file_refusal(written(scratch, content))
    written(scratch, yaml.dump({"hd_diag": {"ros__parameters": junk}}))
    with contextlib.suppress(ConfigError):
        load(scratch)


ARM = [f"j{number}" for number in range(7)]


def test_what_a_node_cannot_keep_up_with_is_refused() -> None:
    often = {"joints": ARM, "array_rate": 1000.0}
    assert re.match(r"array_rate: 1000 Hz is more .* it can be up to 286 Hz", refusal(often))
    page = {"size": 25, "ratio": 500.0, "rated_torque": 56.0, "k1": 2.5e4, "k2": 3.4e4, "k3": 4.4e4}
    slow = {f"j0.gear.{name}": value for name, value in page.items()}
    assert refusal({"joints": ARM, "mesh_rate": 60.0, **slow}).startswith(
        "j0.flexspline_teeth: 1000 are more"
    )
    assert resolve({"joints": ARM, "array_rate": 280.0, "mesh_rate": 60.0}).array_rate == 280.0
