"""The generator of test records against laws, closed forms and the point-by-point reference."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from challenge import drive_causes as drive
from challenge import families, mechanics, motion, noise, records, truth
from challenge import mesh_causes as mesh
from challenge import sensor_causes as sensor
from challenge.contact import Flaws, Gear
from challenge.truth import ARCSEC, Base
from mcap.reader import make_reader
from numpy.testing import assert_allclose
from reference import polyline
from rosbags.typesys import Stores, get_typestore

CLOSE = 0.05 * ARCSEC  # [rad], what the table may add to the brute force
ERRORS = Base(e=18e-6, psi=0.7, runout=4e-6, runout_psi=-2.0, datum=29.8766e-3, compliance=0.9e-6)
ONE_RUN = motion.Motion((motion.Run(9.7, swing=50, period=1.6, duration=2.0),))


def reference_torsion(base: Base, angle: float, torque: float, **mesh: object) -> float:
    drive = dataclasses.replace(
        polyline.DEFAULT, circular_spline_datum=base.datum, tooth_compliance=base.compliance
    )
    displaced = {
        "eccentricity": (base.e * np.cos(base.psi), base.e * np.sin(base.psi)),
        "runout": (base.runout * np.cos(base.runout_psi), base.runout * np.sin(base.runout_psi)),
    }
    return polyline.torsion(polyline.mesh(angle, **displaced, **mesh, drive=drive), torque, drive)


def moments(seed: int, count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-30, 30, count), rng.choice([-85.0, -40.0, -5.0, -0.5, 0.5, 5.0, 40.0, 85.0], count)


# Mesh ---


@pytest.mark.parametrize("base", [truth.NOMINAL, ERRORS])
def test_torsion_is_that_of_the_reference(base: Base) -> None:
    angles, torques = moments(1)
    expected = [reference_torsion(base, a, m) for a, m in zip(angles, torques, strict=True)]
    assert_allclose(Gear(base).torsion(angles, torques), expected, rtol=0, atol=CLOSE)


def test_moved_slots_are_those_of_the_reference() -> None:
    cause = mesh.CircularSplinePitch(3e-6, 0.4)
    angles, torques = moments(2)
    shift = cause.flaws().slot_along
    expected = [
        reference_torsion(ERRORS, a, m, slot_shift=shift) for a, m in zip(angles, torques, strict=True)
    ]
    found = Gear(ERRORS, cause.flaws()).torsion(angles, torques)
    assert_allclose(found, expected, rtol=0, atol=2 * CLOSE)
    assert np.abs(found - Gear(ERRORS).torsion(angles, torques)).max() > 5 * ARCSEC


def test_teeth_all_moved_are_the_references_arc_offset() -> None:
    angles, torques = moments(3)
    expected = [
        reference_torsion(ERRORS, a, m, arc_offset=2e-6) for a, m in zip(angles, torques, strict=True)
    ]
    found = Gear(ERRORS, Flaws(tooth_along=np.full(200, 2e-6))).torsion(angles, torques)
    assert_allclose(found, expected, rtol=0, atol=2 * CLOSE)


def test_a_gear_that_has_skipped_a_tooth_meshes_as_before() -> None:
    tooth = polyline.ring_radius() * 2 * np.pi / 200
    before, after = (reference_torsion(ERRORS, 0.3, 20.0, arc_offset=s) for s in (0.0, tooth))
    slot = reference_torsion(ERRORS, 0.3, 20.0, arc_offset=tooth * 200 / 202)
    assert after == pytest.approx(before, abs=1e-11)
    assert abs(slot - before) > 50 * ARCSEC  # 360°/202 would not be a place of rest
    jump = mesh.ToothSkip(0.01, -1.0).added(records.scene(ONE_RUN, np.array([0.0, 0.02])))
    assert_allclose(jump, [0, -2 * np.pi / 200])


def test_one_tooth_and_one_slot_return_in_their_own_time() -> None:
    tooth = Gear(ERRORS, mesh.ToothDamage(20e-6, 30, "flexspline").flaws())
    slot = Gear(ERRORS, mesh.ToothDamage(20e-6, 30).flaws())
    turn = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    whole = Gear(ERRORS).torsion(turn, 40.0)
    assert_allclose(slot.torsion(turn + 2 * np.pi, 40.0), slot.torsion(turn, 40.0), atol=1e-11)
    assert_allclose(tooth.torsion(turn + 200 * np.pi, 40.0), tooth.torsion(turn, 40.0), atol=1e-11)
    before = Gear(ERRORS, mesh.ToothDamage(20e-6, 20, "flexspline").flaws())  # two teeth a turn
    assert_allclose(tooth.torsion(turn + 10 * np.pi, 40.0), before.torsion(turn, 40.0), atol=1e-11)
    assert np.abs(tooth.torsion(turn, 40.0) - before.torsion(turn, 40.0)).max() > 1 * ARCSEC
    assert 1 * ARCSEC < np.max(slot.torsion(turn, 40.0) - whole) < 10 * ARCSEC


def test_worn_flanks_let_the_torsion_grow_by_what_is_missing() -> None:
    worn = Gear(truth.NOMINAL, mesh.WearBacklash(2e-6).flaws())
    whole = Gear(truth.NOMINAL)
    angle = np.linspace(0, 1, 20)
    for torque in (-30.0, 30.0):
        more = np.sign(torque) * (worn.torsion(angle, torque) - whole.torsion(angle, torque))
        assert np.all((more > 2e-6 / 31.1e-3) & (more < 2e-6 / 27e-3))  # over the arm r cos alpha


def test_flanks_hold_the_torque() -> None:
    gear = Gear(ERRORS)
    angles, torques = moments(4)
    beta = gear.torsion(angles, torques)
    b, stiffness = gear.clearance(angles)
    moment = (np.maximum(beta[:, None] * gear.flank - b, 0) * stiffness) @ gear.flank
    assert_allclose(moment, torques, atol=1e-6)


def test_a_drive_outside_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="outside the table"):
        Gear(Base(e=90e-6))
    with pytest.raises(ValueError, match="datum"):
        Gear(Base(datum=29.5e-3))


# Mechanics and sensors ---


def harmonic(x: np.ndarray, angle: np.ndarray, order: float) -> float:
    return float(2 * np.abs(np.mean(x * np.exp(-1j * order * angle))))


TURN = np.linspace(0, 2 * np.pi, 4096, endpoint=False)


def test_universal_joint_errs_twice_a_turn() -> None:
    error = mechanics.universal_joint(TURN, 0.06, 0.3) - TURN
    assert harmonic(error, TURN, 2) == pytest.approx(np.tan(0.03) ** 2, rel=1e-6)


def test_play_lags_by_half_its_width() -> None:
    there = np.linspace(0, 1, 1000)
    lag = mechanics.play(np.r_[there, there[::-1]], 0.1) - np.r_[there, there[::-1]]
    assert_allclose(lag[[900, 1900]], [-0.05, 0.05])


def test_one_slip_element_is_the_stop_operator() -> None:
    torque = 40 * np.sin(np.linspace(0, 20, 3000)) * np.linspace(0.2, 1, 3000)
    state, expected = 0.0, []
    for step in np.diff(torque, prepend=0.0):
        state = float(np.clip(state + step / 6.0, -1, 1))
        expected.append(3e-5 * state)
    scene = records.scene(ONE_RUN, np.arange(3000) / 1500)
    found = drive.Hysteresis(3e-5, (6.0,)).added(dataclasses.replace(scene, torque=torque))
    assert_allclose(found, expected, atol=1e-12)


def test_slip_elements_use_up_energy() -> None:
    torque = 30 * np.sin(np.linspace(0, 4 * np.pi, 4001))
    twist = mechanics.slip_spring(torque, 3e4, ((2e4, 3.0), (5e4, 6.0)))
    assert np.sum((torque[2001:] + torque[2000:-1]) / 2 * np.diff(twist[2000:])) > 0


def test_friction_has_the_sign_of_the_speed() -> None:
    time = np.arange(0, 3, 0.002)
    state = mechanics.rubbing(5 * np.cos(2 * time), time, presliding=2e-3, relaxation=0.02)
    speed = -10 * np.sin(2 * time)
    assert_allclose(state[np.abs(speed) > 5], np.sign(speed[np.abs(speed) > 5]), atol=0.05)


def test_spring_is_the_integral_of_its_compliance() -> None:
    found = mechanics.spring(np.array([-60.0, 10.0, 20.0, 60.0]), (14.0, 48.0), (2e-6, -1e-6))
    assert_allclose(found, [-(34 * 2e-6 + 12e-6), 0, 12e-6, 34 * 2e-6 + 12e-6], atol=1e-8)


@pytest.mark.parametrize("frequency", [5.0, 19.0, 40.0])
def test_inertia_swings_as_its_transfer_function_says(frequency: float) -> None:
    time = np.arange(0, 20, 0.002)
    angle = 2 * np.pi * frequency * time
    found = mechanics.beyond_spring(np.cos(angle), 0.002, 20.0, 0.08)[5000:]
    r = frequency / 20.0
    expected = (1 + 0.16j * r) / (1 - r**2 + 0.16j * r)
    swing = 2 * np.mean(found * np.exp(-1j * angle[5000:]))
    assert swing == pytest.approx(expected, rel=0.03)  # straight between samples


def test_disc_off_its_shaft() -> None:
    error = sensor.off_centre(TURN, 0.02, 0.4) - TURN
    assert harmonic(error, TURN, 1) == pytest.approx(0.02, rel=1e-3)
    assert harmonic(error, TURN, 2) == pytest.approx(0.02**2 / 2, rel=1e-3)


def test_uneven_quadrature() -> None:
    assert harmonic(sensor.quadrature(TURN, 16, 0.03, 1.0) - TURN, TURN, 16) == pytest.approx(
        0.03 / 16, rel=1e-3
    )
    assert harmonic(sensor.quadrature(TURN, 16, 0, 0, 0.04) - TURN, TURN, 32) == pytest.approx(
        0.04 / 2 / 16, rel=0.03
    )


# Motion and noise ---


@pytest.mark.parametrize("make", [motion.standard, motion.short, motion.one_direction, motion.unloaded])
def test_runs_begin_and_end_at_rest(make: object) -> None:
    m = make(np.random.default_rng(3))  # type: ignore[operator]
    time = m.times()
    angle, speed, torque = m.angle(time), m.speed(time), m.torque(time)
    assert_allclose(np.gradient(angle, time), speed, atol=2e-3)
    for start in m.starts:
        resting = np.abs(time - start) < motion.REST
        assert np.ptp(angle[resting]) < 1e-9
        assert not torque[resting].any()


def test_standard_motion_has_the_speeds_both_ways() -> None:
    m = motion.standard(np.random.default_rng(0))
    assert sorted(run.speed for run in m.runs) == sorted([*motion.SPEEDS, *(-v for v in motion.SPEEDS)])
    torque = m.torque(m.times())
    assert len(torque) == 60_000
    assert torque.min() < -40
    assert torque.max() > 40


@pytest.mark.parametrize("family", noise.FAMILIES)
def test_noise_has_its_rms(family: str) -> None:
    x = noise.FAMILIES[family](np.random.default_rng(1), 60_000)
    assert x.std() == pytest.approx(np.hypot(noise.DRIFTING, noise.WHITE), rel=0.08)
    kurtosis = np.mean(np.diff(x) ** 4) / np.mean(np.diff(x) ** 2) ** 2
    assert kurtosis > 5 if family == "heavy" else kurtosis == pytest.approx(3, abs=0.15)


def test_pink_noise_falls_with_frequency() -> None:
    x = noise.pink(np.random.default_rng(1), 1 << 16)
    power = np.abs(np.fft.rfft(x)) ** 2
    assert power[30:100].mean() / power[300:1000].mean() == pytest.approx(10, rel=0.35)


def test_recording_loses_and_spoils_the_stated_shares() -> None:
    rng = np.random.default_rng(2)
    assert 1 - noise.kept(rng, 60_000, 0.05).mean() == pytest.approx(0.05, abs=0.008)
    wild = noise.outliers(rng, 60_000, 0.01)
    assert np.mean(wild != 0) == pytest.approx(0.01, abs=0.002)
    assert np.abs(wild[wild != 0]).min() > 49 * ARCSEC
    time = noise.jittered(rng, np.arange(5000) / 500)
    assert np.diff(time).min() > 0
    assert np.diff(time).std() == pytest.approx(0.3e-3 * np.sqrt(2), rel=0.1)


# Records ---


def test_record_is_the_mesh_and_the_stated_noise() -> None:
    record = records.simulate(ERRORS, (), ONE_RUN, np.random.default_rng(0))
    time = ONE_RUN.times()
    torsion = Gear(ERRORS).torsion(-record.input_angle, -ONE_RUN.torque(time))
    assert_allclose(record.clean_output, record.input_angle / 100 + torsion, atol=1e-12)
    assert np.std(record.output_angle - record.clean_output) == pytest.approx(record.truth["noise_rms"])
    assert np.std(record.torque - ONE_RUN.torque(time)) == pytest.approx(noise.TORQUE_NOISE, rel=0.1)


def test_a_stream_one_sample_late_is_the_stream_before() -> None:
    time = ONE_RUN.times()
    late = records.transmission_error(ERRORS, (sensor.StreamDelay(1 / 500),), ONE_RUN, time)
    now = records.transmission_error(ERRORS, (), ONE_RUN, time)
    ideal = ONE_RUN.angle(time) / 100
    assert_allclose((late + ideal)[1:], (now + ideal)[:-1], atol=1e-10)


def test_torque_offset_is_in_the_reading_only() -> None:
    quiet = records.simulate(ERRORS, (), ONE_RUN, np.random.default_rng(0))
    off = records.simulate(ERRORS, (sensor.TorqueOffset(1.5),), ONE_RUN, np.random.default_rng(0))
    assert_allclose(off.torque + 1.5, quiet.torque)
    assert_allclose(off.clean_output, quiet.clean_output)


def test_contributions_are_what_each_cause_adds() -> None:
    runout, offset = sensor.OutputRunout(2e-5, 0.0), sensor.TorqueOffset(2.0)
    wave = mesh.CircularSplinePitch(1e-6, 0.2)
    record = records.simulate(ERRORS, (runout, offset, wave), ONE_RUN, np.random.default_rng(0))
    expected = 2e-5 * np.sin(record.clean_output)
    assert_allclose(records.added_by(record, "output_runout"), expected, atol=1e-8)
    steep = records.added_by(record, "torque_offset")  # softer near zero torque
    loaded, free = np.abs(record.torque) > 40, np.abs(record.torque) < 8
    assert np.abs(steep[loaded]).mean() == pytest.approx(2.0 / 5.7e4, rel=0.25)
    assert np.abs(steep[free]).mean() > np.abs(steep[loaded]).mean()
    assert 2 * ARCSEC < records.added_by(record, "circular_spline_pitch").std() < 6 * ARCSEC


def test_ripple_swells_where_it_meets_the_resonance() -> None:
    run = motion.Run(9.7, duration=6.0)
    at = {f: drive.Resonance(f, 0.06, 4e-6, 2, 0.0) for f in (2 * 9.7, 60.0)}
    scene = records.scene(motion.Motion((run,)), np.arange(0, 6, 0.002))
    swing = {f: cause.carried(scene, np.zeros(3000))[1500:2500].std() for f, cause in at.items()}
    assert swing[60.0] < 1.3 * 4e-6 / np.sqrt(2)
    assert swing[19.4] == pytest.approx(4e-6 / np.sqrt(2) / 0.12, rel=0.05)


@pytest.mark.parametrize("name", [*families.FAULTS, *families.UNKNOWN])
def test_every_cause_enters_somewhere(name: str) -> None:
    rng = np.random.default_rng(6)
    cause = families.draw(rng, name, ONE_RUN)
    assert (cause.name, cause.known) == (name, name in families.FAULTS)
    scene = records.scene(ONE_RUN, ONE_RUN.times())
    still = np.zeros(len(scene.time))
    enters = [
        np.ptp(cause.shaft(scene.motor) - scene.motor),
        np.ptp(cause.added(scene) + still),
        np.ptp(cause.carried(scene, still) + still),
        np.ptp(cause.input_reading(scene.motor) - scene.motor),
        np.ptp(cause.output_reading(scene.output) - scene.output),
        np.abs(cause.torque_reading(scene.torque) - scene.torque).max(),
        cause.delay,
        sum(np.abs(value).max() for value in vars(cause.flaws() or Flaws()).values()),
    ]
    assert max(enters) > 1e-9 or name == "loose_hub"  # which needs a second run


# Families ---


def test_seeds_are_apart() -> None:
    assert max(families.DEVELOPMENT) < min(families.FINAL)
    with pytest.raises(ValueError, match="neither"):
        families.one_effect(max(families.DEVELOPMENT) + 1)


def test_a_seed_gives_one_record() -> None:
    one, again, other = families.poor("short", 4), families.poor("short", 4), families.poor("short", 6)
    assert np.array_equal(one.output_angle, again.output_angle)
    assert one.truth == again.truth
    assert not np.array_equal(one.output_angle, other.output_angle)


@pytest.mark.parametrize("fault", [*families.FAULTS.values(), *families.UNKNOWN.values()])
def test_sizes_of_the_field_can_be_found(fault: families.Fault) -> None:
    assert families.TIMES_LEAST * fault.least < fault.high


@pytest.mark.slow
def test_families_hide_what_they_say() -> None:
    several = families.FAMILIES["triple"](3)
    assert len(set(several.truth["hidden"])) == 3
    assert not several.truth["unknown"]
    assert families.unknown(2).truth["unknown"] == ["cogging"]
    poor = families.degraded(1)
    assert 0.93 < len(poor.time) / 60_000 < 0.97
    assert np.mean(np.abs(poor.output_angle - poor.clean_output) > 30 * ARCSEC) == pytest.approx(
        0.01, abs=0.003
    )
    assert len(poor.runs) == 12
    assert families.poor("torque_unmeasured", 0).torque is None


# Files ---


@pytest.fixture(scope="module")
def short_record() -> records.Record:
    return families.poor("short", 2)


def test_bag_holds_the_record(short_record: records.Record, tmp_path: Path) -> None:
    records.write_bag(short_record, tmp_path / "a.mcap")
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        read = [
            (c.topic, m.log_time, store.deserialize_cdr(m.data, s.name)) for s, c, m in reader.iter_messages()
        ]
    states = [message for topic, _, message in read if topic == "/joint_states"]
    assert list(states[0].name) == ["joint_1_motor", "joint_1"]
    position = np.array([message.position for message in states])
    assert np.array_equal(position[:, 0], short_record.input_angle)
    assert np.array_equal(position[:, 1], short_record.output_angle)
    assert np.array_equal([message.effort[1] for message in states], short_record.torque)
    stamps = [m.header.stamp.sec - records.EPOCH + 1e-9 * m.header.stamp.nanosec for m in states]
    assert_allclose(stamps, short_record.time, atol=1e-9)
    assert len([topic for topic, *_ in read if topic == "/joint_1/temperature"]) == 4


def test_csv_holds_the_record(short_record: records.Record, tmp_path: Path) -> None:
    records.write_csv(short_record, tmp_path / "a.csv")
    table = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)
    for name, column in records.columns(short_record).items():
        assert np.array_equal(table[name], column)
