"""Clearance of one tooth pair by brute force, tabulated once per design over all places and displacements.

In the ideal drive the pose of a tooth in its slot depends on one number, its place u on the neutral curve
(angle from the long axis). All assembly errors add a translation (dx, dy) of the tooth in the slot's frame,
x along the slot's axis away from the centre, y counter-clockwise. The table holds the rotation b(u, dx, dy)
of the cup that closes the + flank. The - flank is its mirror image, b(-u, dx, -dy).
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from reference import polyline

from challenge.design import Array, Design

STEPS = 8  # nodes of u per tooth pitch
REACH = 0.175  # share of the teeth on each side of the long axis that can touch
FARTHEST = 70e-6  # [m], largest displacement; this and all lengths here are for size 25
DX_STEP = 5e-6
DX = np.arange(-14, 15)
DY = np.linspace(-1, 1, 5)
DATUM_STEP = 12e-6
DATUM = np.arange(-3, 4)
TOOTH_POINTS, WALL_POINTS = 400, 8000
NEVER = 1.0  # [rad], clearance of a pair that cannot touch
_KEPT = 30 * 86400.0  # [s]; tables unread for longer are deleted


@dataclass(frozen=True)
class Pose:
    """Poses of a tooth in its slot's frame, arrays (2, n): origin [m] and unit axis."""

    origin: Array
    axis: Array

    @property
    def along(self) -> Array:
        """Unit vectors (2, n) along the neutral curve, counter-clockwise."""
        return np.array([-self.axis[1], self.axis[0]])


def reach(design: Design) -> int:
    """Number of teeth on each side of the long axis that can touch."""
    return round(REACH * design.teeth)


def nodes(design: Design) -> NDArray[np.intp]:
    """Places u of the table, in units of a tooth pitch over STEPS."""
    last = STEPS * (reach(design) + 1) + 1
    return np.arange(-last, last + 1)


def ideal_pose(design: Design) -> Pose:
    """Poses at all nodes of a tooth of the ideal drive."""
    u = nodes(design) * design.tooth_pitch / STEPS
    point, normal = polyline.neutral_point(design.ring_radius * u, design.shape)
    turn = -u * design.teeth / design.slots  # angle of the long axis in the slot's frame
    c, s = np.cos(turn), np.sin(turn)
    rotate = np.array([[c, -s], [s, c]])
    return Pose(np.einsum("ijn,jn->in", rotate, point), np.einsum("ijn,jn->in", rotate, normal))


def tip(design: Design, pose: Pose, dx: Array, dy: Array) -> Array:
    """Radius [m] of the tip corner of the + flank."""
    x, y = _tooth(design.shape)[:, -1]
    body = pose.origin + pose.axis * x + pose.along * y
    return np.hypot(body[0] + dx, body[1] + dy)


def _tooth(shape: polyline.Drive) -> Array:
    return polyline._flank(shape.tooth, shape.tooth_root, shape.tooth_tip, TOOTH_POINTS)


def _wall(design: Design, datum: float) -> tuple[Array, Array]:
    """Radius [m] and angle [rad] of the + wall.

    A straight line continues the wall inwards, so that clearance stays smooth for pairs out of reach.
    """
    drive = dataclasses.replace(design.shape, circular_spline_datum=datum)
    radius, angle = polyline._slot_polar(drive, WALL_POINTS)
    slope = (angle[20] - angle[0]) / (radius[20] - radius[0])
    inner = radius[0] - 0.3e-3 * design.module
    return np.r_[inner, radius], np.r_[angle[0] + slope * (inner - radius[0]), angle]


def _closing(radius: Array, angle: Array, wall: tuple[Array, Array]) -> Array:
    """Least angle (n,) from polylines (n, points) to the wall, outwards from the lower of both tips."""
    first = wall[0][1]
    low = np.minimum(first, radius[:, -1:])
    gap = np.where(radius >= low, np.interp(radius, *wall) - angle, np.inf).min(axis=1)
    # The wall's tip corner against the tooth segment that faces it.
    after = np.clip(np.argmax(radius >= first, axis=1), 1, None)
    rows = np.arange(len(radius))
    r0, r1, a0, a1 = (v[rows, i] for v in (radius, angle) for i in (after - 1, after))
    corner = wall[1][1] - (a0 + (a1 - a0) * (first - r0) / (r1 - r0))
    return np.where(radius[:, -1] > first, np.minimum(gap, corner), gap)


