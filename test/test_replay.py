"""Replay of any bag equals one computation over all samples, whatever the bag's form."""

import json
import platform
import random
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_samples import cut_end, rosbag2_folder, write_with_mcap
from cli_runner import hd_diag as command
from live import MS, RATIO, START, config, message, parameters
from logs import content, messages_of
from numpy.testing import assert_array_equal
from player import angles
from replay_fuzz import log_of

import hd_diag
from hd_diag.bag import BagError, BagReader, BagWriter
from hd_diag.config.configuration import ConfigError, resolve
from hd_diag.drive import mesh_state, transmission_error
from hd_diag.messages.publications import DIAGNOSTICS, JOINT_STATE, STRING, read_string, string
from hd_diag.messages.schemas import Definition, definition, jazzy
from hd_diag.replay import versions
from hd_diag.replay.events import read_event
from hd_diag.replay.map_builder import map_of
from hd_diag.replay.replay import replay

CONFIG = config("a", "b", array_rate=20.0)
DRIVE = CONFIG.joints[0].drive
COUNT = 2500
STAMPS = START + MS * np.arange(COUNT)
ANGLE = 9.0 * np.sin(2.1e-3 * np.arange(COUNT))
TORQUE = 4.0 * np.cos(1.3e-3 * np.arange(COUNT))
OUTPUT = ANGLE / RATIO + 5e-5 * np.sin(2.0 * ANGLE)
Message = tuple[str, str, bytes, int]


def samples() -> list[Message]:
    """Messages of one joint with all signals, recorded a little after their stamps."""
    columns = zip(STAMPS.tolist(), ANGLE, OUTPUT, TORQUE, strict=True)
    every = ((s, message(s, {"a_motor": x, "a": y}, {"a": m})) for s, x, y, m in columns)
    return [("/joint_states", JOINT_STATE, data, stamp + 200_000) for stamp, data in every]


def with_writer(path: Path, messages: list[Message], **options: Any) -> Path:
    with BagWriter(path, **options) as writer:
        for topic, kind, data, time in messages:
            writer.write(topic, kind, data, time)
    return path


