"""Mechanics, sensors, motion and noise of the generator of test records against laws and closed forms."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from challenge import drive_causes as drive
from challenge import mechanics, motion, moves, noise, records
from challenge import sensor_causes as sensor
from challenge.design import OTHERS
from challenge.truth import ARCSEC
from numpy.testing import assert_allclose

Array = np.ndarray
ONE_RUN = motion.Motion((motion.Run(9.7, swing=50, period=1.6, duration=2.0),))


TURN = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
LOAD = 40 * np.sin(np.linspace(0, 20, 3000)) * np.linspace(0.2, 1, 3000)


def harmonic(x: Array, angle: Array, order: float) -> float:
    return float(2 * np.abs(np.mean(x * np.exp(-1j * order * angle))))


def test_play_lags_by_half_its_width() -> None:
    there = np.linspace(0, 1, 1000)
    lag = mechanics.play(np.r_[there, there[::-1]], 0.1) - np.r_[there, there[::-1]]
    assert_allclose(lag[[900, 1900]], [-0.05, 0.05])


def test_one_slip_element_is_the_stop_operator() -> None:
    state, expected = 0.0, []
    for step in np.diff(LOAD, prepend=0.0):
        state = float(np.clip(state + step / 6.0, -1, 1))
        expected.append(3e-5 * state)
    scene = dataclasses.replace(records.scene(ONE_RUN, np.arange(3000) / 1500), torque=LOAD)
    assert_allclose(drive.Hysteresis(3e-5, (6.0,)).added(scene), expected, atol=1e-12)
    found = mechanics.slipping_elements(LOAD, np.array([6.0, 1e9]), np.array([3e-5, 0.0]))
    assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    "twist",
    [
        lambda load: mechanics.slip_spring(load, 3e4, ((2e4, 3.0), (5e4, 6.0))),
        lambda load: load / 3e4 - 1e-4 * mechanics.bouc_wen(load, 6.0, 2.0),
        lambda load: load / 3e4 - mechanics.slipping_elements(load, np.array([1, 6.0]), np.full(2, 5e-5)),
    ],
)
def test_hysteresis_uses_up_energy_whatever_the_rate(twist: Callable[[Array], Array]) -> None:
    load = 30 * np.sin(np.linspace(0, 4 * np.pi, 40001))
    found = twist(load)
    assert np.sum((load[20001:] + load[20000:-1]) / 2 * np.diff(found[20000:])) > 0
    assert_allclose(twist(load[::10])[-1000:], found[::10][-1000:], atol=1e-6)


def test_friction_has_the_sign_of_the_speed_and_springs_back_from_little() -> None:
    time = np.arange(0, 3, 0.002)
    state = mechanics.rubbing(5 * np.cos(2 * time), time, presliding=2e-3, relaxation=0.02)
    speed = -10 * np.sin(2 * time)
    assert_allclose(state[np.abs(speed) > 5], np.sign(speed[np.abs(speed) > 5]), atol=0.05)
    bristle = mechanics.elasto_plastic(np.cos(2 * time), 1e-3, stick=0.5)
    assert_allclose(bristle[np.abs(speed) > 5], np.sign(speed[np.abs(speed) > 5]), atol=0.01)
    little = mechanics.elasto_plastic(4e-4 * np.sin(9 * time), 1e-3, 0.5)
    assert_allclose(little, 0.4 * np.sin(9 * time), atol=1e-9)


def test_a_lag_forgets_two_thirds_in_its_time() -> None:
    time = np.arange(0, 10, 0.01)
    found = mechanics.lagging((time > 1).astype(float), time, 2.0)
    assert found[time > 3][0] == pytest.approx(1 - np.exp(-1), abs=0.01)


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
    assert swing == pytest.approx(expected, rel=0.03)  # linear between samples


@pytest.mark.parametrize(
    ("reading", "order", "expected"),
    [
        (mechanics.universal_joint(TURN, 0.06, 0.3), 2, pytest.approx(np.tan(0.03) ** 2, rel=1e-6)),
        (sensor.off_centre(TURN, 0.02, 0.4), 1, pytest.approx(0.02, rel=1e-3)),
        (sensor.off_centre(TURN, 0.02, 0.4), 2, pytest.approx(0.02**2 / 2, rel=1e-3)),
        (sensor.quadrature(TURN, 16, 0.03, 1.0), 16, pytest.approx(0.03 / 16, rel=1e-3)),
        (sensor.quadrature(TURN, 16, 0, 0, 0.04), 32, pytest.approx(0.04 / 2 / 16, rel=0.03)),
    ],
)
def test_joints_discs_and_tracks_err_by_closed_forms(reading: Array, order: int, expected: object) -> None:
    assert harmonic(reading - TURN, TURN, order) == expected


def test_ripple_of_a_torque_sensor_and_current_are_in_the_reading_only() -> None:
    seen = records.scene(ONE_RUN, ONE_RUN.times())
    ripple = sensor.TorqueSensorRipple(0.03, 0.2, (0.1, 0.2, 0.3, 0.4), once=0.2, fourfold=0.1)
    reading = ripple.torque_reading(seen.torque, seen)
    high = seen.torque > 30
    assert harmonic(reading[high] / seen.torque[high], seen.motor[high], 2) > 0.02
    motor = sensor.MotorCurrent(10.0, 3.0, 0.1, 5.0, 1.0)
    extra = 10 * motor.torque_reading(seen.torque, seen) - seen.torque
    assert np.abs(extra - seen.acceleration / 100).max() < 3.0 + 0.1 * 50 + 5.0
    assert_allclose(np.sign(extra[seen.speed > 20]), 1)


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
    if make is motion.standard:
        assert sorted(run.speed for run in m.runs) == sorted(motion.BOTH_WAYS)
        assert torque.min() < -40 < 40 < torque.max()


@pytest.mark.parametrize("seed", range(4))
def test_moves_are_those_of_a_robot(seed: int) -> None:
    m = moves.point_to_point(np.random.default_rng(seed), design=OTHERS[seed % 3])
    time = np.arange(0, m.duration, 1e-3)
    angle, speed = m.angle(time) / m.design.ratio, m.speed(time) / m.design.ratio
    assert_allclose(np.gradient(angle, time), speed, atol=0.01)
    assert 0.5 <= np.ptp(angle) / (2 * np.pi) <= 0.9
    assert 0.05 < np.abs(speed).max() < 1.501
    rests = np.array(m.begin[1:]) - np.array(m.begin[:-1]) - np.array(m.length[:-1])
    assert np.all((rests > 0.199) & (rests < 0.801))
    assert np.abs(m.torque(time)).max() < m.design.rated
    arm = moves.Arm(gravity=0.0, share=1.0, upright=0.0, inertia=2.0, payload=0.0)
    inertia = dataclasses.replace(m, arm=arm).torque(time)
    empty = (np.abs(np.gradient(inertia)) < 0.1) & (m.run_of(time) % 2 == 0)  # every other move has a payload
    assert_allclose(inertia[empty], 2 * np.gradient(speed, time)[empty], atol=0.3)


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
    counts = noise.counted(time, 12) * 4096 / (2 * np.pi)
    assert_allclose(counts, np.rint(counts), atol=1e-9)
