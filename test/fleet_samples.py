"""Rows of a fleet as diagnoses give them, for tests of what is made of rows: 40 robots with 6 joints each."""

from typing import Any

import fleet_tasks
import numpy as np

from hd_diag.fleet.rows import Row
from hd_diag.fleet.series import series_of
from hd_diag.fleet.standing import Health, health, limits_of
from hd_diag.fleet.trend import trends

ARCSEC = np.pi / 648000.0
BEGIN, WEEK = 1_767_600_000 * 10**9, 7 * 86_400 * 10**9  # 2026-01-05 [ns]
ACCURACY, ALLOWED = 90.0 * ARCSEC, 10e-6
WEEKS = 8
CAUSED: Row = {
    "causes": ["hysteresis"],
    "cause_classes": [["hysteresis"]],
    "cause_amplitudes_rad": [9e-6],
    "cause_amplitude_stds_rad": [1e-7],
}


def row(arcsec: float = 40.0, microns: float = 5.0, **more: Any) -> Row:
    """A joint whose error and eccentricity these are, to 1 % of the limit."""
    return {
        **fleet_tasks.row(1.0 * ARCSEC),
        "bag": "bags/a.mcap",
        "robot": None,
        "bag_sha256": "a",
        "start": BEGIN,
        "problems": [],
        "duration_s": 60.0,
        "judgement": "parameters",
        "error_rad": arcsec * ARCSEC,
        "error_std_rad": 0.01 * ACCURACY,
        "accuracy_rad": ACCURACY,
        "eccentricity_m": microns * 1e-6,
        "eccentricity_std_m": 0.01 * ALLOWED,
        "eccentricity_allowed_m": ALLOWED,
        "eccentricity_criterion": "overlap",
        "tested": [],
        "tested_least_rad": [],
        "inspect": [
            "Eccentricity of the wave generator in the housing: Hold a dial gauge on the motor shaft."
        ],
        "verdict": "the joint is within its accuracy; no other cause is needed.",
        **more,
    }


def judged(rows: list[Row]) -> Health:
    """These rows as a run judges them."""
    limits = limits_of(rows)
    return health(rows, trends(series_of(rows, limits), np.random.default_rng(0)), limits)


def fleet_rows(robots: int = 40) -> list[Row]:
    """Eight weeks of robots with six joints: one grows through its limit, others are near it or broken."""
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
    last[29].update(error_rad=None, error_std_rad=None)
    rows.append({"bag": "bags/robot_3/strange.mcap", "robot": "robot_3", "error": "is not an MCAP file"})
    return rows
