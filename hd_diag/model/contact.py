"""Backlash of every tooth pair on both flanks, in closed form: see :mod:`hd_diag.model.kernel.contact`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model import kernel
from hd_diag.model.kernel.chain import first_contact
from hd_diag.model.kernel.contact import Touch
from hd_diag.model.kernel.mesh_data import Constants, reach, width
from hd_diag.model.mesh import Mesh
from hd_diag.model.neutral_curve import tooth_axes

FLANKS = np.array([1.0, -1.0])[:, None]
"""Sign of the torsion that loads the flanks +, -; for arrays (..., 2, teeth)."""

_BLOCK = 32  # moments per block: their arrays fit in the core's cache


@dataclass(frozen=True)
class Contact:
    """Contacts of the flanks of tooth pairs: arrays of shape (moments, 2, columns), flanks (+, -).

    Columns are teeth: section by section of the width for the first lobe, then the same for the second.

    Attributes
    ----------
    teeth : ndarray of int, shape (moments, columns)
        Tooth of the flexspline in each column.
    slots : ndarray of int, shape (moments, columns)
        Slot that the tooth meets.
    weight : ndarray, shape (moments, 1, columns)
        Share of the tooth's section in the width [-].
    rotation : ndarray
        b, rotation of the cup that closes the gap, in the flank's own direction [rad]; nan: cannot touch.
    radius : ndarray
        r, distance of the contact from the axis [m].
    pressure_angle : ndarray
        alpha [rad].
    opening, softening : ndarray
        Derivatives of b [rad/m] and of the stiffness' logarithm [1/m] by an outward shift of the slot.
    """

    teeth: Integers
    slots: Integers
    weight: Floats
    rotation: Floats
    radius: Floats
    pressure_angle: Floats
    opening: Floats
    softening: Floats


def contacts(mesh: Mesh, wave_generator_angle: Floats, compiled: bool = False, lobes: int = 2) -> Contact:
    """Contacts of the tooth pairs near both lobes, at wave generator angles theta_W (moments,) [rad].

    Columns are the teeth that can reach the slots at any angle; all others cannot touch. Code that is already
    `compiled` runs many times faster. In a centred mesh with an even number of teeth both lobes are the same,
    so `lobes` = 1 is enough.
    """
    turn = np.asarray(wave_generator_angle, dtype=np.float64)
    solve: Any = partial(_compiled if compiled else first_contact, mesh.data.constants)
    firsts = range(0, max(turn.size, 1), _BLOCK)
    blocks = [_contacts(mesh, turn[first : first + _BLOCK], solve, lobes) for first in firsts]
    return Contact(*map(np.concatenate, zip(*blocks, strict=True)))


def _contacts(
    mesh: Mesh, turn: Floats, solve: Callable[[Floats, Floats], Any], lobes: int
) -> tuple[Any, ...]:
    """Fields of a `Contact`. Poses are those of :mod:`hd_diag.model.kernel.poses`, without its shortcuts."""
    c, geometry, turned = mesh.data.constants, mesh.geometry, turn[:, None]
    near = reach(mesh.data, abs(mesh.eccentricity) + abs(mesh.runout))
    columns, start = width(c, near), mesh.arc_offset / c.curve_radius - turned * c.turn_ratio
    first = np.ceil((np.pi * np.arange(lobes) - near - start) / c.tooth_pitch)
    number = first[:, :, None] + np.arange(columns)  # tooth numbers by lobe
    arc, found = start[:, :, None] + number * c.tooth_pitch, []
    for place, curve in zip(geometry.section_places, geometry.section_curves, strict=True):
        axis, height, offset = tooth_axes(curve, arc)
        axis = axis + turned[:, :, None]
        center = (mesh.displacement(turned) + mesh.tilt * place)[:, :, None] * np.exp(-1j * axis)
        found.append((number, axis, height + center.real, offset + center.imag))
    number, axis, height, offset = (
        np.stack(each, axis=2).reshape(turn.size, -1) for each in zip(*found, strict=True)
    )
    weight = np.tile(np.repeat(geometry.section_weights, columns), (turn.size, 1, lobes))
    slot = np.rint((axis + np.arctan(offset / (height + c.pitch_height))) / c.slot_pitch)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        touch = solve(height[:, None], FLANKS * offset[:, None])
    push = touch.x * touch.normal_x + touch.y * touch.normal_y
    lever = touch.x * touch.normal_y - touch.y * touch.normal_x
    return (
        np.mod(number, c.flexspline_teeth).astype(np.int64),
        np.mod(slot[:, 0], c.circular_spline_teeth).astype(np.int64),
        weight,
        np.arcsin(touch.sine) - FLANKS * (axis[:, None] - slot * c.slot_pitch),
        np.hypot(touch.x, touch.y),
        np.arctan2(push, lever),
        touch.datum / lever,
        2.0 * touch.lever_datum / lever**2,
    )


def _compiled(c: Constants, height: Floats, offset: Floats) -> Touch:
    """Compiled :func:`first_contact` of arrays."""
    rows = np.broadcast_arrays(height, offset)
    found = kernel.entry.touches(c, *(np.ascontiguousarray(row).ravel() for row in rows))
    return Touch(*found.reshape(-1, *rows[0].shape))
