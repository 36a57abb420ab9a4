"""A log for every start, and which of the oldest files go: never others', never what is being written."""

import logging
import os
import re
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
from bag_samples import STRING, string_cdr
from live import START

from hd_diag.bag import RELIABLE, BagReader, BagWriter, LogFolder, Retention, retention
from hd_diag.bag.retention import delete, surplus
from hd_diag.config.configuration import LogConfig
from hd_diag.ros.diagnosis_run import DiagnosisRun
from hd_diag.ros.log_writer import LogWriter

TEXT = string_cdr("x" * 5000)
DATE = r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(-\d+)?"


def log(path: Path, messages: int = 3, **options: object) -> LogWriter:
    """A log of a start, each message of which is over the size of a file.

    Nothing is synced to the disk: a file stays while it is.
    """
    config = LogConfig(str(path), compression="none", flush_period=0.0, sync_period=0.0, **options)  # type: ignore[arg-type]
    writer = LogWriter(config)
    fill(writer, messages)
    return writer


def fill(writer: LogWriter, messages: int, first: int = 0) -> None:
    for number in range(first, first + messages):
        writer.split_if_due(START + number)
        writer.write("/x", STRING, TEXT, START + number)
        writer.flush_if_due()


def settled(writer: LogWriter) -> None:
    """Whatever is to go has gone."""
    for _ in range(20):
        writer.split_if_due(START)
        writer.flush_if_due()
        writer._retention._next = 0.0
        if job := writer._retention._job:
            job.result()


def lying(folder: Path) -> list[str]:
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())


def messages_in(bag: Path) -> int:
    with BagReader(bag) as reader:
        assert not reader.problems
        return reader.message_count


@pytest.mark.parametrize("name", ["arm", "arm.mcap"])
def test_every_start_has_a_log_of_its_own(tmp_path: Path, name: str) -> None:
    """In the same second too, and where a log of an older version or somebody's file lies there."""
    if name == "arm.mcap":
        (tmp_path / name).write_text("somebody's")
    else:
        (tmp_path / name).mkdir()
    logs = [log(tmp_path / name) for _ in range(3)]
    bags = [Path(each.state.removeprefix("writing ")) for each in logs]
    for each in logs:
        each.close()
        assert each.state == "off"
    pattern = rf"arm_{DATE}\.mcap" if name == "arm.mcap" else DATE
    assert all(re.fullmatch(pattern, bag.name) for bag in bags)
    assert len(set(bags)) == 3
    assert [messages_in(bag) for bag in bags] == [3] * 3
    if name == "arm.mcap":
        assert (tmp_path / name).read_text() == "somebody's"


def test_a_file_that_is_not_there_yet_has_the_name_itself(tmp_path: Path) -> None:
    first, second = log(tmp_path / "arm.mcap"), log(tmp_path / "arm.mcap")
    assert first.state == f"writing {tmp_path / 'arm.mcap'}"
    assert re.fullmatch(rf"writing {tmp_path}/arm_{DATE}\.mcap", second.state)
    first.close()
    second.close()


@pytest.mark.parametrize(("name", "overwrite"), [("arm", False), ("arm", True), ("arm.mcap", False)])
def test_the_oldest_go_until_the_rest_is_within_the_size(tmp_path: Path, name: str, overwrite: bool) -> None:
    """The files of this start, and of others; metadata tell what is left. Files are cut small enough."""
    path = tmp_path / name
    others = [
        path / "notes.txt",
        path / "2026-01-01_00-00-00" / "2026-01-01_00-00-00_0.mcap",
        path / "a_0.mcap",
    ]
    if name == "arm":
        others[1].parent.mkdir(parents=True)
    else:
        others = [tmp_path / "arm_2.mcap", tmp_path / "army.mcap", tmp_path / "other_1.mcap"]
    for file in others:
        file.write_bytes(b"\x89MCAP0\r\nsomebody's" + bytes(100_000))
        os.utime(file, (0, 0))
    before = log(path, 40, split_size=20_000, overwrite=overwrite)
    before.close()
    now = log(path, 100, max_size=100_000, overwrite=overwrite)
    settled(now)
    own = sorted(LogFolder(path, overwrite).files(), key=lambda file: file.stat().st_mtime_ns)
    assert not set(own) & set(others)
    assert 50_000 < sum(file.stat().st_size for file in own) <= 100_000
    newest = now._writer.paths  # type: ignore[union-attr]
    assert set(own) == set(newest)
    fill(now, 5, 100)
    assert now.facts["log_lost"] == "0"
    now.close()
    assert all(file.read_bytes().endswith(bytes(1000)) for file in others)
    kept = [messages_in(file) for file in LogFolder(path, overwrite).files()]
    assert all(0 < count <= 3 for count in kept)
    if (name, overwrite) == ("arm", False):
        assert messages_in(newest[0].parent) == sum(kept)


