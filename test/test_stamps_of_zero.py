"""Header stamps that are zero or constant, and arrays shorter than the names: their replacements."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from bag_samples import JOINT_STATE, joint_state_cdr, write_with_mcap
from cli_runner import hd_diag
from faults import parameter_file
from joint_records import joint
from logs import replayed
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.bag import BagReader
from hd_diag.config.configuration import resolve
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.messages.joint_states import JointStateReader
from hd_diag.records.contents import contents, pairs
from hd_diag.records.joint_record import read_bags
from hd_diag.replay.replay import replay
from hd_diag.streams.alignment import Alignment, Names

COUNT, START, STEP = 1000, 10**18, 5_000_000
LOG = START + STEP * np.arange(COUNT)
ANGLE = 0.05 * np.arange(COUNT)
OUTPUT = ANGLE / 100.0 + 1e-5 * np.random.default_rng(0).standard_normal(COUNT)
EFFORT = 20.0 * np.sin(0.3 * ANGLE)
NAMES = ("joint_1_motor", "joint_1")
Message = tuple[str, str, bytes, int]


def messages(topic: str, stamps: np.ndarray, names: tuple[str, ...] = NAMES, late: int = 0) -> list[Message]:
    position = np.stack([ANGLE if name.endswith("motor") else OUTPUT for name in names], axis=1)
    states = encode_joint_states(names, stamps, position, None, np.tile(EFFORT[:, None], (1, len(names))))
    times = (LOG + late).tolist()
    return [(topic, JOINT_STATE, row.tobytes(), t) for row, t in zip(states, times, strict=True)]


def bag(path: Path, *given: list[Message]) -> Path:
    return write_with_mcap(path, sorted(itertools.chain(*given), key=lambda message: message[3]))


@pytest.fixture(scope="module")
def zeros(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag(tmp_path_factory.mktemp("zeros") / "a.mcap", messages("/joint_states", 0 * LOG))


def test_stamps_of_zero_are_the_time_of_reception_and_that_is_said(zeros: Path, tmp_path: Path) -> None:
    record = read_bags([zeros], joint())
    assert (record.stamps.unstamped, record.stamps.refused, record.stamps.set_back) == (COUNT, 0, 0)
    assert_allclose(record.time, (LOG - START) * 1e-9, atol=1e-12)
    assert_allclose(record.input_angle, ANGLE, atol=1e-9)
    result = hd_diag("diagnose", zeros, "--orders-only", "--json", tmp_path / "d.json")
    assert f"The stamps of {COUNT} messages are zero" in result.stdout
    assert json.loads((tmp_path / "d.json").read_text())["record"]["stamps_zero"] == COUNT
    assert "time of reception" in hd_diag("topics", zeros).stdout


def test_a_simulation_s_clock_begins_at_zero(tmp_path: Path) -> None:
    """Reception, far from the other stamps, replaces it; most stamps give the rate, none is set back."""
    path = bag(tmp_path / "a.mcap", messages("/joint_states", LOG - START))
    result = hd_diag("topics", path, "--json", tmp_path / "t.json")
    assert f"the stamps of 1 of {COUNT} messages are zero" in result.stdout
    (topic,) = json.loads((tmp_path / "t.json").read_text())["topics"]
    assert topic["rate"] == pytest.approx(200.0, rel=1e-3)
    record = read_bags([path], joint())
    assert (record.stamps.unstamped, record.stamps.set_back, record.stamps.refused) == (1, 0, 0)
    assert record.size >= COUNT - 1


def test_a_replay_of_them_is_reproduced_to_the_last_bit(zeros: Path, tmp_path: Path) -> None:
    result = replay(zeros, tmp_path / "log", resolve({"array_rate": 0.0}))
    assert (result.rejected, result.stamps_zero) == ({"joint_1": 0}, {"joint_1": COUNT})
    replayed(tmp_path / "log")


@pytest.mark.parametrize("step", [1, 7, COUNT])
def test_one_message_or_many_give_the_same(step: int) -> None:
    """The first three, some in between, and the last are zero."""
    stamps = LOG - START + 10**9
    stamps[[0, 1, 2, 500, COUNT - 1]] = 0
    rows = [data for *_, data, _ in messages("/j", stamps)]
    whole, parts = Alignment([Names(*NAMES)]), Alignment([Names(*NAMES)])
    shapes, _ = JointStateReader({}).columns(rows, LOG)
    expected, found, reader = whole.take(LOG, shapes), [], JointStateReader({})
    for begin in range(0, COUNT, step):
        received, part = LOG[begin : begin + step], rows[begin : begin + step]
        given = [reader.one(part[0], received)] if step == 1 else reader.columns(part, received)[0]
        found.append(parts.take(received, given))
    for column in ("stamp", "stretch", "input_angle", "output_angle"):
        assert_array_equal(np.concatenate([getattr(f, column) for f in found]), getattr(expected, column))
    assert whole.joints["unstamped"][0] == parts.joints["unstamped"][0] == 5
    assert whole.joints["rejected"][0] == 0


def test_stamps_that_stay_the_same_have_a_mapping_that_topics_writes(tmp_path: Path) -> None:
    path = bag(tmp_path / "a.mcap", messages("/joint_states", 0 * LOG + START))
    result = hd_diag("diagnose", path, "--orders-only")
    assert (result.exit_code, "`stamp: reception`" in result.stderr) == (2, True)
    assert hd_diag("topics", path, "--json", tmp_path / "t.json").exit_code == 0
    mapping = json.loads((tmp_path / "t.json").read_text())["mapping"]
    assert yaml.safe_load(mapping)["hd_diag"]["ros__parameters"]["joint_1"]["input"]["stamp"] == "reception"
    (tmp_path / "c.yaml").write_text(mapping)
    mapped = joint(input__stamp="reception")
    assert_allclose(read_bags([path], mapped).input_angle, ANGLE, atol=1e-9)
    assert hd_diag("check", tmp_path / "c.yaml").exit_code == 0


def test_of_two_topics_one_with_stamps_of_another_clock(tmp_path: Path) -> None:
    """Motor stamps are zero, link stamps from a clock an hour late: reception gives both one clock."""
    motor = messages("/motor", 0 * LOG, NAMES[:1])
    path = bag(tmp_path / "a.mcap", motor, messages("/link", LOG - 3600 * 10**9, NAMES[1:], late=1000))
    result = hd_diag("diagnose", path, "--orders-only")
    assert (result.exit_code, "`stamp: reception`" in result.stderr) == (2, True)
    record = read_bags([path], joint(output_signal__topic="/link", output_signal__stamp="reception"))
    assert record.size > 0.99 * COUNT
    assert_allclose(record.output_angle - record.input_angle / 100.0, 0.0, atol=1e-4)


def states_with(effort: int, velocity: int = 0, positions: int = 2) -> list[Message]:
    rows = [
        joint_state_cdr(NAMES, t, (x, y)[:positions], velocity * (0.5,), effort * (m,))
        for t, x, y, m in zip(LOG.tolist(), ANGLE, OUTPUT, EFFORT, strict=True)
    ]
    return [("/joint_states", JOINT_STATE, row, t) for row, t in zip(rows, LOG.tolist(), strict=True)]


@pytest.mark.parametrize(("effort", "velocity"), [(1, 0), (0, 1), (1, 1), (3, 0), (5, 1), (2, 1)])
def test_what_is_not_mapped_is_not_checked(effort: int, velocity: int, tmp_path: Path) -> None:
    """`topics`, `diagnose` and `replay` agree; fitting efforts are read regardless of velocities."""
    path = bag(tmp_path / "a.mcap", states_with(effort, velocity))
    with BagReader(path) as reader:
        ((_, _, slope),) = pairs(contents(reader, reader.topics[:1])[0].numbers)
    assert abs(slope - 100.0) < 0.1
    mapped = {"input__field": "position[joint_1_motor]", "output_signal__field": "position[joint_1]"}
    for config in (joint(), joint(**mapped)):
        record = read_bags([path], config)
        assert (record.size, record.stamps.refused, record.has_torque) == (COUNT, 0, effort == 2)
        assert_allclose(record.output_angle, OUTPUT, atol=1e-9)
    result = replay(path, tmp_path / "out", resolve({"array_rate": 0.0}))
    assert result.rejected == {"joint_1": 0}


def test_what_is_mapped_is_checked(tmp_path: Path) -> None:
    path = bag(tmp_path / "a.mcap", states_with(1))
    result = read_bags([path], joint(torque_signal__field="effort[0]"))
    assert_allclose(result.reported_torque, EFFORT, atol=1e-9)
    (tmp_path / "c.yaml").write_text(parameter_file(joint_1__torque_signal__field="effort[joint_1]"))
    told = hd_diag("diagnose", path, "--config", tmp_path / "c.yaml")
    assert (told.exit_code, "has 1 values of effort for 2 names" in told.stderr) == (2, True)
    told = hd_diag("diagnose", bag(tmp_path / "b.mcap", states_with(2, positions=1)))
    assert (told.exit_code, "has 1 values of position for 2 names" in told.stderr) == (2, True)
