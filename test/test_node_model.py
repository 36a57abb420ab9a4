"""The node with an extended model, in a process of its own: predictions, parameters, log and replay."""

import itertools
import time
from pathlib import Path

import numpy as np
import pytest
from live import MS, RATIO, START, config, parameters, sample
from logs import content
from models import OFFSET, motion, write_model
from numpy.testing import assert_allclose
from running import running
from sensor_msgs.msg import JointState

from hd_diag.replay.replay import replay

pytestmark = pytest.mark.usefixtures("ros")

AGREEMENT = 1e-9  # [rad]
EFFECTS = ("hysteresis", "stream_delay", "resonance")
COUNT = 300


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
        model = joint.model
        moments = 1e-3 * np.arange(COUNT)
        expected, _ = model.step(model.start(), moments, angle, None, torque, None, model.torsion_map)
        assert_allclose([m.position[0] for m in errors], expected, rtol=0.0, atol=AGREEMENT)

        # Without the file everything else can still be set; the model itself not.
        path.unlink()
        assert rig.set(joint_1__torque=1.0)[0].successful
        assert "cannot be read" in rig.set(joint_1__model_file="model.json")[0].reason
        assert "was fitted to a joint with ratio 100.0" in rig.set(joint_1__ratio=-100.0)[0].reason
        assert rig.set(joint_1__model_file="")[0].successful
        rig.values("joint_1", lambda values: values["model"] == "" and values["eccentricity_um"] == "0")
        assert rig.process.end() == 0
    result = replay(tmp_path / "log", tmp_path / "again.mcap")
    assert result.reproduced
    topic = f"{rig.process.namespace}/hd_diag/transmission_error"
    live = content(tmp_path / "log")[topic]
    assert content(tmp_path / "again.mcap")[topic] == live
    assert len(live) == COUNT
