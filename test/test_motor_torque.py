"""Torque from motor current: the motor's own torque is fitted with the parameters, then subtracted."""

import dataclasses

import numpy as np
import pytest
from benches import CONFIGURED, POINT, swinging
from joint_records import ARCSEC
from numpy.testing import assert_allclose

from hd_diag.arrays import Floats
from hd_diag.diagnosis.diagnosis import Diagnosis, diagnose
from hd_diag.diagnosis.evidence.search import begun
from hd_diag.diagnosis.evidence.sets import Remainders, Set
from hd_diag.diagnosis.fit.fit_parameters import DATUM, swapped
from hd_diag.diagnosis.fit.joint_refinement import settle
from hd_diag.diagnosis.fit.linearised_fit import LinearisedFit
from hd_diag.diagnosis.fit.motor_torque import less_motor
from hd_diag.diagnosis.fit.refit import Refit
from hd_diag.diagnosis.record import Record
from hd_diag.diagnosis.verdict import as_json
from hd_diag.diagnosis.work import Work
from hd_diag.effects import CATALOGUE


def friction(record: Record) -> Floats:
    """Dry, load-dependent and viscous friction [N m]."""
    speed = np.gradient(record.input_angle, record.time)
    dry = (5.0 + 0.08 * np.abs(record.torque)) * np.tanh(speed / 0.6)
    return dry + 4.0 * np.sign(speed) * np.abs(speed / 100.0) ** 0.8


def reporting(torque: Floats, is_declared: bool = False) -> Record:
    """The record with another reported torque."""
    return dataclasses.replace(swinging(), torque=torque, reported_torque=torque, by_current=is_declared)


def by_current(is_declared: bool = True) -> Record:
    """Current times a constant 15 % too small, with friction and inertia of the motor."""
    record = swinging()
    moved = 2.0 * np.gradient(np.gradient(record.input_angle, record.time), record.time) / 100.0
    return reporting((record.torque + friction(record) + moved) / 1.15, is_declared)


@pytest.fixture(scope="module")
def found() -> tuple[LinearisedFit, Refit]:
    record = by_current()
    rows = np.ones(record.size, dtype=np.bool_)
    return less_motor(record, CONFIGURED, rows, np.random.default_rng(0), CATALOGUE, Work())


def off(torque: np.ndarray) -> float:
    """Rms [N m] of a torque's deviation from the link's torque times a factor, open by stiffness."""
    link = swinging().torque
    return float(np.std(torque - link * (link @ torque) / (link @ link)))


def test_the_torque_that_is_left_is_the_link_s(found: tuple[LinearisedFit, Refit]) -> None:
    fit, first = found
    source = fit.data.source
    assert off(source.by_sensor) > 3.0
    assert off(source.torque) < 0.3
    assert first.trustworthy
    lobes = first.parameters, swapped(first.parameters)
    near = min(lobes, key=lambda point: abs(point - POINT)[0])
    assert np.abs(near - POINT)[:4].max() < 1.5
    assert near[DATUM] == pytest.approx(POINT[DATUM], abs=1.5)


def test_the_same_model_about_either_torque(found: tuple[LinearisedFit, Refit]) -> None:
    """The motor's own torque is either subtracted from the record or a present effect: same error."""
    fit, _ = found
    source = fit.data.source
    reported = dataclasses.replace(source, torque=source.by_sensor, taken=None)
    model = dataclasses.replace(fit.data.model, record=reported)
    other = dataclasses.replace(fit, data=dataclasses.replace(fit.data, model=model))
    given = fit.data.given
    both = [one.data.source.torque + one.effects.torque(one.present) for one in (fit, other)]
    assert_allclose(*both, atol=1e-9)
    rest = [one.effects.uncorrected - one.effects.together(one.present) for one in (fit, other)]
    assert np.std(rest[0] - rest[1]) < 0.05 * ARCSEC
    assert other.recentred().data.source.torque == pytest.approx(source.torque, abs=1e-9)
    assert fit.recentred() is fit
    assert fit.with_noise(given).cost(given) == pytest.approx(other.with_noise(given).cost(given), rel=0.05)


def test_a_step_that_leads_away_is_not_taken(found: tuple[LinearisedFit, Refit]) -> None:
    """From far away, full steps of parameters and friction together reach the minimum only by chance."""
    fit, _ = found
    given = fit.data.given
    far = fit.moved(fit.parameters + np.array([6.0, -6.0, 0.0, 3.0, 14.0, 0.0, 0.0])).with_noise(given)
    costs = [far.cost(given)]
    for _ in range(4):
        far = settle(far, given, rounds=1, learn=False)
        costs.append(far.cost(given))
    assert costs[-1] < 0.1 * costs[0]
    assert (np.diff(costs) <= 1e-3 * costs[-1]).all()


def test_what_a_motor_takes_is_looked_for_from_nothing_as_well(found: tuple[LinearisedFit, Refit]) -> None:
    """Several minima exist: the search also starts without motor torque, so a poor start is no trap."""
    fit = found[0].with_noise(found[0].data.given)
    ((item, _),) = fit.present
    poor = fit.beside(((item, np.array([-0.5, 0.0, 0.3, 10.0, -5.0])),))
    there = Set(poor, Remainders.of(fit.data.source, CONFIGURED, 1e-5), (), fit.data.given)
    assert begun(poor).value > there.valued().settled().polished(5).value + 100.0


def judged(record: Record) -> Diagnosis:
    return diagnose(record, CONFIGURED, np.random.default_rng(0), Work(0.0))


def test_a_current_that_nobody_declared_is_recognised() -> None:
    found = judged(by_current(is_declared=False))
    assert found.record.by_current
    assert found.record.undeclared
    said = as_json(found, "elbow")
    assert (
        "the torque is a motor's current (the record shows it; give the signal the unit A" in said["verdict"]
    )
    assert said["motor_current"]["friction"]["value"] == pytest.approx(5.0, rel=0.3)
    declared = judged(by_current())
    assert "the record shows it" not in as_json(declared, "elbow")["verdict"]


def test_friction_of_the_joint_is_not_the_motor_s() -> None:
    """The mesh bears this friction beside the reported torque, so its sign is the other one."""
    record = swinging()
    found = judged(reporting(record.torque - friction(record)))
    assert not found.record.by_current
    assert not judged(record).record.by_current
