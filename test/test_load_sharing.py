"""Load distribution: exact solution of a rising piecewise-linear function."""

import dataclasses

import drives
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from reference import polyline, published

from hd_diag.model.clearance import Contact
from hd_diag.model.load_sharing import (
    LoadSharing,
    flank_stiffness,
    share_load,
    torque_curve,
    torsion,
)
from hd_diag.model.torsion import Mesh

pytestmark = pytest.mark.usefixtures("solver")
Array = polyline.Array
SIDE = np.array([1.0, -1.0])[:, None]
COMPLIANCE = drives.PAPER.tooth_compliance
# Misplaced against each other: in preload at zero torque, and nearly so.
MESHES = {
    "aligned": drives.mesh(),
    "10 um": drives.mesh(eccentricity=(6e-6, 8e-6)),
    "23 um": drives.mesh(eccentricity=(0.0, published.ECCENTRICITY), runout=(2e-6, 0.0)),
}
ANGLES = np.linspace(0.05, 6.2, 9)


def shared(mesh: Mesh, torque: float, angle: Array = ANGLES) -> tuple[Contact, LoadSharing]:
    contact = mesh.contacts(angle)
    return contact, mesh.share_load(contact, np.full(angle.size, torque))


def arm(contact: Contact) -> Array:
    return np.nan_to_num(contact.radius * np.cos(contact.pressure_angle))


# Published values, reference ---


@pytest.mark.parametrize("case", published.LOAD_CASES)
def test_published_load_cases(case: published.LoadCase) -> None:
    _, found = shared(drives.mesh(eccentricity=(0.0, case.eccentricity)), case.torque, np.zeros(1))
    assert_allclose(found.torsion[0], case.torsion, rtol=2e-3 if case.torsion < 1e-4 else 5e-4)
    assert tuple(found.loaded_pairs[0]) == case.loaded
    if case.largest_force is not None:
        assert_allclose(found.force.max(), case.largest_force, atol=0.05)


@pytest.mark.parametrize("drive", drives.DRIVES.values(), ids=drives.DRIVES)
@pytest.mark.parametrize("torque", [-41.0, 0.0, 0.3, 56.0])
def test_reference(drive: polyline.Drive, torque: float) -> None:
    moment = {"eccentricity": (7e-6, -11e-6), "runout": (2e-6, 3e-6), "arc_offset": 5e-6}
    expected = polyline.mesh(0.7, **moment, drive=drive)
    contact, found = shared(drives.mesh(drive, **moment), torque, np.array([0.7]))
    beta = polyline.torsion(expected, torque, drive)
    # Backlash is 0.3 nm apart, the lever arms as far as the polylines' smoothed tangents.
    assert_allclose(found.torsion[0], beta, rtol=1e-4, atol=1e-8)
    force = polyline.loads(expected, beta, drive)[:, contact.teeth[0]]
    assert_allclose(found.force[0], force, rtol=2e-3, atol=0.01)


