"""Random records: every verb ends with a result or one line, never with an internal error."""

from pathlib import Path

import numpy as np
import pytest
from cli_runner import hd_diag
from random_records import GEARS, case

from hd_diag.cli.verbs import FAULT
from hd_diag.config.configuration import dump, resolve


@pytest.fixture(scope="module")
def gears(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    files = [tmp_path_factory.mktemp("gears") / f"{number}.yaml" for number in range(len(GEARS))]
    for words, file in zip(GEARS, files, strict=True):
        page = dict(zip((word[2:].replace("-", "_") for word in words[::2]), words[1::2], strict=True))
        given = {"output": page.pop("output", "flexspline")}
        given |= {f"gear.{name}": float(value) for name, value in page.items()}
        file.write_text(dump(resolve({f"joint_1.{name}": value for name, value in given.items()})))
    return files


FEW = (0, 1, 2, 7, 167)  # every verb, and an output that stands still while the input moves
MANY = (3, 4, 5, 6, 8, 9, *range(100, 500), 2023, 2200)  # the last two once failed


@pytest.mark.parametrize("seed", [*FEW, *(pytest.param(seed, marks=pytest.mark.slow) for seed in MANY)])
def test_records_of_any_make(seed: int, gears: list[Path], tmp_path: Path) -> None:
    """Code 0 with a result, or code 2 with one line that gives the reason; nothing else on stderr."""
    made = case(seed, tmp_path)
    result = hd_diag(*made.arguments, "--config", gears[made.gear])
    assert isinstance(result.exception, SystemExit | None)
    assert result.exit_code in (0, 2), (made, result.output)
    assert FAULT not in result.stderr, (made, result.stderr)
    assert len(result.stderr.splitlines()) == (result.exit_code == 2 and not result.stdout)


@pytest.mark.slow
def test_a_thousand_short_moves(gears: list[Path], tmp_path: Path) -> None:
    """Moves of one second at 100 Hz: each run is less than a four-hundredth of the record."""
    rng, moves = np.random.default_rng(0), 700
    share = np.linspace(0.0, 1.0, 100)
    steps = rng.uniform(-150.0, 150.0, moves)
    smooth = np.concatenate((share**3 * (10.0 - share * (15.0 - 6.0 * share)), np.ones(50)))
    angle = (np.cumsum(steps) - steps)[:, None] + steps[:, None] * smooth
    time, angle = 0.01 * np.arange(angle.size), angle.ravel()
    torque = 20.0 * np.sin(angle / 100.0) + 0.3 * rng.standard_normal(angle.size)
    output = angle / 100.0 - torque / 3e4 + 1e-5 * rng.standard_normal(angle.size)
    file = tmp_path / "moves.csv"
    rows = np.stack((time, angle, output, torque), axis=1)
    np.savetxt(file, rows, fmt="%.9g", delimiter=",", header="t,x,y,q", comments="")
    words = ("diagnose", str(file), "--columns", "time=t,input=x,output=y,torque=q", "--time-limit", "0")
    result = hd_diag(*words, "--config", gears[0])
    assert result.exit_code == 0, result.output
    assert "runs): nominal" in result.stdout  # whole runs are held-out
