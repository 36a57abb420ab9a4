"""Flank of any profile: a chain of arcs and lines, given as such or fitted to points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Complexes
from hd_diag.model.tooth_profile import DoubleArc

TOLERANCE = 1e-7
"""Distance within which a chain follows points [m]: 0.1 µm, the accuracy of flank measurements."""

_STRAIGHT = 1e-6  # [rad]; a piece that turns less is a line
_SMOOTH = 1e-3  # [rad]; allowed change of direction where two pieces meet
_FEWEST = 4  # least number of points of a flank


class Piece(NamedTuple):
    """Arc or line of a flank, from the root to the tip.

    Attributes
    ----------
    radius : float
        [m]; positive where the tooth bulges, negative where it is hollow, 0 for a line.
    x, y : float
        Centre of an arc [m]; for a line, the unit normal out of the tooth.
    start, end : complex
        Ends of the piece, x + iy [m].
    """

    radius: float
    x: float
    y: float
    start: complex
    end: complex

    def normal(self, point: complex) -> complex:
        """Unit normal out of the tooth at a point of the piece."""
        if not self.radius:
            return complex(self.x, self.y)
        return (point - complex(self.x, self.y)) / self.radius


@dataclass(frozen=True)
class FlankChain:
    """Counter-clockwise flank as arcs and lines that join smoothly; x outward, y counter-clockwise.

    Parameters
    ----------
    numbers : tuple of float
        ``x, y`` of the root, then for each piece its radius and ``x, y`` of its end [m]. A positive radius
        bulges out of the tooth (or slot), a negative one is hollow, 0 is a line. x rises from root to tip.

    Raises
    ------
    ValueError
        If the numbers make no chain, or the chain turns back or has a corner.
    """

    numbers: tuple[float, ...]

    def __post_init__(self) -> None:
        count = len(self.numbers)
        if count < 5 or count % 3 != 2:
            raise ValueError(
                "a chain takes x, y of the root and radius, x, y of each piece: 5, 8, 11 ... numbers, "
                f"not {count}"
            )
        if not all(map(math.isfinite, self.numbers)):
            raise ValueError("every length of a chain must be finite")
        for before, after in pairwise(self.numbers[::3]):
            if not after > before:
                raise ValueError(f"the chain turns back at x = {before:.6g} m: x must rise from root to tip")
        for one, other in pairwise(self.pieces):
            if abs(one.normal(one.end) - other.normal(other.start)) > _SMOOTH:
                raise ValueError(f"the chain has a corner at x = {one.end.real:.6g} m")

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """Arcs and lines from root to tip."""
        ends = [complex(x, y) for x, y in zip(self.numbers[::3], self.numbers[1::3], strict=True)]
        radii = self.numbers[2::3]
        return tuple(_piece(r, *between) for r, between in zip(radii, pairwise(ends), strict=True))

    @property
    def start(self) -> float:
        """Height where the chain begins [m]."""
        return self.numbers[0]

    @property
    def end(self) -> float:
        """Height where the chain ends [m]."""
        return self.numbers[-2]

    def covers(self, low: float, high: float) -> bool:
        """Whether the chain reaches from height `low` to `high` [m], within :data:`TOLERANCE`."""
        return self.start - TOLERANCE <= low <= high <= self.end + TOLERANCE

    def half_width(self, x: float) -> float:
        """Half the tooth's or slot's width at height `x` in the flank's frame [m]; nan beyond its ends."""
        if not self.covers(x, x):
            return math.nan
        piece = next((piece for piece in self.pieces if x <= piece.end.real), self.pieces[-1])
        if not piece.radius:
            return piece.start.imag - (x - piece.start.real) * piece.x / piece.y
        reach = piece.radius**2 - (x - piece.x) ** 2
        return piece.y + math.copysign(math.sqrt(max(reach, 0.0)), piece.radius)


def _piece(radius: float, start: complex, end: complex) -> Piece:
    """Arc or line between two points; an arc that bulges has its centre on the tooth's side."""
    chord = end - start
    normal = 1j * chord / abs(chord)
    if not radius:
        return Piece(0.0, normal.real, normal.imag, start, end)
    reach = radius**2 - 0.25 * abs(chord) ** 2
    if not reach >= 0.0:
        raise ValueError(
            f"the arc of radius {abs(radius):.6g} m from x = {start.real:.6g} m is too small for its ends, "
            f"{abs(chord):.6g} m apart"
        )
    centre = 0.5 * (start + end) - math.copysign(math.sqrt(reach), radius) * normal
    return Piece(radius, centre.real, centre.imag, start, end)


def chained(flank: DoubleArc | FlankChain, start: float, end: float) -> FlankChain:
    """A flank as a chain; a double arc is cut to the heights `start` and `end` [m]."""
    if isinstance(flank, FlankChain):
        return flank
    inner, outer = flank.dedendum_joint, flank.addendum_joint
    root, tip = (start, flank.half_width(start)), (end, flank.half_width(end))
    return FlankChain((*root, -flank.dedendum_radius, *inner, 0.0, *outer, flank.addendum_radius, *tip))