# Laws ---


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("torque", [-80.0, -1.0, 0.0, 1e-6, 7.0, 56.0, 300.0])
def test_forces_hold_the_torque(mesh: Mesh, torque: float) -> None:
    contact, found = shared(mesh, torque)
    moment = (SIDE * arm(contact) * found.force).sum(axis=(1, 2))
    scale = (arm(contact) * found.force).sum(axis=(1, 2)).max()
    assert_allclose(moment, torque, rtol=0, atol=1e-12 * max(scale, 1))


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_a_flank_bears_load_where_the_torsion_exceeds_its_clearance(mesh: Mesh) -> None:
    contact, found = shared(mesh, 20.0)
    beyond = np.nan_to_num(SIDE * found.torsion[:, None, None] - contact.rotation, nan=-1.0)
    assert_allclose(found.force, arm(contact) * np.maximum(beyond, 0) / COMPLIANCE, rtol=1e-13)
    assert_array_equal(found.force > 0, beyond > 0)
    assert_array_equal(found.loaded_pairs, (found.force > 0).sum(axis=2))


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("torque", [-56.0, 0.7, 20.0])
def test_stiffness_is_the_slope(mesh: Mesh, torque: float) -> None:
    step = 1e-7  # [N m], over which no further flank comes into load here
    (_, low), (_, found), (_, high) = (shared(mesh, torque + s) for s in (-step, 0, step))
    assert_allclose(2 * step / (high.torsion - low.torsion), found.stiffness, rtol=1e-4)


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_weights_share_a_common_shift(mesh: Mesh) -> None:
    """Slots turned by d, all b+ grow and all b- shrink by it: the cup turns by d."""
    _, found = shared(mesh, -13.0)
    assert_allclose((SIDE * found.weight).sum(axis=(1, 2)), 1, rtol=1e-13)
    assert np.all(SIDE * found.weight >= 0)
    assert_array_equal(found.weight != 0, found.force > 0)


@pytest.mark.parametrize("torque", [0.0, 30.0])
def test_weights_are_the_derivatives_by_each_clearance(torque: float) -> None:
    contact, found = shared(MESHES["23 um"], torque, np.array([0.4]))
    step = 1e-10  # [rad], 3 nm; a flank within that of contact is in doubt
    beyond = SIDE * found.torsion[0] - contact.rotation[0]
    for flank in [tuple(index) for index in np.argwhere(np.abs(beyond) > 10 * step)]:
        beta = []
        for shift in (step, -step):
            rotation = contact.rotation.copy()
            rotation[(0, *flank)] += shift
            moved = dataclasses.replace(contact, rotation=rotation)
            beta.append(share_load(moved, COMPLIANCE, np.array([torque])).torsion[0])
        assert_allclose((beta[0] - beta[1]) / (2 * step), found.weight[(0, *flank)], rtol=1e-4, atol=1e-7)


def test_stiffness_of_a_flank(paper_mesh: Mesh) -> None:
    contact = paper_mesh.contacts(ANGLES)
    found = flank_stiffness(contact, COMPLIANCE)
    assert_array_equal(found == 0, np.isnan(contact.rotation))
    assert_allclose(found, arm(contact) ** 2 / COMPLIANCE, rtol=1e-14)
    assert_allclose(flank_stiffness(contact, 4 * COMPLIANCE), found / 4, rtol=1e-15)


# Lost motion ---


def test_the_middle_of_a_true_gap_at_zero_torque(paper_mesh: Mesh) -> None:
    contact, found = shared(paper_mesh, 0.0)
    first_plus, first_minus = (np.nanmin(contact.rotation[:, side], axis=1) for side in (0, 1))
    assert np.all(first_plus > 0)
    assert_allclose(found.lost_motion, first_plus + first_minus, rtol=1e-14)
    assert_allclose(found.torsion, (first_plus - first_minus) / 2, rtol=0, atol=1e-19)
    assert np.all(found.force == 0)
    for sign in (1, -1):
        _, beside = shared(paper_mesh, sign * 1e-9)
        assert_allclose(beside.torsion - found.torsion, sign * found.lost_motion / 2, rtol=1e-6)


def test_lobes_in_preload_have_no_lost_motion() -> None:
    contact, found = shared(MESHES["23 um"], 0.0)
    assert np.all(found.lost_motion == 0)
    plus, minus = np.moveaxis((arm(contact) * found.force).sum(axis=2), 1, 0)
    assert np.all(plus > 0)
    assert_allclose(plus, minus, rtol=1e-12, atol=1e-11)


# Any flanks at all ---

flanks = arrays(np.float64, (2, 6), elements=st.floats(-1e-3, 1e-3) | st.just(np.nan))
stiffnesses = arrays(np.float64, (2, 6), elements=st.floats(10.0, 1e4))


