"""The catalogue of effects: one contract for all, and properties of single effects."""

import dataclasses
import importlib
import itertools
import math
import pickle
import re
from collections.abc import Callable
from typing import Any

import drives
import numpy as np
import pytest
from models import EFFECTS
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from hd_diag.config.parameters import JOINT_PARAMETERS
from hd_diag.drive import Drive, transmission_error
from hd_diag.effects import CATALOGUE
from hd_diag.effects.contact_weights import contact_weights
from hd_diag.effects.effect import Effect, by_run
from hd_diag.effects.mesh_torque import MeshTorque
from hd_diag.effects.quantity import turning
from hd_diag.effects.signals import Signals
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.model.transmission_error import Kinematics

UNITS = {"rad", "m", "s", "-", "N m", "rad/s", "rad/(N m)", "rad/K"}
NOISE = 1.0 * ARCSEC
EXACT = Drive(drives.mesh(eccentricity=(8e-6, 4e-6)), Kinematics(100.0, phase=0.3), 56.0)
RUN_LENGTHS = (7000, 5000)

# Values of a possible fault, in the order of its quantities: within all limits and easy to see below.
VALUES: dict[str, tuple[float, ...]] = {
    "output_runout": (1e-4, 2.0),
    "output_encoder_eccentricity": (2e-4, 5.0, 2e-5, 3.0),
    "circular_spline_form": (4e-6, 1.0, 3e-6, 0.5, 3e-6, 0.2, 1.0),
    "coupling_misalignment": (0.08, 2.5, 3e-4, 1.0),
    "bearing_passage": (2e-5, 1.0, 0.4437, 0.0),
    "circular_spline_pitch": (
        *(2e-6, 3.0, 2e-6, 2.0, 1e-6, 1.5, 2e-6, 1.2),
        *(1e-6, 0.9, 1e-6, 0.3, 1e-6, 0.6, 1e-6, 0.2),
    ),
    "flexspline_pitch": (2e-6, 0.4, 2e-6, 0.9, 0.0),
    "tooth_damage": (8e-5, 5e-5, 0.0, 2 * math.pi / 202 * 77, 0.0),
    "wear_backlash": (5e-6,),
    "torsional_hardening": (-6e-6, 8e-6, 9.0, 38.0, 0.1),
    "hysteresis": (1e-4, 6e-5, 9.0, 1.6, 4.0, 2.0),
    "coulomb_windup": (1.5, 0.3, 1.0, 0.7, 8.0),
    "viscous_windup": (2.0, 0.85),
    "input_encoder_eccentricity": (4e-3, 4.0, 1e-3, 1.0),
    "encoder_interpolation": (2e-3, 1.5, 1e-3, 2.5, 16.0),
    "output_encoder_interpolation": (2e-5, 1.5, 1e-5, 2.5, 128.0),
    "stream_delay": (3e-4,),
    "thermal_drift": (8e-6, 20.0),
    "ratio_error": (2e-4,),
    "tooth_skip": (-1.0, 31.0),
    "resonance": (4e-5, 2.2, 0.8, 2.0, 130.0, 0.05),
    "torque_offset": (3.0,),
    "torque_gain": (0.1,),
    "torque_sensor_ripple": (0.03, 0.4, 0.5, 1.0, 0.01, 2.0, 0.3, 3.0, 0.01, 0.2, 0.3, 0.5, 0.0, 1.0),
    "motor_current": (0.1, 3.0, 0.1, 5.0, 4.0, 2.0),
}
NAMES = tuple(effect.name for effect in CATALOGUE)
TRUTH = {
    effect.name: {q.name: one for q, one in zip(effect.quantities, VALUES[effect.name], strict=True)}
    for effect in CATALOGUE
}


