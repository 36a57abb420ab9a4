"""Rows, bags and replacements for diagnoses in the fleet's tests; workers import this module."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from bag_samples import rows, write_with_mcap
from pool_tasks import note

from hd_diag.fleet.rows import PAGE, Row, Task
from hd_diag.fleet.run import Survey, survey
from hd_diag.fleet.series import series_of
from hd_diag.fleet.standing import Health, health, limits_of
from hd_diag.fleet.trend import trends

JOINT_STATE = "sensor_msgs/msg/JointState"
ARCSEC = np.pi / 648000.0
DAY = 86_400 * 10**9  # [ns]
BEGIN = 1_767_225_600 * 10**9  # 2026-01-01 [ns]
ACCURACY, ALLOWED = 90.0 * ARCSEC, 10e-6
WEEK, WEEKS = 7 * DAY, 8
CAUSED: Row = {
    "causes": ["hysteresis"],
    "cause_classes": [["hysteresis"]],
    "cause_amplitudes_rad": [9e-6],
    "cause_amplitude_stds_rad": [1e-7],
}


def quick(task: Task) -> Row:
    note(Path(task.bag).name)
    return result(int(task.digest[:6], 16) * 1e-13)


def stuck_survey(path: str) -> Survey:
    if Path(path).name == "00.mcap":
        time.sleep(3600.0)
    return survey(path)


def row(arcsec: float = 40.0, microns: float = 5.0, residual: float = 1.0 * ARCSEC, **more: Any) -> Row:
    """Row of a joint with this error and eccentricity, to 1 % of the limit, as a diagnosis returns it."""
    return {
        "bag": "bags/a.mcap",
        "robot": None,
        "bag_sha256": "a",
        "start": BEGIN,
        "problems": [],
        "joint": "joint_1",
        "samples": 4000,
        "duration_s": 60.0,
        "judgement": "parameters",
        "light": "green",
        "advice": "Nothing to do: the error is within its limit.",
        "trustworthy": True,
        "error_rad": arcsec * ARCSEC,
        "error_std_rad": 0.01 * ACCURACY,
        "accuracy_rad": ACCURACY,
        "eccentricity_m": microns * 1e-6,
        "eccentricity_std_m": 0.01 * ALLOWED,
        "eccentricity_allowed_m": ALLOWED,
        "eccentricity_criterion": "overlap",
        "causes": [],
        "cause_classes": [],
        "cause_amplitudes_rad": [],
        "cause_amplitude_stds_rad": [],
        "tested": [],
        "tested_least_rad": [],
        "rms_nominal_rad": 2.0 * residual,
        "rms_refit_rad": residual,
        "noise_floor_rad": 1e-6,
        "noise_floor_low_rad": 0.98e-6,
        "noise_floor_high_rad": 1.02e-6,
        "hd_diag_version": "0.1.0",
        "inspect": [
            "Eccentricity of the wave generator in the housing: Hold a dial gauge on the motor shaft."
        ],
        "verdict": "the joint is within its accuracy; no other cause is needed.",
        **more,
    }


def result(residual: float, **more: Any) -> Row:
    """Result of a worker for a bag."""
    of_bag = ("bag", "robot", "bag_sha256", "start", "problems")
    return {k: value for k, value in row(residual=residual, **more).items() if k not in of_bag}


def drawn(task: Task) -> Row:
    """Result whose page is the bag's name."""
    page = {PAGE: Path(task.bag).name} if task.drawn else {}
    return {**quick(task), **page}


def small_bag(path: Path, day: int = 0, names: tuple[str, ...] = ("joint_1_motor", "joint_1")) -> Path:
    """Bag of twelve messages: enough to read, too few to judge."""
    block, stamps = rows(12, BEGIN + day * DAY, names)
    messages = [("/j", JOINT_STATE, block[i].tobytes(), int(stamps[i])) for i in range(12)]
    return write_with_mcap(path, messages)


def stepped(task: Task) -> Row:
    """The residual doubles on the ninth day."""
    return result((2e-6 if _day(task) >= 8 else 1e-6) + _scatter(task))


def drifting(task: Task) -> Row:
    """The residual is 1e-5 rad and grows by 1e-6 rad a day."""
    return result(1e-5 + 1e-6 * _day(task) + _scatter(task))


def caused(task: Task) -> Row:
    return result(1e-6, **CAUSED)


def _day(task: Task) -> int:
    return int(Path(task.bag).stem)


def _scatter(task: Task) -> float:
    return 1e-7 * float(np.random.default_rng(_day(task)).standard_normal())


# Fleets ---


def judged(rows: list[Row]) -> Health:
    """Health of these rows as a run judges it."""
    limits = limits_of(rows)
    return health(rows, trends(series_of(rows, limits), np.random.default_rng(0)), limits)


def fleet_rows(robots: int = 40) -> list[Row]:
    """Eight weeks of robots with six joints: one grows beyond its limit, others are near it or broken."""
    rng, rows = np.random.default_rng(0), []
    for week in range(WEEKS):
        for robot in range(1, robots + 1):
            for joint in range(1, 7):
                grown = 30.0 + 10.0 * week if (robot, joint) == (2, 2) else 30.0 + 20.0 * rng.random()
                more: dict[str, Any] = {"start": BEGIN + week * WEEK + robot * 60 * 10**9}
                more |= {"bag": f"bags/robot_{robot}/week_{week}.mcap", "robot": f"robot_{robot}"}
                more |= {"bag_sha256": f"{robot} {week}"}
                rows.append(row(grown, 3.0 + 5.0 * rng.random(), joint=f"joint_{joint}", **more))
    last = rows[-6 * robots :]
    last[2].update(eccentricity_m=10.1e-6)
    last[24].update(**CAUSED, error_rad=ACCURACY * 2.0)
    last[14].update(error="too short: 12 usable samples", error_rad=None, rms_nominal_rad=None)
    last[20].update(problems=["week_7.mcap: is cut off or damaged at byte 228680 of 261683"])
    last[29].update(error_rad=None, error_std_rad=None, light="not_judged", advice="Cannot be judged.")
    rows.append({"bag": "bags/robot_3/strange.mcap", "robot": "robot_3", "error": "is not an MCAP file"})
    return rows
