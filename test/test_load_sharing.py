"""Load distribution: exact solution of a rising piecewise linear function."""

from random import Random

import drives
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose
from reference import polyline

from hd_diag.model import load_sharing
from hd_diag.model.contact import FLANKS, contacts
from hd_diag.model.load_sharing import FlankTorsion, MeshState, torsion_of_flanks
from hd_diag.model.mesh import Mesh

Array = polyline.Array
COMPLIANCE = drives.PAPER.tooth_compliance
PRELOADED = drives.mesh(eccentricity=(0.0, 23e-6), runout=(2e-6, 0.0))
ANGLES = np.linspace(0.05, 6.2, 9)


def state(mesh: Mesh, torque: float, angle: Array = ANGLES) -> MeshState:
    return load_sharing.mesh_state(mesh, angle, np.full(angle.size, torque))


@pytest.mark.parametrize("drive", drives.DRIVES.values(), ids=drives.DRIVES)
def test_reference(drive: polyline.Drive) -> None:
    moment = {"eccentricity": (7e-6, -11e-6), "runout": (2e-6, 3e-6), "arc_offset": 5e-6}
    expected = polyline.mesh(0.7, **moment, drive=drive)
    for torque in (-41.0, 0.0, 0.3, 56.0):
        found = state(drives.mesh(drive, **moment), torque, np.array([0.7]))
        beta = polyline.torsion(expected, torque, drive)
        # Backlash differs by 0.3 nm, lever arms by the polylines' smoothed tangents.
        assert_allclose(found.torsion[0], beta, rtol=1e-4, atol=1e-8)
        assert_allclose(found.load[0], polyline.loads(expected, beta, drive), rtol=2e-3, atol=0.01)
        assert_allclose(found.backlash[0], expected.backlash, rtol=0, atol=1e-9)
        assert_allclose(found.pressure_angle[0], expected.pressure_angle, rtol=0, atol=2e-3)


def test_the_middle_of_a_true_gap_at_zero_torque(paper_mesh: Mesh) -> None:
    found = state(paper_mesh, 0.0)
    first_plus, first_minus = np.nanmin(contacts(paper_mesh, ANGLES).rotation, axis=2).T
    assert np.all(first_plus > 0)
    # `contacts` runs without compiled code, which rounds sines of 0.1 rad differently.
    assert_allclose(found.lost_motion, first_plus + first_minus, rtol=0, atol=1e-15)
    assert_allclose(found.torsion, (first_plus - first_minus) / 2, rtol=0, atol=1e-15)
    assert np.all(found.load == 0)
    for sign in (1, -1):
        beside = state(paper_mesh, sign * 1e-9)
        assert_allclose(beside.torsion - found.torsion, sign * found.lost_motion / 2, rtol=1e-6)
    preload = state(PRELOADED, 0.0)
    assert np.all(preload.lost_motion == 0)
    assert np.all(preload.load.max(axis=2) > 0)


flanks = arrays(np.float64, (2, 6), elements=st.floats(-1e-3, 1e-3) | st.just(np.nan) | st.just(np.inf))
stiffnesses = arrays(np.float64, (2, 6), elements=st.floats(10.0, 1e4))


@given(flanks, stiffnesses, st.floats(-100.0, 100.0))
@settings(max_examples=200)
def test_torsion_holds_the_torque_and_rises_with_it(rotation: Array, stiffness: Array, torque: float) -> None:
    beta = torsion_of_flanks(rotation[None], stiffness[None], np.array([torque]))[0, 0]
    if np.isnan(beta):
        sides = {1: (0,), 0: (0, 1), -1: (1,)}[int(np.sign(torque))]
        assert any(not np.isfinite(rotation[side]).any() for side in sides)
        return
    overlap = np.where(np.isfinite(rotation), FLANKS * beta - rotation, -1.0)
    held = float((FLANKS * stiffness * np.maximum(overlap, 0)).sum())
    assert_allclose(held, torque, rtol=0, atol=1e-12 * (stiffness.sum() * 1e-3 + abs(torque)))
    several = np.array([-50.0, -3.0, -1e-3, -1e-9, 0.0, 1e-9, 1e-3, 3.0, 50.0])
    rising = torsion_of_flanks(rotation[None], stiffness[None], several)[0]
    assert np.all(np.diff(rising[~np.isnan(rising)]) >= -1e-15)
    with np.errstate(invalid="ignore"):
        plain = FlankTorsion(rotation[None], stiffness[None])(several)[0]
    assert_allclose(plain, rising, rtol=1e-9, atol=1e-15)


@given(
    st.floats(1e-4, 1e-3), st.floats(10.0, 60.0), st.floats(-22.0, -10.0), st.randoms(use_true_random=False)
)
def test_a_torque_below_rounding_is_held(start: float, gain: float, exponent: float, random: Random) -> None:
    """Flanks differ in the last digit: the torsion stays there, however small the torque."""
    digits = np.array([[random.randint(-3, 3) for _ in range(6)] for _ in range(2)])
    rotation, stiffness = start + digits * np.spacing(start), np.full((2, 6), gain)
    beta = torsion_of_flanks(rotation[None], stiffness[None], np.array([-(10.0**exponent), 10.0**exponent]))
    assert_allclose(beta[0], [-start, start], rtol=1e-12, atol=10.0**exponent / gain)
