"""The node in a process of its own, over DDS, as on a robot."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from faults import MESSAGES, STARTS, VALUES
from live import MS, RATIO, START, config, message, parameters, sample, with_log
from logs import replayed, whole
from mcap_ros2.reader import read_ros2_messages
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from running import LIMIT, Rig, feed, running, stamp_of, values_of
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64MultiArray, Header
from visualization_msgs.msg import MarkerArray

from hd_diag.drive import mesh_state, transmission_error
from hd_diag.ros.node import main

pytestmark = pytest.mark.usefixtures("ros")

QUICK = {"diagnostics_rate": 20.0}
JOINTS = ("shoulder", "elbow")
FIXED = {"joints": ["elbow"], "elbow.input_joint": "m", "elbow.torque_signal.sign": -1}
SAID = "is fixed when the node starts (read-only)"
REFUSED = [*VALUES, *(({name: value}, f"{name}: {SAID}") for name, value in FIXED.items())]
REFUSED += [({"nonsense": 1.0}, "unknown parameter 'nonsense', and none that is known is like it")]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A node with two joints; its tests share one time, which only advances."""
    folder = tmp_path_factory.mktemp("arm")
    given = with_log(folder / "log", *JOINTS, overwrite=True)
    with running(folder, given | {"mesh_rate": 10.0}) as rig:
        rig.folder = folder  # type: ignore[attr-defined]
        yield rig


@pytest.fixture(scope="module")
def publisher(arm: Rig) -> Any:
    return arm.publisher()


stamps = itertools.count(START, MS)


def predictions(rig: Rig, begin: int = 0) -> Callable[[], list[JointState]]:
    """Predictions heard from now on with stamps from ``begin`` [ns]; earlier samples' may arrive late."""
    (found,) = rig.hear({"hd_diag/transmission_error": JointState}).values()
    return lambda: [message for message in found if stamp_of(message) >= begin]


def exact(angle: float, torque: float, **given: Any) -> float:
    """Exact error [rad] of the elbow; without other parameters it is also the shoulder's."""
    drive = config(*JOINTS, **given).joints[1].drive
    return float(transmission_error(drive, np.array([angle]), np.array([torque]))[0])


BOUND = 1e-7  # the maps aim at 0.01 arcsec, 5e-8 rad


def test_all_topics_with_their_types_and_content(arm: Rig, publisher: Any) -> None:
    angles = ("transmission_error", "measured_transmission_error", "residual")
    kinds = dict.fromkeys((f"hd_diag/{topic}" for topic in angles), JointState)
    for joint in JOINTS:
        kinds |= {f"hd_diag/{joint}/{array}": Float64MultiArray for array in ("backlash", "load")}
        kinds[f"hd_diag/{joint}/stamp"] = Header
        kinds[f"hd_diag/{joint}/mesh"] = MarkerArray
    found = arm.hear(kinds)
    for _ in range(1000):
        next(stamps)  # a new period of every rate begins
    stamp, angle, torque = next(stamps), 0.7, 30.0
    position = {"elbow_motor": angle, "elbow": 0.02, "shoulder_motor": -1.0, "shoulder": 0.1}
    publisher.publish(message(stamp, position, {"elbow": torque}))
    arm.until(lambda: all(found.values()), "message on every topic")
    error, measured, residual = (found[f"hd_diag/{topic}"][0] for topic in angles)
    assert [stamp_of(m) for m in (error, measured, residual)] == [stamp] * 3
    assert list(error.name) == ["shoulder", "elbow"]
    assert list(error.position) == pytest.approx([exact(-1.0, 0.0), exact(angle, torque)], abs=BOUND)
    assert list(error.effort) == [0.0, torque]
    assert measured.position[1] == pytest.approx(0.02 - angle / RATIO, rel=1e-12)
    assert residual.position[1] == measured.position[1] - error.position[1]
    state = mesh_state(config(*JOINTS).joints[1].drive, np.array([angle]), np.array([-torque]))
    for topic, values in (("elbow/backlash", state.backlash[0]), ("elbow/load", state.load[0])):
        array = found[f"hd_diag/{topic}"][0]
        dimensions = [(d.label, d.size, d.stride) for d in array.layout.dim]
        assert dimensions == [("flank", 2, 400), ("tooth", 200, 200)]
        np.testing.assert_array_equal(np.reshape(array.data, (2, 200)), values)
    header = found["hd_diag/elbow/stamp"][0]
    assert (header.stamp.sec * 10**9 + header.stamp.nanosec, header.frame_id) == (stamp, "elbow")
    assert {m.header.frame_id for m in found["hd_diag/elbow/mesh"][0].markers} == {"elbow"}


