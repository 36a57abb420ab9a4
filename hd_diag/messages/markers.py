"""Draws the gear for RViz and Foxglove: a visualization_msgs/MarkerArray in the circular spline's frame."""

from __future__ import annotations

import functools
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Complexes, Floats
from hd_diag.drive import Drive
from hd_diag.messages.encoding import HEADER, text
from hd_diag.model.flank_chain import FlankChain
from hd_diag.model.geometry import Geometry
from hd_diag.model.neutral_curve import NeutralCurve, tooth_axes
from hd_diag.model.tooth_profile import DoubleArc

MARKERS = "visualization_msgs/msg/MarkerArray"

Colour = tuple[float, float, float, float]

# Least-squares fit, c_0 to c_7 for red, green and blue, to the published table of viridis (S. van der Walt,
# N. Smith, CC0); within 0.011 of it everywhere.
_VIRIDIS = np.array(
    [
        (0.2566, 0.004, 0.3229),
        (1.1618, 1.5037, 1.9623),
        (-14.7894, -1.256, -7.804),
        (76.3146, 2.4706, 24.8852),
        (-217.0801, -8.5537, -65.2504),
        (326.8138, 19.0038, 110.5158),
        (-238.1806, -19.0286, -100.802),
        (66.4996, 6.7629, 36.3069),
    ]
)

_FLANK_POINTS = 9  # heights of a drawn flank, whose chords show clearances within 9 um
_FACE_POINTS = 5  # number of these heights between which faces are filled
_BAND_POINTS = 3  # heights of a flank's bands along the width
_CURVE_POINTS = 121
_NANOSECONDS = 1_000_000_000

_STEEL: Colour = (0.55, 0.57, 0.60, 1.0)
_AMBER: Colour = (0.85, 0.60, 0.25, 1.0)  # visible on RViz's and Foxglove's dark ground, and on white
_BLUE: Colour = (0.20, 0.45, 0.85, 1.0)
_RED: Colour = (0.90, 0.15, 0.10, 1.0)

Kind = Literal["line_strip", "line_list", "triangle_list", "text"]
# Type numbers of visualization_msgs/Marker.
_TYPES: dict[Kind, int] = {"line_strip": 4, "line_list": 5, "text": 9, "triangle_list": 11}
_ADD = 0


@dataclass(frozen=True)
class Shape:
    """One marker: its namespace, kind, points (n, 3) [m] (for a text its place) and colour.

    Colours are red, green, blue and opacity [-]; `colours` (n, 4) are those of single points, if any.
    `size` is the width of lines or height of letters [m].
    """

    name: str
    kind: Kind
    points: Floats
    colour: Colour
    size: float = 1.0
    colours: Floats | None = None
    text: str = ""


class Exaggeration(NamedTuple):
    """Factors that enlarge the deformation and the eccentricity in the drawing [-]; 1 is true to scale."""

    deformation: float = 8.0
    eccentricity: float = 200.0


EXAGGERATION = Exaggeration()


