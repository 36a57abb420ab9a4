"""A geometry in a drawing: neutral curve and assembly, teeth in their slots, both profiles, all labelled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc

from hd_diag.arrays import Floats
from hd_diag.model.flank_chain import FlankChain
from hd_diag.model.geometry import Geometry
from hd_diag.model.neutral_curve import tooth_axes
from hd_diag.model.tooth_profile import DoubleArc
from hd_diag.report.pictures import canvas
from hd_diag.report.pictures.canvas import ACCENT, EXTENDED, GRID, INK, NOMINAL, REFIT, drawn, sheet

_WIDTH = 4.4  # [inch]; letters are read on a phone, too
_PANELS = (5.2, 1.8, 3.0, 3.6)  # heights [inch]
_MM = 1e3
_POINTS = 200
_DEFORMED = 12.0  # enlargement of the drawn deformation [-]
_ECCENTRIC, _RUNOUT = 0.25, 0.17  # drawn sizes over the radius [-]
_DIRECTION, _PHASE = math.radians(-50.0), math.radians(25.0)  # drawn directions of eccentricity and long axis
_SMALL: Any = {"fontsize": 7.0}
_BESIDE: Any = {"textcoords": "offset points", **_SMALL}
_FLEXSPLINE, _CIRCULAR_SPLINE = REFIT, NOMINAL


@drawn
def tooth_pair_picture(geometry: Geometry) -> Figure:
    """Drawing of a geometry, labelled with the parameters' names."""
    figure, rows = sheet(sum(_PANELS), len(_PANELS), height_ratios=_PANELS)
    figure.set_figwidth(_WIDTH)
    _assembly(rows[0], geometry)
    _pair(rows[1], geometry)
    for axes in rows:
        axes.axis("off")
    for place, name in zip(rows[2:], ("flexspline_tooth", "circular_spline_slot"), strict=True):
        _profile(place.inset_axes((0.04, 0.1, 0.92, 0.8)), geometry, name)
    return figure


def _assembly(axes: Axes, geometry: Geometry) -> None:
    """Neutral curve, its axes and the wave generator's place; deformation and displacement are enlarged."""
    radius = geometry.curve.radius * _MM
    axes_of_curve = geometry.semi_major, geometry.semi_minor
    major, minor = (radius + _DEFORMED * (axis * _MM - radius) for axis in axes_of_curve)
    turn = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    fixed = _ECCENTRIC * radius * np.exp(1j * _DIRECTION)
    centre = fixed + _RUNOUT * radius * np.exp(1j * (_PHASE + 0.08 * np.pi))
    curve = centre + (major * np.cos(turn) + 1j * minor * np.sin(turn)) * np.exp(1j * _PHASE)
    housing = 1.45 * radius * np.exp(1j * turn)
    axes.plot(housing.real, housing.imag, color=_CIRCULAR_SPLINE, lw=1.0)
    axes.plot(curve.real, curve.imag, color=_FLEXSPLINE)
    axes.plot([0.0, 1.6 * radius], [0.0, 0.0], color=GRID, lw=0.7, ls="-.")
    axes.plot([centre.real, centre.real + 0.75 * radius], [centre.imag] * 2, color=GRID, lw=0.7, ls="-.")
    ends = centre + major * np.exp(1j * _PHASE), centre + minor * np.exp(1j * (_PHASE + 0.5 * np.pi))
    _arrow(axes, centre, ends[0], _FLEXSPLINE)
    _arrow(axes, centre, ends[1], _FLEXSPLINE)
    _arrow(axes, 0.0, fixed, ACCENT)
    _arrow(axes, fixed, centre, EXTENDED)
    _angle(axes, 0.0, 0.2 * radius, 0.0, _DIRECTION, ACCENT)
    _angle(axes, centre, 0.6 * radius, 0.0, _PHASE, _FLEXSPLINE)
    left, right = -0.15 * radius, 0.15 * radius
    pointed = 0.6 * radius * np.exp(0.5j * _PHASE) + centre
    layer = "neutral layer of the flexspline,\nflexspline_teeth on it, first at\n"
    layer += f"arc_offset; deformed {_DEFORMED:g} times"
    major_axis, minor_axis = (centre + 0.75 * (end - centre) for end in ends)
    on_layer, on_spline = centre - major * np.exp(1j * (_PHASE + 0.15)), 1.45 * radius * np.exp(2.2j)
    at_arc = 0.2 * radius * np.exp(0.5j * _DIRECTION)
    spline = "circular spline, in the housing:\ncircular_spline_teeth"
    phase = "wave_generator_phase: the\nlong axis at input angle 0"
    runout = "runout.magnitude and .direction:\nturns with the wave generator"
    magnitude, between = "eccentricity.magnitude:\nfixed in the housing", 0.5 * (fixed + centre)
    # Text, labelled point, side, height, place of the text where the line to the point begins, colour.
    labels: tuple[tuple[str, complex, float, float, tuple[float, float], str], ...] = (
        ("neutral_curve.semi_minor", minor_axis, left, 2.4, (1.0, 0.0), _FLEXSPLINE),
        (spline, on_spline, left, 1.95, (0.5, 0.0), _CIRCULAR_SPLINE),
        (phase, pointed, right, 2.45, (1.0, 0.0), _FLEXSPLINE),
        ("neutral_curve.semi_major", major_axis, right, 2.1, (1.0, 0.0), _FLEXSPLINE),
        ("direction 0, at slot 0", 1.6 * radius, right, 1.8, (1.0, 0.0), INK),
        (layer, on_layer, left, -1.85, (0.5, 1.0), _FLEXSPLINE),
        (runout, between, left, -2.4, (1.0, 1.0), EXTENDED),
        ("eccentricity.direction", at_arc, right + 0.45 * radius, -1.8, (0.0, 1.0), ACCENT),
        (magnitude, 0.5 * fixed, right, -2.25, (0.0, 1.0), ACCENT),
    )
    for text, point, side, height, begin, colour in labels:
        line = {"arrowstyle": "-", "color": colour, "lw": 0.5, "shrinkA": 1.0, "shrinkB": 0.0}
        place = complex(point).real, complex(point).imag
        way: Any = {"color": colour, "ha": "left" if side > 0.0 else "right", "va": "center"}
        axes.annotate(
            text, place, (side, height * radius), arrowprops={**line, "relpos": begin}, **way, **_SMALL
        )
    axes.set(xlim=(-2.2 * radius, 2.2 * radius), ylim=(-2.7 * radius, 2.6 * radius), aspect="equal")