def test_diagnostics(arm: Rig, publisher: Any) -> None:
    feed(publisher, stamps, 100, joint="elbow")
    status = arm.status("elbow", lambda values: values["sample_rate_hz"] not in ("0", "nan"))
    values = values_of(status)
    assert status.hardware_id == f"{arm.process.namespace}/hd_diag/elbow"
    assert status.level in (b"\0", b"\1", b"\2")
    assert len(values) == len(status.values)
    assert values["log_state"].startswith("writing ")
    assert float(values["latency_p99_us"]) > 0.0
    assert [s.name for s in arm.reports[-1].status] == ["hd_diag: shoulder", "hd_diag: elbow"]


def test_a_second_publisher_of_a_joint_is_a_warning_until_it_goes(arm: Rig, publisher: Any) -> None:
    other = arm.publisher()

    def warned() -> bool:
        for each in (publisher, other):
            each.publish(sample(next(stamps), 0.0, 0.0, 0.0, "elbow"))
        values = values_of(arm.reports[-1].status[1])
        return "INPUT_INVALID" in values["fault_codes"] and said in values["warning"]

    said = "/joint_states has more than one publisher of elbow, elbow_motor; on it publish /"
    arm.until(warned, "warning")
    arm.node.destroy_publisher(other)
    arm.values("elbow", lambda values: values["warning"] == "")


def test_temperature_and_an_unreadable_one_of_another_joint(arm: Rig, publisher: Any) -> None:
    """The node listens with best effort: it misses messages sent before it discovers the sensor."""
    sensor = arm.publisher("elbow/temperature", Temperature)

    def reported() -> bool:
        sensor.publish(Temperature(temperature=41.25))
        return any(values_of(status)["temperature_C"] == "41.25" for status in arm.reports[-1].status)

    arm.until(reported, "report of the temperature")
    before = {joint: arm.values(joint)["samples_rejected"] for joint in JOINTS}
    sensor.publish(b"\0\1\0\0no temperature")
    values = arm.values("elbow", lambda values: values["samples_rejected"] != before["elbow"])
    assert "a Temperature message cannot be read" in values["last_rejection"]
    assert arm.values("shoulder")["samples_rejected"] == before["shoulder"]


def kilobytes(rig: Rig, what: str) -> int:
    status = Path(f"/proc/{rig.process.popen.pid}/status").read_text()
    return int(status.partition(f"{what}:")[2].split()[0])


def test_maps_come_into_force_and_it_is_light(arm: Rig) -> None:
    """With its maps, before many messages; LLVM alone takes 110 MB, an empty rclpy node 70."""
    for joint in JOINTS:
        values = arm.values(joint, lambda values: values["prediction"] == "map")
        assert 0.0 < float(values["prediction_error_bound_arcsec"]) < 0.02
    assert kilobytes(arm, "VmRSS") < 250_000


@pytest.mark.parametrize("what", MESSAGES)
def test_bad_messages_are_counted_with_their_reason(arm: Rig, publisher: Any, what: str) -> None:
    made, reason = MESSAGES[what]
    publisher.publish(sample(next(stamps), 0.0, 0.0, 0.0, "elbow"))
    before = int(arm.values("elbow")["samples_rejected"])
    publisher.publish(made(next(stamps)))
    values = arm.values("elbow", lambda values: int(values["samples_rejected"]) > before)
    assert reason in values["last_rejection"]


