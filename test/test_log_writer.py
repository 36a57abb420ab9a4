"""States of the log: errors of the file are reported and stop nothing."""

import errno
import os
import shutil
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from live import START, sample
from logs import whole
from pool_tasks import wait_for

from hd_diag.config.configuration import LogConfig
from hd_diag.ros import log_writer
from hd_diag.ros.log_writer import LogWriter

JOINT_STATE = "sensor_msgs/msg/JointState"
DATA = sample(START, 0.1, 0.2, 0.3)


def fill(log: LogWriter, first: int = 0, count: int = 10) -> None:
    for i in range(first, first + count):
        log.split_if_due(START + i)
        log.write("/joint_states", JOINT_STATE, DATA, START + i)


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_a_log_is_written_and_finished_whatever_message_cannot_be(tmp_path: Path, name: str) -> None:
    for bad, state in ((False, "off"), (True, "has no known definition")):
        log = LogWriter(LogConfig(str(tmp_path / name), overwrite=True))
        assert log.state == f"writing {tmp_path / name}"
        fill(log)
        if bad:
            log.write("/x", "nobody/msg/Knows", b"", START + 20)
            assert state in log.state
            fill(log, 30)
        for _ in range(2):
            log.close()
            assert state in log.state
        assert whole(tmp_path / name) == 10


@pytest.mark.parametrize("path", ["/proc/no/log.mcap", "taken/log.mcap"])
def test_a_path_that_cannot_be_written_stops_nothing(path: str, tmp_path: Path, clock) -> None:
    """A folder that is created later is then used."""
    taken = tmp_path / "taken"
    taken.write_bytes(b"precious")
    log = LogWriter(LogConfig(str(tmp_path / path)))
    assert log.state.startswith("failed: ")
    assert log.state.endswith("Not a directory" if path.startswith("taken") else "No such file or directory")
    fill(log)
    assert not log.flush_if_due()
    assert log.facts.items() >= {"log_state": log.state, "log_lost": "10", "log_warning": ""}.items()
    assert taken.read_bytes() == b"precious"
    taken.unlink()
    taken.mkdir()
    clock[0] += 1.1
    assert log.flush_if_due() == path.startswith("taken")
    fill(log)
    log.close()
    assert log.state.startswith("off" if path.startswith("taken") else "failed: ")
    assert [whole(file) for file in taken.iterdir()] == [10] * path.startswith("taken")