def calculated(design: Design) -> Array:
    """Table (datum, u, dx, dy) of b [rad] by brute force."""
    walls = [_wall(design, d) for d in data(design)]
    x, y = _tooth(design.shape)
    pose = ideal_pose(design)
    k = design.module
    moves = np.stack(np.meshgrid(k * DX_STEP * DX, k * FARTHEST * DY, indexing="ij"), axis=-1).reshape(-1, 2)
    count = pose.origin.shape[1]
    found = np.empty((len(DATUM), count, len(moves)))
    for n in range(count):
        body = pose.origin[:, n, None] + np.outer(pose.axis[:, n], x) + np.outer(pose.along[:, n], y)
        bx, by = body[0] + moves[:, :1], body[1] + moves[:, 1:]
        radius, angle = np.hypot(bx, by), np.arctan2(by, bx)
        found[:, n] = [_closing(radius, angle, wall) for wall in walls]
    return found.reshape(len(DATUM), count, len(DX), len(DY))


def data(design: Design) -> Array:
    """Radii from which slots are measured, those of the table [m]."""
    return design.shape.circular_spline_datum + design.module * DATUM_STEP * DATUM


def _key(design: Design) -> str:
    sources = Path(__file__).read_bytes() + Path(polyline.__file__).read_bytes()
    shape = dataclasses.replace(design.shape, tooth_compliance=0.0)
    return hashlib.sha256(sources + repr(shape).encode()).hexdigest()[:16]


def cache_folder() -> Path:
    """Folder in the user's cache for the tables."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hd_diag-challenge"


@functools.lru_cache(maxsize=4)
def table(design: Design) -> Array:
    """Table of :func:`calculated`, cached on disk."""
    path = cache_folder() / f"{design.name.replace('/', '-')}-{_key(design)}.npy"
    if path.exists():
        path.touch()
        return np.load(path)
    found = calculated(design)
    path.parent.mkdir(parents=True, exist_ok=True)
    for old in path.parent.glob("*.npy"):
        if old.stat().st_mtime < time.time() - _KEPT:
            old.unlink(missing_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
        np.save(file, found)
    os.replace(file.name, path)  # atomic, also if two runs calculate the table
    return found


# Interpolation ---


def _cubic(t: Array) -> tuple[Array, Array]:
    """Lagrange weights (..., 4) of nodes -1, 0, 1, 2 at t, and their derivative."""
    d = (-(3 * t**2 - 6 * t + 2) / 6, (3 * t**2 - 4 * t - 1) / 2)
    d += (-(3 * t**2 - 2 * t - 2) / 2, (3 * t**2 - 1) / 6)
    return np.stack(weights(t), axis=-1), np.stack(d, axis=-1)


def weights(t: Array) -> tuple[Array, Array, Array, Array]:
    """Lagrange weights of nodes -1, 0, 1, 2 at t, without derivative."""
    return (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )


def _cell(x: Array, first: float, step: float, count: int) -> tuple[Array, Array]:
    position = (x - first) / step
    cell = np.clip(np.floor(position).astype(int), 1, count - 3)
    return cell, position - cell


def at_datum(design: Design, datum: float) -> Array:
    """Polynomials (u, dx, 5) in dy / farthest dy, highest power first, at a datum [m]."""
    radii = data(design)
    if not radii[0] <= datum <= radii[-1]:
        raise ValueError(f"datum {datum} m lies outside the table, {radii[0]} to {radii[-1]} m")
    cell, t = _cell(np.array(datum), radii[0], design.module * DATUM_STEP, len(DATUM))
    plane = np.tensordot(_cubic(t)[0], table(design)[int(cell) - 1 : int(cell) + 3], axes=1)
    return plane @ np.linalg.inv(np.vander(DY, len(DY))).T


@dataclass(frozen=True)
class Clearance:
    """Clearance of the + flank: rotation that closes it [rad], and its gradient [rad/m] by dx and dy."""

    rotation: Array
    by_dx: Array
    by_dy: Array


def interpolated(
    plane: Array, node: NDArray[np.intp], dx: Array, dy: Array, module: float = 1.0
) -> Clearance:
    """Clearance at node indices and displacements [m], arrays of one shape."""
    most, step, farthest = max(np.abs(dx).max(), np.abs(dy).max()), module * DX_STEP, module * FARTHEST
    if most > farthest:
        raise ValueError(f"displacement of {most} m lies outside the table")
    cell, t = _cell(dx, step * DX[0], step, len(DX))
    weight, slope = _cubic(t)
    y = dy / farthest
    out = np.zeros((3, *np.shape(dx)))
    for tap in range(4):
        c = plane[node, cell - 1 + tap]
        value = (((c[..., 0] * y + c[..., 1]) * y + c[..., 2]) * y + c[..., 3]) * y + c[..., 4]
        by_y = ((4 * c[..., 0] * y + 3 * c[..., 1]) * y + 2 * c[..., 2]) * y + c[..., 3]
        out[0] += weight[..., tap] * value
        out[1] += slope[..., tap] * value / step
        out[2] += weight[..., tap] * by_y / farthest
    return Clearance(*out)
