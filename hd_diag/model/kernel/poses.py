"""Poses of the teeth near both lobes, the only ones that can reach the slots.

Tooth i stands at ``s_i = R_b (theta_F + 2 pi i / Z_R - theta_W) + s_0`` along the neutral curve: Dong et al.
(2019), eqs. (1)-(7). Its foot point and axis are those of ``neutral_curve.tooth_axes``, moved by the wave
generator's displacement. Angles are cosines and sines here: the next tooth is one rotation by a pitch away.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.model.kernel.compiler import inline, part
from hd_diag.model.kernel.mesh_data import Constants, MeshData, width


class Teeth(NamedTuple):
    """Poses of teeth, each (teeth,), and working space.

    Foot point along the tooth axis and counter-clockwise across it, about the circular spline's axis [m];
    angle by which the tooth axis leads its slot's [rad]; cosine and sine of the tooth axis from the long
    axis; number of the slot; number of the tooth, counted on over turns.
    """

    height: Floats
    offset: Floats
    lead: Floats
    cosine: Floats
    sine: Floats
    slot: Floats
    number: Floats
    place_cos: Floats
    place_sin: Floats
    later: Floats
    last: Floats


@part
def room(c: Constants) -> Teeth:
    """Teeth whose poses are not yet set."""
    n = c.flexspline_teeth
    return Teeth(
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n),
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n),
    )  # fmt: skip


@part
def place(mesh: MeshData, turn: float, center: complex, angle: float, teeth: Teeth) -> int:
    """Set the poses of the teeth within reach, centre in the wave generator's frame; gives their number."""
    c, columns = mesh.constants, width(mesh.constants, angle)
    start = -turn * c.turn_ratio + mesh.arc_offset / c.curve_radius
    for lobe in range(2):
        first = math.ceil((lobe * math.pi - angle - start) / c.tooth_pitch)
        base = start + first * c.tooth_pitch
        base_cos, base_sin, column = math.cos(base), math.sin(base), lobe * columns
        for j in range(columns):
            step_cos, step_sin = mesh.tables.pitch_cos[j], mesh.tables.pitch_sin[j]
            teeth.place_cos[column + j] = base_cos * step_cos - base_sin * step_sin
            teeth.place_sin[column + j] = base_sin * step_cos + base_cos * step_sin
            teeth.number[column + j] = first + j
    count = 2 * columns
    excess = _excess(mesh.tables.harmonics, count, teeth.place_sin, teeth.later, teeth.last)
    _axes(c, count, center, excess, teeth)
    _slots(c, count, start, turn, teeth)
    return count


@part
def _excess(harmonics: Floats, count: int, sine: Floats, later: Floats, last: Floats) -> Floats:
    """``(t - u) / sin 2u`` by Clenshaw's recurrence."""
    later[:count], last[:count] = 0.0, 0.0
    for k in range(harmonics.size - 1, -1, -1):
        coefficient = harmonics[k]
        for j in range(count):
            later[j] = coefficient + (2.0 - 4.0 * sine[j] * sine[j]) * last[j] - later[j]
        later, last = last, later
    return last


@part
def _axes(c: Constants, count: int, center: complex, excess: Floats, teeth: Teeth) -> None:
    """Tooth axes and foot points; lead is for now the axis' angle less u."""
    a, b, center_x, center_y = c.semi_major, c.semi_minor, center.real, center.imag
    for j in range(count):
        cosine, sine = teeth.place_cos[j], teeth.place_sin[j]
        small = excess[j] * 2.0 * sine * cosine
        small_cos, small_sin = _small_cos_sin(small)
        cos_t, sin_t = cosine * small_cos - sine * small_sin, sine * small_cos + cosine * small_sin
        x, y = b * cos_t, a * sin_t
        inverse = 1.0 / math.sqrt(x * x + y * y)
        axis_x, axis_y, cross = x * inverse, y * inverse, sin_t * cos_t
        slope = (a - b) * cross / (b * cos_t * cos_t + a * sin_t * sin_t)
        teeth.lead[j] = small + _small_arctangent(slope)
        teeth.height[j] = a * b * inverse + center_x * axis_x + center_y * axis_y
        teeth.offset[j] = (b * b - a * a) * cross * inverse + center_y * axis_x - center_x * axis_y
        teeth.cosine[j], teeth.sine[j] = axis_x, axis_y


@part
def _slots(c: Constants, count: int, start: float, turn: float, teeth: Teeth) -> None:
    """The slot opposite each tooth, and the angle by which the tooth axis leads it."""
    for j in range(count):
        angle = start + teeth.number[j] * c.tooth_pitch + teeth.lead[j] + turn
        slope = teeth.offset[j] / (teeth.height[j] + c.pitch_height)
        slot = np.rint((angle + _small_arctangent(slope)) / c.slot_pitch)
        teeth.slot[j], teeth.lead[j] = slot, angle - slot * c.slot_pitch


@inline
def _small_arctangent(tangent: float) -> float:
    """To rounding for ellipses up to 20 % apart, whose normals are within 0.12 rad of the parameter."""
    x = tangent * tangent
    low = -1 / 3 + x * (1 / 5 + x * (-1 / 7 + x / 9))
    return tangent + tangent * x * (low + x * x * x * x * (-1 / 11 + x * (1 / 13 - x / 15)))


@inline
def _small_cos_sin(angle: float) -> tuple[float, float]:
    """To rounding for angles up to 0.12 rad."""
    x = angle * angle
    cosine = 1.0 - x * (1 / 2 - x * (1 / 24 - x * (1 / 720 - x * (1 / 40320 - x / 3628800))))
    return cosine, angle * (1.0 - x * (1 / 6 - x * (1 / 120 - x * (1 / 5040 - x / 362880))))
