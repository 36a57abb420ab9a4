"""The model's parameters as numbers to fit: derivatives, symmetry, bounds, what people read."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joint_records import ARCSEC, joint
from numpy.testing import assert_allclose

from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.drive import transmission_error

CONFIGURED = joint().drive
MIRROR = fit_parameters.MIRRORED
POINT = fit_parameters.vector(CONFIGURED, CONFIGURED) + np.array([8.0, -5.0, 2.0, 1.0, 6.0, 0.7, 2.0])
DRIVE = fit_parameters.drive_of(POINT, CONFIGURED)
ANGLE, TORQUE = np.random.default_rng(0).uniform([[0.0], [-60.0]], [[60.0], [60.0]], (2, 400))
LONG_ANGLE = 40.0 * np.arange(21_000) / 500.0
LONG_TORQUE = 50.0 * np.sin(np.arange(21_000) / 500.0)


def error(point: np.ndarray, angle: np.ndarray = ANGLE, torque: np.ndarray = TORQUE) -> np.ndarray:
    return transmission_error(fit_parameters.drive_of(point, CONFIGURED), angle, torque)


def test_vector_and_drive_are_inverse() -> None:
    assert_allclose(fit_parameters.vector(DRIVE, CONFIGURED), POINT, rtol=1e-12)


def test_units_of_the_vector() -> None:
    assert DRIVE.mesh.eccentricity == pytest.approx(8e-6 - 5e-6j, rel=1e-12)
    assert DRIVE.mesh.runout == pytest.approx(2e-6 + 1e-6j, rel=1e-12)
    assert DRIVE.mesh.geometry.circular_spline_datum == pytest.approx(29.874e-3, rel=1e-12)
    assert DRIVE.mesh.tooth_compliance == pytest.approx(1.07e-6, rel=1e-12)
    assert DRIVE.cup_compliance == pytest.approx(2.0 * ARCSEC, rel=1e-12)


@pytest.mark.parametrize(
    "index", range(fit_parameters.COUNT), ids=[scale.name for scale in fit_parameters.SCALES]
)
def test_derivatives_are_finite_differences(index: int) -> None:
    """Piecewise smooth: in a step of 2e-3 units about one moment in a hundred gains or loses a contact."""
    step = np.zeros(fit_parameters.COUNT)
    step[index] = 1e-3
    difference = (error(POINT + step) - error(POINT - step)) / 2e-3
    value, jacobian, _ = fit_parameters.error_and_jacobian(DRIVE, CONFIGURED, ANGLE, TORQUE)
    assert_allclose(value, error(POINT), rtol=0, atol=1e-12)
    miss = np.abs(jacobian[:, index] - difference) / np.abs(difference).max()
    assert np.quantile(miss, 0.97) < 1e-5
    assert miss.max() < 0.05


def test_derivatives_along_a_long_record_are_the_exact_ones() -> None:
    """But for the step from node to node, in which pairs come into load."""
    _, exact, slope = fit_parameters.error_and_jacobian(DRIVE, CONFIGURED, LONG_ANGLE, LONG_TORQUE)
    _, found, found_slope = fit_parameters.along(DRIVE, CONFIGURED, LONG_ANGLE, LONG_TORQUE)
    for column, expected in zip((*found.T, found_slope), (*exact.T, slope), strict=True):
        assert np.std(column - expected) < 0.05 * np.std(expected)
        assert column @ expected / (expected @ expected) == pytest.approx(1.0, abs=0.005)


def test_slope_by_torque_is_a_finite_difference() -> None:
    loaded = np.abs(TORQUE) > 5.0
    angle, torque = ANGLE[loaded], TORQUE[loaded]
    _, _, slope = fit_parameters.along(DRIVE, CONFIGURED, ANGLE, TORQUE)
    difference = (error(POINT, angle, torque + 0.01) - error(POINT, angle, torque - 0.01)) / 0.02
    assert np.all(difference < 0.0)
    assert np.std(slope[loaded] - difference) < 0.05 * np.mean(np.abs(difference))


def test_half_a_turn_of_all_displacements_changes_nothing() -> None:
    """The two lobes change places."""
    assert_allclose(error(POINT * MIRROR), error(POINT), rtol=0, atol=1e-12)


def test_half_a_turn_is_told_as_the_same_drive() -> None:
    covariance = np.diag(np.arange(1.0, 8.0) ** 2) * 1e-2
    one, other = (fit_parameters.physical(p, covariance, CONFIGURED) for p in (POINT, POINT * MIRROR))
    assert one.keys() == other.keys()
    for name, value in one.items():
        assert other[name] == pytest.approx(value), name
    assert 0.0 <= one["eccentricity.direction"]["value"] < np.pi


def test_what_people_read() -> None:
    covariance = np.diag([0.3, 0.3, 0.2, 0.2, 1.0, 0.05, 0.5]) ** 2
    told = fit_parameters.physical(POINT, covariance, CONFIGURED)
    size = np.hypot(8.0, 5.0)
    assert told["eccentricity.magnitude"] == pytest.approx(
        {"value": size * 1e-6, "std": 0.3e-6, "unit": "m", "configured": 0.0}
    )
    assert told["eccentricity.direction"]["value"] == pytest.approx(np.pi - np.arctan2(5.0, 8.0))
    assert told["eccentricity.direction"]["std"] == pytest.approx(0.3 / size)
    assert told["circular_spline_datum"] == pytest.approx(
        {"value": 29.874e-3, "std": 1e-6, "unit": "m", "configured": 29.868e-3}
    )
    assert told["tooth_compliance"] == pytest.approx(
        {"value": 1.07e-6, "std": 0.005e-6, "unit": "m/N", "configured": 1e-6}
    )
    assert told["cup_compliance"]["value"] == pytest.approx(2.0 * ARCSEC)


def test_a_direction_of_nothing_is_not_known() -> None:
    point = fit_parameters.vector(CONFIGURED, CONFIGURED)
    point[:4] = 1e-3
    told = fit_parameters.physical(point, np.eye(fit_parameters.COUNT), CONFIGURED)
    assert told["eccentricity.direction"]["std"] == pytest.approx(np.pi / np.sqrt(12.0))


@given(st.lists(st.floats(-1e5, 1e5), min_size=fit_parameters.COUNT, max_size=fit_parameters.COUNT))
def test_any_step_ends_in_a_drive(values: list[float]) -> None:
    point = fit_parameters.admissible(np.array(values), CONFIGURED)
    assert_allclose(fit_parameters.admissible(point, CONFIGURED), point, rtol=1e-12)
    assert np.hypot(*point[:2]) < 45.1
    assert fit_parameters.drive_of(np.array(values), CONFIGURED).mesh.tooth_compliance > 0.0


def test_a_long_record_is_solved_at_nodes() -> None:
    """To 0.02 arcsec."""
    exact = transmission_error(DRIVE, LONG_ANGLE, LONG_TORQUE)
    away = fit_parameters.along(DRIVE, CONFIGURED, LONG_ANGLE, LONG_TORQUE)[0] - exact
    loaded = np.abs(LONG_TORQUE) > 0.5
    assert 0.0 < np.sqrt(np.mean(away[loaded] ** 2)) < 0.02 * ARCSEC
    few = fit_parameters.along(DRIVE, CONFIGURED, LONG_ANGLE[:500], LONG_TORQUE[:500])[0]
    assert_allclose(few, exact[:500], rtol=0, atol=1e-14)


def test_without_torque_the_gap_s_middle_counts() -> None:
    nothing = np.zeros(LONG_ANGLE.size)
    exact = transmission_error(DRIVE, LONG_ANGLE, nothing)
    assert np.std(fit_parameters.along(DRIVE, CONFIGURED, LONG_ANGLE, nothing)[0] - exact) < 0.05 * ARCSEC
