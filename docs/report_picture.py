"""Make the pages' pictures: docs/images/report.png, the top of a report, and fleet.png, a week's page.

    python docs/report_picture.py

``hd-diag`` must be on the PATH, and Chromium. The report's joint is that of the tour,
docs/examples/faulty_joint.yaml; the fleet's are simulated with eccentricities that grow or stay.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WIDTH, HEIGHT = 1280, 900  # of the window [CSS px]
COLOURS = 128
MOTION = ["--duration", "240", "--rate", "250", "--angle-noise-arcsec", "1", "--temperature"]


FLEET = {"robot_1": (4.0, 4.0), "robot_2": (6.0, 6.5), "robot_3": (8.0, 13.0), "robot_4": (10.0, 10.2)}
"""Eccentricity in each of two weeks [µm]."""

TORN = ("robot_2", 1)  # robot and week of the bag that is cut off
BEGIN, WEEK = 1_767_600_000, 7 * 86_400  # [s]


def report(folder: Path) -> Path:
    """Simulate and diagnose the tour's joint."""
    bag, page = folder / "faulty.mcap", folder / "faulty.html"
    joint = ["--config", DOCS / "examples/faulty_joint.yaml"]
    subprocess.run(["hd-diag", "simulate", *joint, "--out", bag, *MOTION], check=True)
    subprocess.run(["hd-diag", "report", bag, "--out", page], check=True)
    return page


def fleet(folder: Path) -> Path:
    """Simulate and diagnose two weeks of four robots."""
    for robot, sizes in FLEET.items():
        (folder / "bags" / robot).mkdir(parents=True)
        for week, size in enumerate(sizes):
            bag = folder / "bags" / robot / f"week_{week + 1}.mcap"
            start = ["--start-time", BEGIN + week * WEEK, "--seed", week, "--duration", 60]
            size = ["--eccentricity-um", size, "--angle-noise-arcsec", 1]
            subprocess.run(["hd-diag", "simulate", "--out", bag, *map(str, (*start, *size))], check=True)
            if (robot, week) == TORN:
                content = bag.read_bytes()
                bag.write_bytes(content[: 3 * len(content) // 4])
    told = ["--robot", "(robot_.)", "--out", "f.parquet", "--report", "week.html"]
    subprocess.run(["hd-diag", "fleet", "bags", *told], check=True, cwd=folder)
    return folder / "week.html"


def picture(made: Callable[[Path], Path], target: Path, height: int = HEIGHT) -> None:
    """Make a page and save a screenshot of it with few colours."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        sys.exit(f"needs one of {', '.join(BROWSERS)}")
    with tempfile.TemporaryDirectory() as name:
        page, shot = made(Path(name)), Path(name, "shot.png")
        look = [f"--screenshot={shot}", f"--window-size={WIDTH},{height}", "--hide-scrollbars", "--headless"]
        subprocess.run([browser, *look, "--no-sandbox", "--disable-gpu", page.as_uri()], check=True)
        with Image.open(shot) as seen:
            seen.convert("RGB").quantize(COLOURS).save(target, optimize=True)


if __name__ == "__main__":
    picture(report, DOCS / "images/report.png")
    picture(fleet, DOCS / "images/fleet.png", 1000)