def held(rotation: Array, stiffness: Array, beta: float) -> float:
    beyond = np.nan_to_num(SIDE * beta - rotation, nan=-1.0)
    return float((SIDE * stiffness * np.maximum(beyond, 0)).sum())


def curve_of(rotation: Array, stiffness: Array) -> tuple[Array, Array]:
    return rotation[None], np.where(np.isnan(rotation), 0.0, stiffness)[None]


@given(flanks, stiffnesses, st.floats(-100.0, 100.0))
@settings(max_examples=200)
def test_torsion_holds_the_torque(rotation: Array, stiffness: Array, torque: float) -> None:
    beta = torsion(torque_curve(*curve_of(rotation, stiffness)), np.array([torque]))[0, 0]
    if np.isnan(beta):
        sides = {1: (0,), 0: (0, 1), -1: (1,)}[int(np.sign(torque))]
        assert any(np.isnan(rotation[side]).all() for side in sides)
        return
    scale = stiffness.sum() * 1e-3 + abs(torque)
    assert_allclose(held(rotation, stiffness, beta), torque, rtol=0, atol=1e-12 * scale)


@given(flanks, stiffnesses)
@settings(max_examples=100)
def test_torsion_rises_with_torque(rotation: Array, stiffness: Array) -> None:
    torque = np.array([-50.0, -3.0, -1e-3, -1e-9, 0.0, 1e-9, 1e-3, 3.0, 50.0])
    beta = torsion(torque_curve(*curve_of(rotation, stiffness)), torque)[0]
    step = np.diff(beta[~np.isnan(beta)])
    assert np.all(step >= -1e-15)


@given(flanks, stiffnesses)
@settings(max_examples=100)
def test_curve_rises_through_its_breakpoints(rotation: Array, stiffness: Array) -> None:
    curve = torque_curve(*curve_of(rotation, stiffness))
    assert np.all(np.diff(curve.torsion[0]) >= 0)
    assert np.all(np.diff(curve.torque[0]) >= 0)
    expected = [held(rotation, stiffness, beta) for beta in curve.torsion[0]]
    assert_allclose(curve.torque[0], expected, rtol=0, atol=1e-12 * stiffness.sum() * 1e-3)


@pytest.mark.parametrize(("lost", "torque"), [(0, 5.0), (1, -5.0)])
def test_nan_where_no_flank_can_bear_the_torque(lost: int, torque: float) -> None:
    rotation = np.full((1, 2, 3), 1e-5)
    rotation[:, lost] = np.nan
    stiffness = np.where(np.isnan(rotation), 0.0, 100.0)
    found = torsion(torque_curve(rotation, stiffness), np.array([torque, 0.0, -torque]))
    assert np.isnan(found[0, :2]).all()
    assert_allclose(found[0, 2], -np.sign(torque) * (1e-5 + 5 / 300), rtol=1e-13)


def test_a_flank_that_never_closes_bears_nothing() -> None:
    contact = MESHES["23 um"].contacts(ANGLES)
    none = np.isnan(contact.rotation)
    never = dataclasses.replace(contact, rotation=np.where(none, np.inf, contact.rotation))
    torque = np.array([0.0, 5.0, -40.0])
    for open_flank in (contact, never):
        assert np.all(flank_stiffness(open_flank, COMPLIANCE)[none] == 0)
    expected, found = (
        torsion(torque_curve(c.rotation, flank_stiffness(c, COMPLIANCE)), torque) for c in (contact, never)
    )
    assert_array_equal(found, expected)


def test_many_torques_equal_one_to_the_last_bit() -> None:
    contact = MESHES["23 um"].contacts(ANGLES)
    curve = torque_curve(contact.rotation, flank_stiffness(contact, COMPLIANCE))
    torque = np.linspace(-60, 60, 41)
    together = torsion(curve, torque)
    for column, value in enumerate(torque):
        assert_array_equal(torsion(curve, np.array([value]))[:, 0], together[:, column])