@pytest.fixture(scope="module")
def signals() -> Signals:
    """Two runs of a joint that moves both ways under load with nested reversals, and warms up."""
    count = sum(RUN_LENGTHS)
    run = np.repeat(np.arange(len(RUN_LENGTHS)), RUN_LENGTHS)
    jitter = np.random.default_rng(3).uniform(-0.2, 0.2, count)
    time = (np.arange(count) + jitter) / 200.0 + 10.0 * run
    # [rad/s]: ramps in both directions up to 13 turns per second, and slow stretches.
    speed = 85.0 * np.sin(2 * math.pi * time / 37.0) ** 3 + 2.0 * np.sin(2 * math.pi * time / 5.0) + 40.0
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))))
    torque = 30.0 * np.sin(2 * math.pi * time / 11.0) + 18.0 * np.sin(2 * math.pi * time / 2.3)
    wave_generator = EXACT.frame.wave_generator_angle(angle)
    error = transmission_error(EXACT, angle, torque)
    slope = (transmission_error(EXACT, angle, torque + 0.003) - error) / 0.003
    rate = np.concatenate([np.gradient(error[run == k], time[run == k]) for k in np.unique(run)])
    return Signals(
        time=time,
        wave_generator_angle=wave_generator,
        output_angle=angle / EXACT.kinematics.ratio,
        speed=speed,
        torque=torque,
        temperature=25.0 + 12.0 * (1.0 - np.exp(-time / 30.0)),
        run=run,
        predicted=error,
        predicted_torque_slope=slope,
        predicted_rate=rate,
        contact=contact_weights(EXACT, wave_generator, torque),
    )


def truth(effect: Effect) -> tuple[np.ndarray, tuple[float, ...]]:
    return effect.from_physical(TRUTH[effect.name])


def at(signals: Signals, time: np.ndarray, **changes: object) -> Signals:
    """The first row at other times, with the given changes."""
    return dataclasses.replace(signals.part(np.zeros(time.size, dtype=np.int64)), time=time, **changes)


