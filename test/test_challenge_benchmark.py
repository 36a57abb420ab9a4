"""The benchmark of the diagnosis runs: one short record, its table and its JSON."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from challenge import truth
from challenge.contact import Gear
from challenge.design import OTHERS, SIZE_25, Design
from numpy.testing import assert_allclose

import hd_diag
from hd_diag.drive import transmission_error
from hd_diag.formatting import ARCSEC

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "bench"))
import scoring  # noqa: E402


@pytest.mark.parametrize("design", [SIZE_25, *OTHERS], ids=lambda design: design.name)
def test_both_sides_mean_the_same_drive(design: Design) -> None:
    rng = np.random.default_rng(3)
    base = truth.drawn(rng, design)
    angle, torque = rng.uniform(-200, 200, 100), rng.uniform(-0.9, 0.9, 100) * design.rated
    forced = Gear(base).torsion(-angle, -torque) - base.cup * torque
    assert_allclose(transmission_error(scoring.drive(base), angle, torque), forced, atol=0.05 * ARCSEC)


def test_one_record(tmp_path: Path) -> None:
    """A spectrum's peaks beside it; the other methods where they are installed."""
    options = ["--seeds", "1", "--families", "short", "--jobs", "1", "--first", "1"]
    files = ["--json", str(tmp_path / "f.json"), "--markdown", str(tmp_path / "f.md")]
    done = subprocess.run(
        [sys.executable, ROOT / "bench/challenge.py", *options, *files],
        env={**os.environ, "PYTHONPATH": str(Path(hd_diag.__file__).parent.parent)},
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "f.md").read_text() == done.stdout
    assert done.stdout.startswith("1 of 1 records, development seeds from 1 on.")
    rows = [line.split(" | ") for line in done.stdout.splitlines() if line.startswith("| short")]
    assert {"hd_diag", "FFT peaks"} <= {row[1] for row in rows}
    assert len({len(row) for row in rows if row[1] == "hd_diag"}) == 2
    written = json.loads((tmp_path / "f.json").read_text())
    assert written["schema"] == "hd_diag/challenge/1"
    own = next(each for each in written["records"] if each["method"] == "hd_diag")
    assert (own["family"], own["seed"], own["hidden"]) == ("short", 1, ["output_runout"])
    assert own["seconds"] > 0.0
    again = [sys.executable, ROOT / "bench/challenge.py", "--again", str(tmp_path / "f.json")]
    environment = {**os.environ, "PYTHONPATH": str(Path(hd_diag.__file__).parent.parent)}
    tables = subprocess.run(again, env=environment, capture_output=True, text=True, timeout=500)
    assert (tables.returncode, tables.stdout) == (0, done.stdout)
    assert "| poor motions: records with a false name [%] | at most 0 | 0 | yes |" in done.stdout