def shuffled(messages: list[Message]) -> list[Message]:
    """Blocks of messages out of order, as the threads of several recorders leave them."""
    chance, starts = random.Random(4), range(0, len(messages), 7)
    order = sorted(starts, key=lambda start: (start // 140, chance.random()))
    return [entry for start in order for entry in messages[start : start + 7]]


UNSORTED = {"chunk_size": 2000, "summary": False, "indexes": False}
WAYS = {
    "tiny chunks": lambda f, m: write_with_mcap(f / "b.mcap", m, chunk_size=300),
    "no end": lambda f, m: cut_end(write_with_mcap(f / "c.mcap", m), f / "b.mcap"),
    "split by size": lambda f, m: with_writer(f / "b", m, max_size=20_000, compression="none"),
    "sqlite3, messages compressed": lambda f, m: rosbag2_folder(f / "b", m, compression="message"),
    "disordered, no indexes": lambda f, m: write_with_mcap(f / "b.mcap", shuffled(m), **UNSORTED),
}


def columns_of(bag: Path, topic: str) -> tuple[Any, Any]:
    """Stamps [ns] and values, one row per message."""
    found = angles(bag, topic)
    return np.array([stamp for stamp, _ in found]), np.array([values for _, values in found])


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Log that a replay with a given configuration writes; it has the form of the node's."""
    folder = tmp_path_factory.mktemp("log")
    bag = write_with_mcap(folder / "b.mcap", samples())
    replay(bag, folder / "log", CONFIG)
    return folder / "log"


def test_outputs_are_what_one_computation_gives(log: Path) -> None:
    predicted = transmission_error(DRIVE, ANGLE, TORQUE, map_of(CONFIG.joints[0]))
    stamps, values = columns_of(log, "/hd_diag/transmission_error")
    assert_array_equal(stamps, STAMPS)
    assert_array_equal(values, np.column_stack((predicted, TORQUE)))
    stamps, values = columns_of(log, "/hd_diag/residual")
    assert_array_equal(stamps, STAMPS)
    assert_array_equal(values[:, 0], OUTPUT - ANGLE / RATIO - predicted)
    found = content(log)
    assert len(found["/diagnostics"]) == 3
    assert len(found["/hd_diag/a/backlash"]) == 50


def test_every_pair_of_arrays_has_the_stamp_of_its_sample(log: Path) -> None:
    """The arrays' stamps identify the sample in the bag, and the arrays are the mesh at that sample."""
    found = [content(log)[f"/hd_diag/a/{what}"] for what in ("stamp", "backlash", "load")]
    assert len({tuple(time for time, _ in messages) for messages in found}) == 1
    for (_, header), (_, backlash), (_, load) in zip(*found, strict=True):
        sec, nanosec = np.frombuffer(header, np.int32, 2, 4).tolist()
        (at,) = np.flatnonzero(sec * 10**9 + nanosec == STAMPS)
        state = mesh_state(DRIVE, ANGLE[[at]], DRIVE.frame.cup_torque(TORQUE[[at]]))
        for data, values in ((backlash, state.backlash), (load, state.load)):
            assert_array_equal(np.frombuffer(data[-values.nbytes :]), values.ravel())


@pytest.mark.parametrize("way", WAYS)
def test_outputs_are_the_same_whatever_the_bag(tmp_path: Path, log: Path, way: str) -> None:
    result = replay(WAYS[way](tmp_path, samples()), tmp_path / "out", CONFIG)
    assert content(tmp_path / "out") == content(log)
    assert (result.messages, result.joints) == (COUNT, ("a",))
    assert result.rejected == result.missed == {"a": 0, "b": 0}
    assert bool(result.problems) == (way == "no end")


def test_joints_of_several_topics_that_appear_late(tmp_path: Path) -> None:
    """Joint b has its own topic and begins after a second; a third topic has neither joint."""
    rows = list(zip(STAMPS.tolist(), ANGLE, OUTPUT, strict=True))
    topic = "/arm/joint_states"
    late = [(topic, JOINT_STATE, message(s, {"b_motor": x, "b": y}), s + 100) for s, x, y in rows[1000:]]
    other = [("/gripper", JOINT_STATE, message(s, {"finger": 0.1}), s) for s, *_ in rows[::10]]
    messages = sorted(samples() + late + other, key=lambda entry: entry[3])
    result = replay(write_with_mcap(tmp_path / "b.mcap", messages), tmp_path / "out.mcap", CONFIG)
    found = angles(tmp_path / "out.mcap", "/hd_diag/transmission_error")
    table = map_of(CONFIG.joints[1])
    predicted = transmission_error(DRIVE, ANGLE[1000:], np.zeros(COUNT - 1000), table)
    joint_b = [values for stamp, values in found if values[1] == 0.0]
    assert len(found) == 2 * COUNT - 1000
    assert_array_equal(joint_b, np.column_stack((predicted, np.zeros(COUNT - 1000))))
    assert result.joints == ("a", "b")
    only = replay(tmp_path / "b.mcap", tmp_path / "only.mcap", CONFIG, topics=(topic,))
    assert only.joints == ("b",)
    assert set(content(tmp_path / "only.mcap")) >= {topic, "/hd_diag/b/load"}
    assert "/joint_states" not in content(tmp_path / "only.mcap")
    with pytest.raises(BagError, match="has no topic /nowhere with sensor_msgs/msg/JointState"):
        replay(tmp_path / "b.mcap", tmp_path / "no.mcap", CONFIG, topics=("/nowhere",))
    bag = write_with_mcap(tmp_path / "none.mcap", [("/text", STRING, string("x"), START)])
    with pytest.raises(BagError, match="has no topic with sensor_msgs/msg/JointState"):
        replay(bag, tmp_path / "no.mcap", CONFIG)


def test_a_bag_with_its_own_joint_state_is_read_by_its_own_definition(tmp_path: Path) -> None:
    """It is copied in the ROS 2 Jazzy definition, which the outputs have."""
    head, _, rest = definition(JOINT_STATE).text.partition("string[] name")
    text = f"{head}float64 cycle_time\nstring[] name{rest}"
    bag = tmp_path / "b.mcap"
    with BagWriter(bag) as writer:
        writer.add_topic("/joint_states", JOINT_STATE, None, Definition(JOINT_STATE, text, "ros2msg", ""))
        for _, _, data, time in samples()[:200]:
            # The field is aligned to 8 after header and empty frame (16 bytes after the CDR header).
            writer.write("/joint_states", JOINT_STATE, data[:20] + b"\0" * 8 + data[20:], time)
    assert replay(bag, tmp_path / "out.mcap", CONFIG).rejected["a"] == 0
    found = angles(tmp_path / "out.mcap", "/hd_diag/transmission_error")
    assert [(at, load) for at, (_, load) in found] == [*zip(STAMPS[:200], TORQUE[:200], strict=True)]
    copied = content(tmp_path / "out.mcap")["/joint_states"]
    assert copied == [(time, data) for _, _, data, time in samples()[:200]]


def test_a_nodes_outputs_are_no_input(tmp_path: Path, log: Path) -> None:
    """Outputs under any node name are recognised by the joints' own names."""
    messages = samples()
    messages += [
        (f"/left/hd_diag/{topic}", JOINT_STATE, message(s, {"a": 1e-4}, {"a": 0.0}), s + 1)
        for topic in ("transmission_error", "residual", "measured_transmission_error")
        for s in STAMPS[::5].tolist()
    ]
    replay(write_with_mcap(tmp_path / "b.mcap", messages), tmp_path / "out.mcap", CONFIG)
    found = content(tmp_path / "out.mcap")
    assert found["/hd_diag/residual"] == content(log)["/hd_diag/residual"]


def test_reports_go_on_while_a_joint_is_silent_but_not_for_days(tmp_path: Path) -> None:
    """A ten-second silence is reported throughout; of a two-day silence only the last second is."""
    parts = (0, 10 * 10**9, 2 * 86_400 * 10**9)
    times = [START + part + i * MS for part in parts for i in range(1500)]
    messages = [("/joint_states", JOINT_STATE, message(s, {"a_motor": 0.1}), s) for s in times]
    replay(write_with_mcap(tmp_path / "b.mcap", messages), tmp_path / "out.mcap", CONFIG)
    reports = content(tmp_path / "out.mcap")["/diagnostics"]
    assert reports == sorted(reports, key=lambda report: report[0])
    every = (jazzy().deserialize_cdr(data, DIAGNOSTICS).status[0].values for _, data in reports)
    found = [{pair.key: pair.value for pair in values} for values in every]
    assert 14 <= len(found) <= 18
    assert [status["fault_code"] for status in found].count("STALE") >= 8
    assert max(float(status["silence_s"]) for status in found) > 2 * 86_000
    assert (found[-1]["silence_s"], found[-1]["samples"]) == ("0", str(3 * 1500))


def test_times_that_ros_does_not_have_are_refused(tmp_path: Path) -> None:
    late = 2**31 * 10**9
    bag = write_with_mcap(tmp_path / "b.mcap", [*samples()[:3], (*samples()[0][:3], late)])
    with pytest.raises(BagError, match="2038"):
        replay(bag, tmp_path / "out.mcap", CONFIG)


def test_after_an_error_no_reader_takes_the_output_for_whole(tmp_path: Path) -> None:
    bag = write_with_mcap(tmp_path / "b.mcap", samples(), chunk_size=20_000, compression="none")
    data = bytearray(bag.read_bytes())
    data[len(data) // 2] ^= 0xFF
    bag.write_bytes(data)
    with pytest.raises(BagError, match="damaged"):
        replay(bag, tmp_path / "out.mcap", CONFIG)
    with BagReader(tmp_path / "out.mcap") as reader:
        assert reader.problems


GOOD = {"event": "configuration", "new": True, "parameters": dict(CONFIG.flat)}
HOSTILE: dict[str, list[Any]] = {
    "no JSON": ["{"],
    "no object": ["[]"],
    "a number": ["7"],
    "deep": ["[" * 100_000],
    "no kind": ["{}"],
    "no beginning": [{"event": "map", "joint": "a", "torque_limit": 1.0}],
    "kind of another type": [{"event": ["map"]}],
    "no parameters": [{"event": "configuration", "new": True}],
    "parameters are no object": [{**GOOD, "parameters": [1, 2]}],
    "new is no boolean": [{**GOOD, "new": "yes"}],
    "topics are no texts": [{**GOOD, "topics": {"joint_states": 3}}],
    "no joints": [{**GOOD, "parameters": {}}],
    "joints are no names": [{**GOOD, "parameters": {"joints": [1, None]}}],
    "an unknown parameter": [{**GOOD, "parameters": {**CONFIG.flat, "a.nonsense": 1.0}}],
    "nan": [{**GOOD, "parameters": {**CONFIG.flat, "a.torque": float("nan")}}],
    "a huge number": [{**GOOD, "parameters": {**CONFIG.flat, "a.torque": 10**400}}],
    "an impossible geometry": [{**GOOD, "parameters": {**CONFIG.flat, "a.neutral_curve.semi_major": 9.0}}],
    "many joints": [{**GOOD, "parameters": {"joints": [f"j{i}" for i in range(200_000)]}}],
    "joints that change": [GOOD, {"event": "configuration", "parameters": {"joints": ["a", "b", "c"]}}],
    "a map of nobody": [GOOD, {"event": "map", "joint": "z", "torque_limit": 1.0}],
    "a map without limit": [GOOD, {"event": "map", "joint": "a"}],
    "a map with no number": [GOOD, {"event": "map", "joint": "a", "torque_limit": "1"}],
    "a map to nan": [GOOD, '{"event": "map", "joint": "a", "torque_limit": NaN}'],
    "a map to infinity": [GOOD, '{"event": "map", "joint": "a", "torque_limit": 1e999}'],
    "a map to minus one": [GOOD, {"event": "map", "joint": "a", "torque_limit": -1.0}],
    "a report without facts": [GOOD, {"event": "report", "stamp": 5}],
    "a report with other facts": [GOOD, {"event": "report", "stamp": 5, "facts": {"log_state": 5}}],
    "a report at no time": [GOOD, {"event": "report", "stamp": 2**63, "facts": {}}],
    "a report at a text": [GOOD, {"event": "report", "stamp": "now", "facts": {}}],
}


def bag_of_events(path: Path, events: list[Any]) -> Path:
    texts = [event if isinstance(event, str) else json.dumps(event) for event in events]
    made = [("/hd_diag/events", STRING, string(text), START + i) for i, text in enumerate(texts)]
    return write_with_mcap(path, [*made, *samples()[:10]])


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_log_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    bag = bag_of_events(tmp_path / "b.mcap", HOSTILE[kind])
    with pytest.raises((BagError, ConfigError)) as caught:
        replay(bag, tmp_path / "out.mcap")
    text = str(caught.value)
    assert ("b.mcap" in text, "\n" in text, len(text) < 900) == (True, False, True)


def test_a_log_without_its_beginning_says_so(tmp_path: Path) -> None:
    bag = bag_of_events(tmp_path / "b.mcap", HOSTILE["no beginning"])
    with pytest.raises(BagError, match="does not begin with a configuration"):
        replay(bag, tmp_path / "out.mcap")


def test_events_of_later_versions_are_passed_over(tmp_path: Path) -> None:
    bag = bag_of_events(tmp_path / "b.mcap", [GOOD, {"event": "coffee", "sugar": None}])
    assert replay(bag, tmp_path / "out.mcap").messages == 12


def test_a_log_that_begins_anew_is_followed(tmp_path: Path) -> None:
    """As in joined logs: the second beginning discards the first's samples."""
    other = dict(resolve(parameters("a", a__torque=2.5)).flat)
    again, late = {"event": "configuration", "new": True, "parameters": other}, START + 10**9
    made = [("/hd_diag/events", STRING, string(json.dumps(GOOD)), START), *samples()[:10]]
    made.append(("/hd_diag/events", STRING, string(json.dumps(again)), late))
    inputs = [message(START + i, {"a_motor": 0.1}) for i in range(5)]
    made += [("/joint_states", JOINT_STATE, data, late + 1 + i) for i, data in enumerate(inputs)]
    result = replay(write_with_mcap(tmp_path / "b.mcap", made), tmp_path / "out.mcap")
    assert result.rejected == {"a": 0}
    found = angles(tmp_path / "out.mcap", "/hd_diag/transmission_error")
    assert [values[1] for _, values in found[10:]] == [2.5] * 5


def rewritten(log: Path, path: Path, change: dict[str, Any]) -> Path:
    made = []
    for topic, kind, data, time in messages_of(log):
        event = json.loads(read_string(data)) if kind == STRING else {}
        if event.get("new"):
            data = string(json.dumps(event | {"versions": event["versions"] | change}))
        made.append((topic, kind, data, time))
    return with_writer(path, made)


def test_a_log_names_its_versions_and_the_same_ones_are_no_problem(tmp_path: Path) -> None:
    log = log_of(tmp_path / "log.mcap")
    event = read_event(content(log)["/hd_diag/events"][0][1])
    packages = {name: metadata.version(name) for name in ("numpy", "scipy", "numba")}
    own = {"hd_diag": hd_diag.__version__, "python": platform.python_version()}
    assert event["versions"] == versions.running() == own | packages
    assert replay(log, tmp_path / "out.mcap").problems == []


@pytest.mark.parametrize(
    ("name", "found", "told"), [("numpy", "1.0", "1.0"), ("numba", "0\n", "0\\n"), ("numpy", None, "absent")]
)
def test_other_versions_are_one_warning(name: str, found: str | None, told: str, tmp_path: Path) -> None:
    log = rewritten(log_of(tmp_path / "log.mcap"), tmp_path / "other.mcap", {name: found, "cobol": "85"})
    told = f"{name} {told} (here {versions.running()[name] or 'absent'})"
    result = command("replay", log, "--out", tmp_path / "out.mcap")
    assert result.exit_code == 0
    assert result.stderr == f"warning: {log}: was recorded with {told}: outputs may differ by rounding\n"


@pytest.mark.parametrize("given", [[], "1.0", {"numpy": 1}, {"numpy": ["2"]}, None])
def test_versions_that_are_none_are_refused(given: Any) -> None:
    content = {"event": "configuration", "new": True, "parameters": {}, "versions": given}
    with pytest.raises(ValueError, match="versions"):
        read_event(string(json.dumps(content)))
