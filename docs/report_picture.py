"""Make the README's picture, the top of a report, anew: docs/images/report.png.

    python docs/report_picture.py

``hd-diag`` must be on the PATH, and Chromium. The joint is that of the tour, docs/examples/faulty_joint.yaml.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WIDTH, HEIGHT = 1280, 900  # of the window [CSS px]
COLOURS = 64
MOTION = ["--duration", "240", "--rate", "250", "--angle-noise-arcsec", "1", "--temperature"]


def picture(target: Path) -> None:
    """Simulate, diagnose, look, and keep what is seen with few colours."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        sys.exit(f"needs one of {', '.join(BROWSERS)}")
    with tempfile.TemporaryDirectory() as name:
        bag, page, shot = (Path(name, file) for file in ("faulty.mcap", "faulty.html", "shot.png"))
        joint = ["--config", DOCS / "examples/faulty_joint.yaml"]
        subprocess.run(["hd-diag", "simulate", *joint, "--out", bag, *MOTION], check=True)
        subprocess.run(["hd-diag", "report", bag, "--out", page], check=True)
        look = [f"--screenshot={shot}", f"--window-size={WIDTH},{HEIGHT}", "--hide-scrollbars", "--headless"]
        subprocess.run([browser, *look, "--no-sandbox", "--disable-gpu", page.as_uri()], check=True)
        with Image.open(shot) as seen:
            seen.convert("RGB").quantize(COLOURS).save(target, optimize=True)


if __name__ == "__main__":
    picture(DOCS / "images/report.png")
