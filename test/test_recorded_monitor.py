"""A session takes messages and writes bytes; its record gives the same bytes again."""

import base64
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from live import MS, RATIO, START, Recording, config, message, sample
from logs import Log, content, replayed
from models import STATEFUL, write_model
from rosbags.typesys import Stores, get_typestore

from hd_diag.config.configuration import resolve
from hd_diag.messages.joint_states import JointStateReader
from hd_diag.messages.publications import JOINT_STATE, TEMPERATURE
from hd_diag.monitor.carried import carried, carry_on
from hd_diag.replay.recorded_monitor import EVENTS, PARAMETER_EVENTS, Session
from hd_diag.replay.versions import running

STORE = get_typestore(Stores.ROS2_JAZZY)
FACTS = {"log_state": "writing x", "latency_p99_us": "12.0"}


def messages(recording: Recording, topic: str) -> list:
    every = (each for each in recording.all if each.topic == topic)
    return [STORE.deserialize_cdr(bytes(row), each.type_name) for each in every for row in each.rows]


def events(recording: Recording) -> list[dict]:
    return [json.loads(m.data) for m in messages(recording, EVENTS)]


def test_the_configuration_is_recorded_at_the_start() -> None:
    recording = Recording()
    session = Session(config(mesh_rate=50.0), recording, "/robot/hd_diag", {"~/residual": "/elsewhere"})
    session.start(START)
    (event,) = events(recording)
    topics, versions = {"~/residual": "/elsewhere"}, dict(running())
    own = {"event": "configuration", "new": True, "topics": topics, "versions": versions}
    assert event == own | {"parameters": dict(session.config.flat)}
    assert resolve(event["parameters"]) == session.config
    (declared,) = messages(recording, PARAMETER_EVENTS)
    values = {p.name: p.value for p in declared.new_parameters}
    assert (declared.node, values.keys()) == ("/robot/hd_diag", session.config.flat.keys())
    assert (values["joint_1.ratio"].type, values["joint_1.ratio"].double_value) == (3, RATIO)
    assert values["joint_1.flexspline_teeth"].integer_value == 200
    assert values["joints"].string_array_value == ["joint_1"]
    assert values["log.overwrite"].type == 1
    assert values["joint_1.flexspline_tooth.addendum_center"].double_array_value.size == 2


def test_a_change_is_recorded_and_says_whose_map_is_outdated() -> None:
    recording = Recording()
    session = Session(config("a", "b"), recording)
    changed = config("a", "b", b__eccentricity__magnitude=3e-6, a__torque=1.0)
    assert session.configure(START, changed) == ["b"]
    (event,) = events(recording)
    assert event["parameters"] == {"a.torque": 1.0, "b.eccentricity.magnitude": 3e-6}
    assert not event["new"]
    (declared,) = messages(recording, PARAMETER_EVENTS)
    assert [p.name for p in declared.changed_parameters] == ["a.torque", "b.eccentricity.magnitude"]
    assert session.configure(START, changed) == []
    assert len(events(recording)) == 1
    larger = config("a", "b", b__eccentricity__magnitude=3e-6, a__torque=1.0, a__rated_torque=60.0)
    assert session.configure(START, larger) == ["a"]


def temperature(value: float) -> bytes:
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 2), "")
    return bytes(STORE.serialize_cdr(types[TEMPERATURE](header, value, 0.0), TEMPERATURE))


