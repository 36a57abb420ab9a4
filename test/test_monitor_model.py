"""Joints that run by an extended model: live, replayed and fitted alike; their diagnostics."""

import dataclasses
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live import MS, RATIO, START, config, message, states
from logs import Log, content
from models import OFFSET, RANGES, VALUES, motion, write_model
from numpy.testing import assert_allclose, assert_array_equal

from hd_diag.bag import BagReader
from hd_diag.config.configuration import Config, ConfigError
from hd_diag.diagnosis.extension import running_residual
from hd_diag.drive import transmission_error
from hd_diag.extended_model import ExtendedModel
from hd_diag.messages.publications import read_string
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.monitor.all_joints import Monitor
from hd_diag.monitor.publications import Angles
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
    overlap = dict.fromkeys(("joint_1__limits__overlap__warn", "joint_1__limits__overlap__error"), 1e-3)
    return config(joint_1__model_file=str(path), **overlap)


def stamps(count: int = COUNT) -> np.ndarray:
    return START + np.round(motion(count)[0] * 1e9).astype(np.int64)


def columns(count: int = COUNT, velocity: bool = False, model: ExtendedModel | None = None) -> JointStates:
    """Messages of a moving joint; its output is as a model predicts it."""
    _, angle, torque, heat = motion(count)
    time = stamps(count)
    seconds = (time - START) * 1e-9
    error = 1e-4 * np.cos(2.0 * angle)
    if model is not None:
        error, _ = model.step(model.start(), seconds, angle, None, torque, 0.0 * heat + 30.0)
    output = angle / RATIO + error
    speed = np.gradient(angle, seconds)
    speed[::5] = np.nan
    return states(
        NAMES,
        time,
        np.stack((angle, output), 1),
        np.stack((np.zeros(count), torque), 1),
        np.stack((speed, speed / RATIO), 1) if velocity else None,
    )


def rows(all_rows: JointStates, at: slice) -> JointStates:
    columns = (all_rows.position, all_rows.velocity, all_rows.effort, all_rows.signals)
    parts = [None if c is None else c[at] for c in columns]
    return JointStates(all_rows.row[at], all_rows.stamp[at], all_rows.names, "", *parts)


def errors(monitor: Monitor, messages: JointStates, cuts: list[int], topic: str) -> np.ndarray:
    found = []
    for low, high in itertools.pairwise([0, *cuts, messages.stamp.size]):
        part = rows(messages, slice(low, high))
        for publication in monitor.mixed_states(part.stamp + 5, (part,)):
            if isinstance(publication, Angles) and publication.topic == topic:
                found.append(publication.position[:, 0])
    return np.concatenate(found)


def model_of(given: Config) -> ExtendedModel:
    model = given.joints[0].model
    assert model is not None
    return model


# Predictions ---


@pytest.mark.parametrize("velocity", [False, True], ids=["angles", "velocity"])
def test_predictions_are_the_models(modelled: Config, velocity: bool) -> None:
    messages, model = columns(velocity=velocity), model_of(modelled)
    assert messages.position is not None
    assert messages.effort is not None
    speed = None if messages.velocity is None else messages.velocity[:, 0]
    expected, _ = model.step(
        model.start(),
        (messages.stamp - START) * 1e-9,
        messages.position[:, 0],
        speed,
        messages.effort[:, 1],
    )
    found = errors(Monitor(modelled), messages, [], "~/transmission_error")
    assert_allclose(found, expected, rtol=0.0, atol=AGREEMENT)
    own = transmission_error(model.drive, messages.position[:, 0], messages.effort[:, 1])
    assert np.std(found - own) > 10.0 * ARCSEC


def test_the_map_is_of_the_refitted_mesh(modelled: Config) -> None:
    monitor = Monitor(modelled)
    assert not monitor.use_map("joint_1", map_of(config().joints[0]))
    assert monitor.use_map("joint_1", map_of(modelled.joints[0]))
    monitor.configure(config())
    assert monitor.joints["joint_1"].table is None


