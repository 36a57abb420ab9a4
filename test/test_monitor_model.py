"""Joints with an extended model: live, replayed and fitted alike; their diagnostics."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from live import MS, RATIO, START, config, message, states
from logs import Log, replayed
from models import OFFSET, RANGES, VALUES, motion, write_model
from numpy.testing import assert_allclose, assert_array_equal
from player import angles

from hd_diag.config.configuration import Config, ConfigError
from hd_diag.diagnosis.extension import running_residual
from hd_diag.drive import transmission_error
from hd_diag.extended_model import ExtendedModel
from hd_diag.messages.publications import read_string
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.residual_orders import ORDERS
from hd_diag.records.joint_record import read_bags
from hd_diag.replay.map_builder import map_of
from hd_diag.replay.recorded_monitor import Session
from hd_diag.replay.replay import replay
from hd_diag.streams.columns import JointStates

AGREEMENT = 1e-9  # [rad]
NAMES = ("joint_1_motor", "joint_1")
EFFECTS = tuple(name for name in VALUES if name != "thermal_drift")
COUNT = 400
TIME, ANGLE, TORQUE, _ = motion(COUNT)
STAMPS = START + np.round(TIME * 1e9).astype(np.int64)
FACTS = {"log_state": "off"}


@pytest.fixture
def model_path(tmp_path: Path) -> Path:
    return write_model(tmp_path / "model.json", *EFFECTS)


@pytest.fixture
def modelled(model_path: Path) -> Config:
    return config(joint_1__model_file=str(model_path))


@pytest.fixture
def light(tmp_path: Path) -> Config:
    path = write_model(tmp_path / "light.json", "viscous_windup")
    overlap = {f"joint_1__limits__overlap__{level}": 1e-3 for level in ("warn", "error")}
    return config(joint_1__model_file=str(path), **overlap)


def columns(velocity: bool = False, model: ExtendedModel | None = None) -> JointStates:
    """Messages of a moving joint whose output follows a model's prediction."""
    seconds = (STAMPS - START) * 1e-9
    error = 1e-4 * np.cos(2.0 * ANGLE)
    if model is not None:
        error, _ = model.step(model.start(), seconds, ANGLE, None, TORQUE, np.full(COUNT, 30.0))
    speed = np.gradient(ANGLE, seconds)
    speed[::5] = np.nan
    speeds = np.stack((speed, speed / RATIO), 1) if velocity else None
    position = np.stack((ANGLE, ANGLE / RATIO + error), 1)
    return states(NAMES, STAMPS, position, np.stack((0.0 * TORQUE, TORQUE), 1), speeds)


def errors(monitor: Monitor, messages: JointStates, step: int = COUNT) -> np.ndarray:
    found = []
    for low in range(0, messages.stamp.size, step):
        part = messages.between(low, low + step)
        published = monitor.mixed_states(part.stamp + 5, (part,))
        found += [each.position[:, 0] for each in published if each.topic == "~/transmission_error"]
    return np.concatenate(found)


@pytest.mark.parametrize("velocity", [False, True], ids=["angles", "velocity"])
def test_predictions_are_the_models(modelled: Config, velocity: bool) -> None:
    messages, model = columns(velocity=velocity), modelled.joints[0].model
    speed = messages.velocity[:, 0] if velocity else None
    expected, _ = model.step(model.start(), (STAMPS - START) * 1e-9, ANGLE, speed, TORQUE)
    found = errors(Monitor(modelled), messages)
    assert_allclose(found, expected, rtol=0.0, atol=AGREEMENT)
    assert np.std(found - transmission_error(model.drive, ANGLE, TORQUE)) > 10.0 * ARCSEC


def test_a_model_restarts_with_the_stream_and_changes_at_once(modelled: Config, tmp_path: Path) -> None:
    """After the clock is set back, the same messages give the same result."""
    messages, monitor = columns().between(0, 200), Monitor(modelled)
    first = errors(monitor, messages)
    again = messages._replace(stamp=messages.stamp - 3600 * 10**9)
    assert_array_equal(errors(monitor, again, step=1), first)
    other = config(joint_1__model_file=str(write_model(tmp_path / "other.json", "hysteresis")))
    monitor.configure(other)
    assert_array_equal(errors(monitor, messages), errors(Monitor(other), messages))


