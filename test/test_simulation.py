"""The simulated joint: motion, noise, the bag with its data, and the command that writes one."""

import itertools
import json
import math
import signal
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import hd_diag
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.highlevel import AnyReader

from hd_diag.bag import BagReader, BagWriter
from hd_diag.config.configuration import dump, resolve
from hd_diag.drive import Drive, transmission_error
from hd_diag.model import torsion_map
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion_map import ARCSEC, TorsionMap
from hd_diag.simulation import START, Motion, Noise, Samples, SimulatedJoint, simulate, write_bag
from hd_diag.simulation.bag import temperature
from hd_diag.simulation.joint import map_for, parts

TURN = 2.0 * math.pi
SECOND = 1_000_000_000
ECCENTRIC = {"joint_1.eccentricity.magnitude": 15e-6, "joint_1.eccentricity.direction": 0.6}
SHORT = Motion(duration=2.0, sample_rate=150.0, speeds=(TURN, 3.0 * TURN), torques=(-20.0, 40.0))

motions = st.builds(
    Motion,
    duration=st.floats(0.5, 100.0),
    sample_rate=st.floats(10.0, 2000.0),
    speeds=st.lists(st.floats(0.1, 200.0), min_size=1, max_size=4).map(tuple),
    torques=st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=4).map(tuple),
    both_directions=st.booleans(),
    ramp_share=st.floats(0.01, 0.3),
    rest_share=st.floats(0.0, 0.2),
)


def drive(**given: object) -> Drive:
    return resolve(ECCENTRIC | given).joints[0].drive


def joined(records: Iterable[Samples]) -> Samples:
    return Samples(*map(np.concatenate, zip(*records, strict=True)))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@settings(max_examples=40)
@given(motions)
def test_the_input_moves_at_the_velocity_it_has_which_rises_smoothly(motion: Motion) -> None:
    time = np.linspace(0.0, motion.duration, 20_001)
    moments = motion.at(time)
    middle = motion.at(0.5 * (time[1:] + time[:-1])).input_velocity
    ends = moments.input_velocity
    travelled = np.diff(time) * (ends[1:] + 4.0 * middle + ends[:-1]) / 6.0
    fastest = max(motion.speeds) * motion.duration
    assert_allclose(np.diff(moments.input_angle), travelled, atol=1e-6 * fastest)
    # Minimum jerk: the steepest slope of a unit step over unit time is 15/8.
    steepest = 15.0 / 8.0 * max(motion.speeds) / (motion.ramp_share * motion.duration / len(motion.runs))
    change = np.abs(np.diff(ends)) / np.diff(time)
    assert change.max() <= steepest * (1.0 + 1e-9) + 1e-9


@settings(max_examples=40)
@given(motions)
def test_every_run_starts_and_ends_at_rest_and_reaches_its_level(motion: Motion) -> None:
    length = motion.duration / len(motion.runs)
    largest = max(map(abs, motion.torques))  # rounding may move a border into the neighbouring run
    for number, (velocity, torque) in enumerate(motion.runs):
        rest = 0.5 * motion.rest_share
        borders = motion.at(length * (number + np.array([rest, 1.0 - rest])))
        level = motion.at(np.array([length * (number + 0.5)]))
        assert_allclose(borders.input_velocity, 0.0, atol=1e-9 * abs(velocity))
        assert_allclose(borders.torque, 0.0, atol=1e-9 * largest)
        assert_allclose(level.input_velocity, velocity)
        assert_allclose(level.torque, torque)


def test_both_directions_return_to_the_start_at_any_rate() -> None:
    ends = SHORT.at(np.array([-1.0, 0.0, SHORT.duration, SHORT.duration + 5.0])).input_angle
    assert_allclose(ends, 0.0, atol=1e-12)
    one_way = Motion(duration=2.0, speeds=(10.0,), torques=(0.0,), both_directions=False)
    # The 2 s lose 5 % at rest at each end, and half of each 10 % ramp.
    assert one_way.at(np.array([2.0])).input_angle[0] == pytest.approx(10.0 * 2.0 * (1.0 - 0.1 - 0.1))
    motion = Motion(duration=1000.0, sample_rate=300.0)
    stamps = motion.stamps(START, 0, motion.samples)
    assert (stamps[0], stamps[-1]) == (START, START + round(299_999 * SECOND / 300))
    assert set(np.diff(stamps)) == {3_333_333, 3_333_334}


