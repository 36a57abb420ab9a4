"""The brute-force reference and the model reproduce the published values."""

from collections.abc import Callable

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose
from reference import polyline, published

from hd_diag.model.load_sharing import mesh_state

Array = polyline.Array
AtRest = Callable[[float, float], tuple[float, Array, Array]]


def model_at_rest(eccentricity: float, torque: float) -> tuple[float, Array, Array]:
    found = mesh_state(drives.mesh(eccentricity=(0.0, eccentricity)), np.zeros(1), np.array([torque]))
    return float(found.torsion[0]), found.backlash[0], found.load[0]


def reference_at_rest(eccentricity: float, torque: float) -> tuple[float, Array, Array]:
    mesh = polyline.mesh(0.0, (0.0, eccentricity))
    beta = polyline.torsion(mesh, torque)
    force = polyline.loads(mesh, beta)
    arm = np.nan_to_num(mesh.radius * np.cos(mesh.pressure_angle))
    assert_allclose((arm * force).sum(axis=1) @ [1, -1], torque, rtol=1e-9)
    return beta, mesh.backlash, force


@pytest.mark.parametrize("at_rest", [model_at_rest, reference_at_rest])
@pytest.mark.parametrize("case", published.LOAD_CASES)
def test_backlash_torsion_and_loads(case: published.LoadCase, at_rest: AtRest) -> None:
    beta, backlash, force = at_rest(case.eccentricity, case.torque)
    assert_allclose(beta, case.torsion, rtol=2e-3 if case.torsion < 1e-4 else 5e-4)
    assert tuple((force > 0).sum(axis=1)) == case.loaded
    if case.largest_force is not None:
        assert_allclose(force.max(), case.largest_force, atol=0.05)
    away = np.abs(backlash[0, published.BACKLASH_TEETH] - published.BACKLASH[case.eccentricity])
    assert np.all(away < np.where(np.array(published.BACKLASH_TEETH) == 180, 50e-9, 1e-9))  # the last digit


@pytest.mark.parametrize("at_rest", [model_at_rest, reference_at_rest])
def test_stiffness_is_the_catalogue_s(at_rest: AtRest) -> None:
    catalogue = (published.K1, published.K2, published.K3)
    for (spans, secant), k in zip(published.SECANT_STIFFNESS.items(), catalogue, strict=True):
        low, high = (at_rest(0.0, torque)[0] for torque in spans)
        found = (spans[1] - spans[0]) / (high - low)
        assert_allclose(found, secant, atol=0.05e4)
        assert_allclose(found, k, rtol=0.08)


def test_common_slot_shift_turns_the_cup() -> None:
    plain = polyline.mesh(0.2)
    moved = polyline.mesh(0.2, slot_shift=np.full(202, 1e-6))
    near = np.abs(plain.backlash) < 20e-6
    change = (moved.backlash - plain.backlash)[near]
    assert_allclose(change, np.broadcast_to([[1e-6], [-1e-6]], near.shape)[near], atol=2e-9)
