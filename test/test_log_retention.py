"""A log for every start, and deletion of the oldest files: only own files, never the open one."""

import logging
import os
import re
import threading
from pathlib import Path

import pytest
from bag_samples import STRING, string_cdr
from live import START
from logs import whole

from hd_diag.bag import RELIABLE, BagReader, BagWriter, LogFolder, Retention, retention
from hd_diag.bag.retention import delete, surplus
from hd_diag.config.configuration import LogConfig
from hd_diag.ros.diagnosis_run import DiagnosisRun
from hd_diag.ros.log_writer import LogWriter

TEXT = string_cdr("x" * 5000)
DATE = r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(-\d+)?"


def log(path: Path, messages: int = 3, **options: object) -> LogWriter:
    """A log of a start, with messages larger than the size of a file; nothing is synced to the disk."""
    options |= {"compression": "none", "flush_period": 0.0, "sync_period": 0.0}
    writer = LogWriter(LogConfig(str(path), **options))  # type: ignore[arg-type]
    fill(writer, messages)
    return writer


def fill(writer: LogWriter, messages: int, first: int = 0) -> None:
    for number in range(first, first + messages):
        writer.split_if_due(START + number)
        writer.write("/x", STRING, TEXT, START + number, RELIABLE)
        writer.flush_if_due()


def settled(writer: LogWriter) -> None:
    for _ in range(20):
        writer.split_if_due(START)
        writer.flush_if_due()
        writer._retention._next = 0.0
        if job := writer._retention._job:
            job.result()


@pytest.mark.parametrize("name", ["arm", "arm.mcap"])
def test_every_start_has_a_log_of_its_own(tmp_path: Path, name: str) -> None:
    """Also within the same second, and if a log exists already."""
    if name == "arm":
        (tmp_path / name).mkdir()
    logs = [log(tmp_path / name) for _ in range(4)]
    bags = [Path(each.state.removeprefix("writing ")) for each in logs]
    for each in logs:
        each.close()
        assert each.state == "off"
    if name == "arm.mcap":  # the first file has the plain name
        assert bags[0] == tmp_path / name
    pattern = rf"arm_{DATE}\.mcap" if name == "arm.mcap" else DATE
    assert all(re.fullmatch(pattern, bag.name) for bag in bags[1:])
    assert len(set(bags)) == 4
    assert [whole(bag) for bag in bags] == [3] * 4


@pytest.mark.parametrize(("name", "overwrite"), [("arm", False), ("arm", True), ("arm.mcap", False)])
def test_the_oldest_go_until_the_rest_is_within_the_size(tmp_path: Path, name: str, overwrite: bool) -> None:
    """Files of this start and of earlier ones count; metadata list the rest. Files are split small enough."""
    path = tmp_path / name
    names = ("arm_2.mcap", "army.mcap", "other_1.mcap")
    if name == "arm":
        date = "2026-01-01_00-00-00"
        names = ("arm/notes.txt", f"arm/{date}/{date}_0.mcap", "arm/a_0.mcap")
        (path / date).mkdir(parents=True)
    others = [tmp_path / each for each in names]
    for file in others:
        file.write_bytes(b"\x89MCAP0\r\nsomebody's" + bytes(100_000))
        os.utime(file, (0, 0))
    before = log(path, 40, split_size=20_000, overwrite=overwrite)
    before.close()
    now = log(path, 100, max_size=100_000, overwrite=overwrite)
    settled(now)
    own, newest = [*LogFolder(path, overwrite).files()], now._writer.paths  # type: ignore[union-attr]
    assert 50_000 < sum(file.stat().st_size for file in own) <= 100_000
    assert set(own) == set(newest)
    fill(now, 5, 100)
    assert now.facts["log_lost"] == "0"
    now.close()
    assert all(file.read_bytes().endswith(bytes(1000)) for file in others)
    kept = [whole(file) for file in LogFolder(path, overwrite).files()]
    assert all(0 < count <= 3 for count in kept)
    if (name, overwrite) == ("arm", False):
        assert whole(newest[0].parent) == sum(kept)


def test_what_another_node_is_writing_stays(tmp_path: Path) -> None:
    other, own = log(tmp_path / "arm", 20, split_size=1), log(tmp_path / "arm", 1)
    bag = other._writer.path  # type: ignore[union-attr]
    assert surplus(LogFolder(tmp_path / "arm"), 1, 0.0) == []
    other.close()
    assert len(surplus(LogFolder(tmp_path / "arm"), 1, 0.0)) == len([*bag.glob("*.mcap")]) == 20
    own.close()


def test_a_diagnosis_and_the_deletion_of_old_files_may_begin_together(tmp_path: Path, monkeypatch) -> None:
    """Files of a running diagnosis stay, and a diagnosis does not start with files under deletion."""
    goes_on = threading.Event()

    def slowly(file: Path, own) -> None:
        goes_on.wait(30.0)
        delete(file, own)

    monkeypatch.setattr(retention, "delete", slowly)
    writer, diagnosis = log(tmp_path / "arm", 0, split_size=1), DiagnosisRun(print, logging.getLogger())
    fill(writer, 20)
    every, keeper = writer._writer.paths, Retention(LogFolder(tmp_path / "arm"), 1, 0.0)
    writer._retention = keeper
    assert writer.finished(0.0) == every[:-1]
    writer.flush_if_due()
    assert keeper._job.result() == every[:-1]  # all files due for deletion
    verdict = every[0].with_name("verdict_2026-01-01_00-00-00.yaml")
    verdict.write_text("of a diagnosis under way")
    read = [*every[:3], verdict]
    assert diagnosis._keep([*read, tmp_path / "gone.mcap"]) == read  # a deleted file is not read
    writer.flush_if_due()
    assert writer.finished(0.0) == every[:3]
    goes_on.set()
    keeper._job.result()
    assert [file.exists() for file in every] == [True] * 3 + [False] * 16 + [True]
    writer.close()
    assert whole(every[0].parent) == 4
    assert surplus(LogFolder(tmp_path / "arm"), 1, 0.0) == every[-1:]
    for file in (*every[:3], every[-1]):
        delete(file)
    assert verdict.exists()
    diagnosis.close()
    every[0].write_bytes(b"")
    delete(every[0])
    assert not verdict.parent.exists()


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
    assert (now.facts["log_warning"], bag.exists()) == ("", False)
    now.close()


def test_a_folder_of_logs_is_no_bag_and_says_which_is_the_last(tmp_path: Path) -> None:
    log(tmp_path / "arm").close()
    (bag,) = (tmp_path / "arm").iterdir()
    with pytest.raises(ValueError, match=f"the last bag in it is {bag}"):
        BagReader(tmp_path / "arm")


def test_a_writer_counts_what_is_gone(tmp_path: Path) -> None:
    """Also after an error: messages in deleted files do not count as lost."""
    writer = BagWriter(tmp_path / "bag", compression="none")
    for number in range(3):
        writer.write("/x", STRING, TEXT, START + number)
        writer.split()
    writer.take_away(writer.paths[:2])
    writer.resume()
    assert writer.counts == {"/x": 3}
    writer.close()
