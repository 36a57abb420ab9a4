"""The log's states: what goes wrong with the file is shown and stops nothing."""

import subprocess
import sys
from pathlib import Path

import pytest
from live import START, sample

from hd_diag.bag import BagReader
from hd_diag.config.configuration import LogConfig
from hd_diag.ros.log_writer import LogWriter

JOINT_STATE = "sensor_msgs/msg/JointState"
DATA = sample(START, 0.1, 0.2, 0.3)


def fill(log: LogWriter, first: int = 0, count: int = 10) -> None:
    for i in range(first, first + count):
        log.write("/joint_states", JOINT_STATE, DATA, START + i)


def count(path: Path) -> int:
    with BagReader(path) as reader:
        assert not reader.problems
        return reader.message_count


@pytest.mark.parametrize("name", ["log.mcap", "folder"])
def test_a_log_is_written_and_finished(tmp_path: Path, name: str) -> None:
    log = LogWriter(LogConfig(str(tmp_path / name)))
    assert log.state == f"writing {tmp_path / name}"
    fill(log)
    log.close()
    log.close()
    assert log.state == "off"
    assert count(tmp_path / name) == 10


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("/proc/no/log.mcap", "No such file or directory"),
        ("/dev/null/log", "Not a directory"),
        ("taken.mcap", "exists already"),
        ("taken", "exists already"),
    ],
)
def test_a_path_that_cannot_be_written_fails_and_stops_nothing(
    tmp_path: Path, path: str, reason: str
) -> None:
    (tmp_path / "taken.mcap").write_bytes(b"precious")
    (tmp_path / "taken").mkdir()
    log = LogWriter(LogConfig(str(tmp_path / path)))
    assert log.state.startswith("failed: ")
    assert reason in log.state
    fill(log)
    log.flush_if_due()
    assert not log.configure(LogConfig(str(tmp_path / path), flush_period=0.1))
    log.close()
    assert log.state.startswith("failed: ")
    assert (tmp_path / "taken.mcap").read_bytes() == b"precious"


def test_a_message_that_cannot_be_written_ends_the_log_not_the_caller(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    log = LogWriter(LogConfig(str(path)))
    fill(log)
    log.write("/x", "nobody/msg/Knows", b"", START + 20)
    assert "has no known definition" in log.state
    fill(log, 30)
    assert count(path) == 10


# Changes while it is written ---


def test_another_path_finishes_the_file_and_begins_the_next(tmp_path: Path) -> None:
    first, second = tmp_path / "first.mcap", tmp_path / "second"
    log = LogWriter(LogConfig(str(first)))
    fill(log)
    assert log.configure(LogConfig(str(second)))
    assert log.state == f"writing {second}"
    assert count(first) == 10
    fill(log, 10, 5)
    assert log.configure(LogConfig())
    assert log.state == "off"
    fill(log, 20)
    assert count(second) == 5
    assert log.configure(LogConfig("/dev/null/log"))
    assert log.configure(LogConfig(str(tmp_path / "third.mcap")))
    fill(log)
    log.close()
    assert count(tmp_path / "third.mcap") == 10


def test_other_options_go_on_in_the_same_log(tmp_path: Path) -> None:
    folder = tmp_path / "log"
    log = LogWriter(LogConfig(str(folder)))
    fill(log)
    # Every ten nanoseconds of log time a new file, with the other compression.
    assert not log.configure(LogConfig(str(folder), compression="lz4", split_duration=1e-8))
    fill(log, 10, 40)
    assert log.state == f"writing {folder}"
    log.close()
    assert [b"zstd" in path.read_bytes() for path in sorted(folder.glob("*.mcap"))] == [True, *[False] * 4]
    assert count(folder) == 50


# A disk that is full; while the node runs, in test_node.py ---

FILL = """
import resource, signal, sys
from pathlib import Path
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # then a write fails with EFBIG, as it would with ENOSPC
sys.path.insert(0, sys.argv[2])
import test_log_writer
from hd_diag.config.configuration import LogConfig

def filled(name, limit):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    log = test_log_writer.LogWriter(LogConfig(name, compression="none", flush_period=0.01))
    test_log_writer.fill(log, 0, 100)
    log.flush_if_due()
    log.close()
    print(Path(name).stat().st_size, log.state)
    return Path(name).stat().st_size

whole = filled(sys.argv[1] + "/whole.mcap", resource.RLIM_INFINITY)
for missing in (10, 1000, 10_000):  # end, summary, chunk
    filled(sys.argv[1] + f"/{missing}.mcap", whole - missing)
"""


def test_a_disk_that_is_full_only_when_the_log_ends_is_reported_too(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FILL, str(tmp_path), str(Path(__file__).parent)]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    (whole, state), *full = (line.split(" ", 1) for line in run.stdout.splitlines())
    assert state == "off"
    for (size, state), missing in zip(full, (10, 1000, 10_000), strict=True):
        assert state.startswith("failed: ")
        assert int(size) <= int(whole) - missing
