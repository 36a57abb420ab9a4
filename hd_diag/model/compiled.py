"""The contact model compiled: the same numbers as ``clearance`` and ``load_sharing``, some hundred times as fast.

numba is optional: where it is missing :func:`available` is False and callers keep to the numpy modules. It is
imported when first asked for, and its machine code is kept on disk.
"""

from __future__ import annotations

import cmath
import functools
import math
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from hd_diag.model.clearance import _JOINT_SLACK, Contact
from hd_diag.model.geometry import Geometry
from hd_diag.model.neutral_curve import tooth_axes
from hd_diag.model.tooth_profile import DoubleArc

if TYPE_CHECKING:
    from hd_diag.model.kernel import Arc, Constants, Line, Tables

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

# What the columns of a gradient are taken by.
PARAMETERS = (
    "eccentricity.x",
    "eccentricity.y",
    "circular_spline_datum",
    "tooth_compliance",
    "arc_offset",
    "torque",
    "wave_generator_angle",
)


@functools.cache
def _kernel() -> ModuleType:
    from hd_diag.model import kernel

    return kernel


@functools.cache
def available() -> bool:
    """Whether numba is there and works with this numpy; the first call imports it."""
    try:
        _kernel()
    except ImportError:
        return False
    return True


def torsion(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    cup_torque: float | Floats,
) -> Floats:
    """Torsion at one torque per moment, as ``load_sharing.torsion`` gives it.

    Parameters
    ----------
    geometry : Geometry
    tooth_compliance : float
        K1 + K2 of a tooth pair [m/N].
    wave_generator_angle : ndarray, shape (n,)
        theta_W [rad].
    eccentricity : complex or ndarray of complex, shape (n,)
        Displacement of the wave generator's centre in the housing, runout included, x + iy [m].
    arc_offset : float
        s_0 [m].
    cup_torque : float or ndarray, shape (n,)
        M [N m].

    Returns
    -------
    ndarray, shape (n,)
        beta [rad]; the middle of a true gap at zero torque; nan if no flank can bear the torque.
    """
    turn, center, torque = _moments(wave_generator_angle, eccentricity, cup_torque)
    beta = np.empty(turn.size)
    c, tables = _constants(geometry)
    _kernel().torsion(c, tables, float(tooth_compliance), float(arc_offset), turn, center, torque, beta)
    return beta


def torsion_table(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    cup_torque: Floats,
    branch: int = 0,
) -> Floats:
    """Torsion at the same rising torques at every moment: the contacts are solved and sorted once per moment.

    Parameters
    ----------
    geometry, tooth_compliance, wave_generator_angle, eccentricity, arc_offset
        As for :func:`torsion`.
    cup_torque : ndarray, shape (q,)
        M [N m], rising.
    branch : {-1, 0, 1}
        What stands at zero torque in a true gap: its lower end (limit from negative torque), middle, upper end.

    Returns
    -------
    ndarray, shape (n, q)
        beta [rad].

    Raises
    ------
    ValueError
        If the torques do not rise.
    """
    torque = np.ascontiguousarray(cup_torque, dtype=np.float64)
    if not np.all(torque[1:] >= torque[:-1]):
        raise ValueError("torsion_table: cup_torque must rise [N m]")
    turn, center, _ = _moments(wave_generator_angle, eccentricity, 0.0)
    beta = np.empty((turn.size, torque.size))
    c, tables = _constants(geometry)
    _kernel().torsion_table(
        c, tables, float(tooth_compliance), float(arc_offset), turn, center, torque, int(branch), beta
    )
    return beta


def torsion_and_gradient(
    geometry: Geometry,
    tooth_compliance: float,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float,
    cup_torque: float | Floats,
) -> tuple[Floats, Floats, Floats]:
    """Torsion, its stiffness and its derivatives by every parameter of the mesh, in one pass.

    Parameters
    ----------
    geometry, tooth_compliance, wave_generator_angle, eccentricity, arc_offset, cup_torque
        As for :func:`torsion`.

    Returns
    -------
    torsion : ndarray, shape (n,)
        beta [rad].
    stiffness : ndarray, shape (n,)
        dM/dbeta [N m/rad]; zero in a true gap.
    gradient : ndarray, shape (n, 7)
        Derivatives of beta by :data:`PARAMETERS`: E_x, E_y in the housing [rad/m], r_0 [rad/m], K1 + K2 [rad N/m],
        s_0 [rad/m], M [rad/(N m)] (infinite in a true gap), theta_W at constant E [-].

    Notes
    -----
    ``K d beta = sum over loaded flanks of +-(k db - (beta - b) dk)``: by the envelope theorem db is the motion along the
    contact's normal over the lever arm; ``k = (r cos alpha)^2 / (K1 + K2)`` changes, for conformal arcs turn their
    normal fast. The tip radii stay when the datum moves.
    """
    turn, center, torque = _moments(wave_generator_angle, eccentricity, cup_torque)
    beta, stiffness, gradient = np.empty(turn.size), np.empty(turn.size), np.empty((turn.size, len(PARAMETERS)))
    c, tables = _constants(geometry)
    _kernel().torsion_and_gradient(
        c, tables, float(tooth_compliance), float(arc_offset), turn, center, torque, beta, stiffness, gradient
    )
    return beta, stiffness, gradient


