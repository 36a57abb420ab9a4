"""Incomplete data never passes as complete: truncated, miscounted and damaged bags are reported."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bag_samples import cut_end, sealed
from cli_runner import hd_diag
from joint_records import columns, joint
from live import config
from test_bag_reader import NOTES, notes_folder
from test_recording import COLUMNS, Message, read, states, temperatures, whole, write, write_table

from hd_diag.bag import BagReader
from hd_diag.diagnosis.record import RecordError
from hd_diag.diagnosis.stamps import Stamps
from hd_diag.fleet.rows import judge
from hd_diag.fleet.run import survey, tasks
from hd_diag.records.tables import Table, read_tables


def told_of(bag: Path, folder: Path, *words: object) -> tuple[str, dict[str, Any]]:
    """Text and JSON of a diagnosis, or of another verb."""
    words = words or ("diagnose", bag, "--orders-only")
    result = hd_diag(*words, "--json", folder / "a.json")
    assert result.exit_code == 0, result.stderr
    return result.stdout, json.loads((folder / "a.json").read_text())


def test_text_verdict_and_json_tell_it(tmp_path: Path) -> None:
    """A bag of 20 s without its last fifth."""
    bag = write(tmp_path / "whole.mcap", whole(columns(seconds=20.0)))
    cut = cut_end(bag, tmp_path / "cut.mcap", keep=bag.stat().st_size * 4 // 5)
    told, found = told_of(cut, tmp_path)
    said = "the recording is not whole (cut.mcap: "
    assert said in told
    assert said in found["verdict"]
    assert found["record"]["problems"][0].startswith("cut.mcap: ")
    assert found["record"]["refused"] == 0


def test_what_is_told_of_two_topics_is_told_once() -> None:
    cut = Stamps(3, "a message is cut off", problems=("a.mcap: is cut off",))
    both = cut.and_then(Stamps(problems=("a.mcap: is cut off",)))
    assert both.reported["problems"] == ["a.mcap: is cut off"]
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


def test_a_count_is_but_a_hint(tmp_path: Path) -> None:
    """Columns for 2**40 messages would take 60 TB."""
    bag = write(tmp_path / "a.mcap", whole(columns(seconds=2.0)))
    data, own = bag.read_bytes(), struct.pack("<HQ", 1, 400)
    bag.write_bytes(sealed(data.replace(own, struct.pack("<HQ", 1, 2**40))))
    record = read(bag)
    assert record.size == 400
    assert record.stamps.problems == (f"a.mcap: counts {2**40} messages of /joint_states, there are 400",)


def test_a_database_that_hides_rows_is_damaged(tmp_path: Path) -> None:
    """One byte in a page of the time index gives the number of its rows."""
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


def damaged(messages: list[Message], *rows: int) -> list[Message]:
    return [
        (topic, kind, data[:50] if row in rows else data, time)
        for row, (topic, kind, data, time) in enumerate(messages)
    ]


LOST = "3 samples are left out, the last because: a message is cut off"


def test_refused_samples_are_in_the_verdict_however_few(tmp_path: Path) -> None:
    bag = write(tmp_path / "a.mcap", damaged(whole(columns(seconds=5.0)), 300, 301, 302))
    told, found = told_of(bag, tmp_path)
    assert told.count(LOST) == 1
    assert LOST in found["verdict"]
    assert found["record"]["refused"] == 3


def test_topics_a_page_of_the_motion_and_a_fleet_s_row_tell_them(tmp_path: Path) -> None:
    """One bag has only the link and can only be listed; the other has the motor, and so a motion."""
    given = columns(seconds=5.0)
    angles = {"joint_1": given["output"], "joint_1_motor": given["input"]}
    parts = (damaged(states(given["time"], (name,), (angles[name],)), 300, 301, 302) for name in angles)
    link, motor = (write(tmp_path / f"{number}.mcap", part) for number, part in enumerate(parts))
    told, found = told_of(link, tmp_path, "topics", link)
    said = "3 of 1000 messages cannot be read; the last is cut off"
    assert said in told
    assert found["topics"][0]["problem"].startswith(said)
    told, found = told_of(motor, tmp_path, "report", motor, "--out", tmp_path / "a.html")
    assert LOST in told
    assert LOST in (tmp_path / "a.html").read_text()
    assert found["refused"] == 3
    own = config()
    rows = [judge(task) for bag in (link, motor) for task in tasks(survey(str(bag)), own, own.joints)]
    assert all(row["error"] for row in rows)
    assert rows[1]["refused"] == 3
    assert rows[1]["last_refusal"].startswith("a message is cut off")


def test_temperatures_that_cannot_be_are_refused(tmp_path: Path) -> None:
    """A temperature message without content, and one whose value squares to infinity."""
    given = columns(seconds=3.0)
    warm = temperatures(np.array([0.0, 1.0, 2.0, 2.5]), np.array([20.0, 30.0, 30.0, 1e300]))
    warm[1] = (*warm[1][:2], b"", warm[1][3])
    record = read(write(tmp_path / "a.mcap", whole(given), warm))
    assert record.stamps.refused == 2
    assert record.stamps.reason == "temperature is 1e+300"
    assert np.abs(record.temperature - 25.0).max() < 6.0


@pytest.mark.parametrize(("column", "value"), [("time", 1e308), ("input", -1e308), ("torque", 1e160)])
def test_a_table_s_numbers_that_cannot_be_are_refused(column: str, value: float, tmp_path: Path) -> None:
    given = columns(seconds=3.0)
    given[column][-1] = value
    record = read_tables([write_table(tmp_path / "a.csv", given)], Table(COLUMNS), joint())
    assert (record.stamps.refused, record.size) == (1, 599)
    assert f"{column} is {value:g} " in record.stamps.reason


def test_a_table_s_lines_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,motor,link,tau\n" + "0" * (1 << 21))
    with pytest.raises(RecordError, match="a line is longer than 1048576 characters"):
        read_tables([path], Table(COLUMNS), joint())
