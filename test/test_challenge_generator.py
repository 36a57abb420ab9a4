"""The generator of test records against laws, closed forms and the point-by-point reference."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from challenge import drive_causes as drive
from challenge import families, faults, findability, motion, moves, noise, page, records, truth
from challenge import mesh_causes as mesh
from challenge import sensor_causes as sensor
from challenge.cause import Cause
from challenge.contact import Flaws, Gear
from challenge.design import OTHERS, SIZE_25, Design
from challenge.truth import ARCSEC, Base
from mcap.reader import make_reader
from numpy.testing import assert_allclose
from reference import polyline
from rosbags.typesys import Stores, get_typestore

CLOSE = 0.05 * ARCSEC  # [rad], allowed error of the table against brute force
ERRORS = Base(e=18e-6, psi=0.7, runout=4e-6, runout_psi=-2.0, datum=29.8766e-3, compliance=0.9e-6)
ONE_RUN = motion.Motion((motion.Run(9.7, swing=50, period=1.6, duration=2.0),))


def reference_torsion(base: Base, angle: float, torque: float, **mesh: object) -> float:
    shape = base.design.shape
    drive = dataclasses.replace(shape, circular_spline_datum=base.datum, tooth_compliance=base.compliance)
    size, way = np.array([base.e, base.runout]), np.array([base.psi, base.runout_psi])
    displaced = np.stack((size * np.cos(way), size * np.sin(way)), axis=1)
    return polyline.torsion(polyline.mesh(angle, *displaced, **mesh, drive=drive), torque, drive)


SHIFTS = mesh.CircularSplinePitch(3e-6, 0.4).flaws(SIZE_25)
# Tables of one other design suffice: each takes three seconds unless it is cached on the disk.
EACH = [(design, [pytest.mark.slow] if place else []) for place, design in enumerate(OTHERS)]


@pytest.mark.parametrize(
    ("base", "flaws", "moved"),
    [
        *((base, None, {}) for base in (truth.NOMINAL, ERRORS)),
        *(
            pytest.param(truth.drawn(np.random.default_rng(5), one), None, {}, marks=slow)
            for one, slow in EACH
        ),
        (ERRORS, SHIFTS, {"slot_shift": SHIFTS.slot_along}),
        (ERRORS, Flaws(tooth_along=np.full(200, 2e-6)), {"arc_offset": 2e-6}),
    ],
)
def test_torsion_is_that_of_the_reference(base: Base, flaws: Flaws | None, moved: dict[str, object]) -> None:
    rng = np.random.default_rng(1)
    angles = rng.uniform(-30, 30, 4)
    torques = base.design.strength * rng.choice([-85.0, -40.0, -5.0, -0.5, 0.5, 5.0, 40.0, 85.0], 4)
    expected = [reference_torsion(base, a, m, **moved) for a, m in zip(angles, torques, strict=True)]
    found = Gear(base, flaws).torsion(angles, torques)
    assert_allclose(found, expected, rtol=0, atol=2 * CLOSE if moved else CLOSE)
    if "slot_shift" in moved:
        assert np.abs(found - Gear(base).torsion(angles, torques)).max() > 5 * ARCSEC


def test_a_gear_that_has_skipped_a_tooth_meshes_as_before() -> None:
    tooth = polyline.ring_radius() * 2 * np.pi / 200
    before, after = (reference_torsion(ERRORS, 0.3, 20.0, arc_offset=s) for s in (0.0, tooth))
    slot = reference_torsion(ERRORS, 0.3, 20.0, arc_offset=tooth * 200 / 202)
    assert after == pytest.approx(before, abs=1e-11)
    assert abs(slot - before) > 50 * ARCSEC  # 360°/202 is not a stable place
    jump = mesh.ToothSkip(0.01, -1.0).added(records.scene(ONE_RUN, np.array([0.0, 0.02])))
    assert_allclose(jump, [0, -2 * np.pi / 200])


def test_one_tooth_and_one_slot_return_in_their_own_time() -> None:
    tooth = Gear(ERRORS, mesh.ToothDamage(20e-6, 30, "flexspline").flaws(SIZE_25))
    slot = Gear(ERRORS, mesh.ToothDamage(20e-6, 30).flaws(SIZE_25))
    turn = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    whole = Gear(ERRORS).torsion(turn, 40.0)
    assert_allclose(slot.torsion(turn + 2 * np.pi, 40.0), slot.torsion(turn, 40.0), atol=1e-11)
    assert_allclose(tooth.torsion(turn + 200 * np.pi, 40.0), tooth.torsion(turn, 40.0), atol=1e-11)
    before = Gear(ERRORS, mesh.ToothDamage(20e-6, 20, "flexspline").flaws(SIZE_25))  # two teeth per turn
    assert_allclose(tooth.torsion(turn + 10 * np.pi, 40.0), before.torsion(turn, 40.0), atol=1e-11)
    assert np.abs(tooth.torsion(turn, 40.0) - before.torsion(turn, 40.0)).max() > 1 * ARCSEC
    assert 1 * ARCSEC < np.max(slot.torsion(turn, 40.0) - whole) < 10 * ARCSEC


def test_worn_flanks_let_the_torsion_grow_by_what_is_missing() -> None:
    worn = Gear(truth.NOMINAL, mesh.WearBacklash(2e-6).flaws(SIZE_25))
    whole = Gear(truth.NOMINAL)
    angle = np.linspace(0, 1, 20)
    for torque in (-30.0, 30.0):
        more = np.sign(torque) * (worn.torsion(angle, torque) - whole.torsion(angle, torque))
        assert np.all((more > 2e-6 / 31.1e-3) & (more < 2e-6 / 27e-3))  # over the lever arm r cos alpha


def test_a_drive_outside_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="outside the table"):
        Gear(Base(e=90e-6))
    with pytest.raises(ValueError, match="datum"):
        Gear(Base(datum=29.5e-3))


@pytest.mark.parametrize(
    ("design", "knees", "stiffness"),
    [
        (SIZE_25, (14, 48), (31e3, 50e3, 57e3)),
        (OTHERS[0], (2, 6.9), (3.4e3, 4.7e3, 5.7e3)),
        pytest.param(OTHERS[1], (7, 25), (16e3, 25e3, 29e3), marks=pytest.mark.slow),
        pytest.param(OTHERS[2], (29, 108), (67e3, 110e3, 120e3), marks=pytest.mark.slow),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_design_is_as_stiff_as_its_page_says(design: Design, knees: tuple, stiffness: tuple) -> None:
    base = truth.as_configured(design)
    gear, angle = Gear(base), np.linspace(0, 2 * np.pi, 24, endpoint=False)
    levels = np.array([knees[0] / 14, *knees, 2 * knees[1]])
    twist = [gear.torsion(angle, level).mean() + base.cup * level for level in levels]
    assert_allclose(np.diff(levels) / np.diff(twist), stiffness, rtol=0.06)
    clear = [np.nanmin(polyline.mesh(x, drive=design.shape).backlash) for x in (0.0, 0.005, 0.01)]
    assert min(clear) == pytest.approx(0.94e-6 * design.module, abs=0.15e-6)


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


def simulated(*causes: Cause, **more: records.Recording) -> records.Record:
    return records.simulate(ERRORS, causes, ONE_RUN, np.random.default_rng(0), **more)


def test_torque_offset_is_in_the_reading_only() -> None:
    quiet, off = simulated(), simulated(sensor.TorqueOffset(1.5))
    assert_allclose(off.torque + 1.5, quiet.torque)
    assert_allclose(off.clean_output, quiet.clean_output)


def test_friction_is_torque_in_the_mesh_that_no_sensor_sees() -> None:
    friction = drive.DryFriction(2.0, 0.3, 0.05, 5e-4)
    record, seen = simulated(friction), records.scene(ONE_RUN, ONE_RUN.times())
    extra = friction.load(seen)
    assert 2.0 <= np.abs(extra).max() <= 2.6
    torsion = Gear(ERRORS).torsion(-seen.motor, -(seen.torque + extra))
    assert_allclose(record.clean_output, seen.output + torsion, atol=1e-12)
    assert_allclose(record.torque, seen.torque, atol=1.0)


def test_each_recording_has_its_encoder_offset() -> None:
    record = simulated(recording=records.Recording(parts=3, offset_spread=3e-4, output_bits=19))
    off = record.clean_output - simulated().clean_output
    steps = [off[record.part == part] for part in range(3)]
    assert [float(np.ptp(step)) for step in steps] == pytest.approx([0, 0, 0], abs=1e-12)
    assert len({round(float(step[0]), 9) for step in steps}) == 3


def test_a_record_shows_only_what_no_parameter_does() -> None:
    columns = findability.columns(ERRORS, ONE_RUN, records.PLAIN)
    causes = (sensor.TorqueGain(1.2), mesh.CircularSplinePitch(2e-6, 0.2))
    gain, pitch = findability.shares(ERRORS, causes, ONE_RUN, records.PLAIN, columns)
    assert gain < 0.3 < 1.0 < pitch


def test_ripple_swells_where_it_meets_the_resonance() -> None:
    run = motion.Run(9.7, duration=6.0)
    at = {f: drive.Resonance(f, 0.06, 4e-6, 2, 0.0) for f in (2 * 9.7, 60.0)}
    scene = records.scene(motion.Motion((run,)), np.arange(0, 6, 0.002))
    swing = {f: cause.carried(scene, np.zeros(3000))[1500:2500].std() for f, cause in at.items()}
    assert swing[60.0] < 1.3 * 4e-6 / np.sqrt(2)
    assert swing[19.4] == pytest.approx(4e-6 / np.sqrt(2) / 0.12, rel=0.05)


TABLES = (faults.FAULTS, faults.UNKNOWN, faults.MECHANISMS, faults.OPTIONAL, faults.UNNAMED)


@pytest.mark.parametrize(("table", "name"), [(i, name) for i, table in enumerate(TABLES) for name in table])
def test_every_cause_enters_somewhere_and_can_be_found(table: int, name: str) -> None:
    rng, fault = np.random.default_rng(6), TABLES[table][name]
    assert table > 1 or faults.TIMES_LEAST * fault.least < fault.high
    cause, _ = faults.sized(rng, fault, ONE_RUN)
    assert (cause.name, cause.known) == (name, table not in (1, 4))
    scene = records.scene(ONE_RUN, ONE_RUN.times())
    still = np.zeros(len(scene.time))
    enters = [
        np.ptp(cause.shaft(scene.motor) - scene.motor),
        np.ptp(cause.added(scene) + still),
        np.ptp(cause.load(scene) + still),
        np.ptp(cause.carried(scene, still) + still),
        np.ptp(cause.input_reading(scene.motor) - scene.motor),
        np.ptp(cause.output_reading(scene.output) - scene.output),
        np.abs(cause.torque_reading(scene.torque, scene) - scene.torque).max(),
        cause.delay,
        sum(np.abs(value).max() for value in vars(cause.flaws(SIZE_25) or Flaws()).values()),
    ]
    assert max(enters) > 1e-9 or name == "loose_hub"  # needs a second run


def test_a_seed_gives_one_record_and_final_ones_are_apart() -> None:
    assert max(families.DEVELOPMENT) < min(families.FINAL)
    with pytest.raises(ValueError, match="neither"):
        families.made("one_effect", max(families.DEVELOPMENT) + 1)
    one, again, other = (families.made("short", seed) for seed in (4, 4, 6))
    assert np.array_equal(one.output_angle, again.output_angle)
    assert one.truth == again.truth
    assert not np.array_equal(one.output_angle, other.output_angle)


@pytest.mark.slow
def test_families_hide_what_they_say() -> None:
    several = families.made("triple", 3)
    assert len(set(several.truth["hidden"])) == 3
    assert not several.truth["unknown"]
    assert families.made("unknown", 2).truth["unknown"] == ["cogging"]
    poor = families.made("degraded", 1)
    assert 0.93 < len(poor.time) / 60_000 < 0.97
    wild = np.abs(poor.output_angle - poor.clean_output) > 30 * ARCSEC
    assert wild.mean() == pytest.approx(0.01, abs=0.003)
    assert len(poor.runs) == 12
    assert families.made("torque_unmeasured", 0).torque is None


def test_by_current_nothing_is_hidden_in_the_reading_of_a_torque_sensor() -> None:
    """Motor current measures what the motor needs, so no fault may act on a torque sensor's reading."""
    rng, row = np.random.default_rng(0), families.FAMILIES["robot_current"]
    moves = row.motion(rng, SIZE_25)
    made = [faults.sized(rng, fault, moves)[0] for fault in row.faults.values()]
    assert {row.names(rng, seed)[0] for seed in range(len(made))} == set(row.faults)
    assert all(type(one).torque_reading is Cause.torque_reading for one in made)