def test_outputs_that_come_apart_have_a_stream_of_their_own(modelled: Config) -> None:
    """Predictions follow the model along the outputs' stamps, whatever inputs come in between."""
    monitor, model, published = Monitor(modelled), modelled.joints[0].model, []
    for i in range(0, COUNT, 2):
        if i:
            middle = states(NAMES[1:], [STAMPS[i - 1]], [[ANGLE[i - 1] / RATIO]], [[TORQUE[i - 1]]])
            monitor.mixed_states(STAMPS[i - 1 : i], (middle,))
        given = (states(NAMES[:1], [STAMPS[i]], [[ANGLE[i]]]),)
        published += monitor.mixed_states(STAMPS[i : i + 1], given)
    found = [each for each in published if each.topic == "~/residual"]
    at = np.array([p.stamp.item() for p in found])
    between = np.interp((at - START).astype(float), (STAMPS[::2] - START).astype(float), ANGLE[::2])
    expected, _ = model.step(model.start(), (at - at[0]) * 1e-9, between, None, TORQUE[1:399:2])
    measured = ANGLE[1:399:2] / RATIO - between / RATIO
    residual = np.array([p.position.item() for p in found])
    assert_allclose(measured - residual, expected, rtol=0.0, atol=AGREEMENT)
    assert sum(each.topic == "~/transmission_error" for each in published) == 200


def play(log: Log, session: Session, last: int, first: int = 0) -> None:
    for i in range(first, last):
        position = {NAMES[0]: ANGLE[i], NAMES[1]: ANGLE[i] / RATIO + OFFSET}
        log.receive(session, message(int(STAMPS[i]), position, {NAMES[1]: TORQUE[i]}))


def events(log: Path) -> list[dict]:
    return [json.loads(read_string(data)) for _, data in replayed(log)["/hd_diag/events"]]


@pytest.mark.parametrize("mapped", [False, True], ids=["exact", "map"])
def test_live_replay_and_fit_agree(modelled: Config, model_path: Path, tmp_path: Path, mapped: bool) -> None:
    """Bit for bit from the log, even without the model's file; to 1e-9 rad with the fit's evaluation."""
    log = Log(tmp_path / "live.mcap")
    session = Session(modelled, log)
    session.start(next(log.clock))
    if mapped:
        session.use_map(next(log.clock), "joint_1", map_of(modelled.joints[0]))
    play(log, session, COUNT)
    session.tick(next(log.clock), START, FACTS)
    log.writer.close()
    text = model_path.read_text()
    model_path.unlink()
    assert events(tmp_path / "live.mcap")[0]["models"] == {"joint_1": text}
    record, model = read_bags([tmp_path / "live.mcap"], modelled.joints[0]), modelled.joints[0].model
    assert record.size == COUNT
    fit = running_residual(model, record, record.reported_torque, model.torsion_map if mapped else None)
    residual = [value for _, (value, *_) in angles(tmp_path / "live.mcap", "/hd_diag/residual")]
    assert_allclose(residual, fit, rtol=0.0, atol=AGREEMENT)


def test_a_model_that_changes_while_it_runs_is_replayed(modelled, model_path: Path, tmp_path: Path) -> None:
    log = Log(tmp_path / "live.mcap")
    session = Session(config(), log)
    session.start(next(log.clock))
    play(log, session, 100)
    slower = config(joint_1__model_file=str(model_path), array_rate=5.0)
    assert session.configure(next(log.clock), modelled) == ["joint_1"]
    play(log, session, 200, 100)
    assert session.configure(next(log.clock), slower) == []
    write_model(model_path, "viscous_windup")
    other = config(joint_1__model_file=str(model_path), array_rate=5.0)
    assert session.configure(next(log.clock), other) == []
    play(log, session, 300, 200)
    assert session.configure(next(log.clock), config()) == ["joint_1"]
    play(log, session, 400, 300)
    session.start_again(next(log.clock))
    log.writer.close()
    model_path.unlink()
    found = events(tmp_path / "live.mcap")
    assert ["models" in event for event in found] == [False, True, False, True, False, False, False]
    assert (found[3]["parameters"], found[-1]["event"]) == ({}, "state")


def test_a_log_without_its_model_is_refused(modelled: Config, model_path: Path, tmp_path: Path) -> None:
    """A file at the same path is not the model that ran."""
    log = Log(tmp_path / "live.mcap")
    stripped = dataclasses.replace(modelled.joints[0], model=None, model_text="")
    session = Session(dataclasses.replace(modelled, joints=(stripped,)), log)
    session.start(next(log.clock))
    play(log, session, 10)
    log.writer.close()
    with pytest.raises(ConfigError, match="the log does not hold this model"):
        replay(tmp_path / "live.mcap", tmp_path / "again.mcap")


