"""The benchmarks: the paper's method agrees with the model, and each script measures and reports.

The tests do not judge their speeds.
"""

import importlib.util
import json
import math
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import drives
import numpy as np
import pytest
from challenge import truth
from challenge.contact import Gear
from challenge.design import OTHERS, SIZE_25, Design
from numpy.testing import assert_allclose

from hd_diag.diagnosis.diagnosis import diagnose
from hd_diag.diagnosis.work import Work
from hd_diag.drive import Drive, mesh_state, transmission_error
from hd_diag.formatting import ARCSEC
from hd_diag.model.transmission_error import Kinematics

BENCH = Path(__file__).resolve().parent.parent / "bench"
sys.path.append(str(BENCH))
import paper_method  # noqa: E402
import scoring  # noqa: E402


def loaded(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A script as a module; its process-wide settings are undone after the test."""
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.setenv(threads, "1")
    monkeypatch.setattr(sys, "path", [*sys.path])
    spec = importlib.util.spec_from_file_location(f"bench_{name}", BENCH / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):

    def run(script: ModuleType, *words: object) -> str:
        monkeypatch.setattr(sys, "argv", [script.__name__, *map(str, words)])
        assert script.main() == 0
        return capsys.readouterr().out

    return run


GEAR = paper_method.Gear()
MOMENTS = [(0.0, 0.0, 56.0), (0.3, 23e-6j, -56.0), (7.7, 9e-6 + 4e-6j, 5.0), (-4.1, -30e-6 + 1e-6j, -20.0)]


@pytest.mark.parametrize(("turn", "eccentricity", "torque"), MOMENTS)
def test_torsion_backlash_and_force(turn: float, eccentricity: complex, torque: float) -> None:
    beta, backlash, force = paper_method.one_moment(GEAR, turn, complex(eccentricity), torque)
    mesh = drives.mesh(eccentricity=(complex(eccentricity).real, complex(eccentricity).imag))
    state = mesh_state(Drive(mesh, Kinematics(-100.0), 56.0), np.array([turn]), np.array([torque]))
    assert_allclose(beta, state.torsion[0], rtol=0, atol=1e-9)
    gap = backlash, np.nan, state.backlash[0], 30.6e-12
    for values, absent, expected, atol in (gap, (force, 0.0, state.load[0], 1e-4)):
        found = np.full((2, 200), absent)
        for (tooth, side), value in values.items():
            found[0 if side > 0 else 1, tooth] = value
        assert_allclose(found, expected, rtol=0, atol=atol)
    assert len(backlash) > 100


MOMENTS_EACH = 12  # per design; each takes the reference about 0.1 s
EACH = [SIZE_25, OTHERS[0], *(pytest.param(design, marks=pytest.mark.slow) for design in OTHERS[1:])]


@pytest.mark.parametrize("design", EACH, ids=lambda design: design.name)
def test_both_sides_mean_the_same_drive(design: Design) -> None:
    rng = np.random.default_rng(3)
    base = truth.drawn(rng, design)
    angle, torque = rng.uniform(-200, 200, MOMENTS_EACH), rng.uniform(-0.9, 0.9, MOMENTS_EACH) * design.rated
    forced = Gear(base).torsion(-angle, -torque) - base.cup * torque
    assert_allclose(transmission_error(scoring.drive(base), angle, torque), forced, atol=0.05 * ARCSEC)


def test_suite_measures_and_tells(run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One short section: table on stdout, figures as JSON, and rows that meet or miss an aim."""
    suite, file = loaded("suite", monkeypatch), tmp_path / "results.json"
    told = run(suite, "--only", "tolerance", "--json", file)
    found = json.loads(file.read_text())
    assert (found["schema"], found["skipped"]) == ("hd_diag/bench/1", {})
    assert [row["section"] for row in found["rows"]] == ["tolerance"] * 2
    for row in found["rows"]:
        assert row["value"] > 0.0
        assert row["what"] in told
    cases = [(600.0, 1.0, 500.0, "x", True), (400.0, 1.0, 500.0, "x", False), (9.0, 1.0, None, "", None)]
    cases += [(None, 1.0, 2.0, "s", True), (None, 3.0, 2.0, "s", False)]
    for ratio, value, aim, unit, met in cases:
        assert suite.Row("section", "what", value, "s", ratio, aim=aim, aim_unit=unit).met is met


@pytest.mark.parametrize("seconds", [0.0, pytest.param(math.inf, marks=pytest.mark.slow)])
def test_one_record(run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, seconds: float) -> None:
    """Spectral peaks are a baseline, like other installed methods; `seconds` limits the search."""
    monkeypatch.setattr(scoring, "diagnose", lambda *given: diagnose(*given, Work(seconds)))
    challenge, tables, figures = loaded("challenge", monkeypatch), tmp_path / "f.md", tmp_path / "f.json"
    monkeypatch.setattr(challenge, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    one = ("--seeds", 1, "--families", "short", "--jobs", 1, "--first", 1)
    told = run(challenge, *one, "--json", figures, "--markdown", tables)
    assert tables.read_text() == told
    assert told.startswith("1 of 1 records, development seeds from 1 on.")
    rows = [line.split(" | ") for line in told.splitlines() if line.startswith("| short")]
    assert {"hd_diag", "FFT peaks"} <= {row[1] for row in rows}
    assert len({len(row) for row in rows if row[1] == "hd_diag"}) == 2
    written = json.loads(figures.read_text())
    assert written["schema"] == "hd_diag/challenge/1"
    own = next(each for each in written["records"] if each["method"] == "hd_diag")
    assert (own["family"], own["seed"], own["hidden"]) == ("short", 1, ["output_runout"])
    assert own["seconds"] > 0.0
    assert run(challenge, "--again", figures) == told
    assert "| poor motions: records with a false name [%] | at most 0 | 0 | yes |" in told
