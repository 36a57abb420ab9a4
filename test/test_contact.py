"""Backlash of all tooth pairs: against the brute-force reference, published values and laws."""

import dataclasses
from typing import NamedTuple

import drives
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from reference import polyline
from scipy.optimize import brentq

from hd_diag.model.contact import contacts
from hd_diag.model.geometry import Geometry
from hd_diag.model.load_sharing import flank_stiffness
from hd_diag.model.mesh import Mesh

Array = polyline.Array
Vector = tuple[float, float]

# The polylines cut the arcs' bulge by 0.13 nm, 0.25 nm in the drive twice as large; with four times as many
# points by a sixteenth of that.
POLYLINE_ERROR = 0.3e-9  # [m]
PITCH = 2 * np.pi / 202


class Moment(NamedTuple):
    """Arguments of ``drives.mesh`` and, with the angle before them, of ``polyline.mesh``."""

    angle: float
    eccentricity: Vector
    runout: Vector
    arc_offset: float


def vectors(largest: float) -> st.SearchStrategy[Vector]:
    return st.tuples(st.floats(-largest, largest), st.floats(-largest, largest))


moments = st.builds(Moment, st.floats(-20, 20), vectors(20e-6), vectors(8e-6), st.floats(-40e-6, 40e-6))


def spread(mesh: Mesh, angle: float) -> tuple[Array, Array, Array]:
    """Rotation, radius and pressure angle of all teeth, each (2, Z_R)."""
    contact = contacts(mesh, np.array([angle]))
    found = np.full((3, 2, mesh.geometry.flexspline_teeth), np.nan)
    values = contact.rotation[0], contact.radius[0], contact.pressure_angle[0]
    found[:, :, contact.teeth[0]] = np.stack(values)
    assert np.unique(contact.teeth[0]).size == contact.teeth.shape[1]
    return found[0], found[1], found[2]


def backlash(moment: Moment, drive: polyline.Drive = drives.PAPER) -> Array:
    rotation, radius, _ = spread(drives.mesh(drive, *moment[1:]), moment.angle)
    return rotation * radius


@pytest.mark.parametrize("drive", drives.DRIVES.values(), ids=drives.DRIVES)
@given(moment=moments)
@settings(max_examples=4)
def test_reference(drive: polyline.Drive, moment: Moment) -> None:
    expected = polyline.mesh(*moment, drive=drive)
    rotation, radius, pressure = spread(drives.mesh(drive, *moment[1:]), moment.angle)
    assert_allclose(rotation * expected.radius, expected.backlash, rtol=0, atol=POLYLINE_ERROR)
    # The reference smooths its flanks over some micrometres, also where arc and line join.
    assert_allclose(radius, expected.radius, rtol=0, atol=0.5e-6)
    assert_allclose(pressure, expected.pressure_angle, rtol=0, atol=2e-3)


def point_of_wall(geometry: Geometry, radius: float) -> complex:
    """Where a slot's counter-clockwise wall has this distance from the axis [m]."""
    datum, wall = geometry.circular_spline_datum, geometry.circular_spline_slot
    low, high = geometry.circular_spline_tip_radius - datum - 5e-6, 0.999 * geometry.slot_end

    def point(x: float) -> complex:
        return complex(datum + x, wall.half_width(x))

    return point(brentq(lambda x: abs(point(x)) - radius, low, high, xtol=1e-18))


@given(moments)
@settings(max_examples=25)
def test_contact_point_lies_on_both_flanks(moment: Moment) -> None:
    mesh = drives.mesh(drives.PAPER, *moment[1:])
    geometry = mesh.geometry
    contact = contacts(mesh, np.array([moment.angle]))
    origin, normal = polyline.tooth_axes(*moment)
    for side, sign in enumerate((1, -1)):
        for k in np.flatnonzero(~np.isnan(contact.rotation[0, side])):
            tooth = contact.teeth[0, k]
            wall = point_of_wall(geometry, contact.radius[0, side, k])
            position = contact.slots[0, k] * geometry.slot_pitch + sign * np.angle(wall)
            # Before the cup turned by b, the point of the flank stood behind the wall's by b.
            point = abs(wall) * np.exp(1j * (position - sign * contact.rotation[0, side, k]))
            from_foot = (point - complex(*origin[:, tooth])) / complex(*normal[:, tooth])
            width = geometry.flexspline_tooth.half_width(min(from_foot.real, geometry.flexspline_tip))
            assert from_foot.real < geometry.flexspline_tip + 1e-13
            assert_allclose(sign * from_foot.imag, width, atol=1e-13)


def test_slots_that_move_outward_open_the_flanks_and_soften_them() -> None:
    """Also by compiled code, as differences of meshes with other datums have it."""
    mesh, angle, step = drives.mesh(eccentricity=(6e-6, 8e-6)), np.linspace(0.0, 6.0, 40), 5e-9
    datum = mesh.geometry.circular_spline_datum
    moved = [dataclasses.replace(mesh.geometry, circular_spline_datum=datum + d) for d in (-step, step)]
    inner, outer = (contacts(dataclasses.replace(mesh, geometry=one), angle) for one in moved)
    found = contacts(mesh, angle, compiled=True)
    assert_allclose(found.rotation, contacts(mesh, angle).rotation, rtol=0, atol=1e-15)
    with np.errstate(divide="ignore"):  # where a flank cannot touch
        stiffness = [np.log(flank_stiffness(one, mesh.tooth_compliance)) for one in (inner, outer)]
    for slope, low, high in ((found.opening, inner.rotation, outer.rotation), (found.softening, *stiffness)):
        with np.errstate(invalid="ignore"):
            away = np.abs(slope - (high - low) / (2.0 * step))
        assert np.nanquantile(away, 0.99) < 1e-4 * np.nanmax(np.abs(slope))  # but where the contact jumps


def test_tips_of_the_circular_spline_touch() -> None:
    """In one of the drives; without it the reference would test no such contact."""
    drive = drives.DRIVES["200/202 with tips of 31.05 mm, which touch"]
    contact = contacts(drives.mesh(drive, (0.0, 15e-6)), np.linspace(0, 1, 5))
    assert np.count_nonzero(np.abs(contact.radius - drive.circular_spline_tip_radius) < 1e-15) > 50


@given(moments, st.integers(-3, 3))
@settings(max_examples=25)
def test_symmetries_rename_the_teeth(moment: Moment, turns: int) -> None:
    angle, (e_x, e_y), (r_x, r_y), arc_offset = moment
    turned = (e_x + 1j * e_y) * np.exp(1j * PITCH)
    pitched = moment._replace(angle=angle + PITCH, eccentricity=(turned.real, turned.imag))
    opposite = Moment(angle, (-e_x, -e_y), (-r_x, -r_y), arc_offset)
    mirrored = Moment(-angle, (e_x, -e_y), (r_x, -r_y), -arc_offset)
    later = moment._replace(angle=angle + 2 * np.pi * turns)
    along = moment._replace(arc_offset=arc_offset + 2 * np.pi * polyline.ring_radius() / 200)
    found = backlash(moment)
    for name, other in {
        "mirror exchanges the flanks": np.roll(backlash(mirrored)[::-1, ::-1], 1, axis=1),
        "turned by one pitch": np.roll(backlash(pitched), -1, axis=1),
        "whole turns": np.roll(backlash(later), -2 * turns, axis=1),
        "the other lobe": np.roll(backlash(opposite), 100, axis=1),
        "moved along the curve by one pitch": np.roll(backlash(along), 1, axis=1),
    }.items():
        assert_allclose(other, found, rtol=0, atol=1e-13, err_msg=name)
