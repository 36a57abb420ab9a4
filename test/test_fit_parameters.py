"""The model's parameters as fit variables: derivatives, symmetry, bounds, and values for people."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from joint_records import ARCSEC, joint
from numpy.testing import assert_allclose

from hd_diag.diagnosis.fit import fit_parameters
from hd_diag.drive import Drive, transmission_error

Array = np.ndarray
CONFIGURED = joint().drive
PARAMETERS = fit_parameters.count(CONFIGURED)
RING = joint(face_width=11e-3, sections=3).drive
CUP = joint(face_width=11e-3, cup_length=40e-3, sections=3).drive
ASTRAY = np.array([8.0, -5.0, 2.0, 1.0, 6.0, 0.7, 2.0, 5.0, 8.0])


def astray(configured: Drive) -> Array:
    point = fit_parameters.vector(configured, configured)
    return point + ASTRAY[: point.size]


POINT = astray(CONFIGURED)
DRIVE = fit_parameters.drive_of(POINT, CONFIGURED)
ANGLE, TORQUE = np.random.default_rng(0).uniform([[0.0], [-60.0]], [[60.0], [60.0]], (2, 400))
LONG_ANGLE = 40.0 * np.arange(21_000) / 500.0
LONG_TORQUE = 50.0 * np.sin(np.arange(21_000) / 500.0)


def error(point: Array, angle: Array = ANGLE, torque: Array = TORQUE, drive: Drive = CONFIGURED) -> Array:
    return transmission_error(fit_parameters.drive_of(point, drive), angle, torque)


def test_vector_and_drive_are_inverse_with_these_units() -> None:
    assert_allclose(fit_parameters.vector(DRIVE, CONFIGURED), POINT, rtol=1e-12)
    assert DRIVE.mesh.eccentricity == pytest.approx(8e-6 - 5e-6j, rel=1e-12)
    assert DRIVE.mesh.runout == pytest.approx(2e-6 + 1e-6j, rel=1e-12)
    assert DRIVE.mesh.geometry.circular_spline_datum == pytest.approx(29.874e-3, rel=1e-12)
    assert DRIVE.mesh.tooth_compliance == pytest.approx(1.07e-6, rel=1e-12)
    assert DRIVE.cup_compliance == pytest.approx(2.0 * ARCSEC, rel=1e-12)


@pytest.mark.parametrize(
    ("configured", "index"),
    [(CONFIGURED, index) for index in range(PARAMETERS)] + [(CUP, index) for index in (0, 3, 7, 8)],
)
def test_derivatives_are_finite_differences(configured: Drive, index: int) -> None:
    """The error is piecewise smooth: over a step of 2e-3 units, 1 % of the moments gain or lose a contact."""
    point = astray(configured)
    step = np.zeros(point.size)
    step[index] = 1e-3
    ends = (error(point + side * step, drive=configured) for side in (1.0, -1.0))
    difference = np.subtract(*ends) / 2e-3
    drive = fit_parameters.drive_of(point, configured)
    value, jacobian, _ = fit_parameters.along(drive, configured, ANGLE, TORQUE, 10**6)
    assert_allclose(value, error(point, drive=configured), rtol=0, atol=1e-12)
    miss = np.abs(jacobian[:, index] - difference) / np.abs(difference).max()
    assert np.quantile(miss, 0.97) < 1e-5
    assert miss.max() < 0.05


def test_a_long_record_is_solved_at_nodes() -> None:
    """The nodes are a quarter of a tooth apart; slopes jump where pairs come into load."""
    error, exact, slope = fit_parameters.along(DRIVE, CONFIGURED, LONG_ANGLE, LONG_TORQUE, 10**6)
    value, found, found_slope = fit_parameters.along(DRIVE, CONFIGURED, LONG_ANGLE, LONG_TORQUE)
    loaded = np.abs(LONG_TORQUE) > 0.5
    assert 0.0 < np.sqrt(np.mean((value - error)[loaded] ** 2)) < 0.02 * ARCSEC
    for column, expected in zip((*found.T, found_slope), (*exact.T, slope), strict=True):
        assert np.std(column - expected) < 0.1 * np.std(expected)
        assert column @ expected / (expected @ expected) == pytest.approx(1.0, abs=0.005)
    # Without torque the error is the middle of the gap.
    middle = transmission_error(DRIVE, LONG_ANGLE, 0.0 * LONG_TORQUE)
    idle = fit_parameters.along(DRIVE, CONFIGURED, LONG_ANGLE, 0.0 * LONG_TORQUE)[0]
    assert np.std(idle - middle) < 0.05 * ARCSEC


def test_slope_by_torque_is_a_finite_difference() -> None:
    loaded = np.abs(TORQUE) > 5.0
    angle, torque = ANGLE[loaded], TORQUE[loaded]
    _, _, slope = fit_parameters.along(DRIVE, CONFIGURED, ANGLE, TORQUE)
    difference = (error(POINT, angle, torque + 0.01) - error(POINT, angle, torque - 0.01)) / 0.02
    assert np.all(difference < 0.0)
    assert np.std(slope[loaded] - difference) < 0.05 * np.mean(np.abs(difference))


@pytest.mark.parametrize("configured", [CONFIGURED, CUP, RING], ids=["plane", "cup", "ring"])
def test_displacements_that_are_turned_are_the_same_drive(configured: Drive) -> None:
    """A half turn of all displacements gives the same drive; in a ring, so does one of the tilt alone."""
    point = astray(configured)
    covariance = np.diag(np.arange(1.0, 1.0 + point.size) ** 2) * 1e-2
    plain = fit_parameters.physical(point, covariance, configured)
    for other in fit_parameters.alike(point, configured):
        own = error(other, drive=configured)
        assert_allclose(own, error(point, drive=configured), rtol=0, atol=1e-12)
        told = fit_parameters.physical(other, covariance, configured)
        assert told.keys() == plain.keys()
        for name, value in plain.items():
            assert told[name] == pytest.approx(value), name
    assert len(fit_parameters.alike(point, configured)) == (4 if configured is RING else 2)
    assert 0.0 <= plain["eccentricity.direction"]["value"] < np.pi


@pytest.mark.parametrize(
    ("name", "value", "std", "unit", "configured"),
    [
        ("eccentricity.magnitude", np.hypot(8.0, 5.0) * 1e-6, 0.3e-6, "m", 0.0),
        ("eccentricity.direction", np.pi - np.arctan2(5.0, 8.0), 0.3 / np.hypot(8.0, 5.0), "rad", 0.0),
        ("circular_spline_datum", 29.874e-3, 1e-6, "m", 29.868e-3),
        ("tooth_compliance", 1.07e-6, 0.005e-6, "m/N", 1e-6),
        ("cup_compliance", 2.0 * ARCSEC, 0.5 * ARCSEC, "rad/(N m)", 0.0),
    ],
)
def test_what_people_read(name: str, value: float, std: float, unit: str, configured: float) -> None:
    covariance = np.diag([0.3, 0.3, 0.2, 0.2, 1.0, 0.05, 0.5]) ** 2
    told = {"value": value, "std": std, "unit": unit, "configured": configured}
    assert fit_parameters.physical(POINT, covariance, CONFIGURED)[name] == pytest.approx(told)


def test_a_direction_of_nothing_is_not_known() -> None:
    point = np.array([1e-3] * 4 + [0.0] * 3) + fit_parameters.vector(CONFIGURED, CONFIGURED)
    told = fit_parameters.physical(point, np.eye(PARAMETERS), CONFIGURED)
    assert told["eccentricity.direction"]["std"] == pytest.approx(np.pi / np.sqrt(12.0))


SHORT = joint(face_width=11e-3, cup_length=16e-3, sections=5).drive


@given(st.lists(st.floats(-1e5, 1e5), min_size=9, max_size=9), st.sampled_from([CONFIGURED, CUP, SHORT]))
def test_any_step_ends_in_a_drive(values: list[float], configured: Drive) -> None:
    given_ = np.array(values)[: fit_parameters.count(configured)]
    point = fit_parameters.admissible(given_, configured)
    assert_allclose(fit_parameters.admissible(point, configured), point, rtol=1e-12)
    assert np.hypot(*point[:2]) < 45.1
    assert fit_parameters.drive_of(given_, configured).mesh.tooth_compliance > 0.0


@pytest.mark.parametrize("scale", [0.32, 0.56, 2.0])
@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_bounds_go_with_the_module(scale: float, end: float) -> None:
    """At every bound a small or large gear stays valid; in its own units it equals any other."""
    own = scaled(CONFIGURED, scale)
    assert fit_parameters.units(own)[:5] == pytest.approx(scale * fit_parameters.units(CONFIGURED)[:5])
    assert fit_parameters.vector(own, own) == pytest.approx(fit_parameters.vector(CONFIGURED, CONFIGURED))
    far = fit_parameters.vector(own, own) + end * 1e6
    drive = fit_parameters.drive_of(far, own)
    assert abs(drive.mesh.eccentricity) == pytest.approx(scale * 45e-6)
    assert fit_parameters.at_bound(fit_parameters.vector(drive, own), own)[:5] == (0, 1, 2, 3, 4)
    away = abs(drive.mesh.geometry.circular_spline_datum - own.mesh.geometry.circular_spline_datum)
    assert 0.0 < away <= scale * 45.1e-6


def scaled(drive: Drive, scale: float) -> Drive:
    def larger(part: Any) -> Any:
        if isinstance(part, tuple):
            return tuple(scale * value for value in part)
        if not dataclasses.is_dataclass(part):
            return scale * part if isinstance(part, float) else part
        parts = {one.name: larger(getattr(part, one.name)) for one in dataclasses.fields(part)}
        return dataclasses.replace(part, **parts)

    mesh = dataclasses.replace(drive.mesh, geometry=larger(drive.mesh.geometry))
    return dataclasses.replace(drive, mesh=mesh)
