"""Orders without a tooth model: only the ratio of the gear is known."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import ASSUMED, hd_diag
from test_recording import COLUMNS, write_table
from test_signal_findings import ARCSEC, moves

SIZE = 8.0 * ARCSEC
COLUMNS_GIVEN = ("--columns", ",".join(f"{key}={name}" for key, name in COLUMNS.items()))


def table(folder: Path, seed: int, order: float = 128.0, ratio: float = 100.0) -> Path:
    """A move over 0.8 of an output turn, with an encoder's line and a random offset."""
    record = moves(5.0)
    rng = np.random.default_rng(seed)
    line = SIZE * np.cos(order * record.input_angle / 100.0 - 0.7) + 1e-3 * rng.uniform()
    noise = 2.0 * ARCSEC * rng.standard_normal(record.size)
    torsion = -7.0 * ARCSEC * record.torque
    given = {"time": record.time, "input": ratio / 100.0 * record.input_angle, "torque": record.torque}
    output = record.input_angle / 100.0 + torsion + line + noise
    return write_table(folder / f"{seed}.csv", {**given, "output": output})


def test_a_line_of_the_output_encoder_is_described(tmp_path: Path) -> None:
    bags, result = [table(tmp_path, seed) for seed in (1, 2)], tmp_path / "o.json"
    done = hd_diag("diagnose", *bags, *COLUMNS_GIVEN, "--orders-only", "--json", result)
    assert (done.exit_code, done.stderr) == (0, ASSUMED)
    told = json.loads(result.read_text())
    (row,) = told["described"]
    assert (row["order"], row["frame"], row["repeats"]) == (128.0, "output", True)
    assert row["amplitude"] == pytest.approx(SIZE, rel=0.05)
    assert row["phase"] == pytest.approx(0.7, abs=0.1)
    assert row["might_be"] == ["output_encoder_interpolation", "tooth_damage"]
    assert (told["judgement"], told["causes"], told["refit"]["parameters"]) == ("described", [], {})
    assert told["gain"]["low"] > 0.5
    assert "128 per output turn (8.0" in told["verdict"]


@pytest.mark.parametrize("ratio", [160.0, 152.4])
def test_a_ratio_without_its_teeth_is_enough(ratio: float, tmp_path: Path) -> None:
    """Ratio of another gear than the example's, or of one behind a belt; verbs that need teeth say so."""
    config, result = tmp_path / "r.yaml", tmp_path / "o.json"
    config.write_text(f"hd_diag:\n  ros__parameters:\n    joints: [a4]\n    a4: {{ratio: {ratio}}}\n")
    given = (table(tmp_path, 1, ratio=ratio), *COLUMNS_GIVEN, "--config", config, "--json", result)
    done = hd_diag("diagnose", *given, "--orders-only")
    assert (done.exit_code, done.stderr) == (0, "")
    (row,) = json.loads(result.read_text())["described"]
    assert (row["order"], row["amplitude"]) == (128.0, pytest.approx(SIZE, rel=0.05))
    told = hd_diag("ripple", *given).stderr
    assert "ratio" not in told
    of_teeth = {160.0: "320 and 322 teeth has this ratio: hd-diag gear", 152.4: "its magnitude must be 100\n"}
    assert of_teeth[ratio] in hd_diag("diagnose", *given).stderr
