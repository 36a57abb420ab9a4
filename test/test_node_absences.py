"""Reasons for a joint without samples, as the node reports them over DDS and in a replay of its log."""

import itertools
from pathlib import Path

import pytest
from live import MS, START, message, with_log
from logs import replayed
from running import running, values_of
from sensor_msgs.msg import ChannelFloat32, PointCloud

pytestmark = pytest.mark.usefixtures("ros")

CLOUD = {"topic": "clouds", "type": "sensor_msgs/PointCloud", "field": "channels[{name}].values[0]"}
GIVEN = {
    "left_elbow.input_joint": "left_elbow",
    "left_elbow.output_joint": "left_elbow_link",
    "wrist.input.topic": "motors",
    **{f"neck.input.{name}": value for name, value in CLOUD.items()},
    "neck.input.name": "neck_motor",
    **{f"hand.limits.rejected.{level}": 1.0 for level in ("warn", "error")},
}
SAID = {
    "left_elbow": "left_elbow does not arrive; the nearest name that does is left_elbo",
    "shoulder": "of shoulder_motor nothing arrives, of its output shoulder alone",
    "wrist": "nobody publishes {0}/motors; sensor_msgs/msg/JointState is on {0}/joint_states",
    "hand": "the stamps stand still: stamp of hand_motor repeats the last",
    "neck": "{0}/clouds: neck_motor does not arrive; the nearest name that does is nek_motor",
}


def test_stale_says_why_live_and_in_the_replay(tmp_path: Path) -> None:
    with running(tmp_path, with_log(tmp_path / "log.mcap", *SAID) | GIVEN) as rig:
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
    replayed(tmp_path / "log.mcap")


def latest(rig, joint: str, meanwhile) -> str:
    meanwhile()
    (status,) = (s for s in rig.reports[-1].status if s.name.endswith(f" {joint}"))
    is_told = values_of(status)["fault_code"] == "STALE" and status.message.startswith("no valid sample for ")
    return str(status.message) if is_told else ""
