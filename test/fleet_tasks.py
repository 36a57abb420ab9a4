"""What the workers of the fleet's tests do, and bags for them; in a module, for workers import it."""

import os
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bag_samples import rows, write_with_mcap

from hd_diag.fleet.rows import Row, Task
from hd_diag.fleet.survey import Survey, survey

JOINT_STATE = "sensor_msgs/msg/JointState"
CALLS = "HD_DIAG_TEST_CALLS"  # environment: folder in which every call leaves a file
DAY = 86_400 * 10**9  # [ns]
BEGIN = 1_767_225_600 * 10**9  # 2026-01-01 [ns]


def note(name: object) -> None:
    folder = os.environ.get(CALLS)
    if folder:
        Path(folder, f"{name}~{os.getpid()}~{time.monotonic_ns()}").touch()


def calls(folder: Path) -> list[tuple[str, int]]:
    """Name and process of every call, in order of time."""
    noted = sorted((path.name.split("~") for path in folder.iterdir()), key=lambda parts: int(parts[2]))
    return [(name, int(process)) for name, process, _ in noted]


def square(number: int) -> int:
    return number * number


def slow_square(number: int) -> int:
    note(number)
    time.sleep(0.4)
    return number * number


def deadly_seven(number: int) -> int:
    note(number)
    if number == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return number * number


def faulty(number: int) -> int:
    if number == 3:
        raise Unsendable(number, "no")
    return number


def greedy(size: int) -> int:
    return int(np.ones(size // 8).sum())


def stuck(name: str) -> str:
    """Hangs for ever: in a system call for ``fifo``, with the interpreter's lock for ``pattern``."""
    note(name)
    if name == "fifo":
        folder = Path(os.environ[CALLS]).parent
        os.mkfifo(folder / "fifo")
        (folder / "fifo").read_bytes()
    if name == "pattern":
        re.match("(a+)+$", "a" * 60 + "b")
    return name


def setting(name: str) -> str | None:
    return os.environ.get(name)


class Unsendable(Exception):
    """An exception that pickle cannot make again, as many are."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(f"{number}: {text}")


def alive(process: int) -> bool:
    """Whether a process runs; one that has ended and is not yet missed does not."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False


def wait_for(condition: Callable[[], object], patience: float = 60.0) -> None:
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


# In place of the true diagnosis, which takes seconds ---


def quick(task: Task) -> Row:
    note(Path(task.bag).name)
    return row(int(task.digest[:6], 16) * 1e-13)


def stuck_survey(path: str) -> Survey:
    if Path(path).name == "00.mcap":
        time.sleep(3600.0)
    return survey(path)


def stuck_first(task: Task) -> Row:
    if _day(task) == 0:
        note("stuck")
        time.sleep(3600.0)
    return quick(task)


def slow(task: Task) -> Row:
    time.sleep(0.4)
    return quick(task)


def row(residual: float) -> Row:
    return {
        "joint": "joint_1",
        "samples": 4000,
        "trustworthy": True,
        "eccentricity_m": 1e-5,
        "eccentricity_std_m": 1e-7,
        "causes": [],
        "cause_classes": [],
        "cause_amplitudes_rad": [],
        "cause_amplitude_stds_rad": [],
        "tested": ["hysteresis"],
        "tested_least_rad": [1e-6],
        "rms_nominal_rad": 2.0 * residual,
        "rms_refit_rad": residual,
        "noise_floor_rad": 1e-6,
        "noise_floor_low_rad": 0.98e-6,
        "noise_floor_high_rad": 1.02e-6,
        "hd_diag_version": "0.1.0",
    }


def small_bag(path: Path, day: int = 0, names: tuple[str, ...] = ("joint_1_motor", "joint_1")) -> Path:
    """Twelve messages: enough to be looked at, too few to be judged."""
    block, stamps = rows(12, BEGIN + day * DAY, names)
    messages = [("/j", JOINT_STATE, block[i].tobytes(), int(stamps[i])) for i in range(12)]
    return write_with_mcap(path, messages)


def stepped(task: Task) -> Row:
    """From the ninth day on twice as much is left."""
    return row((2e-6 if _day(task) >= 8 else 1e-6) + _scatter(task))


def drifting(task: Task) -> Row:
    """1e-5 rad, and 1e-6 rad more every day."""
    return row(1e-5 + 1e-6 * _day(task) + _scatter(task))


def caused(task: Task) -> Row:
    found = {"causes": ["hysteresis"], "cause_classes": [["hysteresis"]], "cause_amplitudes_rad": [1e-6]}
    return {**row(1e-6), **found, "cause_amplitude_stds_rad": [1e-8]}


def deadly_first(task: Task) -> Row:
    if _day(task) == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return row(1e-6)


def _day(task: Task) -> int:
    return int(Path(task.bag).stem)


def _scatter(task: Task) -> float:
    return 1e-7 * float(np.random.default_rng(_day(task)).standard_normal())