def test_old_files_go_one_by_one_then_their_folder(tmp_path: Path) -> None:
    before = log(tmp_path / "arm", 9, split_size=15_000)
    bag = Path(before.state.removeprefix("writing "))
    before.close()
    files = sorted(bag.glob("*.mcap"))
    assert [messages_in(file) for file in files] == [3, 3, 3]
    total = sum(file.stat().st_size for file in files)
    for left, limit in ((2, total - 1), (1, total - 30_000)):
        retention = Retention(LogFolder(tmp_path / "arm"), limit, 0.0)
        for _ in range(20):
            retention.look(None, time.monotonic(), at_once=True)
            if job := retention._job:
                job.result()
        retention.close()
        assert retention.problem == ""
        assert sorted(bag.glob("*.mcap")) == files[-left:]
        assert messages_in(bag) == 3 * left
    os.utime(files[-1], (time.time() - 100.0,) * 2)
    now = log(tmp_path / "arm", 1, max_age=50.0)
    settled(now)
    assert not bag.exists()
    now.close()


def test_what_another_node_is_writing_stays(tmp_path: Path) -> None:
    other, own = log(tmp_path / "arm", 20, split_size=1), log(tmp_path / "arm", 1)
    bag = other._writer.path  # type: ignore[union-attr]
    assert surplus(LogFolder(tmp_path / "arm"), 1, 0.0) == []
    other.close()
    assert len(surplus(LogFolder(tmp_path / "arm"), 1, 0.0)) == len([*bag.glob("*.mcap")]) == 20
    own.close()


def test_what_a_diagnosis_reads_and_writes_stays_until_it_has_ended(tmp_path: Path) -> None:
    """A file that has gone before is not read."""
    writer, diagnosis = log(tmp_path / "arm", 20, split_size=1), DiagnosisRun(print, logging.getLogger())
    files, folder = writer._writer.paths, LogFolder(tmp_path / "arm")  # type: ignore[union-attr]
    verdict = files[0].with_name("verdict_2026-01-01_00-00-00.yaml")
    verdict.write_text("of a diagnosis under way")
    assert diagnosis._keep([*files[:3], tmp_path / "gone.mcap", verdict]) == [*files[:3], verdict]
    assert {*surplus(folder, 1, 0.0, files)} == {*files[3:-1]}
    writer.close()
    assert {*surplus(folder, 1, 0.0)} == {*files[3:]}
    for file in files:
        delete(file)
    assert verdict.exists()
    diagnosis.close()
    files[0].write_bytes(b"")
    delete(files[0])
    assert not verdict.parent.exists()


def test_a_diagnosis_and_the_deletion_of_old_files_may_begin_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither does what a diagnosis has begun to read go, nor does one begin with what is on its way out."""
    goes_on = threading.Event()

    def slowly(file: Path, own: Sequence[Path]) -> None:
        goes_on.wait(30.0)
        delete(file, own)

    monkeypatch.setattr(retention, "delete", slowly)
    writer, diagnosis = log(tmp_path / "arm", 0, split_size=1), DiagnosisRun(print, logging.getLogger())
    for number in range(20):
        writer.split_if_due(START + number)
        writer.write("/x", STRING, TEXT, START + number, RELIABLE)
        writer.flush_if_due()
    every, keeper = writer._writer.paths, Retention(LogFolder(tmp_path / "arm"), 1, 0.0)  # type: ignore[union-attr]
    writer._retention = keeper
    assert writer.finished(0.0) == every[:-1]
    writer.flush_if_due()
    assert keeper._job is not None
    assert keeper._job.result() == every[:-1]  # all that are to go
    diagnosis._keep(every[:3])
    writer.flush_if_due()
    assert writer.finished(0.0) == every[:3]
    goes_on.set()
    keeper._job.result()
    assert [file.exists() for file in every] == [True] * 3 + [False] * 16 + [True]
    diagnosis.close()
    writer.close()
    assert messages_in(every[0].parent) == 4


def test_a_file_that_cannot_be_deleted_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = log(tmp_path / "arm", 2)
    bag = Path(before.state.removeprefix("writing "))
    before.close()
    os.utime(next(bag.glob("*.mcap")), (0, 0))

    unlink = Path.unlink

    def refused(self: Path, missing_ok: bool = False) -> None:
        if self.suffix == ".mcap":
            raise PermissionError(13, "Permission denied", str(self))
        unlink(self, missing_ok)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", refused)
        now = log(tmp_path / "arm", 1, max_age=1000.0)
        settled(now)
        assert re.search(r"_0\.mcap: cannot be deleted: Permission denied", now.facts["log_warning"])
        assert now.state.startswith("writing ")
    settled(now)
    assert now.facts["log_warning"] == ""
    assert not bag.exists()
    now.close()


def test_a_folder_of_logs_is_no_bag_and_says_which_is_the_last(tmp_path: Path) -> None:
    log(tmp_path / "arm").close()
    (bag,) = (tmp_path / "arm").iterdir()
    with pytest.raises(ValueError, match=f"the last bag in it is {bag}"):
        BagReader(tmp_path / "arm")


def test_a_writer_counts_what_is_gone(tmp_path: Path) -> None:
    """After an error too: what was written is not lost for having been deleted."""
    writer = BagWriter(tmp_path / "bag", compression="none")
    for number in range(3):
        writer.write("/x", STRING, TEXT, START + number)
        writer.split()
    writer.take_away(writer.paths[:2])
    writer.resume()
    assert writer.counts == {"/x": 3}
    writer.close()
