"""The benchmark: the paper's method beside the model gives what the model gives; the suite tells its rows."""

import json
import os
import subprocess
import sys
from pathlib import Path

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose

import hd_diag
from hd_diag.drive import Drive, mesh_state
from hd_diag.model.transmission_error import Kinematics

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "bench"))
import paper_method  # noqa: E402

GEAR = paper_method.Gear()
MOMENTS = [
    (0.0, 0.0, 56.0),
    (0.3, 23e-6j, -56.0),
    (7.7, 9e-6 + 4e-6j, 5.0),
    (-4.1, -30e-6 + 1e-6j, -20.0),
]


@pytest.mark.parametrize(("turn", "eccentricity", "torque"), MOMENTS)
def test_torsion_backlash_and_force(turn: float, eccentricity: complex, torque: float) -> None:
    beta, backlash, force = paper_method.one_moment(GEAR, turn, complex(eccentricity), torque)
    mesh = drives.mesh(eccentricity=(complex(eccentricity).real, complex(eccentricity).imag))
    state = mesh_state(Drive(mesh, Kinematics(-100.0), 56.0), np.array([turn]), np.array([torque]))
    assert_allclose(beta, state.torsion[0], rtol=0, atol=1e-9)
    found = np.full((2, 2, 200), np.nan)
    found[1] = 0.0
    for k, values in enumerate((backlash, force)):
        for (tooth, side), value in values.items():
            found[k, 0 if side > 0 else 1, tooth] = value
    assert_allclose(found[0] / 30.6e-3, state.backlash[0] / 30.6e-3, rtol=0, atol=1e-9)
    assert_allclose(found[1], state.load[0], rtol=0, atol=1e-4)
    assert np.isfinite(found[0]).sum() > 100


def test_suite_measures_and_tells(tmp_path: Path) -> None:
    """One short section: its table on stdout, its figures as JSON; speeds are not judged."""
    told = tmp_path / "results.json"
    run = [sys.executable, ROOT / "bench/suite.py", "--only", "tolerance", "--json", told]
    environment = {**os.environ, "PYTHONPATH": str(Path(hd_diag.__file__).parent.parent)}
    done = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=150)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(told.read_text())
    assert (found["schema"], found["skipped"]) == ("hd_diag/bench/1", {})
    assert [row["section"] for row in found["rows"]] == ["tolerance"] * 2
    for row in found["rows"]:
        assert row["value"] > 0.0
        assert row["what"] in done.stdout


def test_an_aim_is_met_by_a_great_ratio_or_a_small_value() -> None:
    import suite

    for ratio, value, aim, unit, met in (
        (600.0, 1.0, 500.0, "x", True),
        (400.0, 1.0, 500.0, "x", False),
        (None, 1.0, 2.0, "s", True),
        (None, 3.0, 2.0, "s", False),
        (9.0, 1.0, None, "", None),
    ):
        assert suite.Row("section", "what", value, "s", ratio, aim=aim, aim_unit=unit).met is met
