"""From a measured bag to a running model: written, loaded, and as accurate on the record as stated."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import hd_diag
from live import RATIO
from models import model, term
from test_recording import START, whole, write

from hd_diag.bag import BagReader
from hd_diag.config.configuration import JointConfig, load
from hd_diag.diagnosis.extension import running_residual
from hd_diag.diagnosis.record import Record
from hd_diag.effects.remainders import REMAINDERS
from hd_diag.extended_model import ExtendedModel
from hd_diag.records.joint_record import read_bags

DELAY = 2e-4  # [s]; 25 arcsec at 60 rad/s of the input
STEP = 4  # [ms]
NAMES_OF_REMAINDERS = {remainder.name for remainder in REMAINDERS}
NOISE = 1e-5  # [rad]


def runs(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Input angle [rad] and torque [N m], (n,) each: runs at different speeds with rests between them."""
    speeds = [(-1) ** (i // 2) * (20.0 + 10.0 * (i % 5)) for i in range(number)]
    per_run, rest = 750, 100
    shape = np.concatenate((np.zeros(rest), np.sin(np.linspace(0.0, np.pi, per_run - rest)) ** 2))
    speed = np.concatenate([one * shape for one in speeds])
    angle = np.cumsum(speed) * STEP * 1e-3
    time = np.arange(angle.size) * STEP * 1e-3
    return angle, 35.0 * np.sin(1.3 * time) + 10.0 * np.sin(0.31 * time)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("extension")
    angle, torque = runs(10)
    plain, random = model(), np.random.default_rng(11)
    delay = (term("stream_delay", {"delay": DELAY}),)
    made = ExtendedModel(plain.drive, delay, plain.offset, plain.ranges)
    time = np.arange(angle.size) * STEP * 1e-3
    error, _ = made.step(made.start(), time, angle, None, torque, None, made.torsion_map)
    output = angle / RATIO + error + random.normal(0.0, NOISE, angle.size)
    write(path / "bag.mcap", whole({"time": time, "input": angle, "output": output, "torque": torque}))
    files = ("--model", path / "model.json", "--json", path / "verdict.json")
    result = hd_diag("diagnose", path / "bag.mcap", *files)
    assert result.exit_code == 0, result.output
    text = "hd_diag: {ros__parameters: {joints: [joint_1], joint_1: {model_file: model.json}}}"
    (path / "with_model.yaml").write_text(text)
    return path


@pytest.fixture(scope="module")
def joint(folder: Path) -> JointConfig:
    return load(folder / "with_model.yaml").joints[0]


def fit(joint: JointConfig, folder: Path) -> tuple[Record, np.ndarray]:
    record = read_bags([folder / "bag.mcap"], joint)
    return record, running_residual(joint.model, record, record.reported_torque, joint.model.torsion_map)


def test_the_verdict_names_the_file_and_its_evidence(folder: Path) -> None:
    verdict, written = (json.loads((folder / f"{name}.json").read_text()) for name in ("verdict", "model"))
    assert verdict["model"] == str(folder / "model.json")
    assert [cause["name"] for cause in verdict["causes"]] == ["stream_delay"]
    causes = [effect for effect in written["effects"] if effect["name"] not in NAMES_OF_REMAINDERS]
    assert [effect["name"] for effect in causes] == ["stream_delay"]
    delay = causes[0]["parameters"]["delay"]
    assert delay["value"] == pytest.approx(DELAY, rel=0.05)
    assert 0.0 < delay["std"] < 0.05 * DELAY
    evidence = written["evidence"]
    assert evidence["extended"] == verdict["extended"]
    assert len(evidence["bags"][0]["sha256"]["bag.mcap"]) == 64
    assert written["valid_range"]["torque"]["high"] == pytest.approx(45.0, rel=0.1)
    assert written["valid_range"]["temperature"] is None


def test_the_model_as_it_runs_is_as_good_as_told(folder: Path, joint: JointConfig) -> None:
    """On all rows, most of them fitted, the residual does not exceed that stated for held-out rows."""
    verdict = json.loads((folder / "verdict.json").read_text())
    assert 0.9 < np.std(fit(joint, folder)[1]) / verdict["extended"]["rms_live"] < 1.02
    # Its fitted functions contain part of the noise.
    assert verdict["extended"]["rms_live"] == pytest.approx(NOISE, rel=0.12)
    assert verdict["extended"]["rms"] == pytest.approx(NOISE, rel=0.12)
    assert verdict["refit"]["rms"] > 4.5 * NOISE
    # The next diagnosis starts from the configured joint, that is from the parameters before the fit.
    assert abs(joint.configured.mesh.eccentricity) == 0.0
    assert abs(joint.drive.mesh.eccentricity) == pytest.approx(9e-6, rel=0.05)


def test_a_replay_with_the_model_has_the_residual_of_the_fit(folder: Path, joint: JointConfig) -> None:
    out = folder / "replayed.mcap"
    result = hd_diag("replay", folder / "bag.mcap", "--config", folder / "with_model.yaml", "--out", out)
    assert result.exit_code == 0, result.output
    record, expected = fit(joint, folder)
    with BagReader(out) as reader:
        states = [s for b in reader.batches(["/hd_diag/residual"]) for s in reader.joint_states(b)[0]]
    stamp = np.concatenate([s.stamp for s in states])
    residual = np.concatenate([s.position[:, 0] for s in states if s.position is not None])
    rows = np.searchsorted(stamp, START + np.round(record.time * 1e9).astype(np.int64))
    kept = np.flatnonzero(np.diff(rows, prepend=-1) == 1)  # after an outlier the record's last angle is older
    assert kept.size > 0.95 * residual.size
    np.testing.assert_allclose(residual[rows[kept]], expected[kept], rtol=0.0, atol=1e-9)
