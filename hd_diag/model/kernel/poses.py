"""Poses of the teeth near both lobes, the only ones that can reach the slots.

Tooth i stands at ``s_i = R_b (theta_F + 2 pi i / Z_R - theta_W) + s_0`` along the neutral curve: Dong et al.
(2019), eqs. (1)-(7). Its foot point and axis are those of ``neutral_curve.tooth_axes``, moved by the wave
generator's displacement, in every section of the width. Angles are kept as cosines and sines: a rotation by
whole pitches gives the other teeth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model.kernel.compiler import inline, part
from hd_diag.model.kernel.mesh_data import Constants, MeshData, reach, width


class Teeth(NamedTuple):
    """Poses of teeth in all sections, each (columns,), and working space.

    Foot point along the tooth axis and counter-clockwise across it, from the circular spline's axis [m];
    angle by which the tooth axis leads the slot's [rad]; cosine and sine of the tooth axis from the long
    axis; number of the slot; number of the tooth, which does not restart after a turn; number of the section,
    z [m] and the section's share of the width [-]. Columns hold one lobe and then the other, each section by
    section with the same teeth.
    """

    height: Floats
    offset: Floats
    lead: Floats
    cosine: Floats
    sine: Floats
    slot: Floats
    number: Floats
    section: Integers
    z: Floats
    weight: Floats
    place_cos: Floats
    place_sin: Floats
    later: Floats
    last: Floats


@part
def room(columns: int) -> Teeth:
    """Teeth whose poses are not yet set."""
    n = columns
    return Teeth(
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n),
        np.empty(n, dtype=np.int64), np.empty(n), np.empty(n),
        np.empty(n), np.empty(n), np.empty(n), np.empty(n),
    )  # fmt: skip


@part
def place(mesh: MeshData, turn: float, displacement: complex, teeth: Teeth) -> int:
    """Set the poses of the teeth within reach for a displacement in the housing; return their number."""
    c, tables, angle = mesh.constants, mesh.tables, reach(mesh, abs(displacement))
    columns, sections = width(c, angle), tables.section_place.size
    start = -turn * c.turn_ratio + mesh.arc_offset / c.curve_radius
    turned = complex(math.cos(turn), -math.sin(turn))
    for lobe in range(2):
        first = math.ceil((lobe * math.pi - angle - start) / c.tooth_pitch)
        base = start + first * c.tooth_pitch
        base_cos, base_sin = math.cos(base), math.sin(base)
        for section in range(sections):
            begin, z = (lobe * sections + section) * columns, tables.section_place[section]
            weight = tables.section_weight[section]
            for j in range(columns):
                step_cos, step_sin = tables.pitch_cos[j], tables.pitch_sin[j]
                teeth.place_cos[begin + j] = base_cos * step_cos - base_sin * step_sin
                teeth.place_sin[begin + j] = base_sin * step_cos + base_cos * step_sin
                teeth.number[begin + j], teeth.section[begin + j] = first + j, section
                teeth.z[begin + j], teeth.weight[begin + j] = z, weight
            center = (displacement + mesh.tilt * z) * turned
            _axes(tables.series[section], begin, begin + columns, center, teeth)
    count = 2 * sections * columns
    _slots(c, count, start, turn, teeth)
    return count


@part
def _axes(series: Floats, begin: int, end: int, center: complex, teeth: Teeth) -> None:
    """Set tooth axes and foot points of a section; lead temporarily holds the axis' angle less u."""
    # Loops over slices begin at zero: the compiler vectorises them, as no index can be negative.
    count, later, last = end - begin, teeth.later[begin:end], teeth.last[begin:end]
    place_cos, place_sin = teeth.place_cos[begin:end], teeth.place_sin[begin:end]
    leads, offsets, heights = teeth.lead[begin:end], teeth.offset[begin:end], teeth.height[begin:end]
    axes_cos, axes_sin = teeth.cosine[begin:end], teeth.sine[begin:end]
    _, lead = _summed(series[0], place_sin, later, last)
    for j in range(count):
        leads[j] = 2.0 * place_sin[j] * place_cos[j] * lead[j]
    _, offset = _summed(series[1], place_sin, later, last)
    for j in range(count):
        offsets[j] = 2.0 * place_sin[j] * place_cos[j] * offset[j]
    before, height = _summed(series[2], place_sin, later, last)
    center_x, center_y, mean = center.real, center.imag, series[2, 0]
    for j in range(count):
        cosine, sine = place_cos[j], place_sin[j]
        small_cos, small_sin = _small_cos_sin(leads[j])
        axis_x, axis_y = cosine * small_cos - sine * small_sin, sine * small_cos + cosine * small_sin
        along = mean + (1.0 - 2.0 * sine * sine) * height[j] - before[j]
        heights[j] = along + center_x * axis_x + center_y * axis_y
        offsets[j] = offsets[j] + center_y * axis_x - center_x * axis_y
        axes_cos[j], axes_sin[j] = axis_x, axis_y


@part
def _summed(series: Floats, sine: Floats, later: Floats, last: Floats) -> tuple[Floats, Floats]:
    """Clenshaw's sums b_2 and b_1 of a series in 2u: ``sum a_k sin 2ku = b_1 sin 2u``."""
    later[:], last[:] = 0.0, 0.0
    for k in range(series.size - 1, 0, -1):
        coefficient = series[k]
        for j in range(sine.size):
            later[j] = coefficient + (2.0 - 4.0 * sine[j] * sine[j]) * last[j] - later[j]
        later, last = last, later
    return later, last


@part
def _slots(c: Constants, count: int, start: float, turn: float, teeth: Teeth) -> None:
    """The slot opposite each tooth, and the lead of the tooth axis over it [rad]."""
    for j in range(count):
        angle = start + teeth.number[j] * c.tooth_pitch + teeth.lead[j] + turn
        slope = teeth.offset[j] / (teeth.height[j] + c.pitch_height)
        slot = np.rint((angle + _small_arctangent(slope)) / c.slot_pitch)
        teeth.slot[j], teeth.lead[j] = slot, angle - slot * c.slot_pitch


@inline
def _small_arctangent(tangent: float) -> float:
    """Arctangent, exact to rounding for tangents up to 0.15."""
    x = tangent * tangent
    low = -1 / 3 + x * (1 / 5 + x * (-1 / 7 + x / 9))
    return tangent + tangent * x * (low + x * x * x * x * (-1 / 11 + x * (1 / 13 - x / 15)))


@inline
def _small_cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact to rounding for angles up to 0.2 rad."""
    x = angle * angle
    cosine = 1.0 - x * (1 / 2 - x * (1 / 24 - x * (1 / 720 - x * (1 / 40320 - x / 3628800))))
    return cosine, angle * (
        1.0 - x * (1 / 6 - x * (1 / 120 - x * (1 / 5040 - x * (1 / 362880 - x / 39916800))))
    )
