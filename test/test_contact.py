"""Backlash of all tooth pairs, against the brute-force reference and differences of meshes."""

import dataclasses
from typing import NamedTuple

import drives
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from reference import polyline

from hd_diag.model.contact import contacts
from hd_diag.model.load_sharing import flank_stiffness
from hd_diag.model.mesh import Mesh

Array = polyline.Array
Vector = tuple[float, float]

# Polylines cut the bulge of arcs by 0.13 nm (0.25 nm in the drive of double size). Four times as many points
# reduce this to a sixteenth.
POLYLINE_ERROR = 0.3e-9  # [m]


class Moment(NamedTuple):
    """Arguments of ``drives.mesh``; with the angle first, those of ``polyline.mesh``."""

    angle: float
    eccentricity: Vector
    runout: Vector
    arc_offset: float


def vectors(largest: float) -> st.SearchStrategy[Vector]:
    return st.tuples(st.floats(-largest, largest), st.floats(-largest, largest))


moments = st.builds(Moment, st.floats(-20, 20), vectors(20e-6), vectors(8e-6), st.floats(-40e-6, 40e-6))


def spread(mesh: Mesh, angle: float) -> tuple[Array, Array, Array]:
    contact = contacts(mesh, np.array([angle]))
    found = np.full((3, 2, mesh.geometry.flexspline_teeth), np.nan)
    values = contact.rotation[0], contact.radius[0], contact.pressure_angle[0]
    found[:, :, contact.teeth[0]] = np.stack(values)
    assert np.unique(contact.teeth[0]).size == contact.teeth.shape[1]
    return found[0], found[1], found[2]


@pytest.mark.parametrize("drive", drives.DRIVES.values(), ids=drives.DRIVES)
@given(moment=moments)
@settings(max_examples=4)
def test_reference(drive: polyline.Drive, moment: Moment) -> None:
    expected = polyline.mesh(*moment, drive=drive)
    rotation, radius, pressure = spread(drives.mesh(drive, *moment[1:]), moment.angle)
    assert_allclose(rotation * expected.radius, expected.backlash, rtol=0, atol=POLYLINE_ERROR)
    # The reference smooths its flanks over some micrometres, including joints of arc and line.
    assert_allclose(radius, expected.radius, rtol=0, atol=0.5e-6)
    assert_allclose(pressure, expected.pressure_angle, rtol=0, atol=2e-3)


def test_slots_that_move_outward_open_the_flanks_and_soften_them() -> None:
    """Also in compiled code: slopes against differences of meshes with other datums."""
    mesh, angle, step = drives.mesh(eccentricity=(6e-6, 8e-6)), np.linspace(0.0, 6.0, 40), 5e-9
    datum = mesh.geometry.circular_spline_datum
    moved = [dataclasses.replace(mesh.geometry, circular_spline_datum=datum + d) for d in (-step, step)]
    inner, outer = (contacts(dataclasses.replace(mesh, geometry=one), angle) for one in moved)
    found = contacts(mesh, angle, compiled=True)
    assert_allclose(found.rotation, contacts(mesh, angle).rotation, rtol=0, atol=1e-15)
    with np.errstate(divide="ignore"):  # for flanks that cannot touch
        stiffness = [np.log(flank_stiffness(one, mesh.tooth_compliance)) for one in (inner, outer)]
    for slope, low, high in ((found.opening, inner.rotation, outer.rotation), (found.softening, *stiffness)):
        with np.errstate(invalid="ignore"):
            away = np.abs(slope - (high - low) / (2.0 * step))
        assert np.nanquantile(away, 0.99) < 1e-4 * np.nanmax(np.abs(slope))  # except where contacts jump


def test_tips_of_the_circular_spline_touch() -> None:
    drive = drives.DRIVES["200/202 with tips of 31.05 mm, which touch"]
    contact = contacts(drives.mesh(drive, (0.0, 15e-6)), np.linspace(0, 1, 5))
    assert np.count_nonzero(np.abs(contact.radius - drive.circular_spline_tip_radius) < 1e-15) > 50