@pytest.mark.parametrize(
    ("made", "changes", "text"),
    [
        (Motion, {"duration": -1.0}, "duration must be positive and finite, not -1.0 s"),
        (Motion, {"sample_rate": math.nan}, "sample_rate must be positive and finite, not nan Hz"),
        (Motion, {"speeds": (1.0, 0.0)}, "speeds must be positive"),
        (Motion, {"torques": (math.inf,)}, "torques must be finite"),
        (Motion, {"ramp_share": 0.0}, "ramp_share must be positive"),
        (Motion, {"ramp_share": 0.4, "rest_share": 0.2}, "both together at most 0.5"),
        (Motion, {"duration": 1e-3, "sample_rate": 10.0}, "hold no sample"),
        (Noise, {"white": -1.0}, "noise: white must"),
        (Noise, {"drift_correlation": 1.0}, "noise: drift_correlation must"),
    ],
)
def test_motions_and_noise_that_cannot_be(made: type, changes: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        made(**changes)


OTHER = {"joint_1.ratio": -101.0, "joint_1.output": "circular_spline"}


@pytest.mark.parametrize("gear", [drive(), drive(**OTHER)], ids=["flexspline", "circular spline"])
def test_without_noise_the_error_is_the_drives(gear: Drive) -> None:
    record = simulate(SimulatedJoint(gear, offset=1e-3), SHORT, rng())
    measured = record.output_angle - record.input_angle / gear.kinematics.ratio
    expected = transmission_error(gear, record.input_angle, record.torque) + 1e-3
    assert_allclose(measured, expected, rtol=0.0, atol=1e-13)
    assert np.ptp(measured) > 100.0 * ARCSEC
    assert record.stamp.size == SHORT.samples == 300


@pytest.fixture(scope="module")
def table() -> TorsionMap:
    found = map_for(SimulatedJoint(drive()), Motion(duration=1000.0))
    return found


def test_noise_has_the_size_and_the_correlation_asked_for(table: TorsionMap) -> None:
    noise = Noise(white=2e-5, drift=3e-5, drift_correlation=0.9, torque=0.2)
    motion = Motion(duration=8.0, sample_rate=1000.0, speeds=(TURN,), torques=(10.0,))
    quiet = joined(parts(SimulatedJoint(drive()), motion, rng(), table=table))
    noisy = joined(parts(SimulatedJoint(drive(), noise), motion, rng(3), table=table))
    angle, torque = noisy.output_angle - quiet.output_angle, noisy.torque - quiet.torque
    assert_array_equal(noisy.input_angle, quiet.input_angle)
    # A variance over 8000 samples of the drift counts 8000 (1 - 0.9^2) / (1 + 0.9^2) = 840 independent ones.
    # So 4 standard deviations are 4 sqrt(2 / 840) = 20 %; the white part reduces this.
    assert angle.var() == pytest.approx(2e-5**2 + 3e-5**2, rel=0.2)
    assert np.mean(angle[1:] * angle[:-1]) == pytest.approx(0.9 * 3e-5**2, rel=0.2)
    assert np.mean(angle[10:] * angle[:-10]) == pytest.approx(0.9**10 * 3e-5**2, rel=0.5)
    assert torque.std() == pytest.approx(0.2, rel=4.0 / math.sqrt(2.0 * 8000.0))
    assert abs(np.mean(torque[1:] * torque[:-1])) < 4.0 * 0.2**2 / math.sqrt(8000.0)
    assert abs(np.corrcoef(angle, torque)[0, 1]) < 0.1


def test_the_drift_is_as_large_at_the_start_as_later(table: TorsionMap) -> None:
    motion = Motion(duration=0.002, sample_rate=1000.0, speeds=(1.0,), torques=(0.0,))
    joint = SimulatedJoint(drive(), Noise(drift=1.0, drift_correlation=0.99))
    first = [next(parts(joint, motion, rng(seed), table=table)).output_angle[0] for seed in range(300)]
    assert np.std(first) == pytest.approx(1.0, rel=4.0 / math.sqrt(600.0))


def test_parts_join_and_an_alteration_precedes_the_noise() -> None:
    seen: list[Samples] = []

    def runout(samples: Samples) -> Samples:
        seen.append(samples)
        return samples._replace(output_angle=samples.output_angle + 1e-4 * np.cos(samples.output_angle))

    noise = Noise(white=1e-5, drift=1e-5, torque=0.1)
    altered = joined(parts(SimulatedJoint(drive(), noise, alter=runout), SHORT, rng(), chunk=90))
    plain = simulate(SimulatedJoint(drive(), noise), SHORT, rng())
    quiet = simulate(SimulatedJoint(drive()), SHORT, rng())
    pieces = joined(parts(SimulatedJoint(drive(), noise), SHORT, rng(), chunk=7))
    assert [samples.stamp.size for samples in seen] == [90, 90, 90, 30]
    for whole, cut in ((quiet, joined(seen)), (plain, pieces)):
        for name, column in cut._asdict().items():
            assert_allclose(column, getattr(whole, name), rtol=0.0, atol=1e-13, err_msg=name)
    added = altered.output_angle - plain.output_angle
    assert_allclose(added, 1e-4 * np.cos(quiet.output_angle), atol=1e-13)


def test_a_long_motion_by_map_agrees_with_the_exact_solution() -> None:
    gear = drive()
    motion = Motion(duration=30.0, sample_rate=1000.0)
    record = simulate(SimulatedJoint(gear), motion, rng())
    rows = np.arange(0, motion.samples, 37)
    measured = (record.output_angle - record.input_angle / 100.0)[rows]
    exact = transmission_error(gear, record.input_angle[rows], record.torque[rows])
    difference = np.abs(measured - exact).max()
    assert 0.0 < difference < 0.05 * ARCSEC
    assert map_for(SimulatedJoint(gear), SHORT) is None


TWO = {"joints": ["shoulder", "elbow"], "shoulder.eccentricity.magnitude": 10e-6}
TWO |= {"elbow.input_joint": "m2", "elbow.ratio": -100.0}


def messages_of(path: Path, topic: str) -> list[Any]:
    """Messages that rosbags reads on a topic."""
    with AnyReader([path]) as reader:
        own = [c for c in reader.connections if c.topic == topic]
        return [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(own)]


def joint_states(path: Path) -> tuple[list[str], np.ndarray, list[np.ndarray]]:
    """Joint names, stamps and (position, velocity, effort) of a bag."""
    found = messages_of(path, "/joint_states")
    stamps = np.array([m.header.stamp.sec * SECOND + m.header.stamp.nanosec for m in found])
    columns = [np.array([getattr(m, k) for m in found]) for k in ("position", "velocity", "effort")]
    return found[0].name, stamps, columns


def test_a_bag_holds_what_was_simulated(tmp_path: Path) -> None:
    config = resolve(TWO)
    noise = Noise(white=1e-5, torque=0.1)
    truths = {joint.name: SimulatedJoint(joint.drive, noise) for joint in config.joints}
    assert write_bag(tmp_path / "out", config, SHORT, rng(4), truths, with_temperature=True) == 300
    names, stamps, (position, velocity, effort) = joint_states(tmp_path / "out")
    assert names == ["shoulder_motor", "shoulder", "m2", "elbow"]
    assert_array_equal(stamps, SHORT.stamps(START, 0, 300))
    for column, (joint, generator) in enumerate(zip(truths.values(), rng(4).spawn(2), strict=True)):
        record = simulate(joint, SHORT, generator)
        assert_array_equal(position[:, 2 * column], record.input_angle)
        assert_array_equal(position[:, 2 * column + 1], record.output_angle)
        assert_array_equal(effort[:, 2 * column + 1], record.torque)
        assert_array_equal(velocity[:, 2 * column], record.input_velocity)
        slow = record.input_velocity / joint.drive.kinematics.ratio
        assert_allclose(velocity[:, 2 * column + 1], slow)
    assert (effort[:, ::2] == 0.0).all()
    assert (effort[:, 1] != effort[:, 3]).all()


@pytest.mark.parametrize(("rate", "count"), [(40.7, 6), (0.4, 3)])
def test_temperatures_come_once_a_second(tmp_path: Path, rate: float, count: int) -> None:
    motion = Motion(duration=6.0, sample_rate=rate, speeds=(1.0,), torques=(1.0,))
    options = {"with_temperature": True, "start": START + 250, "chunk": 7}
    write_bag(tmp_path / "out.mcap", resolve(TWO), motion, rng(), **options)
    for topic in ("/elbow/temperature", "/shoulder/temperature"):
        found = messages_of(tmp_path / "out.mcap", topic)
        stamps = [m.header.stamp.sec * SECOND + m.header.stamp.nanosec for m in found]
        assert stamps == [START + 250 + second * SECOND for second in range(count)]
        assert_array_equal([m.temperature for m in found], temperature(np.arange(float(count))))


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    config = resolve(ECCENTRIC)
    truths = {"joint_1": SimulatedJoint(config.joints[0].drive, Noise(white=1e-5, drift=1e-5, torque=0.1))}
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        (tmp_path / folder).mkdir()
        write_bag(tmp_path / folder / "out.mcap", config, SHORT, rng(seed), truths, with_temperature=True)
    first, again, other = ((tmp_path / folder / "out.mcap").read_bytes() for folder in "abc")
    assert first == again
    assert first != other


def test_the_command_writes_the_joint_that_its_options_describe(tmp_path: Path) -> None:
    out, summary = tmp_path / "out.mcap", tmp_path / "truth.json"
    options = (
        "--duration 2 --rate 250 --speed 2 --torque-level 20 --torque-level -5 --eccentricity-um 12 "
        "--direction-deg 90 --runout-um 3 --runout-direction-deg -45 --datum-mm 29.87 --offset-arcsec 100 "
        "--torque-noise 0.1 --seed 3 --start-time 1000.5 --temperature --set joint_1.tooth_compliance=11e-7 "
        "--set joint_1.flexspline_tooth.addendum_center=[0.7626e-3,-0.0548e-3]"
    )
    result = hd_diag("simulate", "--out", out, "--json", summary, *options.split())
    assert (result.exit_code, result.output) == (0, f"{out}: 500 samples, 2 s, joints joint_1\n")
    truth = json.loads(summary.read_text())
    assert truth["schema"] == "hd_diag/simulation/1"
    assert (truth["samples"], truth["start"], truth["seed"]) == (500, 1_000_500_000_000, 3)
    parameters = truth["joints"]["joint_1"]["parameters"]
    expected = {"eccentricity.magnitude": 12e-6, "eccentricity.direction": math.pi / 2.0}
    expected |= {"runout.magnitude": 3e-6, "runout.direction": -math.pi / 4.0}
    expected |= {"circular_spline_datum": 29.87e-3, "tooth_compliance": 1.1e-6}
    expected |= {"flexspline_tooth.addendum_center": [0.7626e-3, -0.0548e-3]}
    for name, value in expected.items():
        assert parameters[name] == pytest.approx(value), name
    true = resolve({f"joint_1.{name}": value for name, value in parameters.items()}).joints[0].drive
    motion = Motion(2.0, 250.0, (2.0 * TURN,), (20.0, -5.0))
    joint = SimulatedJoint(true, Noise(torque=0.1), 100.0 * ARCSEC)
    record = simulate(joint, motion, rng(3).spawn(1)[0], 1_000_500_000_000)
    names, stamps, (position, _, effort) = joint_states(out)
    assert names == ["joint_1_motor", "joint_1"]
    assert_array_equal(stamps, record.stamp)
    assert_array_equal(position, np.stack((record.input_angle, record.output_angle), axis=1))
    assert_array_equal(effort[:, 1], record.torque)


def test_the_command_takes_a_configuration_and_some_of_its_joints(tmp_path: Path) -> None:
    file, out = tmp_path / "drive.yaml", tmp_path / "out"
    file.write_text(dump(resolve(TWO)))
    given = ("--config", file, "--joint", "elbow", "--duration", 0.5, "--one-way", "--json", "-")
    result = hd_diag("simulate", "--out", out, *given)
    assert json.loads(result.stdout)["samples"] == 250  # nothing else on stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.yaml", "out"]
    names, _, (position, _, _) = joint_states(out)
    assert names == ["m2", "elbow"]
    assert (np.diff(position[:, 0]) >= 0.0).all()
    assert position[-1, 0] == pytest.approx(-100.0 * position[-1, 1], abs=0.1)


def test_ctrl_c_leaves_a_whole_bag_or_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes while the third of four parts is written; the message tells what exists."""
    new, old = tmp_path / "new.mcap", tmp_path / "old.mcap"
    old.write_text("precious")
    write, calls = BagWriter.write_many, itertools.count(1)

    def interrupting(*arguments: Any) -> None:
        if next(calls) in (3, 6):
            signal.raise_signal(signal.SIGINT)
        write(*arguments)

    monkeypatch.setattr(BagWriter, "write_many", interrupting)
    long = ("--duration", 8, "--rate", 500, "--overwrite")
    told = {new: f"{new} holds the first 3000 messages", old: f"nothing was written, {old} is as it was"}
    for out, left in told.items():
        result = hd_diag("simulate", "--out", out, *long)
        said = f"hd-diag: interrupted: {left}\n"
        assert (result.exit_code, result.stdout, result.stderr) == (130, "", said)
    assert old.read_text() == "precious"
    with BagReader(new) as reader:
        assert (reader.problems, reader.message_count) == ([], 3000)


def test_ctrl_c_while_the_map_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def build(mesh: Mesh, limit: float, wanted: Callable[[float], bool]) -> None:
        signal.raise_signal(signal.SIGINT)
        wanted(0.5)

    monkeypatch.setattr(torsion_map, "build", build)
    result = hd_diag("simulate", "--out", tmp_path / "out.mcap", "--duration", 100)
    assert (result.exit_code, result.stderr) == (130, "hd-diag: interrupted: nothing was written\n")
    assert list(tmp_path.iterdir()) == []