def test_a_publisher_that_dies_and_comes_back(arm: Rig, publisher: Any) -> None:
    mortal = arm.publisher()
    heard = lambda v: "STALE" not in v["fault_codes"]  # noqa: E731
    alive = arm.values("elbow", heard, lambda: feed(mortal, stamps, 1, joint="elbow"))
    assert float(alive["silence_s"]) <= 0.5
    arm.node.destroy_publisher(mortal)
    stale = arm.status("elbow", lambda v: "STALE" in v["fault_codes"])
    assert float(values_of(stale)["silence_s"]) > 0.5
    arm.values("elbow", heard, lambda: feed(publisher, stamps, 1, joint="elbow"))


def test_another_type_on_the_topic_is_a_warning_and_lag_is_told(arm: Rig, publisher: Any) -> None:
    other = rclpy.Context()  # one participant cannot have two types
    rclpy.init(context=other)
    stranger = rclpy.create_node("stranger", namespace=arm.process.namespace, context=other)
    stranger.create_publisher(Temperature, "joint_states", 1)
    said = "also published as sensor_msgs/msg/Temperature, not as sensor_msgs/msg/JointState"
    values = arm.values("elbow", lambda v: said in v["warning"])
    assert "INPUT_INVALID" in values["fault_codes"]
    stranger.destroy_node()
    rclpy.shutdown(context=other)
    arm.values("elbow", lambda v: v["warning"] == "")
    publisher.publish(sample(next(stamps), 0.0, 0.0, 0.0, "elbow"))
    late = arm.values("elbow", lambda v: v["lag_s"] != "nan")["lag_s"]
    assert float(late) == pytest.approx(time.time() - START * 1e-9, rel=1e-3)


def test_memory_is_bounded_where_large_messages_wait(tmp_path: Path) -> None:
    large = JointState(name=["stranger"], position=[0.0])
    small = serialize_message(large)
    large.header.frame_id = "x" * 1_000_000
    data = serialize_message(large)
    with running(tmp_path, parameters(**QUICK)) as rig:
        publisher = rig.publisher()
        publisher.publish(data)
        rig.until(lambda: "has messages of 1000" in rig.process.output(), "word of fewer messages")
        rig.until(publisher.get_subscription_count, "subscription")
        rig.acknowledged(publisher)
        rig.process.popen.send_signal(signal.SIGSTOP)
        for _ in range(200):
            publisher.publish(data)
        rig.process.popen.send_signal(signal.SIGCONT)
        seen = rig.values("joint_1")["messages_without_joint"]
        publisher.publish(small)
        rig.values("joint_1", lambda v: v["messages_without_joint"] != seen)
        assert kilobytes(rig, "VmHWM") < 270_000


def test_every_number_can_be_set(arm: Rig) -> None:
    """Set each parameter to another possible value and back; an integer is accepted as a number."""
    flat = dict(config(*JOINTS, **QUICK, mesh_rate=10.0).flat)
    coupled = ("shoulder.", "ratio", "teeth", "neutral_curve", "circular_spline", "flexspline_tooth")
    coupled += ("gear.", ".input.", "_signal.", "log.")  # a whole page; read when the node starts
    coupled += ("tilt.magnitude",)  # needs sections
    free = [n for n, v in flat.items() if type(v) in (int, float) and not any(part in n for part in coupled)]
    assert len(free) > 25
    assert arm.set(elbow__torque=2)[0].successful
    assert arm.get("elbow.torque")[0].double_value == 2.0
    for name, now in zip(free, arm.get(*free), strict=True):
        assert now.type in (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_INTEGER)
        value: Any = flat[name]
        other = type(value)(value * 1.01 if value else 1e-7 if isinstance(value, float) else 1_000_000)
        answers = arm.set(**{name.replace(".", "__"): other})
        assert [(a.successful, a.reason) for a in answers] == [(True, "")], name
        assert arm.set(**{name.replace(".", "__"): value})[0].successful