def contacts(
    geometry: Geometry,
    wave_generator_angle: Floats,
    eccentricity: complex | Complexes,
    arc_offset: float = 0.0,
) -> Contact:
    """Contacts of the tooth pairs near both lobes, as ``clearance.contacts`` gives them.

    Parameters
    ----------
    geometry, wave_generator_angle, eccentricity, arc_offset
        As for :func:`torsion`.

    Returns
    -------
    Contact
    """
    turn, center, _ = _moments(wave_generator_angle, eccentricity, 0.0)
    kernel, (c, tables) = _kernel(), _constants(geometry)
    reach = kernel.reach(c, tables.distances, float(np.max(np.abs(center), initial=0.0)))
    width = 2 * kernel.width(c, reach)
    indices, values = np.empty((2, turn.size, width), dtype=np.int64), np.empty((4, turn.size, 2, width))
    kernel.contacts(c, tables, float(arc_offset), turn, center, reach, indices, values)
    return Contact(*indices, *values)


def _moments(turn: Floats, eccentricity: complex | Complexes, torque: float | Floats) -> tuple[Floats, Complexes, Floats]:
    angle = np.ascontiguousarray(turn, dtype=np.float64)
    return angle, _each(eccentricity, np.complex128, angle.shape), _each(torque, np.float64, angle.shape)


def _each(values: object, dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray[np.generic]:
    """One value per moment, contiguous: kernels are compiled for one layout only."""
    given = np.asarray(values, dtype=dtype)
    return np.ascontiguousarray(given) if given.shape == shape else np.full(shape, given)


@functools.lru_cache(maxsize=64)
def _constants(geometry: Geometry) -> tuple[Constants, Tables]:
    kernel, curve = _kernel(), geometry.curve
    tooth, wall, datum = geometry.flexspline_tooth, geometry.circular_spline_slot, geometry.circular_spline_datum
    tip = (geometry.flexspline_tip, tooth.half_width(geometry.flexspline_tip))
    wall_tip = _wall_tip(geometry)
    constants = kernel.Constants(
        semi_major=curve.semi_major,
        semi_minor=curve.semi_minor,
        curve_radius=curve.radius,
        tooth_pitch=geometry.tooth_pitch,
        slot_pitch=geometry.slot_pitch,
        turn_ratio=1.0 + 1.0 / geometry.reduction,
        pitch_height=0.5 * (geometry.flexspline_root + geometry.flexspline_tip),
        slack=_JOINT_SLACK,
        tip_x=tip[0],
        tip_y=tip[1],
        tooth_addendum=_arc(tooth.addendum_center, tooth.addendum_radius, 0.0),
        tooth_dedendum=_arc(tooth.dedendum_center, tooth.dedendum_radius, 0.0),
        tooth_line=_line(tooth, 0.0),
        wall_addendum=_arc(wall.addendum_center, wall.addendum_radius, datum),
        wall_dedendum=_arc(wall.dedendum_center, wall.dedendum_radius, datum),
        wall_line=_line(wall, datum),
        wall_tip=geometry.circular_spline_tip_radius,
        wall_tip_x=wall_tip.real,
        wall_tip_y=wall_tip.imag,
        wall_tip_datum=_wall_tip_datum(geometry, wall_tip),
        flexspline_teeth=geometry.flexspline_teeth,
        circular_spline_teeth=geometry.circular_spline_teeth,
    )
    pitches = np.arange(geometry.flexspline_teeth // 2) * geometry.tooth_pitch
    return constants, kernel.Tables(curve.harmonics, np.stack((np.cos(pitches), np.sin(pitches))), _distances(geometry))


def _distances(geometry: Geometry) -> Floats:
    """Angles from a lobe [rad] and how far out a tooth there ends [m]: what bounds the teeth in reach."""
    tip = geometry.flexspline_tip
    depth = math.hypot(geometry.semi_major + tip, geometry.flexspline_tooth.half_width(tip)) - geometry.semi_major
    u = np.linspace(0.0, np.pi / 2, 181)
    _, height, offset = tooth_axes(geometry.curve, u)
    return np.stack((u, np.hypot(height, offset) + depth))


def _arc(center: tuple[float, float], radius: float, datum: float) -> Arc:
    x, y = center[0] + datum, center[1]
    arc: Arc = _kernel().Arc(x, y, math.hypot(x, y), radius)
    return arc


def _line(flank: DoubleArc, datum: float) -> Line:
    (outer_x, outer_y), (inner_x, inner_y) = flank.addendum_joint, flank.dedendum_joint
    outer_x, inner_x = outer_x + datum, inner_x + datum
    distance = flank.normal[0] * outer_x + flank.normal[1] * outer_y
    line: Line = _kernel().Line(
        *flank.normal,
        distance,
        outer_x,
        outer_y,
        math.hypot(outer_x, outer_y),
        inner_x,
        inner_y,
        math.hypot(inner_x, inner_y),
    )
    return line


def _wall_tip(geometry: Geometry) -> complex:
    """Where the slot's wall begins, slot frame about the axis [m]."""
    wall, tip = geometry.circular_spline_slot, geometry.circular_spline_tip_radius
    center = complex(wall.dedendum_center[0] + geometry.circular_spline_datum, wall.dedendum_center[1])
    q, distance = abs(center), wall.dedendum_radius
    lens = 2.0 * math.asin(math.sqrt((distance - tip + q) * (distance + tip - q) / (4.0 * tip * q)))
    return cmath.rect(tip, cmath.phase(center) - lens)


def _wall_tip_datum(geometry: Geometry, tip: complex) -> float:
    """Derivative of the wall's angle at its tip by the datum radius [rad/m]: it slides along the tip circle."""
    wall = geometry.circular_spline_slot
    normal = tip - complex(wall.dedendum_center[0] + geometry.circular_spline_datum, wall.dedendum_center[1])
    return normal.real / (tip.real * normal.imag - tip.imag * normal.real)
