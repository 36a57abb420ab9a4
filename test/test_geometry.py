"""Checks of a drive's geometry as a whole."""

import dataclasses
import math

import drives
import pytest
from numpy.testing import assert_allclose
from reference import polyline

from hd_diag.model.tooth_profile import DoubleArc

TOOTH, SLOT = (drives.double_arc(profile) for profile in (drives.PAPER.tooth, drives.PAPER.slot))
INF, NAN = math.inf, math.nan


def tooth(**changes: object) -> dict[str, object]:
    return {"flexspline_tooth": dataclasses.replace(TOOTH, **changes)}  # type: ignore[arg-type]


def slot(**changes: object) -> dict[str, object]:
    return {"circular_spline_slot": dataclasses.replace(SLOT, **changes)}  # type: ignore[arg-type]


CANNOT_BE = [
    ({"circular_spline_teeth": 200}, r"circular_spline_teeth \(200\) must exceed flexspline_teeth \(200"),
    ({"circular_spline_teeth": 198}, "must exceed flexspline_teeth"),
    ({"circular_spline_teeth": 203}, "by 2 or 4"),
    ({"circular_spline_teeth": 220}, "by 2 or 4"),
    ({"flexspline_teeth": 201, "circular_spline_teeth": 203}, "both must be even"),
    ({"flexspline_teeth": 18, "circular_spline_teeth": 20}, "at least 20"),
    (tooth(addendum_radius=NAN), "flexspline_tooth: every length must be finite"),
    (tooth(dedendum_center=(INF, 1e-3)), "flexspline_tooth: every length must be finite"),
    ({"flexspline_root": NAN}, "flexspline_tooth: every length must be finite"),
    (tooth(addendum_radius=0.0), "flexspline_tooth: arc radii must be positive"),
    (slot(dedendum_radius=-1e-3), "circular_spline_slot: arc radii must be positive"),
    (tooth(addendum_radius=0.6e-3), "flexspline_tooth: the addendum and dedendum arcs overlap"),
    ({"flexspline_root": 0.8e-3}, "flexspline_tooth: the flank must run root, inner arc, tangent"),
    ({"flexspline_tip": 0.5e-3}, "flexspline_tooth: the flank must run root, inner arc, tangent"),
    ({"flexspline_root": 0.18e-3}, "flexspline_tooth: the flank does not reach"),
    ({"flexspline_tip": 0.965e-3}, "flexspline_tooth: the flank does not reach .* or its sides cross"),
    (slot(addendum_radius=0.2e-3), r"circular_spline_slot.addendum_radius \(0.0002 m\) must exceed"),
    (tooth(dedendum_radius=0.43e-3), r"flexspline_tooth.dedendum_radius \(0.00043 m\) must exceed"),
    (slot(addendum_center=(1.2201e-3, -0.24e-3)), "circular_spline_slot: the outer arc must reach the slot"),
    ({"circular_spline_datum": NAN}, "circular_spline_datum and circular_spline_tip_radius must be positive"),
    ({"circular_spline_datum": -0.03}, "circular_spline_datum and circular_spline_tip_radius must be pos"),
    ({"circular_spline_tip_radius": INF}, "circular_spline_tip_radius must be positive and finite"),
    ({"circular_spline_tip_radius": 30.2e-3}, "circular_spline_slot: the flank does not reach"),
    ({"circular_spline_tip_radius": 31.2e-3}, "circular_spline_slot: the flank must run"),
    ({"semi_major": 30.38e-3}, r"root \(0.03078 m at the long axis\) reaches the circular spline's tip rad"),
    ({"flexspline_root": 0.55e-3}, "root .* reaches the circular spline's tip radius"),
    ({"circular_spline_datum": 29.65e-3}, "the flexspline's tip reaches the end of the circular spline's sl"),
    ({"semi_major": 29.9e-3}, "do not reach into the circular spline's slots at the long axis"),
    ({"semi_minor": 29.93e-3}, "do not come free of the circular spline at the short axis"),
    ({"semi_minor": 30.3e-3}, "semi_major .* must be at least semi_minor"),
    ({"semi_minor": 20e-3}, "no more than 20 %"),
    ({"flexspline_teeth": 700, "circular_spline_teeth": 702}, "flexspline_tooth: wider than its pitch"),
    ({"sections": 3}, "give face_width"),
    ({"face_width": -1e-3}, "face_width"),
    ({"sections": 0, "face_width": 0.01}, "sections must be at least 1"),
    ({"cup_length": 4e-3, "face_width": 0.01, "sections": 3}, "must exceed half of face_width"),
    ({"cup_length": 8e-3, "face_width": 0.011, "sections": 5}, "at the long axis of the section at"),
]


@pytest.mark.parametrize(("changes", "message"), CANNOT_BE)
def test_names_what_cannot_be(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        drives.geometry(**changes)


@pytest.mark.parametrize("drive", drives.DRIVES.values(), ids=drives.DRIVES)
def test_what_follows_from_the_teeth(drive: polyline.Drive) -> None:
    geometry = drives.geometry(drive)
    teeth = drive.flexspline_teeth
    assert geometry.reduction == teeth / 2
    assert_allclose(geometry.tooth_pitch * teeth, 2 * math.pi, rtol=1e-15)
    assert_allclose(geometry.slot_pitch * (teeth + 2), 2 * math.pi, rtol=1e-15)
    assert_allclose(geometry.curve.radius, polyline.ring_radius(drive), rtol=1e-13)
    assert_allclose(geometry.circular_spline_slot.half_width(geometry.slot_end), 0, atol=1e-15)


def test_the_nearest_values_that_can_be() -> None:
    for changes in ({"semi_major": 30.37e-3}, {"semi_minor": 29.92e-3}, {"flexspline_root": 0.51e-3}):
        drives.geometry(**changes)


@pytest.mark.parametrize(("flank", "degrees"), [(TOOTH, 1.962), (SLOT, 9.915)])
def test_inclination_of_the_common_tangent(flank: DoubleArc, degrees: float) -> None:
    # The paper's table has 9.88 deg for the slot, and 3.99 deg for the tooth, which its arcs do not give.
    assert_allclose(90 - math.degrees(flank.normal_angle), degrees, atol=5e-4)