@pytest.mark.parametrize(("given", "reason"), REFUSED)
def test_a_bad_value_is_refused_with_its_reason_and_changes_nothing(arm: Rig, given, reason: str) -> None:
    before = arm.get(*given)
    (answer,) = arm.set(**given)
    assert not answer.successful
    assert reason in answer.reason
    assert arm.get(*given) == before


def test_requests_that_make_no_sense_are_survived(arm: Rig) -> None:
    """A type that does not exist, on which rclpy's own service raises without an answer, and a removal."""
    wrong = {"parameters": [ParameterMessage(name="elbow.torque", value=ParameterValue(type=42))]}
    for name in ("set_parameters", "set_parameters_atomically"):
        kind = SetParameters if name == "set_parameters" else SetParametersAtomically
        assert "42 is not a valid" in str(asked(arm, name, kind, **wrong))
    asked(arm, "list_parameters", ListParameters, prefixes=[""], depth=2**63)
    removal = asked(arm, "set_parameters", SetParameters, parameters=[ParameterMessage(name="elbow.torque")])
    assert not removal.results[0].successful
    assert arm.get("elbow.torque")[0].double_value == 0.0


def asked(rig: Rig, name: str, kind: Any, **fields: Any) -> Any:
    client = rig.node.create_client(kind, f"{rig.process.namespace}/hd_diag/{name}")
    rig.until(client.service_is_ready, "service")
    answer = client.call_async(kind.Request(**fields))
    rig.until(answer.done, "answer")
    rig.node.destroy_client(client)
    return answer.result()


def test_descriptors_have_ranges_and_what_is_fixed_is_read_only(arm: Rig) -> None:
    names = [*config(*JOINTS).flat]
    given = asked(arm, "describe_parameters", DescribeParameters, names=names).descriptors
    described = dict(zip(names, given, strict=True))
    (torque,) = described["elbow.limits.torque.warn"].floating_point_range
    assert (torque.from_value, torque.to_value, torque.step) == (0.0, 1e6, 0.0)
    (teeth,) = described["elbow.flexspline_teeth"].integer_range
    assert (teeth.from_value, teeth.to_value) == (20, 640)
    (sign,) = described["elbow.input.sign"].integer_range
    assert (sign.from_value, sign.to_value, sign.step) == (-1, 1, 2)
    own = ("input_joint", "output_joint", "input_divided", "input.topic", "torque_signal.sign")
    fixed = [*(f"elbow.{name}" for name in own), *(name for name in names if name.startswith("log."))]
    assert len(fixed) > 15
    assert all(described[name].read_only for name in fixed)


def test_what_belongs_together_is_set_together(arm: Rig, publisher: Any) -> None:
    both = {"elbow__output": "circular_spline", "elbow__ratio": RATIO + 1.0}
    assert not arm.set(elbow__ratio=RATIO + 1.0)[0].successful
    assert arm.set(atomically=True, **both)[0].successful
    begin = next(stamps)
    found = predictions(arm, begin)
    publisher.publish(sample(begin, 0.4, 0.0, 2.0, "elbow"))
    (error,) = arm.until(found, "prediction")
    assert error.position[0] == pytest.approx(exact(0.4, 2.0, **both), abs=BOUND)
    back = {"elbow__output": "flexspline", "elbow__ratio": RATIO}
    assert not arm.set(atomically=True, **(back | {"array_rate": -1.0}))[0].successful
    assert arm.get("elbow.output")[0].string_value == "circular_spline"
    assert arm.set(atomically=True, **back)[0].successful


