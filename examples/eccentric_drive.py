"""Drawing of a drive along its axis: what is eccentric to what, positive directions, interfering teeth."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from hd_diag.arrays import Complexes, Floats
from hd_diag.drive import Drive, mesh_state
from hd_diag.model.neutral_curve import tooth_axes
from hd_diag.model.transmission_error import Kinematics
from hd_diag.report.pictures import canvas
from hd_diag.report.pictures.canvas import ACCENT, EXTENDED, GRID, INK, NOMINAL, REFIT, drawn, sheet

_HEIGHT = 7.2  # [inch]
_TURNED = math.radians(25.0)  # theta_W
_ACROSS = _TURNED + 0.5 * math.pi  # direction of the eccentricity: lobes are pressed together most
_DASHED, _SIZE, _FREE = 1 / 15, 0.06, 0.1  # dashed line, eccentricity, largest backlash, over the module [-]
_HOUSING, _MAJOR, _MINOR = 1.0, 0.8, 0.62  # radii of the sketch over that of the ring
_CENTRE = 0.2 * np.exp(1j * _ACROSS)
_OUTSIDE = 1.3  # radius of the dashed line
_POINTS = 200
_LETTERS: Any = {"fontsize": 7.5, "ha": "center", "va": "center"}
_DOTTED: Any = {"color": GRID, "lw": 0.7, "ls": (0, (4, 2))}


@drawn
def drive_picture(drive: Drive) -> Figure:
    """Two views along the axis, from the side towards which angles are counter-clockwise positive."""
    figure, (top, bottom) = sheet(_HEIGHT, 2)
    _directions(top)
    _interference(bottom, drive)
    size = _SIZE * drive.mesh.geometry.module * 1e6
    titles = "What is eccentric to what, what is positive", f"Where teeth interfere: E = {size:.0f} µm, T = 0"
    for axes, half, title in ((top, 1.25, titles[0]), (bottom, 1.6, titles[1])):
        axes.set(xlim=(-1.55, 1.55), ylim=(-half, half), aspect="equal")
        axes.set_title(title)
        axes.axis("off")
    return figure


def _directions(axes: Axes) -> None:
    """Axes, displacement and positive directions; the displacement is drawn far too large."""
    turn = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    layer = _CENTRE + (_MAJOR * np.cos(turn) + 1j * _MINOR * np.sin(turn)) * np.exp(1j * _TURNED)
    _curve(axes, _HOUSING * np.exp(1j * turn), NOMINAL)
    _curve(axes, layer, REFIT)
    long_axis = _MAJOR * np.exp(1j * _TURNED)
    for points, style in (
        ([0.0, 1.3], _DOTTED),
        ([_CENTRE, _CENTRE + 0.55], _DOTTED),
        ([_CENTRE - long_axis, _CENTRE + long_axis], {"color": REFIT, "lw": 0.8}),
    ):
        _curve(axes, np.array(points, dtype=np.complex128), **style)
    _arrow(axes, 0.0, _CENTRE, ACCENT)
    axes.plot(0.0, 0.0, "o", color=NOMINAL, ms=4)
    axes.plot(_CENTRE.real, _CENTRE.imag, "o", color=REFIT, ms=4)
    _arc(axes, 0.0, 0.3, 0.0, _ACROSS, ACCENT)
    _arc(axes, _CENTRE, 0.42, 0.0, _TURNED, REFIT)
    _arc(axes, 0.0, 1.1, math.radians(62.0), math.radians(28.0), REFIT)
    _arc(axes, 0.0, 1.1, math.radians(208.0), math.radians(242.0), EXTENDED)
    for x, y, text, colour in (
        (-1.08, 1.0, "circular spline,\nfixed in the\nhousing", INK),
        (0.1, -0.72, "neutral layer of\nthe flexspline", REFIT),
        (0.5, 0.28, "$θ_W$", REFIT),
        (0.15, -0.12, "direction of E", ACCENT),
        (-0.14, 0.05, "E", ACCENT),
        (1.25, 0.09, "slot 0: 0°", INK),
        (1.15, 0.88, "input\n$θ_{in}$ > 0", REFIT),
        (-1.17, -0.88, "output\n$θ_{out}$ > 0\nT > 0", EXTENDED),
        (0.95, -1.02, "TE > 0: output ahead\nT > 0: output lags", INK),
    ):
        axes.text(x, y, text, color=colour, parse_math=True, **_LETTERS)
    axes.text(-0.5, 0.04, "long axis", color=REFIT, rotation=math.degrees(_TURNED), **_LETTERS)


def _interference(axes: Axes, drive: Drive) -> None:
    """Least backlash of every tooth without torque: inside the circle free, outside interfering."""
    where, least, positive = _least_backlash(drive)
    dashed = _DASHED * drive.mesh.geometry.module
    turn = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    _curve(axes, np.exp(1j * turn), INK, lw=0.9)
    _curve(axes, _OUTSIDE * np.exp(1j * turn), **_DOTTED)
    inward = (_OUTSIDE - 1.0) * np.fmin(least / dashed, _FREE / _DASHED)
    shown = np.exp(1j * where) * np.stack((np.ones(where.size), 1.0 - inward))
    struck = least < 0.0
    for which, colour in ((~struck, GRID), (struck & positive, REFIT), (struck & ~positive, NOMINAL)):
        lines = np.stack((shown[:, which].real, shown[:, which].imag), axis=-1).transpose(1, 0, 2)
        axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=1.4))
    for side in (1.0, -1.0):
        tip = side * np.exp(1j * _TURNED)
        _arrow(axes, 0.1 * tip, 0.5 * tip, REFIT)
        axes.text(0.4 * tip.real, 0.4 * tip.imag - 0.17, "lobe", color=REFIT, **_LETTERS)
    _arrow(axes, 0.0, 0.5 * np.exp(1j * _ACROSS), ACCENT)
    told = "inside the circle: backlash; outside: interference,\n"
    told += f"up to the dashed line {dashed * 1e6:.0f} µm"
    for x, y, text, colour in (
        (-0.05, 0.45, "E", ACCENT),
        (0.9, 1.43, "these press on their\ncounter-clockwise flank (+)", REFIT),
        (-0.95, 1.43, "these on their\nclockwise flank (−)", INK),
        (0.0, -1.48, told, INK),
    ):
        axes.text(x, y, text, color=colour, **_LETTERS)


def _least_backlash(drive: Drive) -> tuple[Floats, Floats, Any]:
    """Direction of each tooth in the housing [rad], its least backlash [m], whether its + flank has it."""
    geometry = drive.mesh.geometry
    size = _SIZE * geometry.module * np.exp(1j * _ACROSS)
    mesh = replace(drive.mesh, eccentricity=size, runout=0.0, arc_offset=0.0)
    placed = Drive(mesh, Kinematics(-geometry.reduction), drive.rated_torque)
    plus, minus = mesh_state(placed, np.array([_TURNED]), np.zeros(1)).backlash[0]
    number = np.arange(geometry.flexspline_teeth, dtype=np.float64)
    turned = -_TURNED / geometry.reduction
    angle, _, _ = tooth_axes(geometry.curve, turned + geometry.tooth_pitch * number - _TURNED)
    least = np.fmin(plus, minus)
    near = np.isfinite(least)
    return angle[near] + _TURNED, least[near], plus[near] == least[near]


def _curve(axes: Axes, points: npt.ArrayLike, color: str, **style: Any) -> None:
    places: Complexes = np.asarray(points, np.complex128)
    axes.plot(places.real, places.imag, color=color, **style)


def _arrow(axes: Axes, start: complex, end: complex, colour: str) -> None:
    canvas.arrow(axes, start, end, colour, 1.1, 8.0)


def _arc(axes: Axes, centre: complex, radius: float, start: float, end: float, colour: str) -> None:
    """Arc with an arrow at its end."""
    points = complex(centre) + radius * np.exp(1j * np.linspace(start, end, 60))
    _curve(axes, points[:-4], colour, lw=0.9)
    _arrow(axes, points[-6], points[-1], colour)
