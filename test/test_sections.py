"""Sections along the width: coning, tilt, and their symmetries."""

from dataclasses import replace
from typing import Any

import drives
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from reference import polyline, published

from hd_diag.formatting import ARCSEC
from hd_diag.model.contact import FLANKS, contacts
from hd_diag.model.load_sharing import mesh_state
from hd_diag.model.mesh import Mesh
from hd_diag.model.torsion import torsion, torsion_along, torsion_and_gradient, torsion_table
from hd_diag.model.torsion_map import TOLERANCE, build

WIDTH = published.FACE_WIDTH
TORQUES = np.array(published.SECTION_TORQUES)


def wide(cup: float = 0, eccentricity: complex = 0, tilt: Any = 0, sections: int = 5, **more: Any) -> Mesh:
    geometry = drives.geometry(face_width=WIDTH, cup_length=cup, sections=sections)
    return Mesh(geometry, 1e-6, eccentricity, tilt=tilt, **more)


ASTRAY = wide(0.04, 4e-6 - 7e-6j, 0.5e-3 + 0.8e-3j, runout=2e-6 + 1e-6j, arc_offset=3e-6)


@pytest.mark.parametrize("case", published.SECTION_CASES)
def test_published_torsion_and_backlash(case: published.SectionCase) -> None:
    mesh = wide(case.cup_length, 1j * case.eccentricity, 1j * case.tilt)
    beta = torsion(mesh, np.zeros(4), TORQUES)
    # The calculation is accurate to 0.02 um and 7e-7 rad, and deforms sections beyond the first order.
    assert_allclose(beta, case.torsion, rtol=0, atol=7e-7)
    state = mesh_state(mesh, np.zeros(1), 0.0)
    assert_allclose(np.nanmin(state.section_backlash[0, :, 0], axis=1), case.backlash, atol=0.04e-6)


EVERY_ORDER = [(case, case.order_2) for case in published.SECTION_CASES if case.order_2]
PLANE = published.SectionCase(0.0, 10e-6, 0.0, (), ())


@pytest.mark.parametrize(("case", "expected"), [*EVERY_ORDER, (PLANE, published.ECCENTRIC_ORDER_2)])
def test_published_order_2(case: published.SectionCase, expected: tuple[float, ...]) -> None:
    mesh = wide(case.cup_length, 1j * case.eccentricity, 1j * case.tilt)
    turn = np.pi / 512 * np.arange(512)  # half a turn, after which the error repeats
    beta = torsion_table(mesh, turn, TORQUES)
    found = 2 * np.abs((beta * np.exp(-2j * turn)[:, None]).mean(axis=0)) / ARCSEC
    assert_allclose(found, expected, rtol=0.01, atol=0.01)


@pytest.mark.parametrize("cup_length", [0.0, 0.04])
def test_against_polylines_of_every_section(cup_length: float) -> None:
    mesh, angle = wide(cup_length, 6e-6 - 4e-6j, 0.4e-3 + 0.7e-3j, sections=3), 0.7
    places, weights = mesh.geometry.section_places, mesh.geometry.section_weights
    apart = polyline.sections(angle, (6e-6, -4e-6), (0.4e-3, 0.7e-3), cup_length, places.tolist())
    state = mesh_state(mesh, np.array([angle]), 14.0)
    for found, expected in zip(state.section_backlash[0], apart, strict=True):
        near = np.isfinite(expected.backlash) & (expected.backlash < 20e-6)
        assert_allclose(found[near], expected.backlash[near], rtol=0, atol=0.05e-6)
    expected_beta = polyline.shared_torsion(apart, weights.tolist(), 14.0)
    assert_allclose(state.torsion[0], expected_beta, rtol=2e-4)


def test_one_section_is_the_plane_drive_to_the_last_bit() -> None:
    moments = np.linspace(0, 6, 40), np.linspace(-50, 80, 40)
    plane = drives.mesh(eccentricity=(3e-6, -8e-6), runout=(2e-6, 1e-6), arc_offset=4e-6)
    one = replace(plane, geometry=drives.geometry(face_width=WIDTH, cup_length=0.04))
    assert_array_equal(torsion(one, *moments), torsion(plane, *moments))
    both = (torsion_and_gradient(mesh, *moments) for mesh in (one, plane))
    for found, expected in zip(*both, strict=True):
        assert_array_equal(found, expected)
    found, expected = mesh_state(one, *moments), mesh_state(plane, *moments)
    assert_array_equal(found.load, expected.load)
    assert_array_equal(found.section_load[:, 0], expected.load)


def test_sections_of_a_ring_without_tilt_are_all_alike() -> None:
    turn, torque = np.linspace(0, 6, 30), np.linspace(-50, 80, 30)
    ring, plane = wide(eccentricity=9e-6j, sections=4), drives.mesh(eccentricity=(0.0, 9e-6))
    assert_allclose(torsion(ring, turn, torque), torsion(plane, turn, torque), rtol=1e-12)
    state = mesh_state(ring, turn, torque)
    share = ring.geometry.section_weights[:, None, None]
    assert_allclose(state.section_load, share * state.load[:, None], rtol=1e-9, atol=1e-9)


def test_a_long_cup_is_a_ring() -> None:
    turn, torque = np.linspace(0, 6, 20), np.linspace(1, 80, 20)
    ring = torsion(wide(tilt=1e-3j), turn, torque)
    away = [np.abs(torsion(wide(length, tilt=1e-3j), turn, torque) - ring).max() for length in (1.0, 10.0)]
    assert away[1] < 0.2 * away[0] < 1e-5