def told(monitor: Monitor, messages: JointStates):
    monitor.mixed_states(messages.stamp + 5, (messages,))
    return monitor.tick(int(messages.stamp[-1]) + 6, START, FACTS).statuses[0]


SPIKES = np.where(np.arange(COUNT) % 50, 1.0, 10.0)[:, None]


@pytest.mark.parametrize(
    ("change", "heat", "text"),
    [
        (lambda m: m, 30.0, None),
        (lambda m: m._replace(effort=m.effort * SPIKES), 30.0, None),
        (lambda m: m._replace(effort=m.effort * 1.6), 30.0, "torque "),
        (lambda m: m._replace(stamp=START + (m.stamp - START) // 2), 30.0, "speed "),
        (lambda m: m, 44.0, "temperature 44"),
        (lambda m: m, None, "temperature is not reported"),
    ],
    ids=["inside", "single samples are noise", "torque", "speed", "heat", "no temperature"],
)
def test_outside_its_range_the_diagnostics_say_so(change, heat, text, tmp_path: Path) -> None:
    given = config(joint_1__model_file=str(write_model(tmp_path / "warm.json", "thermal_drift")))
    monitor, messages = Monitor(given), change(columns(model=given.joints[0].model))
    if heat is not None:
        monitor.temperature("joint_1", heat)
    status = told(monitor, messages)
    assert ("OUT_OF_RANGE" in status.values["fault_codes"]) == (text is not None)
    assert text is None or status.message.startswith(f"outside the model's valid range: {text}")
    assert "OUT_OF_RANGE" not in told(Monitor(config()), change(columns())).values["fault_codes"]


def grown(model: ExtendedModel, count, order, amplitude, frame="input") -> JointStates:
    """Messages of a joint that follows the model except for one order."""
    time = 2e-3 * np.arange(count)
    angle, torque = 40.0 * time, 20.0 * np.sin(1.1 * time)
    error, _ = model.step(model.start(), time, angle, None, torque)
    phase = order * angle / (1.0 if frame == "input" else RATIO)
    output = angle / RATIO + error + amplitude * np.cos(phase - 0.3)
    stamp = START + 2 * MS * np.arange(count)
    return states(NAMES, stamp, np.stack((angle, output), 1), np.stack((0.0 * torque, torque), 1))


@pytest.mark.parametrize(("frame", "order"), [one for one in ORDERS if one[1] < 4])
def test_an_order_that_grew_is_a_residual(light: Config, frame: str, order: int) -> None:
    count = 9000 if frame == "output" else 4500
    messages = grown(light.joints[0].model, count, order, 20.0 * ARCSEC, frame)
    status = told(Monitor(light), messages)
    assert status.values["residual_order"] == f"{frame} {order}"
    assert float(status.values["residual_order_amplitude_arcsec"]) == pytest.approx(20.0, rel=0.02)
    assert status.values["fault_codes"].split() == ["RESIDUAL"]
    assert status.message.startswith("residual has grown since the model was fitted: it repeats ")
    assert f"per {frame} turn with 20." in status.message


def test_as_fitted_no_order_has_grown(light: Config) -> None:
    status = told(Monitor(light), grown(light.joints[0].model, 4500, 2.0, 0.0))
    assert float(status.values["residual_order_amplitude_arcsec"]) < 0.01
    assert status.values["fault_code"] == "OK"


def test_without_a_model_an_order_that_repeats_is_named_too() -> None:
    """Except for the output's own order, which a gravity torque has, too. A new drive starts over."""
    nominal = ExtendedModel(config().joints[0].drive, (), 0.0, RANGES)
    monitor = Monitor(config())
    status = told(monitor, grown(nominal, 4500, 2.0, 20.0 * ARCSEC))
    assert (status.values["fault_codes"], status.level) == ("RESIDUAL", 1)
    assert (status.values["residual_order"], status.values["residual_order_repeats"]) == ("input 2", "true")
    monitor.configure(config(joint_1__eccentricity__magnitude=1e-6))
    assert monitor.tick(START, START, FACTS).statuses[0].values["residual_order"] == ""
    assert status.message.startswith("residual repeats twice per input turn with 20.")
    assert "wave generator off centre" in status.message
    status = told(Monitor(config()), grown(nominal, 9000, 1, 20.0 * ARCSEC, "output"))
    assert (status.values["residual_order"], status.values["fault_code"]) == ("output 1", "OK")
