"""What is incomplete never passes for whole: cut off, miscounted and damaged bags are told."""

import json
import struct
from pathlib import Path

import pytest
import yaml
from cli_runner import hd_diag
from joint_records import columns, joint
from test_bag_reader import NOTES, notes_folder
from test_recording import whole, write

from hd_diag.bag import BagReader
from hd_diag.bag.joint_record import read_bags, read_motion
from hd_diag.diagnosis.screening import screened
from hd_diag.diagnosis.stamps import Stamps


@pytest.fixture(scope="module")
def cut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of 20 s of which the last fifth is not there."""
    folder = tmp_path_factory.mktemp("cut")
    bag = write(folder / "whole.mcap", whole(columns(seconds=20.0)))
    (folder / "cut.mcap").write_bytes(bag.read_bytes()[: bag.stat().st_size * 4 // 5])
    return folder / "cut.mcap"


def test_a_bag_that_is_cut_off_is_a_finding(cut: Path) -> None:
    record = read_bags([cut], joint())
    (problem,) = record.stamps.problems
    assert problem.startswith("cut.mcap: ")
    (finding,) = (f for f in screened(record, joint().drive).findings if f.name == "incomplete")
    assert problem in finding.text
    assert not finding.fatal
    motion = read_motion([cut], joint())
    assert motion is not None
    assert motion.stamps.problems == (problem,)


def test_text_verdict_and_json_tell_it(cut: Path, tmp_path: Path) -> None:
    result = hd_diag("diagnose", cut, "--orders-only", "--json", tmp_path / "a.json")
    assert result.exit_code == 0, result.stderr
    said = "the recording is not whole (cut.mcap: "
    assert said in result.stdout
    found = json.loads((tmp_path / "a.json").read_text())
    assert said in found["verdict"]
    assert found["record"]["problems"][0].startswith("cut.mcap: ")
    assert found["record"]["refused"] == 0


def test_a_few_refused_samples_are_told_beside_the_verdict() -> None:
    told = Stamps(3, "a message is cut off")
    assert told.lines == ["3 samples are left out, the last because: a message is cut off"]
    assert told.told["last_refusal"] == "a message is cut off"
    both = told.and_then(Stamps(problems=("a.mcap: is cut off",))).and_then(
        Stamps(problems=("a.mcap: is cut off",))
    )
    assert both.told["problems"] == ["a.mcap: is cut off"]
    assert len(both.lines) == 2


def test_counts_of_the_metadata_are_compared(tmp_path: Path) -> None:
    bag = notes_folder(tmp_path / "bag")
    with BagReader(bag) as reader:
        name, count = reader.topics[0].name, reader.topics[0].count
        assert reader.problems == []
    file = bag / "metadata.yaml"
    content = yaml.safe_load(file.read_text())
    content["rosbag2_bagfile_information"]["topics_with_message_count"][0]["message_count"] = count + 7
    file.write_text(yaml.safe_dump(content))
    with BagReader(bag) as reader:
        assert reader.problems == [f"metadata.yaml: counts {count + 7} messages of {name}, there are {count}"]


def test_a_file_s_own_counts_are_compared_with_what_is_read(tmp_path: Path) -> None:
    bag = write(tmp_path / "a.mcap", whole(columns(seconds=2.0)))
    data = bag.read_bytes()
    own, other = struct.pack("<HQ", 1, 400), struct.pack("<HQ", 1, 408)
    assert data.count(own) == 1
    bag.write_bytes(data.replace(own, other))
    with BagReader(bag) as reader:
        assert sum(map(len, reader.batches())) == 400
        assert reader.problems == ["a.mcap: counts 408 messages of /joint_states, there are 400"]


def test_a_database_that_hides_rows_is_damaged(tmp_path: Path) -> None:
    """One byte of a page of the index by time says how many rows are on it."""
    file = notes_folder(tmp_path / "bag") / "bag.db3"
    data = bytearray(file.read_bytes())
    size = int.from_bytes(data[16:18], "big")
    pages = [at for at in range(size, len(data), size) if data[at] == 0x0A and data[at + 4] > 2]
    data[pages[-1] + 4] -= 2
    file.write_bytes(data)
    with BagReader(file) as reader:
        assert sum(map(len, reader.batches())) < len(NOTES)
        (problem,) = reader.problems
    assert problem.startswith("bag.db3: is damaged: ")
    assert problem.endswith("`sqlite3 bag.db3 .recover | sqlite3 new.db3` saves what can be read")
