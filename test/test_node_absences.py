"""Why a joint has no samples, as the node tells it: over DDS, and the same in a replay of its log."""

import itertools
from pathlib import Path
from typing import Any

import pytest
from live import MS, START, message
from logs import content
from rcl_interfaces.srv import DescribeParameters
from running import running, values_of
from sensor_msgs.msg import ChannelFloat32, JointState, PointCloud

from hd_diag.config.configuration import resolve
from hd_diag.replay.replay import replay

pytestmark = pytest.mark.usefixtures("ros")

JOINTS = ("left_elbow", "shoulder", "wrist", "hand", "neck")
CLOUD = {"topic": "clouds", "type": "sensor_msgs/PointCloud", "field": "channels[{name}].values[0]"}
GIVEN = {
    "left_elbow.input_joint": "left_elbow",
    "left_elbow.output_joint": "left_elbow_link",
    "wrist.input.topic": "motors",
    **{f"neck.input.{name}": value for name, value in CLOUD.items()},
    "neck.input.name": "neck_motor",
}
SAID = {
    "left_elbow": "left_elbow does not arrive; the nearest name that does is left_elbo",
    "shoulder": "of shoulder_motor nothing arrives, of its output shoulder alone",
    "wrist": "nobody publishes {0}/motors; sensor_msgs/msg/JointState is on {0}/joint_states",
    "hand": "the stamps stand still: stamp of hand_motor repeats the last",
    "neck": "{0}/clouds: neck_motor does not arrive; the nearest name that does is nek_motor",
}


def test_stale_says_why_live_and_in_the_replay(tmp_path: Path) -> None:
    given = {"joints": [*JOINTS], "diagnostics_rate": 20.0, "log.path": str(tmp_path / "log.mcap"), **GIVEN}
    given |= {"hand.limits.rejected.warn": 1.0, "hand.limits.rejected.error": 1.0}
    with running(tmp_path, given) as rig:
        source, clouds = rig.publisher(), rig.publisher("clouds", PointCloud)
        stamps = itertools.count(START, MS)

        def publish() -> None:
            source.publish(message(next(stamps), {"left_elbo": 0.1, "shoulder": 0.1}))
            source.publish(message(START, {"hand_motor": 0.1, "hand": 0.1}))
            clouds.publish(PointCloud(channels=[ChannelFloat32(name="nek_motor", values=[1.0])]))

        for joint, said in SAID.items():
            why = said.format(rig.process.namespace)
            rig.until(lambda j=joint, w=why: w in latest(rig, j, publish), why)  # type: ignore[misc]
        rig.node.destroy_publisher(source)
        nobody = f"nobody publishes {rig.process.namespace}/joint_states"
        rig.until(lambda: nobody in latest(rig, "hand", lambda: None), nobody)
        assert rig.process.end() == 0
    replay(tmp_path / "log.mcap", tmp_path / "again.mcap")
    assert content(tmp_path / "again.mcap") == content(tmp_path / "log.mcap")


def latest(rig: Any, joint: str, meanwhile: Any) -> str:
    meanwhile()
    (status,) = (s for s in rig.reports[-1].status if s.name.endswith(f" {joint}"))
    is_told = values_of(status)["fault_code"] == "STALE" and status.message.startswith("no valid sample for ")
    return str(status.message) if is_told else ""


def test_parameter_descriptors_have_ranges_and_fixed_names(tmp_path: Path) -> None:
    """Tools draw a slider from a range; who writes a name to a running node is told that it stays."""
    config = resolve({"joints": ["elbow"]})
    with running(tmp_path, {"joints": ["elbow"], "diagnostics_rate": 20.0}) as rig:
        client = rig.node.create_client(
            DescribeParameters, f"{rig.process.namespace}/hd_diag/describe_parameters"
        )
        rig.until(client.service_is_ready, "service")
        names = [*config.flat]
        answer = client.call_async(DescribeParameters.Request(names=names))
        rig.until(answer.done, "answer")
        described = dict(zip(names, answer.result().descriptors, strict=True))
        (torque,) = described["elbow.limits.torque.warn"].floating_point_range
        assert (torque.from_value, torque.to_value, torque.step) == (0.0, 1e6, 0.0)
        (teeth,) = described["elbow.flexspline_teeth"].integer_range
        assert (teeth.from_value, teeth.to_value) == (20, 640)
        (sign,) = described["elbow.input.sign"].integer_range
        assert (sign.from_value, sign.to_value, sign.step) == (-1, 1, 2)
        for name in ("input_joint", "output_joint", "input_divided", "input.topic", "torque_signal.sign"):
            assert described[f"elbow.{name}"].read_only
        changes: dict[str, Any] = {"elbow__input_joint": "m", "elbow__torque_signal__sign": -1}
        for name, answer in zip(changes, rig.set(**changes), strict=True):
            assert not answer.successful
            assert answer.reason == f"{name.replace('__', '.')}: is fixed when the node starts (read-only)"
        assert [value.string_value for value in rig.get("elbow.input_joint")] == [""]
        (refused,) = rig.set(nonsense=1.0)
        assert refused.reason == "unknown parameter 'nonsense', and none that is known is like it"
        rig.publisher("joint_states", JointState).publish(message(START, {"elbow_motor": 0.1, "elbow": 0.0}))
        rig.values("elbow", lambda values: values["samples"] == "1")
