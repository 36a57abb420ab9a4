"""The refit of the model's own parameters, on records of the independent generator."""

import dataclasses

import numpy as np
import pytest
from challenge import families, motion
from challenge.records import Recording, simulate
from challenge.truth import Base, drawn
from joint_records import joint

from hd_diag.criticism import base
from hd_diag.criticism.record import Record, prepare
from hd_diag.criticism.refit import nuisance, refit, usable
from hd_diag.criticism.search import Search, parameters_of
from hd_diag.criticism.workbench import Workbench, settle

CONFIGURED = joint().drive
MIRROR = np.array([-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0])


def generated(seed: int) -> tuple[Record, Base]:
    """Two minutes at 100 Hz of a drive with wrong parameters, and the truth."""
    rng = families.generator("wrong_parameters", seed)
    made = simulate(drawn(rng), (), motion.standard(rng), rng, Recording(rate=100.0))
    bag = np.zeros(made.time.size, dtype=np.int64)
    columns = (made.time, made.input_angle, made.output_angle, made.torque, made.temperature)
    return prepare(*columns, bag, 100.0), made.base


def true_vector(truth: Base) -> np.ndarray:
    eccentricity, runout = truth.e * np.exp(1j * truth.psi), truth.runout * np.exp(1j * truth.runout_psi)
    numbers = [eccentricity.real, eccentricity.imag, runout.real, runout.imag, truth.datum]
    compliance = truth.compliance / CONFIGURED.mesh.tooth_compliance
    return np.array([*numbers, compliance, truth.cup]) / [scale.si for scale in base.SCALES]


def away(point: np.ndarray, truth: Base) -> np.ndarray:
    """Difference from the truth, lobes swapped or not."""
    expected = true_vector(truth)
    return min((point - expected, point - MIRROR * expected), key=lambda x: float(np.hypot(*x[:2])))


@pytest.mark.parametrize("seed", [3, 4])
def test_parameters_are_recovered(seed: int) -> None:
    """The right minimum at once; within four standard deviations when the noise is known."""
    record, truth = generated(seed)
    found = refit(record, CONFIGURED)
    assert found.trustworthy
    assert np.all(np.abs(away(found.parameters, truth)) < [1.0, 1.0, 2.0, 1.0, 3.0, 2.0, 0.5])
    point, covariance = parameters_of(Search(settle(Workbench(record, CONFIGURED, found.parameters), ()), ()))
    off = away(point, truth)
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.diag(covariance)))
    assert off @ np.linalg.solve(covariance, off) < 31.0  # chi-square, 7 degrees of freedom, 6e-5


def test_a_true_gap_is_left_out() -> None:
    record, _ = generated(3)
    kept = usable(record)
    assert 0.8 < kept.mean() < 1.0
    assert np.abs(record.torque[~kept]).max() < 1.0
    assert usable(dataclasses.replace(record, has_torque=False)).all()


def test_terms_that_a_record_does_not_excite_are_left_out() -> None:
    record, _ = generated(3)
    assert nuisance(record, 100.0).shape[1] == 6
    one_speed = dataclasses.replace(record, speed=np.full(record.size, 30.0), temperature=None)
    small = dataclasses.replace(one_speed, input_angle=0.01 * record.input_angle)
    assert nuisance(one_speed, 100.0).shape[1] == 3
    assert nuisance(small, 100.0).shape[1] == 1