def test_a_model_restarts_with_the_stream_and_changes_at_once(modelled: Config, tmp_path: Path) -> None:
    """After a clock that was set back the same messages give the same again."""
    messages, monitor, topic = columns(200), Monitor(modelled), "~/transmission_error"
    first = errors(monitor, messages, [], topic)
    again = messages._replace(stamp=messages.stamp - 3600 * 10**9)
    assert_array_equal(errors(monitor, again, list(range(1, 200)), topic), first)
    other = config(joint_1__model_file=str(write_model(tmp_path / "other.json", "hysteresis")))
    monitor.configure(other)
    assert_array_equal(errors(monitor, messages, [], topic), errors(Monitor(other), messages, [], topic))


def test_outputs_that_come_apart_have_a_stream_of_their_own(modelled: Config) -> None:
    """Their predictions are the model's along the outputs' stamps, whatever the inputs in between."""
    monitor, model = Monitor(modelled), model_of(modelled)
    _, angle, torque, _ = motion(400)
    stamp = stamps(400)
    found, predicted_at_inputs = [], []
    for i in range(0, 400, 2):
        if i:
            middle = states(NAMES[1:], [stamp[i - 1]], [[angle[i - 1] / RATIO]], [[torque[i - 1]]])
            monitor.mixed_states(stamp[i - 1 : i], (middle,))
        given = (states(NAMES[:1], [stamp[i]], [[angle[i]]]),)
        for publication in monitor.mixed_states(stamp[i : i + 1], given):
            if publication.topic == "~/residual":
                found.append(publication)
            if publication.topic == "~/transmission_error":
                predicted_at_inputs.append(publication)
    at = np.array([p.stamp.item() for p in found])
    even = np.arange(0, 400, 2)
    between = np.interp((at - START).astype(float), (stamp[even] - START).astype(float), angle[even])
    load = torque[1:399:2]
    expected, _ = model.step(model.start(), (at - at[0]) * 1e-9, between, None, load)
    measured = angle[1:399:2] / RATIO - between / RATIO
    residual = np.array([p.position.item() for p in found])
    assert_allclose(measured - residual, expected, rtol=0.0, atol=AGREEMENT)
    assert len(predicted_at_inputs) == 200


# Live, replay, fit ---


def play(log: Log, session: Session, count: int, first: int = 0) -> None:
    _, angle, torque, _ = motion(COUNT)
    stamp = stamps().tolist()
    for i in range(first, count):
        position = {NAMES[0]: angle[i], NAMES[1]: angle[i] / RATIO + OFFSET}
        log.receive(session, message(stamp[i], position, {NAMES[1]: torque[i]}))


def residuals(path: Path) -> np.ndarray:
    with BagReader(path) as reader:
        every = [reader.joint_states(batch)[0] for batch in reader.batches(["/hd_diag/residual"])]
    return np.concatenate([c.position[:, 0] for part in every for c in part])


@pytest.mark.parametrize("mapped", [False, True], ids=["exact", "map"])
def test_live_replay_and_fit_agree(modelled: Config, model_path: Path, tmp_path: Path, mapped: bool) -> None:
    """Bit for bit from the log, though the model's file is gone; to 1e-9 rad with the fit's evaluation."""
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
    replay(tmp_path / "live.mcap", tmp_path / "again.mcap")
    assert content(tmp_path / "again.mcap") == content(tmp_path / "live.mcap")
    (first, *_) = content(tmp_path / "live.mcap")["/hd_diag/events"]
    assert json.loads(read_string(first[1]))["models"] == {"joint_1": text}

    joint = modelled.joints[0]
    record = read_bags([tmp_path / "live.mcap"], joint)
    assert record.size == COUNT
    model = model_of(modelled)
    fit = running_residual(model, record, record.reported_torque, model.torsion_map if mapped else None)
    assert_allclose(residuals(tmp_path / "live.mcap"), fit, rtol=0.0, atol=AGREEMENT)


def test_a_model_that_changes_while_it_runs_is_replayed(
    modelled: Config, model_path: Path, tmp_path: Path
) -> None:
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
    replay(tmp_path / "live.mcap", tmp_path / "again.mcap")
    assert content(tmp_path / "again.mcap") == content(tmp_path / "live.mcap")
    events = [json.loads(read_string(data)) for _, data in content(tmp_path / "live.mcap")["/hd_diag/events"]]
    assert ["models" in event for event in events] == [False, True, False, True, False, False, False]
    assert events[3]["parameters"] == {}
    assert events[-1]["event"] == "state"