@pytest.mark.parametrize("planted", ["log.mcap", "log", "log/log_1.mcap", "log/metadata.yaml.tmp"])
def test_nothing_is_written_through_a_link(tmp_path: Path, planted: str) -> None:
    """For the log, its next file, and the draft of its metadata: the link's target stays unchanged."""
    other = tmp_path / "other"
    if planted == "log":
        LogWriter(LogConfig(str(other / "log"))).close()  # a bag of the same name
    else:
        other.write_text("precious")
    path = tmp_path / "log.mcap" if planted == "log.mcap" else tmp_path / "log"
    (tmp_path / planted).parent.mkdir(exist_ok=True)
    (tmp_path / planted).symlink_to(other / "log" if planted == "log" else other)
    before = {file: file.read_bytes() for file in [other, *other.rglob("*")] if file.is_file()}
    log = LogWriter(LogConfig(str(path), split_duration=1e-8, overwrite=True))
    fill(log, count=30)
    log.close()
    assert before == {file: file.read_bytes() for file in [other, *other.rglob("*")] if file.is_file()}
    if planted in ("log", "log.mcap"):
        assert "symbolic link" in log.state


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_a_second_writer_takes_nothing_away(tmp_path: Path, name: str, clock: list[float]) -> None:
    """Finished and open files stay, even after the first writer ends; each refusal gives its reason."""
    config = LogConfig(str(tmp_path / name), split_duration=1e-8, overwrite=True)
    first, second = LogWriter(config), LogWriter(config)
    assert first.state == f"writing {tmp_path / name}"
    assert "is being written by another process" in second.state
    fill(first, count=30)
    clock[0] += 2.0
    assert not second.flush_if_due()
    assert "is being written by another process" in second.state
    fill(first, 30, 30)
    third = LogWriter(config)
    first.close()
    clock[0] += 100.0
    assert not any(log.flush_if_due() for log in (second, third))
    files = sorted(tmp_path.glob("log*.mcap")) or [tmp_path / name]
    assert sum(map(whole, files)) == 60
    assert "exists already" in second.state


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The clock of the log [s], which a test can set."""
    now = [0.0]
    monkeypatch.setattr(log_writer, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def write_limited(monkeypatch: pytest.MonkeyPatch, is_full) -> None:
    """Simulate a full disk for all writes that meet a condition."""
    write = os.write

    def written(fd: int, data: bytes) -> int:
        if is_full(fd, data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(fd, data)

    monkeypatch.setattr(os, "write", written)


def truncate(path: Path) -> None:
    os.truncate(path / "log_0.mcap" if path.is_dir() else path, 100)


HARMS = [
    (lambda path: shutil.rmtree(path) if path.is_dir() else path.unlink(), "was deleted or moved"),
    (lambda path: path.rename(path.with_name("moved")), "was deleted or moved"),
    (truncate, "was changed by another program: 100 bytes"),
]


@pytest.mark.parametrize("name", ["log.mcap", "log"])
@pytest.mark.parametrize(("harm", "reason"), HARMS)
def test_files_taken_away_are_noticed_at_the_next_flush(name, harm, reason, tmp_path: Path, clock) -> None:
    log = LogWriter(LogConfig(str(tmp_path / name), flush_period=0.01, overwrite=True))
    fill(log)
    first = tmp_path / ("log/log_0.mcap" if name == "log" else name)
    wait_for(lambda: (log.flush_if_due(), first.stat().st_size)[1] > 100)
    harm(tmp_path / name)
    fill(log, 10)
    wait_for(lambda: log.flush_if_due() or reason in log.state)
    fill(log, 20)
    clock[0] += 1.1
    assert log.flush_if_due()
    new = tmp_path / ("log/log_1.mcap" if name == "log" else "log_1.mcap")
    assert (log.state, log.facts["log_lost"]) == (f"writing {new}", "20")
    fill(log, 40)
    log.close()
    assert whole(new) == 10


@pytest.mark.parametrize("name", ["log.mcap", "log"])
def test_a_disk_that_has_room_again_is_written_in_a_new_file(name, tmp_path, clock, monkeypatch) -> None:
    """The old file is finished, none is added while the disk is full, and lost messages are counted."""
    attempts, full = list[int](), False

    def is_full(fd: int, data: bytes) -> bool:
        attempts.extend([fd] * full)
        return full

    write_limited(monkeypatch, is_full)
    (tmp_path / "log_1.mcap").write_text("another's")
    log = LogWriter(LogConfig(str(tmp_path / name), flush_period=0.0, overwrite=True))
    fill(log)
    log.flush_if_due()
    full = True
    fill(log, 10, 5)
    log.flush_if_due()
    assert "No space left" in log.state
    lying = sorted(tmp_path.rglob("*.mcap"))
    for step in range(1000):
        clock[0] = 0.1 * step
        assert not log.flush_if_due()
        assert sorted(tmp_path.rglob("*.mcap")) == lying
    assert 2 * 6 <= len(attempts) <= 2 * 9 + 5  # after 1, 2, 4, 8, 16, 30, 30 s: old end and new start
    full = False
    fill(log, 15, 5)
    clock[0] += 30.0
    assert log.flush_if_due()
    fill(log, 20, 7)
    new = tmp_path / ("log/log_1.mcap" if name == "log" else "log_2.mcap")
    assert (log.state, log.facts["log_lost"]) == (f"writing {new}", "10")
    log.close()
    assert (whole(tmp_path / name), whole(new)) == (17 if name == "log" else 10, 7)
    assert (tmp_path / "log_1.mcap").read_text() == "another's"


@pytest.mark.parametrize("period", [0.0, 0.02])
def test_the_disk_is_made_to_take_it_and_nobody_waits_for_that(period, tmp_path: Path, monkeypatch) -> None:
    """Syncs at the period and the end, if a period is set; a slow disk delays no message and no flush."""
    done, calls = threading.Event(), list[int]()

    def slow(fd: int) -> None:
        calls.append(os.fstat(fd).st_size)
        done.wait(30.0)

    monkeypatch.setattr(os, "fdatasync", slow)
    log = LogWriter(LogConfig(str(tmp_path / "log"), flush_period=0.0, sync_period=period, overwrite=True))
    for first in range(0, 50, 10):
        fill(log, first)
        log.flush_if_due()
        threading.Event().wait(0.03)
    wait_for(lambda: len(calls) == (1 if period else 0))
    done.set()
    log.close()
    assert log.state == "off"
    assert calls[-1:] == ([(tmp_path / "log/log_0.mcap").stat().st_size] if period else [])

    def broken(fd: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fdatasync", broken)
    log = LogWriter(LogConfig(str(tmp_path / "again"), sync_period=0.01))
    wait_for(lambda: log.flush_if_due() or "Input/output error" in log.state)


@pytest.mark.parametrize("missing", [10, 1000, 10_000], ids=["end", "summary", "chunk"])
def test_a_disk_that_is_full_only_when_the_log_ends_is_reported_too(missing, tmp_path, monkeypatch) -> None:
    config = LogConfig(str(tmp_path / "log.mcap"), compression="none", flush_period=60.0)
    log = LogWriter(config)
    fill(log, count=100)
    log.close()
    assert log.state == "off"
    room = (tmp_path / "log.mcap").stat().st_size - missing
    write_limited(monkeypatch, lambda fd, data: os.fstat(fd).st_size + len(data) > room)
    (tmp_path / "log.mcap").unlink()
    log = LogWriter(config)
    fill(log, count=100)
    log.close()
    assert "No space left" in log.state
    assert (tmp_path / "log.mcap").stat().st_size <= room