@pytest.mark.parametrize("effect", CATALOGUE, ids=NAMES)
class TestContract:
    def test_says_what_it_is_and_with_what_it_is_confused(self, effect: Effect) -> None:
        for text in (effect.cause, effect.source, effect.inspect, *(q.meaning for q in effect.quantities)):
            assert text.strip() == text
            assert len(text) > 2
        assert not re.search(r"\d (um|deg)\b", f"{effect.cause} {effect.inspect} {effect.formula}")
        assert importlib.import_module(f"hd_diag.effects.{effect.name}").EFFECT is effect
        assert pickle.loads(pickle.dumps(effect)).quantities == effect.quantities
        assert effect.cause.find(".") == len(effect.cause) - 1
        assert len(effect.inspect) > 120
        assert effect.kind in ("kinematic", "torsion", "friction", "sensor")
        assert effect.frame in ("input", "output", "housing", "time", "torque")
        fields = {field.name for field in dataclasses.fields(Signals)}
        assert set() < set(effect.needs) <= fields
        parameters = {parameter.name for parameter in JOINT_PARAMETERS}
        assert set() < set(effect.confused_with) <= set(NAMES) - {effect.name}
        assert set(effect.always_confused) <= (set(NAMES) | parameters) - {effect.name}
        for other in set(effect.always_confused) & set(NAMES):
            assert effect.name in EFFECTS[other].always_confused

    def test_quantities(self, effect: Effect) -> None:
        assert len({quantity.name for quantity in effect.quantities}) == len(effect.quantities)
        linear = [quantity.linear for quantity in effect.quantities]
        assert linear == sorted(linear, reverse=True)
        for quantity in effect.quantities:
            assert quantity.unit in UNITS
            assert quantity.low < quantity.high
            assert quantity.prior_scale > 0.0
            assert quantity.periodic is None or quantity.unit == "rad"
        assert effect.wanders_by in ("", *(q.name for q in effect.nonlinear if q.discrete))
        assert effect.formula or type(effect).__doc__
        assert not effect.own_slopes or not effect.proportional

    def test_physical_round_trip_within_limits(self, effect: Effect) -> None:
        coefficients, nonlinear = truth(effect)
        assert (len(coefficients), len(nonlinear)) == (effect.size, len(effect.nonlinear))
        back = effect.to_physical(coefficients, nonlinear)
        assert list(back) == [quantity.name for quantity in effect.quantities]
        for quantity in effect.quantities:
            expected = pytest.approx(TRUTH[effect.name][quantity.name], rel=1e-12)
            assert back[quantity.name] == (expected, quantity.unit)
            if quantity.periodic is None:
                beyond = TRUTH[effect.name] | {quantity.name: quantity.high * 1.01 + 1e-9}
                with pytest.raises(ValueError, match=rf"{effect.name}: {quantity.name} must be from"):
                    effect.from_physical(beyond)
            else:
                turned = TRUTH[effect.name] | {quantity.name: back[quantity.name][0] + quantity.periodic}
                assert_allclose(effect.from_physical(turned)[0], coefficients, rtol=1e-12)
        with pytest.raises(ValueError, match=r"nonsense is missing or unknown"):
            effect.from_physical(TRUTH[effect.name] | {"nonsense": 1.0})

    def test_starts_are_few_and_within_limits(self, effect: Effect, signals: Signals) -> None:
        residual = np.random.default_rng(0).normal(0.0, NOISE, signals.size)
        grid, trials = effect.starts(signals)
        for starts in (grid, effect.starts(signals, residual).points):
            assert 1 <= len(starts) <= 24
            assert len(set(starts)) == len(starts)
            for start in starts:
                assert len(start) == len(effect.nonlinear)
                for value, quantity in zip(start, effect.nonlinear, strict=True):
                    assert quantity.low <= value <= quantity.high
        assert effect.starts(signals, residual).trials == trials >= len(grid)

    def test_zero_size_is_no_effect(self, effect: Effect, signals: Signals) -> None:
        columns = effect.columns(signals, truth(effect)[1])
        assert columns.shape == (signals.size, effect.size)
        assert np.isfinite(columns).all()
        assert np.all(np.any(columns != 0.0, axis=0))
        assert not np.any(columns @ np.zeros(effect.size))
        values = {q.name: (0.0 if q.linear else TRUTH[effect.name][q.name]) for q in effect.quantities}
        assert not np.any(effect.from_physical(values)[0])

    def test_chunks_are_the_whole(self, effect: Effect, signals: Signals) -> None:
        coefficients, nonlinear = truth(effect)
        start = effect.start(nonlinear)
        whole = by_run(signals, lambda run: effect.step(start, run, coefficients, nonlinear)[0])
        # Offline, a late stream is interpolated with samples from both sides.
        rest = 1e-12 if effect.name != "stream_delay" else 0.1
        response = effect.response(signals, coefficients, nonlinear)
        assert_allclose(response, whole, rtol=1e-12, atol=rest * np.std(whole))
        parts = []
        for run in signals.runs():
            state, inside = effect.start(nonlinear), signals.part(run)
            for start, end in itertools.pairwise([0, 1, 2, 3, 3, 40, 41, 1000, inside.size]):
                error, state = effect.step(state, inside.part(slice(start, end)), coefficients, nonlinear)
                parts.append(error)
        assert_allclose(np.concatenate(parts), whole, rtol=1e-12, atol=1e-12 * np.abs(whole).max())

    def test_response_is_the_columns_at_small_size(self, effect: Effect, signals: Signals) -> None:
        coefficients, nonlinear = truth(effect)
        small = 1e-3 * coefficients
        expected = effect.columns(signals, nonlinear) @ small
        away = effect.response(signals, small, nonlinear) - expected
        assert np.sqrt(np.mean(away**2)) < 0.05 * np.sqrt(np.mean(expected**2))
        assert not effect.response(signals, 0.0 * coefficients, nonlinear).any()
        first = effect.columns(signals, nonlinear) @ coefficients
        whole = effect.response(signals, coefficients, nonlinear)
        assert np.array_equal(whole, first) is effect.proportional
        assert effect.columns(signals.part(slice(0, 0)), nonlinear).shape == (0, effect.size)

    def test_testable(self, effect: Effect, signals: Signals) -> None:
        assert effect.testable(signals) == (True, "")
        few = {"torque": np.full(9, 5.0), "temperature": None, "speed": np.full(9, 1.0)}
        still = dataclasses.replace(signals.part(np.arange(9)), **few)
        possible, reason = effect.testable(still)
        assert not possible
        assert len(reason) > 20
        assert "temperature" not in effect.needs or "no temperature is measured" in reason

    def test_fit_returns_the_quantities(self, effect: Effect, signals: Signals) -> None:
        coefficients, nonlinear = truth(effect)
        noise = np.random.default_rng(1).normal(0.0, NOISE, signals.size)
        error = effect.columns(signals, nonlinear) @ coefficients + noise
        found, covariance = fitted(effect, signals, error)
        values = effect.to_physical(found[: effect.size], tuple(found[effect.size :]))
        deviations = effect.standard_deviations(found[: effect.size], tuple(found[effect.size :]), covariance)
        for quantity in effect.quantities:
            expected, deviation = TRUTH[effect.name][quantity.name], deviations[quantity.name]
            away = values[quantity.name][0] - expected
            if quantity.periodic is not None:
                away -= quantity.periodic * round(away / quantity.periodic)
            if quantity.discrete:
                tolerance = 0.1 if effect.name == "tooth_skip" else 1e-9  # [s]: some samples
                assert abs(away) < tolerance
            else:
                assert 0.0 < deviation < 0.25 * max(abs(expected), 0.1 * quantity.prior_scale)
                assert abs(away) < 5.0 * deviation