def test_bag_holds_the_record(tmp_path: Path) -> None:
    short_record = families.made("short", 2)
    records.write_bag(short_record, tmp_path / "a.mcap")
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        read = [(c.topic, store.deserialize_cdr(m.data, s.name)) for s, c, m in reader.iter_messages()]
    states = [message for topic, message in read if topic == "/joint_states"]
    assert list(states[0].name) == ["joint_1_motor", "joint_1"]
    position = np.array([message.position for message in states])
    assert np.array_equal(position[:, 0], short_record.input_angle)
    assert np.array_equal(position[:, 1], short_record.output_angle)
    assert np.array_equal([message.effort[1] for message in states], short_record.torque)
    stamps = [m.header.stamp.sec - records.EPOCH + 1e-9 * m.header.stamp.nanosec for m in states]
    assert_allclose(stamps, short_record.time, atol=1e-9)
    assert len([topic for topic, _ in read if topic == "/joint_1/temperature"]) == 4


def loaded(torque: np.ndarray, design: page.Page = page.PAGES[0]) -> records.Scene:
    zero, time = np.zeros_like(torque), np.arange(torque.size) / 500.0
    return records.Scene(time, zero, zero, torque, zero, zero.astype(int), design)  # type: ignore[arg-type]


def test_a_page_joint_lags_by_the_torsion_of_its_page() -> None:
    row = page.PAGES[0]
    t1, t2, t3 = row.t1, row.t2, 2 * row.t2
    found = records.output(page.PageJoint(design=row), (), loaded(np.array([0.0, t1, -t1, t2, t3]), row))
    at_t2 = t1 / row.k1 + (t2 - t1) / row.k2
    assert_allclose(found, [0, -t1 / row.k1, t1 / row.k1, -at_t2, -at_t2 - t2 / row.k3], rtol=1e-12)