def _pair(axes: Axes, geometry: Geometry) -> None:
    """Teeth in their slots at the long axis, radius upwards, and the radii that place them."""
    number = np.arange(-1.0, 2.0)
    angle, height, offset = tooth_axes(geometry.curve, geometry.tooth_pitch * number)
    tooth = _outline(geometry.flexspline_tooth, geometry.flexspline_root, geometry.flexspline_tip)
    datum, tip = geometry.circular_spline_datum, geometry.circular_spline_tip_radius
    slot = datum + _outline(geometry.circular_spline_slot, tip - datum, geometry.slot_end)
    for k in range(number.size):
        own = (height[k] + 1j * offset[k] + tooth) * np.exp(1j * angle[k]) * _MM
        axes.fill(-own.imag, own.real, color=_FLEXSPLINE, alpha=0.25, lw=0)
        axes.plot(-own.imag, own.real, color=_FLEXSPLINE, lw=1.2)
        wall = slot * np.exp(1j * number[k] * geometry.slot_pitch) * _MM
        axes.plot(-wall.imag, wall.real, color=_CIRCULAR_SPLINE, lw=1.2)
    wide, a = 1.5 * geometry.tooth_pitch * geometry.curve.radius * _MM, geometry.semi_major
    marks = (
        ("neutral_curve.semi_major, ", a, _FLEXSPLINE, 0.0),
        ("+ flexspline_tooth.root\n", a + geometry.flexspline_root, _FLEXSPLINE, -1.0),
        ("+ flexspline_tooth.tip\n", a + geometry.flexspline_tip, _FLEXSPLINE, -1.0),
        ("circular_spline_datum, ", datum, _CIRCULAR_SPLINE, 0.0),
        ("circular_spline_tip_radius\n", tip, _CIRCULAR_SPLINE, 1.0),
    )
    sides = {-1.0: ("right", "center", 4.5), 0.0: ("center", "bottom", 1.0), 1.0: ("left", "center", 0.0)}
    for name, radius, colour, side in marks:
        axes.plot([-wide, wide], [radius * _MM] * 2, color=colour, lw=0.6, ls="--")
        across, along, up = sides[side]
        text, place = f"{name}{radius * _MM:.4f} mm", (side * wide, radius * _MM)
        axes.annotate(text, place, (4.0 * side, up), ha=across, va=along, color=colour, **_BESIDE)
    module = geometry.module * _MM
    axes.set_title(
        "Teeth in their slots at the long axis:\nradii from the circular spline's axis", fontsize=7.5
    )
    axes.set(xlim=(-13.2 * module, 13.2 * module), aspect="equal")