def fitted(effect: Effect, signals: Signals, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size, free = effect.size, [i for i, quantity in enumerate(effect.nonlinear) if not quantity.discrete]

    def begin(start: tuple[float, ...]) -> np.ndarray:
        return np.array([*solved(effect.columns(signals, start), error), *np.array(start)[free]])

    def left(values: np.ndarray, start: tuple[float, ...]) -> np.ndarray:
        nonlinear = np.array(start)
        nonlinear[free] = values[size:]
        return error - effect.columns(signals, tuple(nonlinear.tolist())) @ values[:size]

    starts = effect.starts(signals).points + effect.starts(signals, error).points
    start = min(starts, key=lambda one: float(np.sum(left(begin(one), one) ** 2)))
    first, found = begin(start), np.array([*np.zeros(size), *start])
    own = [*range(size), *(size + i for i in free)]
    bounds = [(effect.nonlinear[i].low, effect.nonlinear[i].high) for i in free]
    limits = np.array([(-np.inf, np.inf)] * size + bounds)
    scale = np.where(np.arange(first.size) < size, np.abs(first) + 1e-12, np.maximum(np.abs(first), 1e-3))
    made = least_squares(left, first, bounds=limits.T, x_scale=scale, args=(start,), xtol=1e-12, ftol=1e-12)
    found[own] = made.x
    norm = np.linalg.norm(made.jac, axis=0)
    scaled, covariance = made.jac / norm, np.zeros((found.size, found.size))
    covariance[np.ix_(own, own)] = NOISE**2 * np.linalg.pinv(scaled.T @ scaled) / np.outer(norm, norm)
    return found, covariance


def solved(columns: np.ndarray, error: np.ndarray) -> np.ndarray:
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.linalg.lstsq(columns / scale, error, rcond=None)[0] / scale


def test_hysteresis_closes_its_loop(signals: Signals) -> None:
    """Masing: the loop repeats after the first swing; it is 2 a wide and dissipates work."""
    count = 401
    swing = np.concatenate([np.linspace(*ends, count) for ends in ((0, 20), (20, -20), (-20, 20))])
    loop = dataclasses.replace(signals.part(slice(0, swing.size)), torque=swing)
    z = EFFECTS["hysteresis"].columns(loop, (3.0, 1.0, 4.0, 1.5))
    assert_allclose(z[[count - 1, 2 * count - 1], 1], [1.0, -1.0], atol=1e-12)
    assert_allclose(z[: count // 2, 0], -np.expm1(-swing[: count // 2] / 3.0), atol=1e-4)  # for n = 1
    down, up = z[count : 2 * count], z[2 * count :]
    assert_allclose(down[:, 1], -up[:, 1], atol=1e-12)
    area = (up[::-1] - down).sum(axis=0) * 40.0 / (count - 1)  # a rectangle of 40 x 2 minus two wedges
    assert_allclose(area[1], 80.0 - 4.0 * 4.0 * np.mean(1.5 ** np.linspace(-1, 1, 4)), rtol=0.02)
    assert area[0] > 0.7 * area[1] > 0.0  # a lagging link, -TE, dissipates work


def test_resonance_follows_the_equation_of_motion(signals: Signals) -> None:
    time = np.linspace(0.0, 4.0, 8001)
    angle = -0.5 * 40.0 * time**2
    sweep = at(signals, time, wave_generator_angle=angle, output_angle=-angle / 100.0, speed=40.0 * time)
    frequency, damping = 130.0, 0.05
    found = EFFECTS["resonance"].columns(sweep, (2.0, frequency, damping))

    def push(t: float, y: np.ndarray) -> np.ndarray:
        drive = np.exp(-1j * 40.0 * t * t)
        moved = -80j * t * drive
        return np.array([y[1], frequency**2 * (drive - y[0]) + 2 * damping * frequency * (moved - y[1])])

    begun = np.array([1.0 + 0j, 0.0])
    expected = solve_ivp(push, (0.0, 4.0), begun, t_eval=time, rtol=1e-7, atol=1e-7, max_step=2e-3).y[0]
    # Real columns for u = cos and sin: the real parts of x for exp and -i exp.
    assert np.abs(expected).max() > 5.0  # the sweep passes the resonance
    assert_allclose(found[:, 0], expected.real, atol=0.01)
    assert_allclose(found[:, 1], expected.imag, atol=0.01)


def test_resonance_carries_the_ripple(signals: Signals) -> None:
    """A densely sampled ripple passes the spring like an order of rotation."""
    effect, time = EFFECTS["resonance"], np.linspace(0.0, 4.0, 8001)
    motion = {"wave_generator_angle": -20.0 * time**2, "output_angle": 0.2 * time**2, "speed": 40.0 * time}
    sweep = at(signals, time, **motion, torque=np.full(time.size, 56.0))
    wave = np.cos(2.0 * sweep.wave_generator_angle)
    sweep.contact.__dict__["ripple"] = wave
    found = effect.columns(sweep, (2.0, 130.0, 0.05))
    assert_allclose(found[:, 2], found[:, 0] - wave, atol=0.01)
    sweep.contact.__dict__["ripple"] = 0.7 * wave
    teeth = dataclasses.replace(sweep, tooth_ripple=0.3 * wave)
    assert_allclose(effect.columns(teeth, (2.0, 130.0, 0.05)), found, atol=1e-12)
    share = np.array([0.0, 0.0, 0.6])
    carried = effect.carry(sweep, wave[:, None], share, (2.0, 130.0, 0.05))
    assert_allclose(carried[:, 0], 0.6 * found[:, 2], atol=1e-9)
    loose = dataclasses.replace(sweep, torque=np.full(time.size, 0.0056))
    assert np.max(np.abs(effect.carry(loose, wave[:, None], share, (2.0, 130.0, 0.05)))) < 1e-3


def test_a_bearing_that_slips_is_followed_through_its_record(signals: Signals) -> None:
    """The phase creeps by more than half a turn; a fit that allows creep leaves a small residual."""
    effect, count = EFFECTS["bearing_passage"], 20_000
    angle = np.linspace(0.0, 2.0 * math.pi * 300.0, count)
    long = at(signals, angle / 20.0, wave_generator_angle=angle)
    true = np.cos(10.25 * angle + 2.0 * np.sin(angle / angle[-1] * 4.0))

    def left(slips: float) -> float:
        own = effect.columns(long, (10.25, slips))
        columns = np.concatenate((own, effect.wandering(long, (10.25, slips))), axis=1)
        return float(np.std(true - columns @ np.linalg.lstsq(columns, true, rcond=None)[0]))

    assert effect.wandering(long, (10.25, 0.0)).shape == (count, 0)
    assert left(1.0) < 0.05 < 0.5 < left(0.0)


@pytest.mark.parametrize("name", ["torque_offset", "torque_gain", "viscous_windup", "torque_sensor_ripple"])
def test_a_torque_is_borne_by_the_mesh(signals: Signals, name: str) -> None:
    ratio, angle, torque = signals.ratio, signals.wave_generator_angle, signals.torque
    forward = signals.speed * np.sign(ratio) / 100.0
    more = {
        "torque_offset": np.full(signals.size, 3.0),
        "torque_gain": 0.1 * torque,
        "viscous_windup": 2.0 * np.sign(forward) * np.abs(forward) ** 0.85,
        "torque_sensor_ripple": torque * (0.03 * np.cos(2.0 * (angle - 0.4)) + 0.01 * np.cos(angle - 2.0))
        + 0.5 * np.cos(2.0 * (angle - 1.0))
        + 0.3 * np.cos(angle - 3.0)
        + torque * 0.01 * np.cos(4.0 * (angle - 0.2))
        + 0.3 * np.cos(4.0 * (angle - 0.5)),
    }[name]
    expected = transmission_error(EXACT, signals.input_angle, torque + more) - signals.predicted
    found = EFFECTS[name].response(signals, *truth(EFFECTS[name]))
    assert_allclose(found, expected, atol=0.1 * ARCSEC)


def test_friction_builds_up_over_a_way_and_stays_at_rest(signals: Signals) -> None:
    """Dahl: 1 - exp(-x / x_0) while moving, constant at rest, reversed on the way back; creep relaxes it."""
    effect = EFFECTS["coulomb_windup"]
    assert isinstance(effect, MeshTorque)
    way = np.concatenate((np.linspace(0.0, 0.5, 100), np.full(50, 0.5), np.linspace(0.5, 0.0, 100)))
    moving = at(signals, 0.02 * np.arange(way.size), output_angle=way / 100.0)
    z = effect.torque(dataclasses.replace(moving, speed=np.full(way.size, 1e3)), (0.2, 0.0, 1.0, 5.0))
    assert_allclose(z[:100, 0], -np.expm1(-way[:100] / 0.2), atol=1e-12)
    assert_allclose(z[100:150, 0], z[99, 0], atol=1e-12)
    assert_allclose(z[150:, 0], (1.0 + z[99, 0]) * np.exp((way[150:] - 0.5) / 0.2) - 1.0, atol=1e-12)
    slow = effect.torque(dataclasses.replace(moving, speed=np.zeros(way.size)), (1e-3, 0.25, 1.0, 5.0))
    assert_allclose(slow[50], 2.0 * 0.5, atol=0.02)  # 0.25 rad/s equals the creep; Stribeck doubles
    assert abs(slow[149, 0]) < 1e-12


@pytest.mark.parametrize("law", [lambda t: t**3 / 1600.0, lambda t: 10.0 * np.tanh(t / 10.0)])
def test_hardening_bends_as_smoothly_as_any(signals: Signals, law: Callable[[Any], Any]) -> None:
    """A fitted cubic or saturating spring leaves under a tenth of a constant compliance's residual."""
    torque = np.linspace(-60.0, 60.0, signals.size)
    ramp, effect = dataclasses.replace(signals, torque=torque), EFFECTS["torsional_hardening"]

    def left(columns: list[np.ndarray]) -> float:
        every = np.column_stack([torque, *columns])
        return float(np.std(law(torque) - every @ solved(every, law(torque))))

    best = min(left([effect.columns(ramp, point)]) for point in effect.starts(ramp).points)
    assert best < 0.1 * left([])


def test_drift_lags(signals: Signals) -> None:
    time = np.arange(400.0)
    step = at(signals, time, temperature=np.where(time < 100.0, 20.0, 30.0))
    found = EFFECTS["thermal_drift"].columns(step, (60.0,))[:, 0]
    assert_allclose(found, np.where(time < 100.0, 0.0, -10.0 * np.expm1(-(time - 99.0) / 60.0)), atol=1e-9)


def test_ratio_error_is_another_ratio(signals: Signals) -> None:
    expected = signals.input_angle / (100.0 / 1.01) - signals.input_angle / 100.0
    assert_allclose(0.01 * EFFECTS["ratio_error"].columns(signals, ())[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize("order", [0.4123, 0.4437, 10.2537, 12.8821])
def test_scan_finds_the_bearing(signals: Signals, order: float) -> None:
    effect = EFFECTS["bearing_passage"]
    noise, angle = np.random.default_rng(5).normal(0.0, NOISE, signals.size), signals.wave_generator_angle
    found = effect.starts(signals, 0.5 * NOISE * np.cos(order * angle + 0.4) + noise).points
    assert min(abs(one - order) for one, _ in found) < 0.5 * 2 * math.pi / np.ptp(angle)


@pytest.mark.parametrize("order", [2.02, 4.04, 6.0, 10.0, 3.3])
def test_scan_leaves_others_orders_alone(signals: Signals, order: float) -> None:
    effect = EFFECTS["bearing_passage"]
    line = 1e-4 * np.cos(order * signals.wave_generator_angle)
    best = effect.columns(signals, effect.starts(signals, line).points[0])
    left = line - best @ solved(best, line)
    assert np.sum(left**2) > 0.9 * np.sum(line**2)


def test_no_bearing_slips_beside_a_stronger_loaded_wave(signals: Signals) -> None:
    """The loaded wave's plain sum vanishes under torques of both signs, but its leakage does not."""
    effect, angle = EFFECTS["bearing_passage"], signals.wave_generator_angle
    weak, load = 0.2 * np.cos(10.2537 * angle), signals.torque / np.std(signals.torque)
    assert any(slips for _, slips in effect.starts(signals, weak).points)
    found = effect.starts(signals, weak + load * np.cos(21.0 * angle)).points
    assert not any(slips for _, slips in found)


@pytest.mark.parametrize(("member", "count"), [(0.0, 202), (1.0, 200)])
@pytest.mark.parametrize("tooth", [3, 111])
def test_scan_finds_the_tooth(signals: Signals, member: float, count: int, tooth: int) -> None:
    effect = EFFECTS["tooth_damage"]
    position = 2 * math.pi / count * tooth
    noise = np.random.default_rng(6).normal(0.0, NOISE, signals.size)
    error = effect.columns(signals, (member, position, 0.0)) @ [5e-5, 3e-5] + noise
    found = [at for kind, at, arc in effect.starts(signals, error).points if (kind, arc) == (member, 0.0)]
    assert min(abs(math.remainder(at - position, 2 * math.pi)) for at in found) < 1e-9


def test_standard_deviations_are_propagated() -> None:
    """Amplitude and direction of a cosine and sine part have deviations sigma and sigma / (k a)."""
    effect = EFFECTS["flexspline_pitch"]
    coefficients, _ = truth(effect)
    sigma = 1e-8
    found = effect.standard_deviations(coefficients, (0.0,), sigma**2 * np.eye(4))
    assert_allclose(found["pitch_2"], sigma, rtol=1e-6)
    assert_allclose(found["pitch_direction_2"], sigma / (2 * 2e-6), rtol=1e-6)
    assert_allclose(found["pitch_direction_4"], sigma / (4 * 2e-6), rtol=1e-6)


def test_a_pitch_error_under_a_preload_is_alike_under_any_torque(signals: Signals) -> None:
    """The same teeth are ahead as in the wave of the loaded pairs."""
    effect, contact = EFFECTS["flexspline_pitch"], signals.contact
    found, by_pairs = effect.columns(signals, (1.0,)), effect.columns(signals, (0.0,))
    waves = np.hstack([turning(order * signals.flexspline_angle) for order in (2, 4)])
    behind = contact.drive.frame.torque_sign / contact.drive.mesh.geometry.curve.radius
    assert_allclose(found, behind * waves, atol=1e-9)
    for own, other in zip(found.T[:2], by_pairs.T[:2], strict=True):
        assert np.corrcoef(own, other)[0, 1] > 0.3


def test_lines_of_an_output_encoder_are_a_multiple_of_four(signals: Signals) -> None:
    """Odd orders per output turn have no name, and neither have their side lobes."""
    effect, turn = EFFECTS["output_encoder_interpolation"], 2.0 * np.pi * np.linspace(0.0, 0.8, 8000)
    moved = at(signals, np.arange(8000) * 0.01, output_angle=turn, speed=np.full(8000, 2.0))

    def found(lines: float) -> set[float]:
        return {lines for (lines,) in effect.starts(moved, np.cos(lines * turn)).points}

    assert 128.0 in found(128.0)
    assert not found(337.0) & {332.0, 336.0, 340.0}


def test_an_encoder_s_lines_are_looked_for_where_samples_show_them(signals: Signals) -> None:
    """In fast motion 128 lines turn by a whole period per sample, so they look like a constant."""
    effect = EFFECTS["output_encoder_interpolation"]
    speed = np.repeat([1.0, 100.0 * 2.0 * np.pi / 128.0 / 0.01], 4000)
    turn = np.cumsum(speed) * 0.01 / 100.0
    moved = at(signals, np.arange(8000) * 0.01, output_angle=turn, speed=speed)
    shown = effect.shown(moved, effect.columns(moved, (128.0,)), (128.0,))
    assert np.array_equal(np.any(shown != 0.0, axis=1), speed == 1.0)
    rest = 1e-6 * np.cos(64.0 * turn) + np.where(speed > 1.0, 1e-4, 0.0)
    assert effect.starts(moved, rest).points[0] == (64.0,)


@pytest.mark.parametrize(
    ("name", "coefficients", "nonlinear", "itself"),
    [
        ("hysteresis", (2e-5, 1e-5), (), True),
        ("hysteresis", (2e-5, -3e-6), (), True),
        ("hysteresis", (-1e-5, 2e-5), (), False),
        ("torsional_hardening", (1e-6, -2e-6), (9.0, 38.0, 0.1), True),
        ("torsional_hardening", (2e-4, -7e-4), (0.2, 48.0, 0.4), True),  # a smooth curve from two large parts
        ("torsional_hardening", (1e-6, 1e20), (9.0, 38.0, 0.1), False),
        ("torsional_hardening", (1e-6, 1e-2), (9.0, 400.0, 0.3), False),  # a knee beyond all torques
        ("coulomb_windup", (1.0,), (0.003, 0.1, 0.0, 10.0), True),
        ("coulomb_windup", (-1.0,), (0.003, 0.1, 0.0, 10.0), False),  # friction cannot drive
        ("viscous_windup", (1.0,), (0.75,), True),
        ("viscous_windup", (-1.0,), (0.75,), False),
        ("coupling_misalignment", (1e-3, 0.0, 3e-4), (1.0,), True),
        ("coupling_misalignment", (1e-3, 0.0, 0.0), (0.0,), True),
        ("coupling_misalignment", (1e-3, 0.0, -1e-4), (1.0,), False),  # so much play acts as friction
        ("coupling_misalignment", (1e-3, 0.0, 2e-3), (1.0,), False),
    ],
)
def test_what_is_another_cause(name: str, coefficients: tuple, nonlinear: tuple, itself: bool) -> None:
    assert EFFECTS[name].sensible(np.array(coefficients), nonlinear) is itself


def test_a_late_stream_does_not_average_the_input_s_counts(signals: Signals) -> None:
    """A delay by part of a sample could average the counts; lower noise would then falsely support it."""
    delay, late, step = EFFECTS["stream_delay"], np.array([4.5e-5]), 1.5e-5
    counted = dataclasses.replace(signals, output_angle=step * np.rint(signals.output_angle / step))
    error = counted.output_angle - signals.output_angle
    whole = delay.response(signals, late, ())
    live = by_run(counted, lambda run: delay.step(delay.start(()), run, late, ())[0])
    change = delay.response(counted, late, ()) - whole
    assert abs(np.mean(error * change)) < 0.1 * abs(np.mean(error * (live - whole)))


def test_a_late_output_is_not_interpolated_across_rows_left_out(signals: Signals) -> None:
    """At an isolated row, as between stretches of a long record, the delay acts to first order."""
    effect, coefficients = EFFECTS["stream_delay"], np.array([3e-4])
    alone, gap = signals.size // 2 + 700, 600
    kept = np.delete(np.arange(signals.size), np.r_[alone - gap : alone, alone + 1 : alone + gap])
    whole, some = (effect.response(one, coefficients, ()) for one in (signals, signals.part(kept)))
    assert_allclose(some, whole[kept], atol=0.5 * ARCSEC)