def test_a_loop_of_relays_closes_holds_back_and_knows_no_rate() -> None:
    torque = 5.0 * np.sin(np.linspace(0, 6 * np.pi, 3001))
    loop = page.Loop(1e-5, 1.0)
    found = loop.added(loaded(torque))
    assert_allclose(found[1000:2000], found[2000:3000], atol=1e-8)
    rising = np.gradient(torque) > 0
    assert found[rising & (np.abs(torque) < 1)][50:].min() > 0.5e-5
    assert found[~rising & (np.abs(torque) < 1)].max() < -0.5e-5
    assert np.abs(found).max() == pytest.approx(1e-5)
    assert_allclose(loop.added(loaded(torque[::4])), found[::4], atol=5e-7)


@pytest.mark.parametrize("law", ["reciprocal", "exponential", "straight"])
def test_a_usual_wave_falls_with_the_load(law: str) -> None:
    wave = page.Wave(1e-5, 2, 0.0, law, 10.0)
    found = wave.added(loaded(np.array([0.0, 5.0, -10.0, 20.0])))
    assert found[0] == 1e-5
    assert np.all(np.diff(found) < 0)
    assert found[-1] > 0


@pytest.mark.parametrize("make", [moves.there, moves.there_and_back])
def test_journeys_are_driven_as_said(make: object) -> None:
    for seed in range(5):
        m = make(np.random.default_rng(seed), page.PAGES[seed])  # type: ignore[operator]
        time = np.arange(0, m.duration, 1e-3)
        angle, speed = m.angle(time) / m.design.ratio, m.speed(time) / m.design.ratio
        assert_allclose(np.gradient(angle, time), speed, atol=0.01)
        assert 0.14 < np.ptp(angle) / (2 * np.pi) < 0.96
        assert (speed.min() < -0.01) == (make is moves.there_and_back)
        assert np.abs(m.torque(time)).max() < m.design.rated


def test_every_page_record_has_what_is_usual_and_at_most_one_fault() -> None:
    for seed, name in enumerate(faults.PAGE):
        made = families.made("page_single", seed)
        assert made.truth["hidden"] + made.truth["unknown"] == [name]
        assert {*faults.PAGE_USUAL, "hysteresis", "output_runout"} <= {*made.truth["optional"]}
    made = families.made("page_none", 1)
    assert (made.truth["hidden"], made.truth["unknown"]) == ([], [])
    assert made.base.design.ratio == 100
    own = records.added_by(made, "usual_loop")
    assert 0.2 * ARCSEC < own.std() < 5 * ARCSEC
    assert np.ptp(own) == pytest.approx(2 * made.truth["effects"]["usual_loop"]["half_width"])