@lru_cache(maxsize=16)
def chain_of_points(points: tuple[float, ...], tolerance: float = TOLERANCE) -> FlankChain:
    """Chain of biarcs that follows points of a drawing or of a measuring machine.

    Parameters
    ----------
    points : tuple of float
        x, y of each point in turn, from root to tip [m].
    tolerance : float
        Greatest distance of a point from the chain [m].

    Raises
    ------
    ValueError
        If there are too few points, their heights do not rise, or the chain turns back or has a corner.

    Notes
    -----
    A smoothing spline, whose rms distance from the points is at most a quarter of the tolerance, gives the
    directions. Each biarc spans as many points of the spline as it follows within half the tolerance.
    Biarcs: Bolton, Computer-Aided Design 7(2), 1975.
    """
    if len(points) < 2 * _FEWEST or len(points) % 2:
        raise ValueError(
            f"a flank needs at least {_FEWEST} points, x and y of each; {len(points)} numbers given"
        )
    place = np.array(points[::2]) + 1j * np.array(points[1::2])
    if not (np.all(np.isfinite(place)) and np.all(np.diff(place.real) > 0.0)):
        raise ValueError("points of a flank must be finite, and their heights x rise from root to tip")
    place, way = _smoothed(place, tolerance)
    numbers, first = [place[0].real, place[0].imag], 0
    while first < place.size - 1:
        last = _farthest(place, way, first, tolerance)
        for piece in _biarc(place[first], way[first], place[last], way[last]):
            numbers += [piece.radius, piece.end.real, piece.end.imag]
        first = last
    return FlankChain(tuple(map(float, numbers)))


def _smoothed(place: Complexes, tolerance: float) -> tuple[Complexes, Complexes]:
    """Points of a smoothing spline at the given points, and the spline's unit directions there."""
    from scipy.interpolate import splev, splprep  # imported here: it takes a third of a second

    scale = float(np.abs(place[-1] - place[0]))
    wanted = place.size * (0.25 * tolerance / scale) ** 2
    spline, at = splprep([place.real / scale, place.imag / scale], s=wanted, k=min(5, place.size - 1))
    x, y = splev(at, spline)
    dx, dy = splev(at, spline, der=1)
    way = np.asarray(dx) + 1j * np.asarray(dy)
    return scale * (np.asarray(x) + 1j * np.asarray(y)), way / np.abs(way)


def _farthest(place: Complexes, way: Complexes, first: int, tolerance: float) -> int:
    """Index of the last point up to which one biarc from `first` follows all points."""
    good, step = first + 1, 1
    while good + step < place.size or step > 1:
        trial = min(good + step, place.size - 1)
        if trial > good and _follows(place, way, first, trial, tolerance):
            good, step = trial, 2 * step
        elif step > 1:
            step //= 2
        else:
            break
        if good == place.size - 1:
            break
    return good


def _follows(place: Complexes, way: Complexes, first: int, last: int, tolerance: float) -> bool:
    pieces = _biarc(place[first], way[first], place[last], way[last])
    if not pieces or any(not piece.end.real > piece.start.real for piece in pieces):
        return False
    between = place[first + 1 : last]
    heights = np.array([piece.end.real for piece in pieces[:-1]])
    number = np.searchsorted(heights, between.real)
    for k, piece in enumerate(pieces):
        own = between[number == k]
        if piece.radius:
            off = np.abs(np.abs(own - complex(piece.x, piece.y)) - abs(piece.radius))
        else:
            off = np.abs(((own - piece.start) * complex(piece.x, -piece.y)).real)
        if np.any(off > 0.5 * tolerance):
            return False
    return True


def _biarc(start: complex, way: complex, end: complex, last_way: complex) -> list[Piece]:
    """Two arcs that join smoothly, between points with given directions; the tangent legs are equal."""
    chord, both = end - start, way + last_way
    turned = 2.0 * (1.0 - (way * last_way.conjugate()).real)
    along, square = (chord * both.conjugate()).real, abs(chord) ** 2
    if turned < 1e-12:
        leg = square / (4.0 * (chord * last_way.conjugate()).real)
    else:
        leg = (math.sqrt(along**2 + turned * square) - along) / turned
    joint = 0.5 * (start + end + leg * (way - last_way))
    return [
        _piece(_radius(start, way, joint), start, joint),
        _piece(_radius(end, last_way, joint), joint, end),
    ]


def _radius(point: complex, way: complex, other: complex) -> float:
    """Signed radius of the arc through two points with a given direction at the first; 0 for a line."""
    across = ((other - point) * (1j * way).conjugate()).real
    curvature = -2.0 * across / abs(other - point) ** 2  # positive where it turns away from the normal
    return 0.0 if abs(curvature * (other - point)) < _STRAIGHT else 1.0 / curvature
