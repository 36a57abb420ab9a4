"""The node with an extended model, in a process of its own: predictions, parameters, log and replay."""

import itertools
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from live import MS, RATIO, START, config, parameters, sample
from logs import content
from models import OFFSET, motion, write_model
from numpy.testing import assert_allclose
from rclpy.parameter import Parameter
from running import running
from sensor_msgs.msg import JointState

from hd_diag.config.configuration import Config, ConfigError
from hd_diag.drive import transmission_error
from hd_diag.replay.replay import replay
from hd_diag.ros.parameter_server import ParameterServer

pytestmark = pytest.mark.usefixtures("ros")

AGREEMENT = 1e-9  # [rad]
EFFECTS = ("hysteresis", "stream_delay", "resonance")
COUNT = 300


def test_the_node_predicts_by_the_model_and_its_log_replays(tmp_path: Path) -> None:
    path = write_model(tmp_path / "model.json", *EFFECTS)
    # Relative to the parameter file, which the node runs far from.
    given = parameters(
        diagnostics_rate=20.0,
        log__path=str(tmp_path / "log"),
        log__overwrite=True,
        joint_1__model_file="model.json",
    )
    (joint,) = config(joint_1__model_file=str(path)).joints
    assert joint.model is not None
    with running(tmp_path, given) as rig:
        values = rig.values("joint_1", lambda values: values["prediction"] == "map")
        assert values["model"].startswith("model.json sha256:")
        assert values["model_effects"] == ", ".join(EFFECTS)
        assert float(values["eccentricity_um"]) == pytest.approx(9.0)
        publisher = rig.publisher()
        (errors,) = rig.hear({"hd_diag/transmission_error": JointState}).values()
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
        assert "was fitted to a joint with another ratio" in rig.set(joint_1__ratio=-100.0)[0].reason
        # A file that is none is not waited for, and of others' files nothing is told.
        os.mkfifo(tmp_path / "pipe")
        assert "no regular file" in rig.set(joint_1__model_file=str(tmp_path / "pipe"))[0].reason
        (tmp_path / "a\nb").write_text('{"password": "hunter2"}')
        (answer,) = rig.set(joint_1__model_file=str(tmp_path / "a\nb"))
        said = "is not a model that can be used: `hd-diag check` says why"
        expected = f"joint_1.model_file: '{tmp_path}/a\\nb': {said}"
        assert (answer.successful, answer.reason) == (False, expected)
        assert rig.set(joint_1__model_file="")[0].successful
        rig.values("joint_1", lambda values: values["model"] == "" and values["eccentricity_um"] == "0")
        assert rig.process.end() == 0
    result = replay(tmp_path / "log", tmp_path / "again.mcap")
    assert result.reproduced
    topic = f"{rig.process.namespace}/hd_diag/transmission_error"
    live = content(tmp_path / "log")[topic]
    assert content(tmp_path / "again.mcap")[topic] == live
    assert len(live) == COUNT


def test_a_disk_that_does_not_answer_holds_up_no_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first request alone is waited for; when the disk answers again, files are read again."""
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


def test_a_tilt_that_is_set_acts_on_the_next_sample(tmp_path: Path) -> None:
    """On a cup in sections; one that no cup can have, or on one section, is refused and changes nothing."""
    width = {"joint_1__face_width": 0.011, "joint_1__cup_length": 0.04, "joint_1__sections": 3}
    angle, torque = np.linspace(0.1, 2.0, 20), np.full(20, 6.0)
    with running(tmp_path, parameters(diagnostics_rate=20.0, **width)) as rig:
        publisher = rig.publisher()
        (errors,) = rig.hear({"hd_diag/transmission_error": JointState}).values()
        stamps = itertools.count(START, MS)
        for number, tilt in enumerate(
            ({}, {"joint_1__tilt__magnitude": 1e-3, "joint_1__tilt__direction": 0.7})
        ):
            if tilt:
                assert "strikes the circular spline" in rig.set(joint_1__tilt__magnitude=0.09)[0].reason
                assert all(answer.successful for answer in rig.set(**tilt))
            for own, load in zip(angle, torque, strict=True):
                publisher.publish(sample(next(stamps), own, own / RATIO, load))
            rig.until(lambda n=number: len(errors) == 20 * (n + 1), "prediction of every message")
            (joint,) = config(**width, **tilt).joints
            expected = transmission_error(joint.drive, angle, torque)
            found = [m.position[0] for m in errors[-20:]]
            assert_allclose(found, expected, rtol=0.0, atol=2e-7)  # by a map, or exact
        assert "give face_width" in rig.set(joint_1__sections=1)[0].reason
        assert rig.process.end() == 0