@given(st.floats(0, 2 * np.pi), st.floats(-60, 60).filter(lambda torque: abs(torque) > 0.5))
def test_mirrored_and_turned(turn: float, torque: float) -> None:
    own, load = np.array([turn]), np.array([torque])
    beta = torsion(ASTRAY, own, load)
    other = {name: getattr(ASTRAY, name).conjugate() for name in ("eccentricity", "runout", "tilt")}
    mirrored = replace(ASTRAY, **other, arc_offset=-ASTRAY.arc_offset)
    assert_allclose(torsion(mirrored, -own, -load), -beta, rtol=1e-9, atol=1e-14)  # [rad], near zero
    # The drive is the same if everything fixed in the housing turns by a slot pitch.
    pitch = ASTRAY.geometry.slot_pitch
    along = np.exp(1j * pitch)
    moved = replace(ASTRAY, eccentricity=ASTRAY.eccentricity * along, tilt=ASTRAY.tilt * along)
    same = torsion(moved, own + pitch, load)
    # The teeth shift by the difference of slot and tooth travel, a whole tooth.
    assert_allclose(same, beta, rtol=1e-9, atol=1e-14)


def test_a_tilt_of_a_ring_has_no_side_and_of_a_cup_has_one() -> None:
    turn, torque = np.linspace(0, 3, 20), np.full(20, 5.0)

    def both(cup: float) -> list[np.ndarray]:
        return [torsion(wide(cup, 8e-6j, side * 1e-3j), turn, torque) for side in (1, -1)]

    assert_allclose(*both(0.0), rtol=1e-12)
    assert np.abs(np.subtract(*both(0.04))).max() > 1e-5


@pytest.mark.parametrize("torque", [0.0, 3.0, -40.0])
def test_sections_together_bear_the_torque(torque: float) -> None:
    state = mesh_state(ASTRAY, np.linspace(0, 6, 15), torque)
    assert_allclose(state.section_load.sum(axis=1), state.load, rtol=1e-14)
    contact = contacts(ASTRAY, np.linspace(0, 6, 15))
    lever = contact.radius * np.cos(contact.pressure_angle)
    overlap = np.fmax(FLANKS * state.torsion[:, None, None] - contact.rotation, 0.0)
    force = overlap * lever * contact.weight / ASTRAY.tooth_compliance
    assert_allclose(np.nansum(FLANKS * force * lever, axis=(1, 2)), torque, atol=1e-8)
    assert_allclose(np.nansum(force, axis=(1, 2)), state.load.sum(axis=(1, 2)), rtol=1e-9, atol=1e-9)
    assert_allclose(state.backlash, np.fmin.reduce(state.section_backlash, axis=1))


def test_what_coning_presses_as_built_is_no_interference() -> None:
    """Interference comes from an eccentricity, in the plane and beyond coning; overlap has both."""
    turn = np.linspace(0.0, 6.0, 57)
    rest = mesh_state(wide(0.04), turn, 0.0)
    assert rest.overlap.min() > 8e-6
    assert not rest.interference.any()
    assert mesh_state(wide(0.04, 10e-6), turn, 0.0).interference.any()
    for e in (0.0, 2e-6, 5e-6):
        both = drives.mesh(eccentricity=(e, 0.0)), wide(0.0, e)
        plane, ring = (mesh_state(mesh, turn, 0.0) for mesh in both)
        assert_array_equal(plane.interference, plane.overlap > 0.0)
        assert_array_equal(ring.interference, plane.interference)


@pytest.mark.parametrize("torque", [0.5, 30.0, -9.0])
def test_derivatives_by_displacement_and_tilt(torque: float) -> None:
    turn, load = np.linspace(0.01, 6, 40), np.full(40, torque)
    beta, gradient = torsion_and_gradient(ASTRAY, turn, load)
    assert_array_equal(beta, torsion(ASTRAY, turn, load))
    steps = {0: 1e-9, 1: 1e-9j, 5: 1e-7, 6: 1e-7j}
    for column, step in steps.items():
        name = "eccentricity" if column < 2 else "tilt"
        above, below = (replace(ASTRAY, **{name: getattr(ASTRAY, name) + s}) for s in (step, -step))
        slope = (torsion(above, turn, load) - torsion(below, turn, load)) / (2 * abs(step))
        assert np.median(np.abs(gradient[:, column] - slope)) < 1e-4 * np.abs(slope).max()
    turn, load = np.linspace(0.01, 6, 400), np.full(400, torque)
    found = np.column_stack(torsion_along(ASTRAY, turn, load, 2))
    exact = np.column_stack(torsion_and_gradient(ASTRAY, turn, load))
    near_a_gap = 0.0 < torque < 1.0
    assert np.std(found[:, 0] - exact[:, 0]) < (0.25 if near_a_gap else 0.06) * ARCSEC
    assert np.all(np.std(found - exact, axis=0) < (0.2 if near_a_gap else 0.1) * np.abs(exact).max(axis=0))


def test_a_map_of_sections_keeps_its_tolerance() -> None:
    table = build(wide(0.04, 8e-6j, 0.6e-3), 60.0, steps_per_tooth=16)
    assert table.repeats == 2
    assert table.error_bound < 2 * TOLERANCE * 16
    turn, torque = np.linspace(0, 6, 200), np.linspace(-59, 59, 200)
    assert_allclose(table(turn, torque), torsion(table.mesh, turn, torque), rtol=0, atol=table.error_bound)


def test_tilts_that_cannot_be() -> None:
    with pytest.raises(ValueError, match="give face_width and sections"):
        Mesh(drives.geometry(), tilt=1e-3)
    with pytest.raises(ValueError, match="what the tilt adds at the ends"):
        wide(tilt=0.05)
