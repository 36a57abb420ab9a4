"""Brute-force mesh of a harmonic drive: flanks are polylines, compared point by point for clearance.

This independent calculation tests the closed forms of the model. It imports nothing of hd_diag and shares
only the statement of the problem with it (the paper: Dong, Chen, Wang, Dong, "Kinematic Model of Harmonic
Drive in Robot Joints with Input Eccentricity Error", ROMANSY 22, 2019, doi 10.1007/978-3-319-78963-7_18).
SI units, angles counter-clockwise, origin on the circular-spline axis.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize_scalar

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """Double circular arc of one flank, x outward along the symmetry axis, y towards the flank [m].

    The addendum centre lies beyond the axis (y = -addendum_offset), the dedendum centre on the flank's side.
    """

    addendum_radius: float
    dedendum_radius: float
    addendum_centre: float
    dedendum_centre: float
    addendum_offset: float
    dedendum_offset: float


@dataclass(frozen=True)
class Outline:
    """Any flank: alternating x and y of its points [m], dense enough to be straight in between."""

    numbers: tuple[float, ...]

    def part(self, x_inner: float, x_outer: float, points: int) -> Array:
        """Polyline (2, points) from one x to another, interpolated by a cubic spline."""
        x = np.linspace(x_inner, x_outer, points)
        return np.array([x, CubicSpline(self.numbers[::2], self.numbers[1::2])(x)])


@dataclass(frozen=True)
class Drive:
    """All numbers of the paper's example (Table 1 and section 4), and the two that it does not print [SI]."""

    tooth: Profile | Outline = Profile(0.2031e-3, 0.5046e-3, 0.7625e-3, 0.6929e-3, 0.0548e-3, 0.6557e-3)
    slot: Profile | Outline = Profile(0.2313e-3, 0.4357e-3, 1.2201e-3, 1.2791e-3, 0.0782e-3, 0.5886e-3)
    tooth_root: float = 0.4e-3
    tooth_tip: float = 0.8519e-3
    semi_major: float = 30.2584e-3
    semi_minor: float = 29.7404e-3
    flexspline_teeth: int = 200
    circular_spline_teeth: int = 202
    circular_spline_datum: float = 29.868e-3
    circular_spline_tip_radius: float = 30.7755e-3
    tooth_compliance: float = 1e-6
    cam: Callable[[Array], tuple[Array, Array]] | None = None  # replaces the ellipse; radius 30 mm


DEFAULT = Drive()


@dataclass(frozen=True)
class Mesh:
    """All tooth pairs at one moment, arrays (2, Z_R), flanks + and -; nan where a pair cannot touch."""

    rotation: Array
    backlash: Array
    radius: Array
    pressure_angle: Array


def _joint_angle(p: Profile) -> float:
    """Normal direction (sin u, cos u) of the common tangent [rad], where the support lines coincide.

    Two inner tangents exist. The flank has the one along which x grows from the dedendum to the addendum arc.
    """

    def distance(u: float) -> float:
        n = np.array([np.sin(u), np.cos(u)])
        outer = n @ (p.addendum_centre, -p.addendum_offset) + p.addendum_radius
        inner = n @ (p.dedendum_centre, p.dedendum_offset) - p.dedendum_radius
        return float(outer - inner)

    turn = minimize_scalar(distance, bounds=(-0.8, 0.8), method="bounded").x
    return float(brentq(distance, turn, 0.8, xtol=1e-15))


