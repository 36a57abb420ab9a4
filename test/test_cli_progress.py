"""Progress of long work: a bar on a terminal, periodic lines in a pipe, share done and remaining time."""

import fcntl
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hd_diag.cli import progress
from hd_diag.cli.progress import duration, showing, working
from hd_diag.ros.stop_signals import Stopped


@pytest.mark.parametrize(
    ("unit", "done", "total", "seconds", "told"),
    [
        ("", (0.2, 0.4), 1.0, (10.0, 5.0), "40 %, about 25 s left"),
        ("", (0.2, 0.4), 1.0, (10.0, 65.0), "40 %"),  # longer than estimated: no remaining time
        ("messages", (0, 12_000), 30_000, (2.0, 0.0), "12,000 of 30,000 messages, 6,000/s, about 3 s left"),
        ("", (0, 0), 0, (130.0, 0.0), "2 min so far"),
    ],
)
def test_work_says_how_far_it_is_and_how_long_still(
    unit: str, done: tuple[float, ...], total: float, seconds: tuple[float, ...], told: str, monkeypatch: Any
) -> None:
    """The rate counts from the first call of the work, and includes the time since the last one."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    work = progress._Work("joint_1", unit)
    for part, later, name in zip(done, seconds, ("reading", "fitting"), strict=True):
        work.advance(part, total, name)
        now[0] += later
    assert (work.name, str(work)) == ("joint_1: fitting", told)


def test_durations_as_people_say_them() -> None:
    told = {0.6: "1 s", 99.0: "99 s", 100.0: "2 min", 7800.0: "2 h 10 min"}
    assert [duration(seconds) for seconds in told] == [*told.values()]


def test_in_a_pipe_lines_come_while_nothing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines start with the first word and continue during a long step; none comes after the end."""
    written, lines = threading.Event(), []

    def tell(line: str, err: bool) -> None:
        lines.append((line, err))
        written.set()

    monkeypatch.setattr(progress, "_PERIOD", 0.01)
    monkeypatch.setattr(progress, "tell", tell)
    with showing() as part:
        part("joint_1")(0.5, 1.0, "looking for causes")
        assert written.wait(30.0)
    assert lines[0] == ("hd-diag: joint_1: looking for causes: 50 %", True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_work_at_its_next_call(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with working() as part:
        advance = part("replay", "messages")
        signal.raise_signal(number)  # a signal at a moment when work cannot stop
        with pytest.raises(Stopped) as ended:
            advance(1, 2)
    assert (ended.value.number, signal.getsignal(number)) == (number, before)


def test_ctrl_c_at_a_terminal(tmp_path: Path) -> None:
    """Code 130 and no traceback; cursor and terminal settings are restored, NO_COLOR is respected."""
    here, there = pty.openpty()
    before = termios.tcgetattr(there)
    words = f"-m hd_diag simulate --duration 3600 --out {tmp_path / 'joint.mcap'}"
    environment = {**os.environ, "TERM": "xterm-256color", "NO_COLOR": "1"}
    streams: Any = dict.fromkeys(("stdin", "stdout", "stderr"), there)
    streams |= {"start_new_session": True, "preexec_fn": lambda: fcntl.ioctl(there, termios.TIOCSCTTY, 0)}
    with subprocess.Popen([sys.executable, *words.split()], env=environment, **streams) as process:
        shown = read(here, lambda so_far: b"\x1b[?25l" in so_far)  # bar shown, cursor hidden
        os.write(here, b"\x03")
        shown += read(here, lambda _: process.poll() is not None)
        assert process.returncode == 130, shown
    shown += read(here, lambda _: not select.select([here], [], [], 0.0)[0])
    assert b"interrupted" in shown
    assert shown.rindex(b"\x1b[?25h") > shown.rindex(b"\x1b[?25l")
    assert termios.tcgetattr(there) == before
    assert b"Traceback" not in shown
    assert not re.search(rb"\x1b\[[34]8;", shown)
    os.close(here)
    os.close(there)


def read(terminal: int, is_enough: Callable[[bytes], bool]) -> bytes:
    """Output of a terminal until `is_enough`, for at most a minute."""
    shown, end = b"", time.monotonic() + 60.0
    while not is_enough(shown) and time.monotonic() < end:
        if select.select([terminal], [], [], 0.05)[0]:
            shown += os.read(terminal, 4096)
    return shown
