"""A geometry similar to a known one.

A catalogue gives size, ratio and stiffness, never the teeth. Teeth and the radial deformation of the
flexspline scale with the module; the neutral curve's perimeter scales with the pitch circle. The page's
torsion curve gives the further shift of the circular spline's slots (:mod:`hd_diag.gears.page_fit`). Results
that follow from the profile and not from the stiffness remain assumptions: backlash of single teeth, the
eccentricity of the first interference, forces on teeth.
"""

from __future__ import annotations

from dataclasses import replace

from hd_diag.model.cams import Ellipse
from hd_diag.model.flank_chain import FlankChain
from hd_diag.model.geometry import Geometry
from hd_diag.model.tooth_profile import DoubleArc

LEAST_TEETH = 60
"""Least number of flexspline teeth: below ratio 30 no gear is known with the teeth of ratio 100."""

FACE_WIDTH, CUP_LENGTH = 0.37, 1.3
"""Width of the teeth, and their middle's distance from the cup's bottom, over the pitch radius [-]."""

SECTIONS = 5
"""Sections along the width; more sections change the torsion by at most 1 %."""

_DIGITS = 10  # decimals of a length: a tenth of a nanometre, so that all machines get the same numbers [m]
_STEPS = 12  # iterations of a solution; each reduces the error to a fiftieth or less


def module_scale(known: Geometry, scale: float, teeth: int) -> float:
    """Module of a drive over that of a known one [-], for a pitch circle `scale` times as large."""
    return scale * known.flexspline_teeth / teeth


def similar(known: Geometry, scale: float, teeth: int) -> Geometry:
    """Geometry with `teeth` teeth and a pitch circle `scale` times that of a known one, in sections.

    The module gives the place of the slots; width and length are those of usual cups.

    Parameters
    ----------
    known : Geometry
    scale : float
        Pitch diameter over the known one's [-].
    teeth : int
        Teeth of the flexspline, even; the circular spline has as many more as in the known geometry.

    Raises
    ------
    ValueError
        If no drive with these teeth runs; the message says why.
    """
    if teeth < LEAST_TEETH:
        raise ValueError(
            f"{teeth} teeth of the flexspline are fewer than {LEAST_TEETH} (ratio {LEAST_TEETH // 2}): such "
            "gears have another profile and deformation, which similarity does not tell: give them all"
        )
    k, radius = module_scale(known, scale, teeth), scale * known.curve.radius
    major = radius + k * (known.semi_major - known.curve.radius)
    minor = 2.0 * radius - major
    for _ in range(_STEPS):  # the perimeter hardly differs from that of a circle of the semi-axes' mean
        minor += 2.0 * (radius - Ellipse(major, minor).support()[0])
    return Geometry(
        teeth,
        teeth + known.circular_spline_teeth - known.flexspline_teeth,
        Ellipse(round(major, _DIGITS), round(minor, _DIGITS)),
        _scaled(known.flexspline_tooth, k),
        round(k * known.flexspline_root, _DIGITS),
        round(k * known.flexspline_tip, _DIGITS),
        _scaled(known.circular_spline_slot, k),
        major + k * (known.circular_spline_datum - known.semi_major),
        major + k * (known.circular_spline_tip_radius - known.semi_major),
        round(FACE_WIDTH * radius, _DIGITS),
        round(CUP_LENGTH * radius, _DIGITS),
        SECTIONS,
    )


def moved(geometry: Geometry, shift: float) -> Geometry:
    """Geometry with the slots moved outward by `shift` [m]."""
    places = (geometry.circular_spline_datum, geometry.circular_spline_tip_radius)
    datum, tip = (round(place + shift, _DIGITS) for place in places)
    return replace(geometry, circular_spline_datum=datum, circular_spline_tip_radius=tip)


def _scaled(flank: DoubleArc | FlankChain, k: float) -> DoubleArc:
    assert isinstance(flank, DoubleArc)  # as the example drive's are

    def point(center: tuple[float, float]) -> tuple[float, float]:
        return round(k * center[0], _DIGITS), round(k * center[1], _DIGITS)

    return DoubleArc(
        round(k * flank.addendum_radius, _DIGITS),
        round(k * flank.dedendum_radius, _DIGITS),
        point(flank.addendum_center),
        point(flank.dedendum_center),
    )
