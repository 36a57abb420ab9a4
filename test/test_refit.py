"""Refit of the model's own parameters on records of the independent generator."""

import dataclasses
import functools

import joint_records
import numpy as np
import pytest
from benches import CONFIGURED
from benches import POINT as TRUE
from challenge import families, motion
from challenge.records import Recording, simulate
from challenge.truth import Base, drawn
from joint_records import columns, prepared
from numpy.testing import assert_array_equal

from hd_diag.diagnosis.evidence.solution import Solution, parameters_of
from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.diagnosis.fit import refit as module
from hd_diag.diagnosis.fit.fit_parameters import swapped
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import linearise
from hd_diag.diagnosis.fit.refit import FEW_STARTS, distinct, nuisance, refit, usable
from hd_diag.diagnosis.record import Record

RNG = np.random.default_rng(0)


@functools.cache
def generated(seed: int) -> tuple[Record, Base]:
    """Two minutes at 100 Hz of a drive with wrong parameters, and its true parameters."""
    rng = families.generator("wrong_parameters", seed)
    made = simulate(drawn(rng), (), motion.standard(rng), rng, Recording(rate=100.0))
    return joint_records.generated(made), made.base


def away(point: np.ndarray, truth: Base) -> np.ndarray:
    displacements = np.array([truth.e, truth.runout]) * np.exp(1j * np.array([truth.psi, truth.runout_psi]))
    compliance = truth.compliance / CONFIGURED.mesh.tooth_compliance
    numbers = [*displacements.view(float), truth.datum, compliance, truth.cup]
    expected = np.array(numbers) / fit_parameters.units(CONFIGURED)
    return min((point - expected, point - swapped(expected)), key=lambda x: float(np.hypot(*x[:2])))


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_parameters_are_recovered(seed: int) -> None:
    record, truth = generated(seed)
    found = refit(record, CONFIGURED, RNG)
    assert found.trustworthy
    assert np.all(np.abs(away(found.parameters, truth)) < [1.0, 1.0, 2.0, 1.0, 3.0, 2.0, 0.5])
    point, covariance = parameters_of(Solution(settle(linearise(record, CONFIGURED, found.parameters), ())))
    off = away(point, truth)
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.diag(covariance)))
    assert off @ np.linalg.solve(covariance, off) < 31.0  # chi-square, 7 degrees of freedom, probability 6e-5


def test_gaps_of_the_reported_and_the_real_torque_are_left_out() -> None:
    record, _ = generated(3)
    kept, shifted = usable(record), usable(record, 4.0)
    assert 0.8 < kept.mean() < 1.0
    moving = usable(dataclasses.replace(record, has_torque=False))
    assert np.abs(record.torque[moving & ~kept]).max() < 1.0
    assert np.all(kept[shifted])
    left_out = record.torque[kept & ~shifted]
    assert left_out.size > 50
    assert np.all(np.abs(left_out + 4.0) < 1.0)
    ways = np.tile([4.0, -6.0, 0.0], (record.size, 1))
    assert_array_equal(usable(record, ways), shifted & usable(record, -6.0))


def test_a_torque_whose_noise_hides_its_sign_is_left_out() -> None:
    """On an unloaded joint noise decides the flank, and the residual there is not noise."""
    record, _ = generated(3)
    noise = 0.3 * np.random.default_rng(0).standard_normal(record.size)
    light = 0.01 * record.torque
    quiet = dataclasses.replace(record, torque=light, reported_torque=light)
    window = np.full(record.size, 0.11)
    noisy = dataclasses.replace(quiet, reported_torque=light + noise, torque_window=window)
    assert quiet.torque_deviation.max() == 0.0
    assert noisy.torque_deviation == pytest.approx(np.full(record.size, 0.3 * np.sqrt(1.75 / 11)), rel=0.05)
    left = usable(quiet) & ~usable(noisy)
    assert left.mean() > 0.1
    assert np.abs(light[left]).max() < 3.0 * noisy.torque_deviation[0]
    assert np.abs(light[usable(noisy)]).min() >= 3.0 * noisy.torque_deviation[0]
    nothing_but_noise = dataclasses.replace(noisy, torque=0.1 * light)
    assert usable(nothing_but_noise).mean() > 0.5


