"""The smallest eccentricity or tilt that exceeds a criterion, over all directions and input angles.

A drive in sections may have a tilt. The search is then for the displacement of the outermost section, and
`leaning` is the tilt's share of it: 0 is an eccentricity alone, 1 a tilt alone, -0.5 half of each in opposite
directions.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.optimize import brentq

from hd_diag.arrays import Complexes, Floats, Integers
from hd_diag.drive import Drive
from hd_diag.model.geometry import Geometry
from hd_diag.model.mesh import Mesh, largest_displacement
from hd_diag.model.torsion import torsion
from hd_diag.tolerance.evaluation import CRITERIA, NAMES, evaluate, of_moments, reference_stiffness

STEPS = 60
"""Steps of the eccentricity in the search for the first excess."""

FINE_STEPS = 16
"""Parts into which the step of the first excess is divided, for a criterion that jumps."""

ROOT_TOLERANCE = 1e-10
"""Resolution of the displacement at which a limit is exceeded [m]."""

CHART_STEPS = 24
"""Steps of the displacement in a chart, which is linear between them."""

_MOST = 1e9  # replaces an infinite value where no flank can bear the torque: root finding needs finite ones
_ROUNDING = 1e-9  # share of a limit by which the worst value at its crossing may exceed it [-]

# A mesh that is turned by a slot pitch together with its eccentricity stays the same. The search therefore
# covers the eccentricity's angle from the long axis and the wave generator's angle within a pitch.
_SCAN = (36, 4)
_SEARCH, _SEARCH_OF_JUMPS = (72, 8), (72, 16)
_TURN_DIRECTIONS, _TURN_PHASES = 4, 6  # within a slot pitch: of the eccentricity, of the wave generator

_HILLS = 8  # most local maxima that are refined
_ROUNDS, _CLOSER, _BESIDE = 6, 3, 3  # of a refinement: grids, factor between their steps, points to each side
_ROOM = 0.8  # share of the possible displacement: runout and datum of an assembly need the rest

# In a mesh without runout each moment has images: mirrored, and with the lobes swapped. Values within this
# share of the greatest [-], which is more than the error of a refinement, are such images. The first one is
# taken, because rounding would choose a different one on another machine.
_IMAGE = 1e-4

RESOLUTION = tuple(
    extent / points / _CLOSER**_ROUNDS for extent, points in zip((2.0 * math.pi, 1.0), _SEARCH, strict=True)
)
"""Final step of the angle from the long axis [rad] and of the wave generator [slot pitch]."""


@dataclass(frozen=True)
class Worst:
    """Greatest value of a criterion at a displacement, and its place.

    Direction of the eccentricity, or of a tilt alone, in the housing, and wave generator angle theta_W [rad].
    Adding a slot pitch to both gives an equally bad moment.
    """

    value: float
    direction: float
    wave_generator_angle: float


@dataclass(frozen=True)
class DisplacementLimit:
    """Displacement at which a criterion is first exceeded.

    The largest eccentricity [m] and tilt [rad] within the limit in all directions, nan if the limit is not
    reached; the worst moment there, or at the largest displacement searched; the value `without` eccentricity
    and tilt; `scanned` (2, STEPS + 1): displacements of the outermost section [m] (eccentricities if there is
    no tilt), and the values on a coarse grid of direction and angle.
    """

    criterion: str
    limit: float
    eccentricity: float
    tilt: float
    worst: Worst
    without: float
    scanned: Floats

    @property
    def reached(self) -> bool:
        """Whether any displacement searched exceeds the limit."""
        return math.isfinite(self.eccentricity)


def input_angle(drive: Drive, wave_generator_angle: float) -> float:
    """Reported input angle [rad] for the wave generator angle theta_W [rad]."""
    return (wave_generator_angle - drive.frame.phase) / drive.frame.turning


def largest_eccentricity(drive: Drive) -> float:
    """Default range of the search [m]: a fifth of the module, at most 0.8 of the possible displacement."""
    geometry = drive.mesh.geometry
    return min(0.2 * geometry.module, _ROOM * largest_displacement(geometry)[0])


def divided(geometry: Geometry, displacement: float, leaning: float) -> tuple[float, float]:
    """Eccentricity [m] and tilt [rad] that displace the outermost section [m], given the tilt's share.

    A negative share tilts against the eccentricity. With one section the share must be 0.
    """
    arm = float(np.abs(geometry.section_places).max())
    return displacement * (1.0 - abs(leaning)), displacement * (leaning / arm if leaning else 0.0)


def check_largest(drive: Drive, largest: float) -> None:
    """Raise ValueError for an eccentricity [m] that the geometry cannot have."""
    if not 0.0 < largest < math.inf:
        raise ValueError(f"the largest eccentricity must be positive, not {largest * 1e6:g} µm")
    replace(drive.mesh, eccentricity=largest)


def first_excess(
    drive: Drive, cup_torque: float, criterion: str, limit: float, largest: float, leaning: float = 0.0
) -> DisplacementLimit:
    """The smallest displacement that exceeds a criterion, searched up to a `largest` one [m].

    `leaning` is the tilt's share of it. The drive's own eccentricity and tilt are ignored; its runout stays.
    The torque is that on the cup [N m].

    The value need not rise with the displacement. Brent's method solves the first of :data:`STEPS` steps with
    an excess; for a criterion that jumps, the first such of its :data:`FINE_STEPS` parts. An excess that
    comes and goes within a step is missed.
    """
    search = _Search(drive, cup_torque, criterion, leaning)
    sizes, values = _scanned(drive, cup_torque, largest, leaning)
    scanned = np.stack((sizes, values[search.index]))
    found = search.exceeded(limit, scanned)
    worst = search.worst(found if math.isfinite(found) else largest)
    both = divided(drive.mesh.geometry, found, leaning)
    return DisplacementLimit(criterion, limit, *both, worst, search.worst(0.0).value, scanned)


def allowed(
    drive: Drive, cup_torque: float, limits: Mapping[str, float], largest: float
) -> tuple[float, str] | None:
    """The least :func:`first_excess` of all criteria [m] and its criterion, without solving for the others.

    Limits by name of the criterion. None if no limit is reached.
    """
    return _allowed(drive, cup_torque, tuple(limits[name] for name in NAMES), largest)


@lru_cache(maxsize=16)  # bags of a fleet and records of a robot have few drives; each takes nearly a second
def _allowed(
    drive: Drive, cup_torque: float, limits: tuple[float, ...], largest: float
) -> tuple[float, str] | None:
    searches, scans = [_Search(drive, cup_torque, name) for name in NAMES], list[Floats]()
    sizes = np.linspace(0.0, largest, STEPS + 1)
    for size in sizes.tolist():
        scans.append(searches[0].scan(size))
        if len(scans) == sizes.size or np.any(scans[-1] > limits):
            scanned = sizes[: len(scans)], np.stack(scans, axis=1)
            if least := _least_excess(searches, limits, *scanned):
                return least
    return None


def _least_excess(
    searches: list[_Search], limits: Sequence[float], sizes: Floats, values: Floats
) -> tuple[float, str] | None:
    """The least displacement in a scan that exceeds a limit [m], and its criterion; None if none does."""
    above = [row > limit for row, limit in zip(values, limits, strict=True)]
    first = [int(np.argmax(one)) if one.any() else sizes.size for one in above]
    least = None
    for k in sorted(range(len(NAMES)), key=lambda k: first[k]):
        limit, search = limits[k], searches[k]
        if least is not None and not search.worst(least[0]).value > limit:
            continue
        found = search.exceeded(limit, np.stack((sizes, values[k])))
        if math.isfinite(found) and (least is None or found < least[0]):
            least = found, NAMES[k]
    return least


@lru_cache(maxsize=4)  # callers ask for the criteria of one torque in turn
def _scanned(drive: Drive, cup_torque: float, largest: float, leaning: float = 0.0) -> tuple[Floats, Floats]:
    """Displacements (STEPS + 1,) [m] and the worst value of every criterion at each (6, STEPS + 1)."""
    search, sizes = _Search(drive, cup_torque, NAMES[0], leaning), np.linspace(0.0, largest, STEPS + 1)
    return sizes, np.stack([search.scan(size) for size in sizes], axis=1)


def across_long_axis(drive: Drive, largest: float) -> tuple[float, float]:
    """The paper's arrangement: eccentricity across the long axis, on which tooth 0 is held.

    Returns the eccentricity up to `largest` at which the first tooth of that lobe interferes (nan if none),
    and the least backlash without eccentricity [m]. The drive's own eccentricity and runout are ignored.
    """

    def overlap(e: float) -> float:
        return float(evaluate(drive.mesh, np.zeros(1), np.array([1j * e]), np.ones(1)).interference[0])

    eccentricity = np.linspace(0.0, largest, STEPS + 1)
    above = np.array([overlap(e) for e in eccentricity]) > 0.0
    solved = partial(brentq, overlap, xtol=ROOT_TOLERANCE, rtol=1e-12)
    return _crossing(overlap, eccentricity, above, solved), -overlap(0.0)


def _crossing(
    excess: Callable[[float], float],
    steps: Floats,
    above: npt.NDArray[np.bool_],
    solved: Callable[[float, float], float],
    parts: int = 1,
) -> float:
    """Size at which an excess first occurs, searched in parts of a step; nan if it does not occur.

    `solved` finds it between a size without an excess and one with it. A coarse scan gives the steps
    ``above`` the limit; the excess may begin at an earlier or later step.
    """
    first = int(np.argmax(above)) if above.any() else steps.size - 1
    while first > 0 and excess(steps[first - 1]) > 0.0:
        first -= 1
    while first < steps.size - 1 and excess(steps[first]) <= 0.0:
        first += 1
    if excess(steps[first]) <= 0.0:
        return math.nan
    if first == 0:
        return 0.0
    fine = np.linspace(steps[first - 1], steps[first], parts + 1)
    part = next(k for k in range(1, parts + 1) if k == parts or excess(fine[k]) > 0.0)
    return solved(float(fine[part - 1]), float(fine[part]))


def frontier(
    drive: Drive, cup_torque: float, limits: Mapping[str, float], largest: float, leaning: float
) -> dict[str, tuple[float, float]]:
    """Smallest eccentricity [m] and tilt [rad] that exceed each given limit, on a coarse grid for a chart.

    Limits by name of the criterion. As :func:`first_excess`, but linear between :data:`CHART_STEPS`
    displacements. nan where a limit is not reached.
    """
    search = _Search(drive, cup_torque, NAMES[0], leaning)
    sizes = np.linspace(0.0, largest, CHART_STEPS + 1)
    values = np.stack([search.scan_moments(size) for size in sizes], axis=1)
    rows = ((name, values[NAMES.index(name)] - limit) for name, limit in limits.items())
    return {name: divided(drive.mesh.geometry, _straight(sizes, row), leaning) for name, row in rows}


def _straight(sizes: Floats, excess: Floats) -> float:
    """Size at which an excess first occurs, linear between rising sizes; nan if it does not occur."""
    first = int(np.argmax(excess > 0.0))
    if not excess[first] > 0.0:
        return math.nan
    if first == 0:
        return 0.0
    low, high = excess[first - 1], excess[first]
    share = -low / (high - low) if math.isfinite(high) else 0.0
    return float(sizes[first - 1] + share * (sizes[first] - sizes[first - 1]))


class _Search:
    """Search for one criterion of a drive at one torque; `leaning` is the tilt's share of a displacement."""

    def __init__(self, drive: Drive, cup_torque: float, criterion: str, leaning: float = 0.0) -> None:
        self.drive = drive = replace(drive, mesh=replace(drive.mesh, tilt=0.0))
        self.torque, self.leaning = np.array([cup_torque]), leaning
        self.pitch, self.index = drive.mesh.geometry.slot_pitch, NAMES.index(criterion)
        self.jumps = CRITERIA[self.index].jumps
        self.grid = _SEARCH_OF_JUMPS if self.jumps else _SEARCH
        self._known: dict[float, Worst] = {}  # by size
        self.reference = reference_stiffness(drive, self.torque)

    def scan(self, size: float) -> Floats:
        """Worst value of every criterion over a coarse grid (6,); the last, of a turn, is approximate."""
        around = 2.0 * math.pi * (np.arange(_SCAN[0]) + 0.37) / _SCAN[0]  # meets several tooth phases
        beta = self._torsion(self._displaced(size, 0.0), around[:, None])
        width = np.ptp(np.where(np.isnan(beta), np.inf, beta))
        return np.append(self.scan_moments(size), width)

    def scan_moments(self, size: float) -> Floats:
        """Worst value of every criterion of a moment over a coarse grid (5,)."""
        return np.asarray(self._moments(size, _grid(*_SCAN)).max(axis=1))

    def exceeded(self, limit: float, scanned: Floats) -> float:
        """The smallest displacement that exceeds a limit, nan if none does."""

        def excess(e: float) -> float:
            return min(self.worst(e).value, _MOST) - limit

        def solved(low: float, high: float) -> float:
            return self._solved(excess, limit, low, high)

        return _crossing(excess, scanned[0], scanned[1] > limit, solved, FINE_STEPS if self.jumps else 1)

    def _solved(self, excess: Callable[[float], float], limit: float, low: float, high: float) -> float:
        """Displacement at which the limit is crossed in any direction, between one within it and one beyond.

        The search follows the place of the worst at `high`, at a tenth of the cost, until no other is worse.
        """
        while high - low > ROOT_TOLERANCE:
            beside = partial(self._excess_beside, self.worst(high), limit)
            if beside(low) > 0.0:
                return low
            found = float(brentq(beside, low, high, xtol=ROOT_TOLERANCE, rtol=1e-12))
            is_first = excess(found) <= _ROUNDING * abs(limit)
            if is_first or high - found <= ROOT_TOLERANCE:
                return found
            high = found
        return high

    def _excess_beside(self, worst: Worst, limit: float, size: float) -> float:
        """Excess over the limit at a size, searched near the place of the worst at another size."""
        if NAMES[self.index] == "transmission_error":
            return min(self._width(size, worst.direction).value, _MOST) - limit
        turn = worst.wave_generator_angle
        place = np.array([[worst.direction - turn, turn / self.pitch]])
        return min(self._climbed(size, place)[1], _MOST) - limit

    def worst(self, size: float) -> Worst:
        """Worst over all directions and angles at a size; cached."""
        if size not in self._known:
            self._known[size] = self._worst(size)
        return self._known[size]

    def _worst(self, size: float) -> Worst:
        if NAMES[self.index] == "transmission_error":
            directions = self.pitch * np.arange(_TURN_DIRECTIONS) / _TURN_DIRECTIONS
            widths = (self._width(size, float(direction)) for direction in directions)
            found = list(widths)
            return found[_first(np.array([worst.value for worst in found]))]

        points = _grid(*self.grid)
        best, most = self._climbed(size, points[_hills(self._value(size, points).reshape(self.grid))])
        turn = self.pitch * float(best[1])
        return Worst(most, (float(best[0]) + turn) % (2.0 * math.pi), turn)

    def _climbed(self, size: float, places: Floats) -> tuple[Floats, float]:
        """Place (2,) of the greatest value near given places (m, 2), and the value."""
        step = np.array([2.0 * math.pi, 1.0]) / self.grid
        return _climbed(partial(self._value, size), places, step)

    def _value(self, size: float, points: Floats) -> Floats:
        return np.asarray(self._moments(size, points, [NAMES[self.index]])[self.index])

    def _displaced(self, size: float, direction: float) -> Mesh:
        e, tilt = divided(self.drive.mesh.geometry, size, self.leaning)
        towards = cmath.rect(1.0, direction)
        return replace(self.drive.mesh, eccentricity=cmath.rect(e, direction), tilt=tilt * towards)

    def _moments(self, size: float, points: Floats, wanted: Collection[str] = NAMES) -> Floats:
        """Criteria (5, n) at points (n, 2): angle from the long axis [rad], phase in a slot pitch [-]."""
        turn, mesh = self.pitch * points[:, 1], self.drive.mesh
        towards: Complexes = np.exp(1j * (points[:, 0] + turn))
        turning: Complexes = np.exp(1j * turn)
        e, tilt = divided(mesh.geometry, size, self.leaning)
        center = e * towards + mesh.runout * turning
        found = evaluate(mesh, turn, center, self.torque, tilt=tilt * towards, wanted=wanted)
        return of_moments(found, self.drive.cup_compliance, self.reference)[:, :, 0]

    def _width(self, size: float, direction: float) -> Worst:
        """Peak-to-peak torsion of a turn at one direction of the displacement, and place of its maximum."""
        mesh = self._displaced(size, direction)
        count = _TURN_PHASES * mesh.geometry.circular_spline_teeth
        step = 2.0 * math.pi / count
        points = step * np.arange(count, dtype=np.float64)[:, None]
        beta = self._torsion(mesh, points)
        if not np.isfinite(beta).all():
            return Worst(math.inf, direction, float(points[np.argmin(np.isfinite(beta)), 0]))
        spacing = np.array([step])
        place, high = _climbed(lambda p: self._torsion(mesh, p), points[_hills(beta)], spacing)
        _, low = _climbed(lambda p: -self._torsion(mesh, p), points[_hills(-beta)], spacing)
        return Worst(high + low, direction, float(place[0]) % (2.0 * math.pi))

    def _torsion(self, mesh: Mesh, points: Floats) -> Floats:
        return torsion(mesh, points[:, 0], self.torque[0])