def test_a_change_acts_on_the_next_sample_without_loss(arm: Rig, publisher: Any) -> None:
    arm.values("elbow", lambda values: values["prediction"] == "map")
    begin = next(stamps) + MS
    found = predictions(arm, begin)
    feed(publisher, stamps, 500, joint="elbow")
    changed = {"elbow__eccentricity__magnitude": 3e-6, "elbow__eccentricity__direction": 1.0}
    future = arm.client.set_parameters_atomically(
        [Parameter(name.replace("__", "."), value=value) for name, value in changed.items()]
    )
    parts = [500]

    def answered() -> bool:
        feed(publisher, stamps, 1, joint="elbow")
        parts.append(1)
        return bool(future.done())

    arm.until(answered, "answer")
    count = sum(parts)
    feed(publisher, stamps, 1000, joint="elbow")
    parts.append(1000)
    end = next(stamps)
    arm.until(lambda: [stamp_of(m) for m in found()[-1:]] == [end - MS], "prediction of the last sample")
    errors = found()
    assert [stamp_of(m) for m in errors] == list(range(begin, end, MS))
    angle = 0.01 * np.concatenate([np.arange(part) for part in parts])
    drives = (each.joints[1].drive for each in (config(*JOINTS), config(*JOINTS, **changed)))
    old, new = (transmission_error(drive, angle, np.ones(angle.size)) for drive in drives)
    apart = np.flatnonzero(np.abs(old - new) > 3.0 * BOUND)
    assert apart.size > 0.5 * angle.size
    is_new, is_old = (np.abs([m.position[0] for m in errors] - each) < BOUND for each in (new, old))
    assert np.all(is_new | is_old)
    assert not is_new[apart[apart < 500]].any()
    switched = apart[np.argmax(is_new[apart])]
    assert 500 <= switched <= apart[apart >= count][0]
    assert is_new[apart[apart >= switched]].all()
    arm.values("elbow", lambda values: values["prediction"] == "map" and values["eccentricity_um"] == "3")
    arm.set(elbow__eccentricity__magnitude=0.0, elbow__eccentricity__direction=0.0)


def test_rates_act_at_once(arm: Rig) -> None:
    """Of 100 reports per second some are late on a busy machine; of 20, fewer than half come within 30 ms."""

    def quick() -> bool:
        times = [stamp_of(report) for report in arm.reports[-20:]]
        return bool(np.median(np.diff(times)) < 30 * MS)

    arm.until(lambda: not quick(), "reports at the old rate")
    assert arm.set(diagnostics_rate=100.0)[0].successful
    arm.until(quick, "reports at the new rate")
    assert arm.set(diagnostics_rate=20.0)[0].successful


def test_log_holds_everything_and_replays(arm: Rig) -> None:
    """The log has all of the above: every kind of message and every change of a parameter."""
    assert arm.process.end() == 0
    live = replayed(arm.folder / "log")  # type: ignore[attr-defined]
    assert len(live[f"{arm.process.namespace}/hd_diag/transmission_error"]) >= 1000


def test_a_best_effort_publisher_that_appears_later(tmp_path: Path) -> None:
    """It works under remapped names, also in its log; files without parameters for the node are named."""
    other, empty, log = (tmp_path / name for name in ("other.yaml", "empty.yaml", "log.mcap"))
    other.write_text("{hd_dag: {ros__parameters: {}}, hd_diag: {ros__parameters: {}}}")
    empty.touch()
    names = ("joint_states:=robot/js", "joint_1/temperature:=/warmth", "~/residual:=left")
    more = [word for name in names for word in ("-r", name)]
    more += ["--params-file", str(other), "--params-file", str(empty)]
    with running(tmp_path, with_log(log), *more) as rig:
        errors = predictions(rig)
        times = itertools.count(START, MS)
        feed(rig.publisher("robot/js"), times, 20)
        rig.until(lambda: len(errors()) == 20, "predictions of the reliable publisher")
        late = rig.publisher("robot/js", reliable=False)

        def comes() -> bool:
            late.publish(sample(next(times), 0.1, 0.0, 1.0))
            return len(errors()) > 40

        rig.until(comes, "predictions of the best-effort publisher")
        assert rig.process.end(signal.SIGINT) == 0
        said = rig.process.output()
        assert "best effort" in said
        own = f"{rig.process.namespace}/hd_diag"
        assert f"other.yaml has no section for {own}, but hd_dag, hd_diag" in said
        assert f"empty.yaml has no section for {own}, but nothing" in said
    assert {f"{rig.process.namespace}/{name}" for name in ("robot/js", "left")} <= replayed(log).keys()