def test_a_constant_torque_that_a_shift_takes_away_keeps_its_rows() -> None:
    record, _ = generated(3)
    constant = dataclasses.replace(record, torque=np.full(record.size, 0.6))
    for shift in (-0.6, -0.599, 0.0, 5.0):
        assert_array_equal(usable(constant, shift), usable(constant))


def test_a_rest_is_left_out_unless_the_torque_goes_on() -> None:
    """An encoder repeats one count there: hundreds of samples are worth one."""
    record, _ = generated(3)
    time = np.arange(record.size) / 500.0
    moves = np.floor(time) % 2 == 0
    record = dataclasses.replace(record, time=time, speed=np.where(moves, 30.0, 0.0))
    still = dataclasses.replace(record, torque=np.full(record.size, 20.0))
    assert usable(still)[moves].all()
    assert 0.7 < np.mean(~usable(still)[~moves]) < 0.95
    assert usable(dataclasses.replace(record, torque=40.0 + 20.0 * np.sin(9.0 * time))).mean() > 0.9


def test_terms_that_a_record_does_not_excite_are_left_out() -> None:
    record, _ = generated(3)
    assert nuisance(record, 100.0).shape[1] == 6
    one_speed = dataclasses.replace(record, speed=np.full(record.size, 30.0), temperature=None)
    assert nuisance(one_speed, 100.0).shape[1] == 3
    small = dataclasses.replace(one_speed, input_angle=0.01 * record.input_angle)
    assert nuisance(small, 100.0).shape[1] == 1


POINT = fit_parameters.vector(CONFIGURED, CONFIGURED) + np.array([8.0, -5.0, 2.0, 1.0, 6.0, 0.7, 2.0])
FAR = POINT + np.array([0.0, 12.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_mirrored_drives_are_the_same() -> None:
    assert len(distinct([POINT, swapped(POINT), POINT])) == 1
    found = distinct([swapped(FAR), POINT, FAR, swapped(POINT)])
    assert [point.tolist() for point in found] == [swapped(FAR).tolist(), POINT.tolist()]
    assert distinct([]) == []


def test_drives_that_are_near_are_the_same() -> None:
    for step in np.diag(module._NEAR[: POINT.size]):
        assert len(distinct([POINT, POINT + 0.9 * step, swapped(POINT - 0.9 * step)])) == 1
        assert len(distinct([POINT, POINT + 1.1 * step])) == 2


SHORT = prepared(columns(seconds=8.0))
MINIMA = [(FAR, 5.0, False), (FAR, 11.9, False), (FAR, 12.1, True)]
SAME = [(swapped(POINT), 0.0, True), (POINT + 0.01, 0.0, True)]


@pytest.mark.parametrize("minimum", [*MINIMA, *SAME], ids=range(5))
def test_trust_is_lost_to_another_minimum_as_good(minimum: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    other, worse, trustworthy = minimum

    def fit(problem: module._Problem, point: np.ndarray, steps: int) -> tuple[np.ndarray, float]:
        reached, deviance = (other, 1000.0 + worse) if point[1] > 1.0 else (POINT, 1000.0)
        return np.append(reached, 0.0), deviance

    monkeypatch.setattr(module, "_levenberg", fit)
    found = refit(SHORT, CONFIGURED, RNG)
    assert found.trustworthy is trustworthy
    assert len(distinct([POINT, found.parameters])) == 1


def test_starts_of_either_lobe_end_in_the_same_drive() -> None:
    given, rest = (SHORT, CONFIGURED), {"starts": FEW_STARTS[:1]}
    found = [refit(*given, np.random.default_rng(0), start=at, **rest) for at in (TRUE, swapped(TRUE))]
    assert len(distinct([TRUE, *(one.parameters for one in found)])) == 1
    assert [one.trustworthy for one in found] == [True, True]