def moving(session: Session, log: Log, first: int, last: int) -> None:
    """Joint a in one message, joint b with a separate output; a temperature and lost samples."""
    for i in range(first, last):
        if i % 40 == 7:
            continue
        stamp, angle = START + i * MS, 0.03 * i
        log.receive(session, message(stamp, {"a_motor": angle, "a": 0.0, "b_motor": -angle}, {"a": 0.1 * i}))
        log.receive(session, message(stamp + MS // 2, {"b": -angle / RATIO}))
        if i % 50 == 20:
            log.receive(session, message(stamp, {"a_motor": np.nan}))
            log.warm(session, "a", temperature(20.0 + i))
        if i % 90 == 45:
            session.tick(next(log.clock), stamp, FACTS)


def test_another_log_goes_on_and_replays_from_its_own_start(tmp_path: Path) -> None:
    """All state is kept, also in a third log: counters, waiting pairs, effects with memory."""
    given = config("a", "b", a__model_file=str(write_model(tmp_path / "m.json", *STATEFUL)))
    whole, logs = Log(tmp_path / "whole.mcap"), [Log(tmp_path / f"{i}.mcap") for i in range(3)]
    clock, log = itertools.count(START), logs[0]
    reference, session = Session(given, whole), Session(given, lambda encoded: log(encoded))
    for number, (first, last) in enumerate(((0, 60), (60, 150), (150, 300))):
        log = logs[number]
        log.clock = clock
        begin = session.start_again if number else session.start
        begin(next(clock))
        now = next(whole.clock)
        if not number:
            reference.start(now)
        moving(session, log, first, last)
        moving(reference, whole, first, last)
    for log in (whole, *logs):
        log.writer.close()
    found = [replayed(tmp_path / f"{i}.mcap") for i in range(3)]
    expected = content(tmp_path / "whole.mcap")
    for topic in ("transmission_error", "residual", "b/load"):
        name = f"/hd_diag/{topic}"
        assert [data for part in found for _, data in part[name]] == [data for _, data in expected[name]]
    for joint, other in zip(*(s.monitor.joints.values() for s in (session, reference)), strict=True):
        assert (joint.samples, joint.rejected) == (other.samples, other.rejected)
        assert joint.lost.count == other.lost.count > 0


@pytest.mark.parametrize("spoil", ["streams", "last_rejections", "foreign", "periods", "joints"])
def test_a_hostile_state_is_refused(spoil: str) -> None:
    session = Session(config("a"), Recording())
    session.start_again(START)
    state = carried(session.monitor)
    own = state["joints"]["a"]
    runs, lost = ({"a": own | wrong} for wrong in ({"runs": [1]}, {"lost": [0, 0, 1e-300, []]}))
    for value in (None, [], "x", [[1e300]], {"a": {}}, ["AAAA"] * 4, runs, lost):
        with pytest.raises(ValueError, match="its state is none of these joints"):
            carry_on(session.monitor, state | {spoil: value})
    joints, *others = (array.copy() for array in session.monitor.streams.state)
    joints["waiting"] = 10**9
    rows = [base64.b64encode(array.tobytes()).decode() for array in (joints, *others)]
    with pytest.raises(ValueError, match="a place that no ring has"):
        carry_on(session.monitor, state | {"streams": rows})


def test_silence_goes_by_a_clock_of_its_own(tmp_path: Path) -> None:
    """The system's clock is set back by an hour, so reception times hardly advance."""
    log, hour = Log(tmp_path / "log.mcap"), 3600 * 10**9
    session = Session(config(), log)
    session.start(next(log.clock))
    data = sample(START, 0.1, 0.001, 0.0)
    log.writer.write("/joint_states", JOINT_STATE, data, next(log.clock))
    session.joint_state(START + 1, data, heard=hour)
    session.tick(next(log.clock), START, FACTS, session.monitor.silence(hour + 10**7))
    session.tick(next(log.clock), START, FACTS, session.monitor.silence(hour + 3 * 10**9))
    log.writer.close()
    reports, said = messages(log, "/diagnostics"), "its input arrives no more"
    assert [report.status[0].message for report in reports] == ["OK", f"no valid sample for 3.0 s: {said}"]
    replayed(tmp_path / "log.mcap")


def test_messages_taken_together_give_what_one_by_one_do() -> None:
    """Any number of messages of two topics; some are unreadable, and a temperature changes."""
    chance = np.random.default_rng(7)
    own = {"field": "effort[b_motor]", "topic": "joint_states", "type": "sensor_msgs/JointState"}
    configured = config("a", "b", **{f"b__temperature_signal__{name}": value for name, value in own.items()})
    usual = JointStateReader({k: s for j in configured.joints for k, s in j.mapped.items()})
    other = JointStateReader({})
    taken: list[tuple[JointStateReader, bytes]] = []
    for i in range(300):
        stamp, warm = START + i * MS, 20.0 + i // 75
        angles = {"a_motor": 0.01 * i, "a": 1e-4 * i, "b_motor": 0.02 * i, "b": 2e-4 * i}
        data = message(stamp, angles, {"a": 3.0, "b_motor": warm, "b": 1.0})
        if i % 7 == 3:
            taken.append((other, message(stamp, {"a": 1e-4 * i}, {"a": 2.0})))
        taken.append((usual, data[:-9] if i % 50 == 20 else data))
    received = START + np.cumsum(chance.integers(1, MS, len(taken)))
    found = []
    for most in (1, 2, 9, 64):
        recording = Recording()
        session, begin = Session(configured, recording), 0
        session.start(START - 1)
        while begin < len(taken):
            end = min(len(taken), begin + int(chance.integers(1, most + 1)))
            session.messages(received[begin:end], taken[begin:end])
            begin = end
        session.tick(int(received[-1]) + 1, START, FACTS)
        found.append(recording.topics())
    (status, _) = messages(recording, "/diagnostics")[-1].status
    assert {pair.key: pair.value for pair in status.values}["samples_rejected"] == "6"
    assert all(again == found[0] for again in found)
