"""The node with an extended model, in a process of its own: predictions, parameters, log and replay."""

import itertools
import time
from pathlib import Path

import numpy as np
import pytest
from live import MS, RATIO, START, config, parameters, sample
from models import OFFSET, motion, write_model
from numpy.testing import assert_allclose
from running import running
from sensor_msgs.msg import JointState

from hd_diag.bag import BagReader
from hd_diag.extended_model import ExtendedModel
from hd_diag.replay.replay import replay

pytestmark = pytest.mark.usefixtures("ros")

AGREEMENT = 1e-9  # [rad]
EFFECTS = ("hysteresis", "stream_delay", "resonance")
COUNT = 300


def expected(model: ExtendedModel) -> np.ndarray:
    _, angle, torque, _ = motion(COUNT)
    time = 1e-3 * np.arange(COUNT)
    error, _ = model.step(model.start(), time, angle, None, torque, None, model.torsion_map)
    return error


def test_the_node_predicts_by_the_model_and_its_log_replays(tmp_path: Path) -> None:
    path = write_model(tmp_path / "model.json", *EFFECTS)
    # Relative to the parameter file, which the node runs far from.
    given = parameters(
        diagnostics_rate=20.0, log__path=str(tmp_path / "log"), joint_1__model_file="model.json"
    )
    (joint,) = config(joint_1__model_file=str(path)).joints
    assert joint.model is not None
    with running(tmp_path, given) as rig:
        values = rig.values("joint_1", lambda values: values["prediction"] == "map")
        assert values["model"].startswith("model.json sha256:")
        assert values["model_effects"] == ", ".join(EFFECTS)
        assert float(values["eccentricity_um"]) == pytest.approx(9.0)
        publisher = rig.publisher()
        errors: list[JointState] = rig.hear("hd_diag/transmission_error", JointState, [])
        _, angle, torque, _ = motion(COUNT)
        stamps = itertools.count(START, MS)
        for i in range(COUNT):
            publisher.publish(sample(next(stamps), angle[i], angle[i] / RATIO + OFFSET, torque[i]))
            time.sleep(1e-3)
        rig.until(lambda: len(errors) == COUNT, "prediction of every message")
        found = np.array([m.position[0] for m in errors])
        assert_allclose(found, expected(joint.model), rtol=0.0, atol=AGREEMENT)

        # Without the file everything else can still be set; the model itself not.
        path.unlink()
        assert [r.successful for r in rig.set(joint_1__torque=1.0)] == [True]
        (answer,) = rig.set(joint_1__model_file="model.json")
        assert not answer.successful
        assert "cannot be read" in answer.reason
        (answer,) = rig.set(joint_1__ratio=-100.0)
        assert not answer.successful
        assert "was fitted to a joint with ratio 100.0" in answer.reason
        assert [r.successful for r in rig.set(joint_1__model_file="")] == [True]
        rig.values("joint_1", lambda values: values["model"] == "" and values["eccentricity_um"] == "0")
        assert rig.process.end() == 0
    result = replay(tmp_path / "log", tmp_path / "again.mcap")
    assert result.reproduced
    topic = f"{rig.process.namespace}/hd_diag/transmission_error"
    assert messages(tmp_path / "again.mcap", topic) == messages(tmp_path / "log", topic)
    assert len(messages(tmp_path / "log", topic)) == COUNT


def messages(path: Path, topic: str) -> list[bytes]:
    with BagReader(path) as reader:
        return [bytes(data) for batch in reader.batches([topic]) for data in batch.messages()]