def _profile(axes: Axes, geometry: Geometry, name: str) -> None:
    """One profile in its own frame: arcs with their centres and radii, beginning and end."""
    if name == "flexspline_tooth":
        flank, colour, zero = geometry.flexspline_tooth, _FLEXSPLINE, "neutral layer"
        low, high = geometry.flexspline_root, geometry.flexspline_tip
        ends = {"root": low, "tip": high}
    else:
        flank, colour, zero = geometry.circular_spline_slot, _CIRCULAR_SPLINE, "circular_spline_datum"
        low = geometry.circular_spline_tip_radius - geometry.circular_spline_datum
        high, ends = geometry.slot_end, {"tip radius − datum": low}
    assert isinstance(flank, DoubleArc)  # its arcs are drawn
    outline = _outline(flank, low, high) * _MM
    axes.plot(outline.imag, outline.real, color=colour, lw=0.8)
    half = outline[:_POINTS]
    axes.plot(half.imag, half.real, color=colour, lw=2.0)
    arcs = (
        ("addendum", flank.addendum_center, flank.addendum_radius, flank.addendum_joint, EXTENDED),
        ("dedendum", flank.dedendum_center, flank.dedendum_radius, flank.dedendum_joint, ACCENT),
    )
    for part, (x, y), radius, joint, ink in arcs:
        x, y, size = x * _MM, y * _MM, 2.0 * radius * _MM
        axes.add_patch(Arc((y, x), size, size, color=ink, lw=0.6, ls=":"))
        axes.plot(y, x, "+", color=ink)
        _arrow(axes, complex(y, x), complex(joint[1], joint[0]) * _MM, ink)
        up, along = (1.0, "bottom") if part == "addendum" else (-1.0, "top")
        for text, away in ((f"{part}_center", 6.0), (f"{part}_radius", 15.0)):
            axes.annotate(text, (y, x), (0.0, up * away), ha="center", va=along, color=ink, **_BESIDE)
    far = 1.4 * flank.dedendum_center[1] * _MM
    near = -0.8 * far
    for end, value in (ends | {f"{zero}, x = 0": 0.0}).items():
        axes.plot([far, near], [value * _MM] * 2, color=GRID, lw=0.6, ls="--")
        axes.annotate(end, (near, value * _MM), (-2.0, 1.5), ha="right", color=INK, **_BESIDE)
    axes.plot([0.0, 0.0], [0.0, 1.1 * high * _MM], color=GRID, lw=0.6, ls="-.")
    # Counter-clockwise, where y is positive, is to the left when x points up.
    axes.set(xlim=(far, near), ylim=(-0.08 * high * _MM, 1.22 * high * _MM), aspect="equal")
    axes.set_title(name, fontsize=7.5, color=colour)
    axes.tick_params(labelsize=6.5)
    axes.grid(visible=False)
    axes.set_xlabel("y across, counter-clockwise [mm]", fontsize=7.0)
    axes.set_ylabel("x outward [mm]", fontsize=7.0)


def _outline(
    flank: DoubleArc | FlankChain, low: float, high: float
) -> np.ndarray[Any, np.dtype[np.complex128]]:
    """Points of both sides, x + iy [m]: the counter-clockwise one from its start to its end, and back."""
    x: Floats = np.linspace(low, high, _POINTS)
    side = x + 1j * np.array([flank.half_width(float(each)) for each in x])
    return np.concatenate((side, np.conj(side[::-1])))


def _arrow(axes: Axes, start: complex, end: complex, colour: str) -> None:
    canvas.arrow(axes, start, end, colour, 0.9, 7.0)


def _angle(axes: Axes, centre: complex, radius: float, start: float, end: float, colour: str) -> None:
    arc = complex(centre) + radius * np.exp(1j * np.linspace(start, end, 30))
    axes.plot(arc.real, arc.imag, color=colour, lw=0.7)
