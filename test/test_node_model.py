"""The node with an extended model, in its own process: predictions, parameters, log and replay."""

import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from live import MS, RATIO, START, config, sample, with_log
from logs import content
from models import OFFSET, motion, write_model
from numpy.testing import assert_allclose
from rclpy.parameter import Parameter
from running import running
from sensor_msgs.msg import JointState

from hd_diag.config.configuration import Config, ConfigError
from hd_diag.replay.replay import replay
from hd_diag.ros.parameter_server import ParameterServer

pytestmark = pytest.mark.usefixtures("ros")

AGREEMENT = 1e-9  # [rad]
EFFECTS = ("hysteresis", "stream_delay", "resonance")
COUNT = 300


def test_the_node_predicts_by_the_model_and_its_log_replays(tmp_path: Path) -> None:
    path = write_model(tmp_path / "model.json", *EFFECTS)
    given = with_log(tmp_path / "log", overwrite=True)
    given["joint_1.model_file"] = "model.json"  # relative to the parameter file, not to the node's folder
    (joint,) = config(joint_1__model_file=str(path)).joints
    with running(tmp_path, given) as rig:
        values = rig.values("joint_1", lambda values: values["prediction"] == "map")
        assert values["model"].startswith("model.json sha256:")
        assert values["model_effects"] == ", ".join(EFFECTS)
        assert float(values["eccentricity_um"]) == pytest.approx(9.0)
        publisher = rig.publisher()
        (errors,) = rig.hear({"hd_diag/transmission_error": JointState}).values()
        _, angle, torque, _ = motion(COUNT)
        for i in range(COUNT):
            publisher.publish(sample(START + i * MS, angle[i], angle[i] / RATIO + OFFSET, torque[i]))
            time.sleep(1e-3)
        rig.until(lambda: len(errors) == COUNT, "prediction of every message")
        model, moments = joint.model, 1e-3 * np.arange(COUNT)
        expected, _ = model.step(model.start(), moments, angle, None, torque, None, model.torsion_map)
        assert_allclose([m.position[0] for m in errors], expected, rtol=0.0, atol=AGREEMENT)

        # Without the file everything except the model can still be set.
        path.unlink()
        assert rig.set(joint_1__torque=1.0)[0].successful
        assert "cannot be read" in rig.set(joint_1__model_file="model.json")[0].reason
        assert "was fitted to a joint with another ratio" in rig.set(joint_1__ratio=-100.0)[0].reason
        # The node waits for no pipe, and reveals nothing of other users' files.
        os.mkfifo(tmp_path / "pipe")
        assert "no regular file" in rig.set(joint_1__model_file=str(tmp_path / "pipe"))[0].reason
        (tmp_path / "a\nb").write_text('{"password": "hunter2"}')
        (answer,) = rig.set(joint_1__model_file=str(tmp_path / "a\nb"))
        said = f"'{tmp_path}/a\\nb': is not a model that can be used: `hd-diag check` says why"
        assert (answer.successful, answer.reason) == (False, f"joint_1.model_file: {said}")
        assert rig.set(joint_1__model_file="")[0].successful
        rig.values("joint_1", lambda values: values["model"] == "" and values["eccentricity_um"] == "0")
        assert rig.process.end() == 0
    assert replay(tmp_path / "log", tmp_path / "again.mcap").reproduced
    topic = f"{rig.process.namespace}/hd_diag/transmission_error"
    live, again = (content(tmp_path / name)[topic] for name in ("log", "again.mcap"))
    assert (len(live), again) == (COUNT, live)


def test_a_disk_that_does_not_answer_holds_up_no_samples(tmp_path: Path, monkeypatch) -> None:
    """Only the first request waits; once the disk answers, files are read again."""
    answers, asked = threading.Event(), list[str]()

    def text(joint: str, path: str) -> str:
        asked.append(path)
        answers.wait(60.0)
        return Path(path).read_text()

    node = rclpy.create_node("slow", automatically_declare_parameters_from_overrides=True)
    server = ParameterServer(node, text)
    applied: list[Config] = []
    server.serve(applied.append)
    wanted = [Parameter("joint_1.model_file", value=str(write_model(tmp_path / "model.json")))]
    for reason in ("that takes longer than 0.25 s", "the file before is still being read"):
        begin = time.monotonic()
        with pytest.raises(ConfigError, match=reason):
            node.set_parameters_atomically(wanted)
        monkeypatch.setattr("hd_diag.ros.parameter_server._PATIENCE", 60.0)
    assert time.monotonic() - begin < 30.0
    assert (len(asked), server.config.joints[0].model, applied) == (1, None, [])
    answers.set()
    server._reading.join()
    assert node.set_parameters_atomically(wanted).successful
    assert applied == [server.config]
    assert server.config.joints[0].model is not None
    node.destroy_node()