def test_a_configuration_is_read_whatever_the_namespace_and_the_name(tmp_path: Path) -> None:
    """A command-line argument still takes precedence, and messages about the file name the file."""
    given = parameters("elbow", **QUICK, elbow__torque=3.0) | {"use_sim_time": True}
    more = ("-r", "hd_diag:__node:=watcher", "-p", "elbow.gear.size:=0.0", "-p", "diagnostics_rate:=10.0")
    with running(tmp_path, given, *more, by_config=True) as rig:
        (status,) = rig.reports[-1].status
        assert status.hardware_id == f"{rig.process.namespace}/watcher/elbow"
        assert "no section" not in rig.process.output()
        client = AsyncParameterClient(rig.node, f"{rig.process.namespace}/watcher")
        rig.until(client.services_are_ready, "parameter services")
        future = client.get_parameters(["elbow.torque", "diagnostics_rate", "use_sim_time"])
        rig.until(future.done, "answer")
        torque, rate, simulated = future.result().values
        assert (torque.double_value, rate.double_value, simulated.bool_value) == (3.0, 10.0, True)
        assert rig.process.end() == 0


def test_simulated_time_that_jumps_back(tmp_path: Path) -> None:
    """A bag played repeatedly, then a loop of half a second, which only the clock shows."""
    log = tmp_path / "log.mcap"
    with running(tmp_path, with_log(log) | {"use_sim_time": True, "joint_1.torque": 1}) as rig:
        clock, source = rig.publisher("clock", Clock), rig.publisher()
        errors, total = predictions(rig), 0
        for length, step, loops in ((30, 100 * MS, 3), (25, 20 * MS, 4)):
            for _ in range(loops):
                for i in range(length):
                    now = Clock()
                    now.clock.sec, now.clock.nanosec = divmod(10**12 + i * step, 10**9)
                    clock.publish(now)
                    rig.drain()
                    source.publish(sample(10**12 + i * step, 0.1, 0.0, 1.0))
                    total += 1
                rig.until(lambda n=total: len(errors()) >= n, "predictions")
            latest = 1000 + (length * step - 1) // 10**9
            rig.until(lambda t=latest: rig.reports[-1].header.stamp.sec == t, "report in simulated time")
        values = rig.values("joint_1", lambda v: v["samples"] == "190")
        assert (values["clock_jumps"], values["samples_rejected"]) == ("6", "0")
        assert rig.process.end(signal.SIGINT) == 0
    assert_log_is_whole(log, rig.process.namespace, 190)
    replayed(log)


def assert_log_is_whole(path: Path, namespace: str, least: int) -> None:
    """Two independent readers read the log with its types, and nothing was rejected."""
    assert whole(path)
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
    topics: dict[str, list[Any]] = {}
    for found in read_ros2_messages(path):
        topics.setdefault(found.channel.topic, []).append(found.ros_msg)
    samples = len(topics[f"{namespace}/joint_states"])
    assert samples >= least
    assert len(topics[f"{namespace}/hd_diag/transmission_error"]) == samples
    (last,) = topics[f"{namespace}/diagnostics"][-1].status
    values = values_of(last)
    assert (values["samples_rejected"], values["samples"]) == ("0", str(samples)), values["last_rejection"]
    events = [json.loads(message.data)["event"] for message in topics[f"{namespace}/hd_diag/events"]]
    assert (events[0], events[-1]) == ("configuration", "report")


