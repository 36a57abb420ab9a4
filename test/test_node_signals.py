"""The node with messages of other types, as far as they are installed."""

import re
import time
from pathlib import Path
from typing import Any

import live
import pytest
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from live import MS, START
from logs import replayed
from rosgraph_msgs.msg import Clock
from running import running
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hd_diag.bag.typestore import store_of
from hd_diag.config.configuration import Config, ConfigError, resolve
from hd_diag.messages.schemas import jazzy
from hd_diag.ros.message_types import definition_by_class, message_class
from hd_diag.ros.subscriptions import check_types, sources

pytestmark = pytest.mark.usefixtures("ros")

WRENCH = "geometry_msgs/msg/WrenchStamped"
STATE = {"topic": "states", "type": "trajectory_msgs/JointTrajectory"}
SIGNALS = {
    "input": {**STATE, "field": "points[0].positions[1]", "unit": "deg"},
    "output_signal": {**STATE, "field": "points[0].positions[0]"},
    "torque_signal": {"topic": "force", "type": WRENCH, "field": "wrench.torque.z", "sign": -1},
    "temperature_signal": {**STATE, "field": "points[0].effort[0]", "unit": "K"},
}


def parameters(**more: Any) -> dict[str, Any]:
    flat = {f"elbow.{owner}.{name}": value for owner, own in SIGNALS.items() for name, value in own.items()}
    return {"joints": ["elbow"], "diagnostics_rate": 20.0, **flat, **more}


def stamped(message: Any, number: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(START + number * MS, 10**9)
    return message


def test_signals_of_other_types_live_and_in_the_log(tmp_path: Path) -> None:
    """An encoder that wraps at 180 degrees, a torque of opposite sign; the log replays bit for bit."""
    with running(tmp_path, parameters(**{"log.path": str(tmp_path / "log.mcap")})) as rig:
        states, forces = rig.publisher("states", JointTrajectory), rig.publisher("force", WrenchStamped)
        forces.publish(stamped(WrenchStamped(wrench=Wrench(torque=Vector3(z=4.0))), 0))
        for sent in range(1, 200):
            degrees = (sent * 5.0 + 180.0) % 360.0 - 180.0
            point = JointTrajectoryPoint(positions=[0.0, degrees], effort=[300.0 + sent])
            states.publish(stamped(JointTrajectory(points=[point]), sent))
            if sent < 99:
                continue
            values = rig.values("elbow", lambda values, sent=sent: values["samples"] == str(sent))
            if float(values["torque_Nm"]):  # the torque's topic may come after many states
                break
        assert float(values["input_angle_rad"]) == pytest.approx(sent * 5.0 * 3.14159265 / 180.0, abs=1e-3)
        assert float(values["torque_Nm"]) == -4.0
        assert float(values["temperature_C"]) == pytest.approx(300.0 + sent - 273.15)
        states.publish(JointTrajectory())
        values = rig.values("elbow", lambda values: values["samples_rejected"] == "1")
        assert values["last_rejection"] == "a message has 0 elements of points: none is points[0]"
        assert rig.process.end() == 0
    assert len(replayed(tmp_path / "log.mcap")[f"{rig.process.namespace}/states"]) == sent + 1


NAMES = """trajectory_msgs/msg/JointTrajectory diagnostic_msgs/msg/DiagnosticArray std_msgs/msg/Empty
rcl_interfaces/msg/ParameterEvent rcl_interfaces/msg/ParameterDescriptor sensor_msgs/msg/PointCloud2
geometry_msgs/msg/PoseWithCovarianceStamped shape_msgs/msg/SolidPrimitive"""


@pytest.mark.parametrize("name", NAMES.split())
def test_definitions_by_class_are_those_of_the_type(name: str) -> None:
    found = definition_by_class(name)
    assert store_of(name, found).hash_rihs01(name) == jazzy().hash_rihs01(name)
    assert name == "std_msgs/msg/Empty" or message_class(name).__name__ == name.rsplit("/", 1)[1]


WRONG = {
    "type: control_msgs/msg/DynamicJointState is not installed here": (
        "type",
        "control_msgs/DynamicJointState",
    ),
    "no message JointTrajectry; the nearest is JointTrajectory": ("type", "trajectory_msgs/JointTrajectry"),
    "field: trajectory_msgs/msg/JointTrajectoryPoint has no field 'posn'": ("field", "points[0].posn[1]"),
    "elbow.input.type: /joint_states cannot have": ("topic", "joint_states"),
}


@pytest.mark.parametrize("said", WRONG)
def test_a_mapping_that_cannot_be_is_told_at_the_start(said: str) -> None:
    what, value = WRONG[said]
    with pytest.raises(ConfigError, match=re.escape(said)):
        begin(resolve(parameters(**{f"elbow.input.{what}": value})))


def begin(given: Config) -> None:
    check_types(given)
    sources(given, lambda topic: f"/{topic.lstrip('/')}")


def test_a_clock_as_fast_as_the_samples_costs_none(tmp_path: Path) -> None:
    """DDS has a clock message between every two samples, and holds 2000 samples."""
    given = live.parameters(use_sim_time=True, diagnostics_rate=10.0)
    with running(tmp_path, given) as rig:
        rig.values("joint_1", lambda values: values["prediction"] == "map")
        clock, source = rig.publisher("clock", Clock), rig.publisher()
        count, now, begin = 5000, Clock(), time.monotonic()
        for number in range(count):
            now.clock.sec, now.clock.nanosec = divmod(START + number * MS, 10**9)
            clock.publish(now)
            source.publish(live.sample(START + number * MS, 1e-4 * number, 0.0, 1.0))
            time.sleep(max(0.0, begin + number * 1e-3 - time.monotonic()))
        values = rig.values("joint_1", lambda values: int(values["samples"]) == count)
        assert (values["samples_missed"], values["messages_lost"]) == ("0", "0")