def drawing(
    drive: Drive,
    input_angle: float,
    load: Floats,
    *,
    torsion: float = 0.0,
    full_scale: float = 100.0,
    exaggeration: Exaggeration = EXAGGERATION,
) -> tuple[Shape, ...]:
    """The gear at one moment, in the frame of the circular spline: z along its axis, x through slot 0.

    Parameters
    ----------
    drive : Drive
    input_angle : float
        Reported input angle [rad].
    load : ndarray, shape (sections, 2, Z_R)
        Forces on the flanks (+, -) of every tooth in each section [N].
    torsion : float
        beta, rotation of the cup under load [rad].
    full_scale : float
        Force drawn in the last colour [N]; larger forces have this colour too.
    exaggeration : Exaggeration
        The deformation is exaggerated from the long axis. The flexspline stays in its true place there, so
        the teeth still stand in their slots.

    Returns
    -------
    tuple of Shape
        ``circular_spline``, ``flexspline``, ``wave_generator`` (the neutral curve), ``long_axis``, ``teeth``
        (each flank coloured by its own load), ``eccentricity`` (from the axis to the displaced centre),
        ``legend``. A drive in sections is drawn with its width, z towards the open end. Lines are drawn there
        and, except for the flexspline's, also at the cup's bottom. The flanks are then bands, one for each
        section, in the section's place, coloured by its force over its share of the width.

    Raises
    ------
    ValueError
        If the load's shape does not fit the drive's sections and teeth.
    """
    geometry = drive.mesh.geometry
    if load.shape != (geometry.sections, 2, geometry.flexspline_teeth):
        raise ValueError(
            f"load: shape {(geometry.sections, 2, geometry.flexspline_teeth)} is needed, got {load.shape}"
        )
    angle = drive.frame.wave_generator_angle(np.array([input_angle]))
    turn = complex(np.exp(1j * angle[0]))
    displacement = complex(drive.mesh.displacement(angle)[0])
    centres = (displacement + drive.mesh.tilt * geometry.section_places)[:, None]
    factor = exaggeration.deformation
    teeth = _teeth(drive, float(angle[0]), factor)
    teeth = np.exp(1j * torsion) * (turn * teeth + centres[:, :, None])
    around = np.linspace(0.0, 2.0 * np.pi, _CURVE_POINTS)
    ends = [0, -1] if geometry.sections > 1 else [-1]
    curves = [geometry.section_curves[end] for end in ends]
    neutral = np.stack([_deformed(curve, around, factor)[0] for curve in curves])
    neutral = turn * neutral + centres[ends]
    edges = _edges(geometry)
    outer = geometry.circular_spline_datum + geometry.slot_end
    width = 0.1 * geometry.tooth_pitch * outer
    outline = np.append(teeth[-1], teeth[-1, 0, 0])
    long_axis = neutral[:, [0, _CURVE_POINTS // 2]]
    arrow = np.add(_arrow(displacement * exaggeration.eccentricity), (0.0, 0.0, edges[-1]))
    place = np.array([[0.0, -1.2 * outer, 0.0]])
    legend = _legend(geometry, exaggeration, full_scale)
    return (
        Shape("circular_spline", "line_strip", _slots(geometry), _STEEL, width),
        Shape("flexspline", "line_strip", _flat(outline, edges[-1]), _AMBER, 0.5 * width),
        Shape("wave_generator", "line_strip", _flat(neutral, edges[ends]), _BLUE, 2.0 * width),
        Shape("long_axis", "line_list", _flat(long_axis, edges[ends]), _BLUE, 2.0 * width),
        _faces(teeth, edges, load / _shares(geometry) / full_scale, width),
        Shape("eccentricity", "line_list", arrow, _RED, 3.0 * width),
        Shape("legend", "text", place, _STEEL, 0.06 * outer, text=legend),
    )


def _edges(geometry: Geometry) -> Floats:
    """Edges of the sections' bands along the width [m], (sections + 1,); 0 for a single section."""
    if geometry.sections == 1:
        return np.zeros(2)
    return geometry.face_width * (np.append(0.0, np.cumsum(geometry.section_weights)) - 0.5)


def _shares(geometry: Geometry) -> Floats:
    """Shares of the sections in the width [-], shape (sections, 1, 1)."""
    return geometry.section_weights[:, None, None]


def _legend(geometry: Geometry, exaggeration: Exaggeration, full_scale: float) -> str:
    bands = " over a section's share of the width" if geometry.sections > 1 else ""
    return (
        f"deformation x {exaggeration.deformation:g}, eccentricity x {exaggeration.eccentricity:g}\n"
        f"teeth: force on the flank{bands}, dark 0 to yellow {full_scale:g} N\n"
        "blue: wave generator, amber: flexspline, grey: circular spline"
    )


def _faces(teeth: Complexes, edges: Floats, share: Floats, below: float) -> Shape:
    """Filled teeth at the open end and, for several sections, flanks along the width.

    `teeth` are outlines (sections, Z_R, points), `share` has shares of the full scale (sections, 2, Z_R). The
    faces lie `below` the lines [m], because they would flicker in one plane.
    """
    front = _face_order()
    points, colours = [_flat(teeth[-1][:, front], edges[-1] - below)], [_flank_colours(share[-1], front)]
    if len(teeth) > 1:
        along, end = _band_order()
        for k, section in enumerate(teeth):
            place = np.broadcast_to(edges[k + end] - below, (len(section), along.size))
            points.append(_placed(section[:, along], place))
            colours.append(_flank_colours(share[k], along))
    return Shape("teeth", "triangle_list", np.concatenate(points), _STEEL, colours=np.concatenate(colours))


def viridis(share: Floats) -> Floats:
    """Colours for shares of the full scale.

    `share`, shape (...), is clipped to 0 ... 1. Returns red, green, blue and opacity 1, shape (..., 4).
    """
    rgb = np.polynomial.polynomial.polyval(np.clip(share, 0.0, 1.0), _VIRIDIS)
    return np.concatenate((np.clip(np.moveaxis(rgb, 0, -1), 0.0, 1.0), np.ones((*share.shape, 1))), axis=-1)


def _teeth(drive: Drive, wave_generator_angle: float, exaggeration: float) -> Complexes:
    """Outlines of the teeth in the wave generator's frame, counter-clockwise, x + iy [m].

    Shape (sections, Z_R, points).

    Pose as in :func:`hd_diag.model.contact.contacts`.
    """
    mesh = drive.mesh
    geometry = mesh.geometry
    start = -wave_generator_angle * (1.0 + 1.0 / geometry.reduction) + mesh.arc_offset / geometry.curve.radius
    u = start + geometry.tooth_pitch * np.arange(geometry.flexspline_teeth, dtype=np.float64)
    posed = [_deformed(curve, u, exaggeration) for curve in geometry.section_curves]
    outline = _tooth_outline(geometry)
    return np.stack([foot[:, None] + np.exp(1j * axis)[:, None] * outline for foot, axis in posed])


def _deformed(curve: NeutralCurve, u: Floats, exaggeration: float) -> tuple[Complexes, Floats]:
    """Points of the neutral curve, x + iy [m], and directions of its normals [rad]."""
    axis, height, offset = tooth_axes(curve, u)
    foot = np.exp(1j * axis) * (height + 1j * offset)
    place = axis + np.arctan2(offset, height)
    radius = curve.semi_major - exaggeration * (curve.semi_major - np.abs(foot))
    return np.asarray(radius * np.exp(1j * place)), place + exaggeration * (axis - place)


@functools.lru_cache(maxsize=16)
def _tooth_outline(geometry: Geometry) -> Complexes:
    """A tooth in its own frame: up its clockwise flank, down the other, x + iy [m]."""
    flank = _flank(geometry.flexspline_tooth, geometry.flexspline_root, geometry.flexspline_tip)
    return np.concatenate((flank.conj(), flank[::-1]))


@functools.lru_cache(maxsize=16)
def _slots(geometry: Geometry) -> Floats:
    """Closed outline of the circular spline's teeth (n, 3) [m]; with sections, at both ends of the width."""
    datum = geometry.circular_spline_datum
    start = geometry.circular_spline_tip_radius - datum
    wall = datum + _flank(geometry.circular_spline_slot, start, geometry.slot_end)
    slot = np.concatenate((wall.conj(), wall[-2::-1]))
    turns = np.exp(1j * geometry.slot_pitch * np.arange(geometry.circular_spline_teeth))
    ring = (turns[:, None] * slot).reshape(-1)
    edges = _edges(geometry)
    ends = edges[[0, -1]] if geometry.sections > 1 else edges[-1:]
    return _flat(np.tile(np.append(ring, ring[0]), (ends.size, 1)), ends)


def _flank(profile: DoubleArc | FlankChain, start: float, end: float) -> Complexes:
    """Counter-clockwise flank between two heights [m], x + iy."""
    heights = np.linspace(start, end, _FLANK_POINTS)
    # The half width is 0 at a slot's end, and nan if rounding puts the height beyond.
    width = np.nan_to_num([profile.half_width(x) for x in heights.tolist()])
    return np.asarray(heights + 1j * width)


def _flank_colours(share: Floats, order: npt.NDArray[np.int64]) -> Floats:
    """Colours (points, 4) of points of the outlines in an order, from shares (2, Z_R) of the full scale."""
    clockwise, counter_clockwise = viridis(share[::-1])
    flanks = np.stack((clockwise, counter_clockwise), axis=1)
    side = (order >= _FLANK_POINTS).astype(np.int64)
    return np.ascontiguousarray(flanks[:, side].reshape(-1, 4))


def _band_order() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Indices of outline points for a band's triangles, and the end of each: 0 towards the bottom, or 1."""
    height = np.linspace(0, _FLANK_POINTS - 1, _BAND_POINTS).astype(np.int64)
    along = np.append(height, height + _FLANK_POINTS)
    here, there = along[:-1], along[1:]
    points = np.stack((here, there, there, here, there, here), axis=1)
    return points.reshape(-1), np.tile([0, 0, 1, 0, 1, 1], here.size)


def _face_order() -> npt.NDArray[np.int64]:
    """Indices of outline points for a tooth's triangles: two between one height and the next."""
    height = np.linspace(0, _FLANK_POINTS - 1, _FACE_POINTS).astype(np.int64)
    low, high = height[:-1], height[1:]
    far = 2 * _FLANK_POINTS - 1
    return np.stack((low, high, far - high, low, far - high, far - low), axis=1).reshape(-1)


def _arrow(tip: complex) -> Floats:
    """Line list from the axis to a point, with a head [m]."""
    head = tip * (1.0 - 0.25 * np.exp(1j * np.array([0.5, -0.5])))
    return _flat(np.array([0.0, tip, tip, head[0], tip, head[1]]))


def _flat(points: Complexes, z: float | Floats = 0.0) -> Floats:
    """Points (n, 3) at a common height z, or at one height for each row."""
    rows = np.broadcast_to(np.reshape(z, (-1,) + (1,) * (points.ndim - 1)), points.shape)
    return _placed(points, rows)


def _placed(points: Complexes, z: Floats) -> Floats:
    return np.stack((points.real, points.imag, z), axis=-1).reshape(-1, 3)


def marker_array(shapes: Sequence[Shape], stamp: int, frame_id: str) -> bytes:
    """CDR of a visualization_msgs/MarkerArray of shapes drawn in a frame, at a time [ns]."""
    body, time = bytearray(struct.pack("<I", len(shapes))), struct.pack("<iI", *divmod(stamp, _NANOSECONDS))
    for number, shape in enumerate(shapes):
        is_text = shape.kind == "text"
        points = shape.points[:0] if is_text else shape.points
        colours = np.empty((0, 4)) if shape.colours is None else shape.colours
        place = shape.points[0].tolist() if is_text else (0.0, 0.0, 0.0)
        body += bytes(-len(body) % 4) + time + text(frame_id) + text(shape.name)
        body += struct.pack("<3i", number, _TYPES[shape.kind], _ADD)
        # Pose, scale, colour, lifetime without end, not locked to the frame.
        body += bytes(-len(body) % 8) + struct.pack("<7d", *place, 0.0, 0.0, 0.0, 1.0)
        body += struct.pack("<3d4f2iI", *_scale(shape), *shape.colour, 0, 0, 0)
        body += struct.pack("<I", len(points)) + bytes(-(len(body) + 4) % 8 if len(points) else 0)
        body += points.astype("<f8").tobytes()
        body += struct.pack("<I", len(colours)) + colours.astype("<f4").tobytes()
        # No texture: resource, image (stamp, frame, format, data), coordinates. No mesh after the text.
        body += text("") + bytes(8) + text("") + text("") + bytes(8)
        body += text(shape.text) + text("") + text("") + bytes(4) + b"\0"
    return HEADER + bytes(body)


def _scale(shape: Shape) -> tuple[float, float, float]:
    """Scale that RViz expects: width of lines in x, height of letters in z, 1 in all three for triangles."""
    if shape.kind == "triangle_list":
        return (1.0, 1.0, 1.0)
    return (0.0, 0.0, shape.size) if shape.kind == "text" else (shape.size, 0.0, 0.0)
