"""A recorder's clock that is set back: the file's order stays; messages merely out of order are sorted."""

from pathlib import Path

import numpy as np
import pytest
from bag_samples import JOINT_STATE, rosbag2_folder, rows, string_cdr, write_with_mcap
from logs import replayed
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.bag import BagReader, BagWriter
from hd_diag.config.configuration import resolve
from hd_diag.messages.encoding import encode_joint_states
from hd_diag.records.contents import contents, pairs
from hd_diag.records.joint_record import read_bags
from hd_diag.replay.replay import replay

MS, SECOND = 1_000_000, 1_000_000_000
START = 10**18
Message = tuple[str, str, bytes, int]
STRING = "std_msgs/msg/String"


def two_topics(count: int, back: float | np.ndarray, at: int = 300) -> list[Message]:
    """Messages every 10 ms on two alternating topics; from index `at` on, the clock is ``back`` late [s]."""
    late = np.where(np.arange(count) < at, 0, np.rint(np.multiply(back, SECOND)).astype(np.int64))
    times = START + 10 * MS * np.arange(count) - late
    return [("/ab"[:1] + "ab"[i % 2], STRING, string_cdr(f"{i}"), int(t)) for i, t in enumerate(times)]


WAYS = {
    "one chunk": lambda f, m: write_with_mcap(f / "a.mcap", m),
    "small chunks": lambda f, m: write_with_mcap(f / "a.mcap", m, chunk_size=700),
    "tiny chunks": lambda f, m: write_with_mcap(f / "a.mcap", m, chunk_size=1),
    "no chunks": lambda f, m: write_with_mcap(f / "a.mcap", m, chunked=False),
    "no summary": lambda f, m: write_with_mcap(f / "a.mcap", m, chunk_size=700, summary=False, indexes=False),
    "sqlite3": lambda f, m: rosbag2_folder(f / "bag", m),
}


def read(path: Path, topics: list[str] | None = None) -> list[int]:
    with BagReader(path) as reader:
        every = [bytes(data) for batch in reader.batches(topics) for data in batch.messages()]
    return [int(data[8:-1]) for data in every]


OFTEN = np.repeat([0.0, 2.0, 7.0, -20.0, -3.0], 100)


CLOCKS = [*((way, back) for way in WAYS for back in (2.0, OFTEN))]


@pytest.mark.parametrize(("way", "back"), [*CLOCKS, *(("small chunks", far) for far in (0.353, 3600.0, 1e9))])
def test_the_order_of_the_file_is_kept(way: str, back: float | np.ndarray, tmp_path: Path) -> None:
    """The clock is set back once, or repeatedly and also forward."""
    path = WAYS[way](tmp_path, two_topics(500, back, at=0 if back is OFTEN else 300))
    assert read(path) == list(range(500))
    assert read(path, ["/b"]) == list(range(1, 500, 2))


@pytest.mark.parametrize("back", [0.0, 2.0])
@pytest.mark.parametrize("way", WAYS)
def test_what_threads_write_out_of_turn_is_sorted(way: str, back: float, tmp_path: Path) -> None:
    """Blocks of seven messages within 0.28 s are sorted, but not across the step of the clock."""
    chance, given = np.random.default_rng(3), two_topics(602, back, at=280)
    blocks = [given[i : i + 7] for i in range(0, 602, 7)]
    order = [int(i) for begin in range(0, len(blocks), 4) for i in begin + chance.permutation(4)]
    written = [message for i in order if i < len(blocks) for message in blocks[i]]
    assert [m[3] for m in written] != sorted(m[3] for m in written)
    assert read(WAYS[way](tmp_path, written)) == list(range(602))


@pytest.mark.parametrize("way", ["tiny chunks", "small chunks", "one chunk", "sqlite3"])
def test_a_file_of_one_topic_after_the_other_is_sorted(way: str, tmp_path: Path) -> None:
    count = 120 if way == "tiny chunks" else 600
    given = sorted(two_topics(count, 0.0), key=lambda message: message[0])
    assert read(WAYS[way](tmp_path, given)) == list(range(count))


@pytest.mark.parametrize("order", [(2, 0, 1), (1, 2, 0), (0, 2, 1), (0, 1, 2)])
def test_splits_that_are_listed_out_of_order(order: tuple[int, ...], tmp_path: Path) -> None:
    block, stamps = rows(600, START, period=10 * MS)
    with BagWriter(tmp_path / "bag", max_duration=2.0) as writer:
        writer.write_many("/j", JOINT_STATE, block, stamps)
    info = tmp_path / "bag" / "metadata.yaml"
    for i in range(3):
        info.write_text(info.read_text().replace(f"bag_{i}.mcap", f"bag_{order[i]}_.mcap"))
    info.write_text(info.read_text().replace("_.mcap", ".mcap"))
    with BagReader(tmp_path / "bag") as reader:
        assert_array_equal(np.concatenate([batch.log_time for batch in reader.batches()]), stamps)
        assert [path.name for path in reader.paths] == [f"bag_{i}.mcap" for i in range(3)]


COUNT, AT = 3000, 1700
ANGLE = np.cumsum(0.05 * np.ones(COUNT))
OUTPUT = ANGLE / 100.0 + 1e-5 * np.random.default_rng(0).standard_normal(COUNT)


def joint(path: Path, back: float, headers: bool) -> Path:
    """A joint at 200 Hz whose recorder's clock is set back, with or without the header's clock."""
    true = START + 5 * MS * np.arange(COUNT)
    log = true - np.where(np.arange(COUNT) < AT, 0, round(back * SECOND))
    stamps, angles = log if headers else true, np.column_stack((ANGLE, OUTPUT))
    states = map(bytes, encode_joint_states(("joint_1_motor", "joint_1"), stamps, angles))
    given = [("/joint_states", JOINT_STATE, row, t) for row, t in zip(states, log.tolist(), strict=True)]
    return write_with_mcap(path, given) if path.suffix == ".mcap" else rosbag2_folder(path, given)


@pytest.mark.parametrize("name", ["a.mcap", "bag"])
@pytest.mark.parametrize("back", [2.0013, 5.0, 100.0])
@pytest.mark.parametrize("headers", [True, False])
def test_a_record_begins_another_recording_there(
    name: str, back: float, headers: bool, tmp_path: Path
) -> None:
    """A new recording begins if the header stamps go back, too."""
    record = read_bags([joint(tmp_path / name, back, headers)], resolve({}).joints[0])
    assert (record.stamps.set_back, record.stamps.refused) == (int(headers), 0)
    assert np.unique(record.bag).size == 1 + headers
    assert_allclose(record.input_angle, ANGLE, atol=1e-9)
    assert_allclose(record.output_angle, OUTPUT, atol=1e-9)


def test_topics_pairs_input_and_output_of_it(tmp_path: Path) -> None:
    with BagReader(joint(tmp_path / "a.mcap", 2.0013, True)) as reader:
        ((_, _, slope),) = pairs(contents(reader, reader.topics[:1])[0].numbers)
    assert abs(slope - 100.0) < 0.1


def test_a_replay_keeps_the_order_and_so_does_one_of_it(tmp_path: Path) -> None:
    """Reports continue by the clock that was set back, even by hours."""
    bag = joint(tmp_path / "a.mcap", 7200.0, True)
    result = replay(bag, tmp_path / "log", resolve({"array_rate": 0.0}))
    assert result.rejected == {"joint_1": 0}
    assert len(replayed(tmp_path / "log")["/diagnostics"]) >= COUNT * 0.005 - 2
