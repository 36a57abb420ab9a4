"""Drives for tests of the mechanics, shared by the model and the reference."""

import dataclasses

from reference import polyline

from hd_diag.model.cams import Ellipse
from hd_diag.model.geometry import Geometry
from hd_diag.model.mesh import Mesh
from hd_diag.model.tooth_profile import DoubleArc

PAPER = polyline.DEFAULT


def resized(teeth: int, outward: float, drive: polyline.Drive = PAPER) -> polyline.Drive:
    """The drive with another number of teeth of the same size: all radii move with the pitch radius.

    The circular spline lies ``outward`` [m] further out, so that 1 um of backlash remains, as in the paper.
    """
    difference = drive.circular_spline_teeth - drive.flexspline_teeth
    ring = polyline.ring_radius(drive)
    pitch = ring + 0.6193e-3
    inward = ring * (1 - teeth / drive.flexspline_teeth)
    pitch_outward = pitch * (1 + difference / drive.flexspline_teeth)
    shift = outward + (pitch - inward) * (1 + difference / teeth) - pitch_outward
    return dataclasses.replace(
        drive,
        semi_major=drive.semi_major - inward,
        semi_minor=drive.semi_minor - inward,
        flexspline_teeth=teeth,
        circular_spline_teeth=teeth + difference,
        circular_spline_datum=drive.circular_spline_datum + shift,
        circular_spline_tip_radius=drive.circular_spline_tip_radius + shift,
    )


def scaled(factor: float, drive: polyline.Drive = PAPER) -> polyline.Drive:
    """The drive with every length multiplied by a factor."""

    def grown(profile: polyline.Profile) -> polyline.Profile:
        return polyline.Profile(*(factor * length for length in dataclasses.astuple(profile)))

    lengths = ("tooth_root", "tooth_tip", "semi_major", "semi_minor")
    radii = ("circular_spline_datum", "circular_spline_tip_radius")
    return dataclasses.replace(
        drive,
        tooth=grown(drive.tooth),
        slot=grown(drive.slot),
        **{name: factor * getattr(drive, name) for name in (*lengths, *radii)},
    )


DRIVES = {
    "200/202 of the paper": PAPER,
    "200/202 with the slots 8 um farther out": dataclasses.replace(PAPER, circular_spline_datum=29.876e-3),
    "200/202 with tips of 31.05 mm, which touch": dataclasses.replace(
        PAPER, circular_spline_tip_radius=31.05e-3
    ),
    "160/162": resized(160, 5.6e-6),
    "100/102": resized(100, 20.7e-6),
    "320/322": resized(320, -8.4e-6),
    "200/202 twice as large": scaled(2.0),
}


COARSE = resized(60, 43.5e-6)


def shallow() -> polyline.Drive:
    """A drive with so few and so short teeth that at times none is in a slot."""
    drive = resized(30, 0.0)
    tip_radius = drive.semi_major + drive.tooth_tip - 0.2e-6
    outward = tip_radius - drive.circular_spline_tip_radius
    datum = drive.circular_spline_datum + outward
    return dataclasses.replace(drive, circular_spline_datum=datum, circular_spline_tip_radius=tip_radius)


def double_arc(profile: polyline.Profile) -> DoubleArc:
    return DoubleArc(
        profile.addendum_radius,
        profile.dedendum_radius,
        (profile.addendum_centre, -profile.addendum_offset),
        (profile.dedendum_centre, profile.dedendum_offset),
    )


def geometry(drive: polyline.Drive = PAPER, **changes: object) -> Geometry:
    """The model's geometry of a drive with some changes; semi-axes are the ellipse's."""
    axes = {name: changes.pop(name) for name in ("semi_major", "semi_minor") if name in changes}
    drive = dataclasses.replace(drive, **axes)
    own: dict[str, object] = {
        "flexspline_teeth": drive.flexspline_teeth,
        "circular_spline_teeth": drive.circular_spline_teeth,
        "neutral_curve": Ellipse(drive.semi_major, drive.semi_minor),
        "flexspline_tooth": double_arc(drive.tooth),
        "flexspline_root": drive.tooth_root,
        "flexspline_tip": drive.tooth_tip,
        "circular_spline_slot": double_arc(drive.slot),
        "circular_spline_datum": drive.circular_spline_datum,
        "circular_spline_tip_radius": drive.circular_spline_tip_radius,
    }
    return Geometry(**(own | changes))  # type: ignore[arg-type]


def mesh(
    drive: polyline.Drive = PAPER,
    eccentricity: tuple[float, float] = (0.0, 0.0),
    runout: tuple[float, float] = (0.0, 0.0),
    arc_offset: float = 0.0,
) -> Mesh:
    """The model's mesh of a drive; arguments as for the reference."""
    return Mesh(geometry(drive), drive.tooth_compliance, complex(*eccentricity), complex(*runout), arc_offset)
