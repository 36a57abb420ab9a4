"""Stand-ins for surveys and diagnoses in the fleet's tests, and bags for them; workers import this module."""

import os
import signal
import time
from pathlib import Path

import numpy as np
from bag_samples import rows, write_with_mcap
from pool_tasks import note

from hd_diag.fleet.rows import PAGE, Row, Task
from hd_diag.fleet.survey import Survey, survey

JOINT_STATE = "sensor_msgs/msg/JointState"
DAY = 86_400 * 10**9  # [ns]
BEGIN = 1_767_225_600 * 10**9  # 2026-01-01 [ns]


def quick(task: Task) -> Row:
    note(Path(task.bag).name)
    return row(int(task.digest[:6], 16) * 1e-13)


def stuck_survey(path: str) -> Survey:
    if Path(path).name == "00.mcap":
        time.sleep(3600.0)
    return survey(path)


def stuck_first(task: Task) -> Row:
    if _day(task) == 0:
        note("ended")
        time.sleep(3600.0)
    return quick(task)


def slow(task: Task) -> Row:
    time.sleep(0.4)
    return quick(task)


def compared(arcsec: float) -> Row:
    """Columns of an error beside an accuracy of 90 arcsec, known to 1 arcsec."""
    error, std, accuracy = np.radians([arcsec / 3600.0, 1.0 / 3600.0, 90.0 / 3600.0]).tolist()
    return {"error_rad": error, "error_std_rad": std, "accuracy_rad": accuracy}


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
        **compared(40.0),
    }


def drawn(task: Task) -> Row:
    """The name of its bag is its page."""
    page = {PAGE: Path(task.bag).name} if task.drawn else {}
    return {**quick(task), **page}


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
        note("ended")
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(task)


def _day(task: Task) -> int:
    return int(Path(task.bag).stem)


def _scatter(task: Task) -> float:
    return 1e-7 * float(np.random.default_rng(_day(task)).standard_normal())