def test_a_log_without_its_model_is_refused(modelled: Config, model_path: Path, tmp_path: Path) -> None:
    """Whatever lies at the path now is not what ran."""
    log = Log(tmp_path / "live.mcap")
    stripped = dataclasses.replace(modelled.joints[0], model=None, model_text="")
    session = Session(dataclasses.replace(modelled, joints=(stripped,)), log)
    session.start(next(log.clock))
    play(log, session, 10)
    log.writer.close()
    with pytest.raises(ConfigError, match="the log does not hold this model"):
        replay(tmp_path / "live.mcap", tmp_path / "again.mcap")


# Diagnostics ---


def told(monitor: Monitor, messages: JointStates) -> Any:
    monitor.mixed_states(messages.stamp + 5, (messages,))
    return monitor.tick(int(messages.stamp[-1]) + 6, START, FACTS).statuses[0]


def test_diagnostics_name_the_model(modelled: Config, model_path: Path) -> None:
    values = told(Monitor(modelled), columns(100)).values
    assert values["model"].startswith(f"{model_path} sha256:")
    assert values["model_effects"] == ", ".join(EFFECTS)
    assert float(values["eccentricity_um"]) == pytest.approx(9.0)
    values = told(Monitor(config()), columns(100)).values
    assert (values["model"], values["model_effects"]) == ("", "")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda m: m, None),
        (lambda m: m._replace(effort=m.effort * np.where(np.arange(COUNT) % 50, 1.0, 10.0)[:, None]), None),
        (lambda m: m._replace(effort=m.effort * 1.6), "torque"),
        (lambda m: m._replace(stamp=START + (m.stamp - START) // 2), "speed"),
    ],
    ids=["inside", "single samples are noise", "torque", "speed"],
)
def test_outside_its_range_the_diagnostics_say_so(
    modelled: Config, change: Callable[[JointStates], JointStates], text: str | None
) -> None:
    status = told(Monitor(modelled), change(columns(model=model_of(modelled))))
    assert ("OUT_OF_RANGE" in status.values["fault_codes"]) == (text is not None)
    if text:
        told_first = status.message.startswith(f"outside the model's valid range: {text} ")
        assert told_first or status.level == 2
    plain = told(Monitor(config()), change(columns()))
    assert "OUT_OF_RANGE" not in plain.values["fault_codes"]


@pytest.mark.parametrize(
    ("heat", "text"), [(30.0, None), (44.0, "temperature 44"), (None, "temperature is not reported")]
)
def test_temperature_out_of_range(tmp_path: Path, heat: float | None, text: str | None) -> None:
    given = config(joint_1__model_file=str(write_model(tmp_path / "warm.json", "thermal_drift")))
    monitor = Monitor(given)
    if heat is not None:
        monitor.temperature("joint_1", heat)
    status = told(monitor, columns(model=model_of(given)))
    assert (status.values["fault_code"] == "OUT_OF_RANGE") == (text is not None)
    assert text is None or text in status.message


def grown(
    model: ExtendedModel, count: int, order: float, amplitude: float, frame: str = "input"
) -> JointStates:
    """Messages of a joint that is as the model says, but for one order."""
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
    messages = grown(model_of(light), count, order, 20.0 * ARCSEC, frame)
    status = told(Monitor(light), messages)
    assert status.values["residual_order"] == f"{frame} {order}"
    assert float(status.values["residual_order_amplitude_arcsec"]) == pytest.approx(20.0, rel=0.02)
    assert status.values["fault_codes"].split() == ["RESIDUAL"]
    assert status.message.startswith("residual has grown since the model was fitted: it repeats ")
    assert f"per {frame} turn with 20." in status.message


def test_as_fitted_no_order_has_grown(light: Config) -> None:
    status = told(Monitor(light), grown(model_of(light), 4500, 2.0, 0.0))
    assert float(status.values["residual_order_amplitude_arcsec"]) < 0.01
    assert status.values["fault_code"] == "OK"


def test_without_a_model_an_order_that_repeats_is_named_too() -> None:
    """But not the output's own: a torque that goes with the link's angle has it. A new drive begins anew."""
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