def test_signals_while_messages_wait(tmp_path: Path) -> None:
    """Messages already taken are answered and logged, and none counts as rejected because of the end.

    Further signals while it ends change nothing.
    """
    with running(tmp_path, with_log(tmp_path / "log.mcap")) as rig:
        source, _ = rig.publisher(), rig.publisher()
        rig.until(lambda: source.get_subscription_count() > 1, "look at two publishers")
        errors = predictions(rig)
        for i in range(4000):
            source.publish(sample(START + i * MS, 0.01 * i, 0.0, 1.0))
        rig.until(errors, "first prediction")
        for number in itertools.cycle((signal.SIGTERM, signal.SIGINT)):
            rig.process.popen.send_signal(number)
            time.sleep(0.01)
            if rig.process.popen.poll() is not None:
                break
        assert rig.process.popen.returncode == 0
        assert_log_is_whole(tmp_path / "log.mcap", rig.process.namespace, 1)
        assert "Traceback" not in rig.process.output()


CALLS = """
import json, sys
from hd_diag.ros.node import main
for arguments in json.loads(sys.argv[1]):
    print(main(["node", "--ros-args", *arguments], []), flush=True)
"""


def test_a_faulty_start_ends_with_one_line_and_code_2(tmp_path: Path) -> None:
    starts = []
    for number, (text, arguments, _) in enumerate(STARTS.values()):
        (tmp_path / f"{number}robot.yaml").write_text(text)
        starts.append(["--params-file", str(tmp_path / f"{number}robot.yaml"), *arguments])
    command = [sys.executable, "-c", CALLS, json.dumps(starts)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
    assert run.stdout.split() == ["2"] * len(STARTS), run.stderr
    for line, (_, _, words) in zip(run.stderr.strip().splitlines(), STARTS.values(), strict=True):
        assert line.startswith("hd_diag: ")
        assert all(word in line for word in words), line


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_ros_leaves_its_lines_without_colour_where_the_user_wants_none(monkeypatch, name, value) -> None:
    monkeypatch.setattr("hd_diag.ros.node.ignore_signals", lambda: None)
    for each, usual in {"NO_COLOR": "", "TERM": "xterm", "RCUTILS_COLORIZED_OUTPUT": ""}.items():
        monkeypatch.setenv(each, usual)
    monkeypatch.delenv("RCUTILS_COLORIZED_OUTPUT")
    for wanted in (None, "0"):
        assert main(["node", "no_argument"], []) == 2
        assert os.environ.get("RCUTILS_COLORIZED_OUTPUT") == wanted
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize(
    ("number", "delay", "entry"),
    [(signal.SIGINT, 0.3, "node"), (signal.SIGTERM, 0.4, "main"), (signal.SIGINT, 1.2, "node")],
)
def test_a_signal_while_it_starts_ends_it_with_code_0(number: int, delay: float, entry: str) -> None:
    """For ``hd_diag_node`` and ``hd-diag node``."""
    code = f"import hd_diag.__main__ as main, hd_diag.ros.stop_signals; print(1, flush=True); main.{entry}()"
    command = [sys.executable, "-c", code, *(["node"] if entry == "main" else [])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        time.sleep(delay)
        process.send_signal(number)
        _, stderr = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, stderr
    assert "Traceback" not in stderr


COMPILING = """
import os, signal, time
from hd_diag.replay import preparation
from hd_diag.ros import node, stop_signals
preparation.prepare = lambda config: time.sleep(1e9) if os.getpid() != own else print("compiles itself")
node.prepare = preparation.prepare
own, noted = os.getpid(), stop_signals.note_signals()
import hd_diag.model.kernel.compiler as compiler
compiler.is_kept = lambda kernel: os.kill(own, signal.SIGTERM)
print(node.main(["node"], noted))
"""


def test_a_signal_while_it_compiles_ends_it_at_once() -> None:
    """The compiling process is ended, and the node does not compile instead."""
    command = [sys.executable, "-c", COMPILING]
    run = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=True)
    assert run.stdout.split() == ["0"], run.stdout