def _grid(around: int, phases: int) -> Floats:
    """Points (n, 2): angles from the long axis [rad], phases in a slot pitch [-]."""
    angle, phase = np.meshgrid(
        2.0 * math.pi * np.arange(around) / around, np.arange(phases) / phases, indexing="ij"
    )
    return np.column_stack((angle.ravel(), phase.ravel()))


def _hills(values: Floats) -> Integers:
    """Flat indices of the greatest local maxima on a grid over a circle or a torus: at most eight."""
    beside = ndimage.generate_binary_structure(values.ndim, 1)
    index = np.flatnonzero(values >= ndimage.maximum_filter(values, footprint=beside, mode="wrap"))
    order = np.argsort(-values.ravel()[index], kind="stable")
    return np.asarray(index[order[:_HILLS]], dtype=np.int64)


def _climbed(function: Callable[[Floats], Floats], centers: Floats, step: Floats) -> tuple[Floats, float]:
    """Place (d,) of the greatest value near given places (m, d), and the value, by grids that narrow.

    The function takes points (n, d) and gives values (n,); `step` (d,) is half the width of the first grids.
    Among images of one place, the one with the least angle (the first coordinate) within a turn is taken.
    """
    dimensions = centers.shape[1]
    side = np.linspace(-1.0, 1.0, 2 * _BESIDE + 1)
    offsets = np.stack(np.meshgrid(*[side] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)
    for _ in range(_ROUNDS):
        points = centers[:, None, :] + offsets * step
        values = function(points.reshape(-1, dimensions)).reshape(points.shape[:2])
        best = np.argmax(values, axis=1)
        centers = points[np.arange(best.size), best]
        step = step / _CLOSER
    order = np.argsort(np.mod(centers[:, 0], 2.0 * math.pi), kind="stable")
    highest = values.max(axis=1)
    top = order[_first(highest[order])]
    return centers[top], float(highest.max())


def _first(values: Floats) -> int:
    """Index of the first value that equals the greatest within a share :data:`_IMAGE`."""
    highest = values.max()
    return int(np.argmax(values >= highest - _IMAGE * abs(highest)))
