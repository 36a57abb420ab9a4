"""The brute-force reference and the model give the published values."""

import dataclasses
from collections.abc import Callable

import drives
import numpy as np
import pytest
from numpy.testing import assert_allclose
from reference import polyline, published
from scipy.integrate import quad
from scipy.optimize import brentq

from hd_diag.model.load_sharing import mesh_state

Array = polyline.Array
LAST_FIGURE = 1e-9  # [m], of the printed backlash


def least_backlash(eccentricity: float, datum: float) -> tuple[float, int]:
    drive = dataclasses.replace(polyline.DEFAULT, circular_spline_datum=datum)
    mesh = polyline.mesh(**published.anchored(eccentricity)._asdict(), drive=drive)
    plus, minus = mesh.backlash[:, published.ENGAGEMENT_TEETH]
    least = np.fmin(plus, minus)
    return float(np.nanmin(least)), published.ENGAGEMENT_TEETH[int(np.nanargmin(least))]


def model_at_rest(eccentricity: float, torque: float) -> tuple[float, Array, Array]:
    """Torsion, backlash and loads (2, Z_R) of the model at angle 0, the eccentricity across the long axis."""
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
def test_backlash_torsion_and_loads(
    case: published.LoadCase, at_rest: Callable[[float, float], tuple[float, Array, Array]]
) -> None:
    beta, backlash, force = at_rest(case.eccentricity, case.torque)
    assert_allclose(beta, case.torsion, rtol=2e-3 if case.torsion < 1e-4 else 5e-4)
    assert tuple((force > 0).sum(axis=1)) == case.loaded
    if case.largest_force is not None:
        assert_allclose(force.max(), case.largest_force, atol=0.05)
    away = np.abs(backlash[0, published.BACKLASH_TEETH] - published.BACKLASH[case.eccentricity])
    assert np.all(away < np.where(np.array(published.BACKLASH_TEETH) == 180, 50e-9, LAST_FIGURE))


@pytest.mark.parametrize("at_rest", [model_at_rest, reference_at_rest])
def test_stiffness_is_the_catalogue_s(at_rest: Callable[[float, float], tuple[float, Array, Array]]) -> None:
    catalogue = (published.K1, published.K2, published.K3)
    for (spans, secant), k in zip(published.SECANT_STIFFNESS.items(), catalogue, strict=True):
        low, high = (at_rest(0.0, torque)[0] for torque in spans)
        found = (spans[1] - spans[0]) / (high - low)
        assert_allclose(found, secant, atol=0.05e4)
        assert_allclose(found, k, rtol=0.08)


def test_first_interference() -> None:
    e, rounded = published.ECCENTRICITY, polyline.DEFAULT.circular_spline_datum
    found = brentq(lambda datum: least_backlash(e, datum)[0], 29.867e-3, 29.869e-3, xtol=1e-10)
    assert_allclose(found, published.DATUM_OF_INTERFERENCE, atol=6e-9)
    assert round(found * 1e3, 3) == rounded * 1e3
    assert least_backlash(e, found)[1] == published.FIRST_TO_INTERFERE
    found = brentq(lambda e: least_backlash(e, rounded)[0], 0, 40e-6, xtol=1e-10)
    assert_allclose(found, published.ECCENTRICITY_AT_ROUNDED_DATUM, atol=0.01e-6)


@pytest.mark.slow
@pytest.mark.parametrize("turn", published.TURNS)
def test_one_tooth_at_the_passage_of_the_lobe(turn: published.Turn) -> None:
    angles = np.arange(*published.PASSAGE, 0.02)
    meshes = [polyline.mesh(angle, (turn.eccentricity, 0.0)) for angle in angles]
    force = [polyline.loads(m, polyline.torsion(m, published.RATED_TORQUE))[0, 0] for m in meshes]
    assert_allclose(max(force), turn.largest_force, atol=0.1)
    least = min(np.nanmin(m.backlash[:, 0], initial=np.inf) for m in meshes)
    assert_allclose(least, turn.least_backlash, atol=0.05e-6)


@pytest.mark.slow
def test_transmission_error_has_even_orders() -> None:
    angles = np.arange(24) * np.pi / 24
    meshes = [polyline.mesh(angle, (0.0, published.ECCENTRICITY)) for angle in angles]
    for torque, amplitude in published.ORDER_2_ARCSEC.items():
        te = np.degrees([-polyline.torsion(m, torque) for m in meshes]) * 3600
        order_2 = 2 / angles.size * abs(te @ np.exp(-2j * angles))
        assert_allclose(order_2, amplitude, atol=0.1)
        assert_allclose(np.ptp(te), published.PEAK_TO_PEAK_ARCSEC[torque], rtol=0.02)


def test_half_turn_moves_the_flexspline_by_one_tooth_and_mirror_exchanges_the_flanks() -> None:
    first, later = (polyline.mesh(angle, (5e-6, -8e-6)) for angle in (0.3, 0.3 + np.pi))
    assert_allclose(np.roll(later.backlash, -1, axis=1), first.backlash, atol=1e-12)
    mesh = polyline.mesh(0.7, (9e-6, 4e-6), runout=(1e-6, 2e-6), arc_offset=3e-6)
    mirror = polyline.mesh(-0.7, (9e-6, -4e-6), runout=(1e-6, -2e-6), arc_offset=-3e-6)
    assert_allclose(np.roll(mirror.backlash[::-1, ::-1], 1, axis=1), mesh.backlash, atol=1e-12)
    assert_allclose(polyline.torsion(mirror, -20.0), -polyline.torsion(mesh, 20.0), rtol=1e-9)


def test_common_slot_shift_turns_the_cup() -> None:
    plain = polyline.mesh(0.2)
    moved = polyline.mesh(0.2, slot_shift=np.full(202, 1e-6))
    near = np.abs(plain.backlash) < 20e-6
    change = (moved.backlash - plain.backlash)[near]
    assert_allclose(change, np.broadcast_to([[1e-6], [-1e-6]], near.shape)[near], atol=2e-9)


def test_neutral_curve_is_inextensible() -> None:
    drive = polyline.DEFAULT
    arc = np.linspace(0, 2 * np.pi * polyline.ring_radius(), 9)[:-1]
    point, normal = polyline.neutral_point(arc)
    t = np.unwrap(np.arctan2(point[1] / drive.semi_minor, point[0] / drive.semi_major))
    for end, length in zip(t, arc, strict=True):
        speed = lambda q: np.hypot(drive.semi_major * np.sin(q), drive.semi_minor * np.cos(q))  # noqa: E731
        assert_allclose(quad(speed, 0, end, epsabs=1e-15)[0], length, atol=1e-12)
    assert_allclose(np.hypot(*normal), 1, rtol=1e-14)


@pytest.mark.slow
def test_refinement_changes_nothing() -> None:
    coarse, fine = (polyline.mesh(0.9, (0.0, published.ECCENTRICITY), points=n) for n in (1600, 6400))
    assert_allclose(coarse.backlash, fine.backlash, atol=1e-9)
    assert_allclose(coarse.pressure_angle, fine.pressure_angle, atol=5e-4)