@functools.lru_cache(maxsize=64)
def _flank(p: Profile | Outline, x_inner: float, x_outer: float, points: int) -> Array:
    """Polyline (2, points) [m] from x_inner to x_outer: dedendum arc, straight line, addendum arc."""
    if isinstance(p, Outline):
        return p.part(x_inner, x_outer, points)
    u = _joint_angle(p)
    sin_in = (p.dedendum_centre - x_inner) / p.dedendum_radius
    sin_out = (x_outer - p.addendum_centre) / p.addendum_radius
    a, b = np.arcsin(sin_in), np.arcsin(sin_out)
    lower = np.linspace(a, u, points // 2)
    upper = np.linspace(u, b, points - points // 2 - points // 8)
    dedendum = (
        p.dedendum_centre - p.dedendum_radius * np.sin(lower),
        p.dedendum_offset - p.dedendum_radius * np.cos(lower),
    )
    addendum = (
        p.addendum_centre + p.addendum_radius * np.sin(upper),
        p.addendum_radius * np.cos(upper) - p.addendum_offset,
    )
    line = np.linspace(0, 1, points // 8 + 2)[1:-1]
    joint = [d[-1] + line * (e[0] - d[-1]) for d, e in zip(dedendum, addendum, strict=True)]
    return np.array([np.concatenate(parts) for parts in zip(dedendum, joint, addendum, strict=True)])


@functools.lru_cache(maxsize=64)
def _slot_polar(drive: Drive, points: int) -> tuple[Array, Array]:
    """Radius [m] and angle [rad] of the + wall of a slot, from the tip circle to the slot's axis."""
    p, datum = drive.slot, drive.circular_spline_datum
    if isinstance(p, Outline):
        x, y = p.part(p.numbers[0], p.numbers[-2], 4 * points)
        inside = np.hypot(datum + x, y) >= drive.circular_spline_tip_radius
        first = int(np.argmax(inside))
        radius, angle = np.hypot(datum + x, y), np.arctan2(y, datum + x)
        tip = float(np.interp(drive.circular_spline_tip_radius, radius, angle))
        return np.append(drive.circular_spline_tip_radius, radius[first:]), np.append(tip, angle[first:])

    def beyond_tip(x: float) -> float:
        y = p.dedendum_offset - np.sqrt(max(p.dedendum_radius**2 - (x - p.dedendum_centre) ** 2, 0.0))
        return float(np.hypot(datum + x, y)) - drive.circular_spline_tip_radius

    x_tip = brentq(beyond_tip, p.dedendum_centre - p.dedendum_radius, p.dedendum_centre, xtol=1e-18)
    x_root = p.addendum_centre + np.sqrt(p.addendum_radius**2 - p.addendum_offset**2)
    x, y = _flank(p, x_tip, x_root, points)
    return np.hypot(datum + x, y), np.arctan2(y, datum + x)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_PANELS = 400


def _speed(t: Array, major: float, minor: float) -> Array:
    return np.hypot(major * np.sin(t), minor * np.cos(t))


def _length(start: Array, end: Array, major: float, minor: float) -> Array:
    """Arc length [m] between two parameters by Gauss-Legendre quadrature."""
    half = (end - start) / 2
    t = (start + end)[..., None] / 2 + half[..., None] * _NODES
    return half * (_speed(t, major, minor) @ _WEIGHTS)


@functools.lru_cache(maxsize=64)
def _arc_table(major: float, minor: float) -> tuple[Array, Array]:
    t = np.linspace(0, 2 * np.pi, _PANELS + 1)
    return t, np.concatenate([[0], np.cumsum(_length(t[:-1], t[1:], major, minor))])


def cosine_ring(deformation: float, angle: Array) -> tuple[Array, Array]:
    """Displacement (radial, along the ring) ``w0 cos 2 phi`` of an inextensible ring at angles [rad]."""
    return deformation * np.cos(2 * angle), -deformation / 2 * np.sin(2 * angle)


def four_forces_ring(deformation: float, force: float, angle: Array) -> tuple[Array, Array]:
    """Displacement by four forces at an angle [rad] from the long axis; series summed to rounding error."""
    n = np.arange(2, 4000, 2)
    size = np.cos(n * force) / (n**2 - 1.0) ** 2
    size *= deformation / size.sum()
    turn = np.exp(2j * angle)  # the series is a polynomial in this, by Horner's rule
    radial, along = (np.polyval([*each[::-1], 0.0], turn) for each in (size, size / n))
    return radial.real, -along.imag


RING_RADIUS = 30e-3
"""Radius of the displaced rings [m]."""


@functools.lru_cache(maxsize=16)
def _ring(cam: Callable[[Array], tuple[Array, Array]]) -> tuple[Array, Array, Array]:
    """Arc length, points and normals (x + iy) of a displaced ring; a parallel curve restores its length."""
    angle = np.linspace(0, 2 * np.pi, 40_001)
    radial, along = cam(angle)
    points = (RING_RADIUS + radial + 1j * along) * np.exp(1j * angle)
    slope = np.gradient(np.concatenate((points[-3:-1], points, points[1:3])))[2:-2]
    normals = -1j * slope / np.abs(slope)
    points = points - (np.abs(np.diff(points)).sum() / (2 * np.pi) - RING_RADIUS) * normals
    return np.concatenate(([0.0], np.abs(np.diff(points)).cumsum())), points, normals


def ring_radius(drive: Drive = DEFAULT) -> float:
    """R_b [m]: radius of the undeformed neutral circle, whose length equals that of the curve."""
    if drive.cam is not None:
        return RING_RADIUS
    return float(_arc_table(drive.semi_major, drive.semi_minor)[1][-1] / (2 * np.pi))


def neutral_point(arc: Array, drive: Drive = DEFAULT) -> tuple[Array, Array]:
    """Points (2, n) [m] and outward unit normals (2, n) at arc lengths from the long axis [m]."""
    if drive.cam is not None:
        length, points, normals = _ring(drive.cam)
        at = np.mod(arc, length[-1])
        found = np.array([np.interp(at, length, each) for each in (points, normals)])
        return np.array([found[0].real, found[0].imag]), np.array([found[1].real, found[1].imag])
    major, minor = drive.semi_major, drive.semi_minor
    table_t, table_s = _arc_table(major, minor)
    s = np.mod(arc, table_s[-1])
    t = np.interp(s, table_s, table_t)
    panel = np.clip(np.searchsorted(table_s, s, side="right") - 1, 0, _PANELS - 1)
    for _ in range(4):
        error = table_s[panel] + _length(table_t[panel], t, major, minor) - s
        t = t - error / _speed(t, major, minor)
    normal = np.array([minor * np.cos(t), major * np.sin(t)])
    return np.array([major * np.cos(t), minor * np.sin(t)]), normal / np.hypot(*normal)


def _turned(angle: float, vectors: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(np.array([[c, -s], [s, c]]) @ vectors, dtype=np.float64)


def tooth_axes(
    wave_generator_angle: float,
    eccentricity: tuple[float, float] = (0.0, 0.0),
    runout: tuple[float, float] = (0.0, 0.0),
    arc_offset: float = 0.0,
    drive: Drive = DEFAULT,
) -> tuple[Array, Array]:
    """Neutral points (2, Z_R) [m] and outward normals (2, Z_R) of all teeth in the housing frame."""
    z_r, z_g = drive.flexspline_teeth, drive.circular_spline_teeth
    cup = -wave_generator_angle * (z_g - z_r) / z_r
    angle = cup + 2 * np.pi * np.arange(z_r) / z_r - wave_generator_angle
    point, normal = neutral_point(ring_radius(drive) * angle + arc_offset, drive)
    point = _turned(wave_generator_angle, point + np.reshape(runout, (2, 1)))
    return point + np.reshape(eccentricity, (2, 1)), _turned(wave_generator_angle, normal)


_WINDOW = 4e-6  # [m], smoothing width for a polyline's tangent: about twenty points, no visible bend


def _contact(tooth: tuple[Array, Array], wall: tuple[Array, Array]) -> tuple[float, float, float]:
    """Least angle wall - tooth [rad] of two polar polylines, its radius [m] and pressure angle [rad].

    The difference of two polylines is least at a point of either. A polyline that continues on both sides
    gives the tangent there: a tip corner touches with the other body's normal.
    """
    low, high = max(tooth[0][0], wall[0][0]), min(tooth[0][-1], wall[0][-1])
    if low >= high:
        return np.nan, np.nan, np.nan
    radii = np.concatenate([f[0][(f[0] >= low) & (f[0] <= high)] for f in (tooth, wall)])
    gap = np.interp(radii, *wall) - np.interp(radii, *tooth)
    best = int(np.argmin(gap))
    r = float(radii[best])
    if low + _WINDOW < r < high - _WINDOW:
        r = _lowest(radii, gap, r)
    slopes = [r * _local(f[0], f[1], r)[1] for f in (tooth, wall) if f[0][0] < r < f[0][-1]]
    return float(gap[best]), r, float(np.arctan(abs(np.mean(slopes))))


def _local(x: Array, y: Array, x_0: float) -> Array:
    """Parabola (value, slope, half the second derivative) through the points of a polyline near x_0."""
    near = np.abs(x - x_0) < _WINDOW
    return np.polynomial.polynomial.polyfit(x[near] - x_0, y[near], 2)


def _lowest(x: Array, y: Array, x_0: float) -> float:
    """Minimum of a polyline smoothed about its lowest point; a kink stays where it is."""
    _, slope, curvature = _local(x, y, x_0)
    step = -slope / (2 * curvature) if curvature > 0 else 0.0
    return x_0 + step if abs(step) < _WINDOW / 2 else x_0


def mesh(
    wave_generator_angle: float,
    eccentricity: tuple[float, float] = (0.0, 0.0),
    runout: tuple[float, float] = (0.0, 0.0),
    arc_offset: float = 0.0,
    drive: Drive = DEFAULT,
    points: int = 1600,
    slot_shift: Array | None = None,
) -> Mesh:
    """Clearance of all tooth pairs at one wave-generator angle [rad].

    Displacements of the wave generator [m]: `eccentricity` is fixed in the housing, `runout` turns with it
    and is given at angle 0. `arc_offset` moves the flexspline along the neutral curve, `slot_shift` (Z_G,)
    moves every slot counter-clockwise [m]. Each flank is a polyline of `points` points.
    """
    origin, normal = tooth_axes(wave_generator_angle, eccentricity, runout, arc_offset, drive)
    x, y = _flank(drive.tooth, drive.tooth_root, drive.tooth_tip, points)
    wall = _slot_polar(drive, points)
    shift = np.zeros(drive.circular_spline_teeth) if slot_shift is None else np.asarray(slot_shift)
    middle = origin + 0.5 * (drive.tooth_root + drive.tooth_tip) * normal
    pitch = 2 * np.pi / drive.circular_spline_teeth
    slot = np.rint(np.arctan2(middle[1], middle[0]) / pitch).astype(int)
    out = np.full((3, 2, drive.flexspline_teeth), np.nan)
    for side, sign in enumerate((1, -1)):
        across = np.array([-normal[1], normal[0]]) * sign
        body = origin[:, :, None] + normal[:, :, None] * x + across[:, :, None] * y
        radius = np.hypot(body[0], body[1])
        for i in np.flatnonzero(radius[:, -1] > wall[0][0]):
            c, s = np.cos(slot[i] * pitch), np.sin(slot[i] * pitch)
            angle = np.arctan2(c * body[1, i] - s * body[0, i], c * body[0, i] + s * body[1, i])
            moved = wall[1] + sign * shift[slot[i]] / wall[0]
            out[:, side, i] = _contact((radius[i], sign * angle), (wall[0], moved))
    return Mesh(out[0], out[0] * out[1], out[1], out[2])


def sections(
    wave_generator_angle: float,
    eccentricity: tuple[float, float],
    tilt: tuple[float, float],
    cup_length: float,
    places: Sequence[float],
    drive: Drive = DEFAULT,
) -> list[Mesh]:
    """Clearance in sections at places [m] from the middle one, positive towards the cup's open end.

    The ellipse's deformation in a section grows with its distance from the cup's bottom (cup length 0: same
    everywhere); its perimeter is kept. The tilt [rad] displaces the section's centre.
    """
    found = []
    for z in places:
        here = deformed(drive, cup_length, z)
        moved = (eccentricity[0] + tilt[0] * z, eccentricity[1] + tilt[1] * z)
        found.append(mesh(wave_generator_angle, moved, drive=here))
    return found


def deformed(drive: Drive, cup_length: float, z: float) -> Drive:
    """Section of a drive at a place [m] from the middle one; see :func:`sections`."""
    factor = 1 + z / cup_length if cup_length else 1.0
    ring, major = ring_radius(drive), drive.semi_major
    major = ring + factor * (major - ring)

    def longer(minor: float) -> float:
        return ring_radius(replace(drive, semi_major=major, semi_minor=minor)) - ring

    return replace(drive, semi_major=major, semi_minor=brentq(longer, 0.9 * ring, 1.1 * ring, xtol=1e-15))


def shared_torsion(
    meshes: Sequence[Mesh], weights: Sequence[float], torque: float, drive: Drive = DEFAULT
) -> float:
    """Torsion [rad] of parallel sections; ``weights`` are their shares of the width."""

    def excess(beta: float) -> float:
        held = -torque
        for m, weight in zip(meshes, weights, strict=True):
            arm = np.nan_to_num(m.radius * np.cos(m.pressure_angle))
            moment = (arm * loads(m, beta, drive)).sum(axis=1)
            held += weight * float(moment[0] - moment[1])
        return held

    return float(brentq(excess, -0.1, 0.1, xtol=1e-16, rtol=1e-14))


def loads(m: Mesh, torsion: float, drive: Drive = DEFAULT) -> Array:
    """Flank forces (2, Z_R) [N] at a torsion of the cup [rad]."""
    closing = np.array([[torsion], [-torsion]]) - m.rotation
    force = m.radius * np.cos(m.pressure_angle) * np.maximum(closing, 0) / drive.tooth_compliance
    return np.nan_to_num(force)


def torsion(m: Mesh, torque: float, drive: Drive = DEFAULT) -> float:
    """Torsion of the cup [rad] at which the flank forces hold a torque [N m]; at 0 the middle of a gap."""
    arm = np.nan_to_num(m.radius * np.cos(m.pressure_angle))

    def excess(beta: float) -> float:
        moment = (arm * loads(m, beta, drive)).sum(axis=1)
        return float(moment[0] - moment[1] - torque)

    gap = np.nanmin(m.rotation, axis=1)
    if torque == 0 and gap.sum() > 0:
        return float(gap[0] - gap[1]) / 2
    wide = 0.1 + np.nanmax(np.abs(m.rotation))
    return float(brentq(excess, -wide, wide, xtol=1e-16, rtol=1e-14))
