"""The model's own parameters as numbers to fit; the drive with these, its error and derivatives."""

from __future__ import annotations

import cmath
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.fit.design import solve
from hd_diag.drive import Drive
from hd_diag.effects import recursions
from hd_diag.effects.scaling import unit_scales
from hd_diag.formatting import ARCSEC
from hd_diag.model import torsion
from hd_diag.model.geometry import Geometry
from hd_diag.model.mesh import largest_displacement


@dataclass(frozen=True)
class Scale:
    """One fitted number: name, SI size of one unit, prior width in these units, unit as people write it."""

    name: str
    si: float
    prior: float
    unit: str


SCALES = (
    Scale("eccentricity.x", 1e-6, 15.0, "m"),
    Scale("eccentricity.y", 1e-6, 15.0, "m"),
    Scale("runout.x", 1e-6, 8.0, "m"),
    Scale("runout.y", 1e-6, 8.0, "m"),
    Scale("circular_spline_datum", 1e-6, 12.0, "m"),
    Scale("tooth_compliance", 0.1, 1.5, "m/N"),  # relative to the configured value
    Scale("cup_compliance", ARCSEC, 2.0, "rad/(N m)"),
    Scale("tilt.x", 1e-4, 10.0, "rad"),
    Scale("tilt.y", 1e-4, 10.0, "rad"),
)
"""The fitted parameters, in units near the precision that matters to a gear of size 25, ratio 100.

Only a drive with more than one section has the last two, its tilt: see :func:`units`.
"""

GROUPS: dict[str, tuple[int, ...]] = {
    "eccentricity": (0, 1),
    "runout": (2, 3),
    "circular_spline_datum": (4,),
    "tooth_compliance": (5,),
    "cup_compliance": (6,),
    "tilt": (7, 8),
}
"""Indices of the parameters that are judged together, by group."""

DATUM, COMPLIANCE, CUP = (
    GROUPS[name][0] for name in ("circular_spline_datum", "tooth_compliance", "cup_compliance")
)
"""Indices of the datum and of the two compliances."""

TORSION = [DATUM, COMPLIANCE, CUP]
"""Indices of the parameters that shape the torsion."""

_PAIRS = {name: slice(own[0], own[1] + 1) for name, own in GROUPS.items() if len(own) == 2}
TILT = _PAIRS["tilt"]
"""Slice of the tilt, empty in the parameters of a drive with one section."""

_SINGLE = slice(DATUM, CUP + 1)  # all but the displacements
_MOST_DISPLACED = {"eccentricity": 45.0, "runout": 20.0}
_MOST_TILTED, _MOST_LEANING = 50.0, 15.0  # tilt, and displacement of the outermost section by it, in units
_ROOM = 0.98  # usable share of the largest displacement of a mesh
_DATUM = (-40.0, 45.0)  # range about the configured one, in units
_HALVINGS = 12  # in the search for the last datum that makes a gear

_OTHER_END = np.ones(len(SCALES))  # signs of the parameters with a ring's ends swapped
_OTHER_END[TILT] = -1.0
_SIGNS = -np.ones(len(SCALES))  # signs of the parameters with lobes swapped
_SIGNS[_SINGLE] = 1.0

# Nodes per pitch, from one section to many. Sections bear one after the other, so fewer nodes are as exact.
_STEPS_PER_TOOTH, _LEAST_STEPS = 4, 2
_NODES_PAY = 1.5  # samples per node from which nodes are faster than exact samples
_MORE_TORQUE = 0.25  # of the rated torque: causes may add this before nodes are solved again


def warm_up() -> None:
    """Compile now, or read from the disk, the functions that a diagnosis needs."""
    from hd_diag.diagnosis import kernel  # late: it imports numba

    torsion.warm_up(gradient=True)
    recursions.warm_up()
    kernel.warm_up()


def units(configured: Drive) -> Floats:
    """SI size of one unit of each parameter, shape (p,). Lengths scale with the module, the cup with torque.

    There are 7 parameters, or 9 for a drive with several sections, which a tilt displaces.
    """
    scales = unit_scales(configured)
    return np.array([scale.si * scales.get(scale.unit, 1.0) for scale in SCALES[: count(configured)]])


def count(configured: Drive) -> int:
    """Number p of the parameters."""
    return len(SCALES) if configured.mesh.geometry.sections > 1 else TILT.start


def numbers_of(names: Iterable[str]) -> list[int]:
    """Indices of the parameters of some groups."""
    return [number for name in names for number in GROUPS[name]]


def groups(configured: Drive) -> dict[str, tuple[int, ...]]:
    """The entries of `GROUPS` that a drive has."""
    return {name: numbers for name, numbers in GROUPS.items() if numbers[-1] < count(configured)}


def displacements(parameters: Floats) -> Floats:
    """Eccentricity, runout and tilt among parameters, shape (4,) or (6,)."""
    return np.asarray(parameters[_SIGNS[: parameters.size] < 0.0])


def alike(parameters: Floats, configured: Drive) -> tuple[Floats, ...]:
    """Equivalent parameters: as given, with lobes swapped, and for a ring also with its ends swapped."""
    found = parameters, swapped(parameters)
    if configured.mesh.geometry.cup_length or parameters.size == TILT.start:
        return found
    return (*found, *(each * _OTHER_END for each in found))


def direction_period(name: str, configured: Drive) -> float:
    """Period of a displacement's direction [rad]: pi for the eccentricity and a ring's tilt, else 2 pi."""
    ring = not configured.mesh.geometry.cup_length
    return np.pi if name == "eccentricity" or (name == "tilt" and ring) else 2.0 * np.pi


def swapped(parameters: Floats) -> Floats:
    """Parameters of the same drive with its lobes swapped."""
    return np.asarray(parameters * _SIGNS[: parameters.size])


def vector(drive: Drive, configured: Drive) -> Floats:
    """A drive's parameters in the configured drive's units, see :func:`units`, shape (p,)."""
    mesh = drive.mesh
    compliance = mesh.tooth_compliance / configured.mesh.tooth_compliance
    displaced = [mesh.eccentricity.real, mesh.eccentricity.imag, mesh.runout.real, mesh.runout.imag]
    values = [*displaced, mesh.geometry.circular_spline_datum, compliance, drive.cup_compliance]
    values += [mesh.tilt.real, mesh.tilt.imag]
    return np.asarray(np.array(values[: count(configured)]) / units(configured))


def drive_of(parameters: Floats, configured: Drive) -> Drive:
    """The drive with these parameters, after they are moved into their bounds.

    Parameters
    ----------
    parameters : ndarray, shape (p,)
        See :func:`units`.
    configured : Drive
        Supplies everything that is not fitted.

    Returns
    -------
    Drive
    """
    x, y, runout_x, runout_y, datum, compliance, cup, *tilt = (
        admissible(parameters, configured) * units(configured)
    ).tolist()
    mesh = replace(
        configured.mesh,
        geometry=replace(configured.mesh.geometry, circular_spline_datum=datum),
        eccentricity=complex(x, y),
        runout=complex(runout_x, runout_y),
        tooth_compliance=compliance * configured.mesh.tooth_compliance,
        tilt=complex(*tilt),
    )
    return replace(configured, mesh=mesh, cup_compliance=cup)


def admissible(parameters: Floats, configured: Drive) -> Floats:
    """Parameters moved into bounds wide enough for any drive worth assembling."""
    p = parameters.copy()
    for pair, most in _displaced(configured):
        size = float(np.hypot(*p[pair]))
        if size > most:
            p[pair] *= most / size
    low, high = bounds(configured)
    p[_SINGLE] = np.clip(p[_SINGLE], low[_SINGLE], high[_SINGLE])
    return p


def at_bound(parameters: Floats, configured: Drive) -> tuple[int, ...]:
    """Indices of the parameters at a bound: the record does not determine their values.

    A cup compliance of zero is possible and does not count.
    """
    low, high = bounds(configured)
    wide = 1e-3 * (high - low)[_SINGLE]
    above = parameters[_SINGLE] > high[_SINGLE] - wide
    below = parameters[_SINGLE] < low[_SINGLE] + wide
    below[-1] = False
    edge = np.zeros(parameters.size, dtype=np.bool_)
    edge[_SINGLE] = above | below
    for pair, most in _displaced(configured):
        edge[pair] = float(np.hypot(*parameters[pair])) > 0.999 * most
    return tuple(np.flatnonzero(edge).tolist())


def _displaced(configured: Drive) -> list[tuple[slice, float]]:
    """Slice and largest size of every displacement. Together they stay within the room of the mesh."""
    own = units(configured)
    found = [(_PAIRS[name], most) for name, most in _MOST_DISPLACED.items()]
    if own.size == TILT.start:
        return found
    geometry = configured.mesh.geometry
    lean = float(np.abs(geometry.section_places).max()) * float(own[TILT][0] / own[0])  # per unit of tilt
    tilt = min(_MOST_TILTED, _MOST_LEANING / lean)
    whole = sum(most for _, most in found) + tilt * lean
    least = float(bounds(configured)[0][DATUM] * own[DATUM])
    room = _ROOM * _room(geometry, least) / float(own[0])
    return [(pair, most * min(1.0, room / whole)) for pair, most in (*found, (TILT, tilt))]


def bounds(configured: Drive) -> tuple[Floats, Floats]:
    """Least and greatest value of every parameter, shape (p,) each; infinite for displacements."""
    own = units(configured)
    low, high = np.full(own.size, -np.inf), np.full(own.size, np.inf)
    unit = float(own[DATUM])
    datum = [end / unit for end in _datums(configured.mesh.geometry, unit)]
    low[_SINGLE], high[_SINGLE] = (datum[0], 4.0, 0.0), (datum[1], 25.0, 20.0)
    return low, high


@lru_cache(maxsize=16)
def _room(geometry: Geometry, datum: float) -> float:
    """Largest displacement of the wave generator [m] in a drive with a given datum [m]."""
    return largest_displacement(replace(geometry, circular_spline_datum=datum))[0]


@lru_cache(maxsize=16)
def _datums(geometry: Geometry, unit: float) -> tuple[float, float]:
    """Least and greatest datum that makes a gear [m], within `_DATUM` units of the configured one."""

    def last(most: float) -> float:
        good, bad = 0.0, 2.0 * most
        for _ in range(_HALVINGS):
            trial = 0.5 * (good + bad)
            try:
                replace(geometry, circular_spline_datum=geometry.circular_spline_datum + trial * unit)
                good = trial
            except ValueError:
                bad = trial
            if abs(good) >= abs(most):
                return most
        return good

    low, high = (geometry.circular_spline_datum + last(end) * unit for end in _DATUM)
    return low, high


def common_factor(configured: Drive) -> float:
    """Prior standard deviation of a common factor of all compliances and of the inverse torque [-]."""
    center, width = prior(configured)
    return float(width[COMPLIANCE] / center[COMPLIANCE])


def scaling(parameters: Floats, held: tuple[int, ...], configured: Drive) -> Floats:
    """Covariance (p, p) of a common factor of the compliances if that of the teeth is held, else zero."""
    step = np.zeros(parameters.size)
    if COMPLIANCE in held:
        step[[COMPLIANCE, CUP]] = parameters[[COMPLIANCE, CUP]] * common_factor(configured)
    return np.outer(step, step)


def bounded(
    beta: Floats, covariance: Floats, parameters: Floats, configured: Drive
) -> tuple[Floats, Integers]:
    """The best coefficients of a fit with parameters in their bounds; those beyond a bound are set on it.

    Parameters
    ----------
    beta : ndarray, shape (k,)
        Steps from the parameters, then the other coefficients.
    covariance : ndarray, shape (k, k)
    parameters : ndarray, shape (p,)
    configured : Drive

    Returns
    -------
    beta : ndarray, shape (k,)
    held : ndarray of int64
        Indices of the parameters on a bound.
    """
    own, held = slice(parameters.size), np.zeros(parameters.size, dtype=np.bool_)
    found = beta
    for _ in range(held.size):
        at = parameters + found[own]
        beyond = (np.abs(admissible(at, configured) - at) > 1e-9) & ~held
        if not beyond.any():
            break
        held |= beyond
        rows = np.flatnonzero(held)
        wanted = (admissible(parameters + beta[own], configured) - parameters)[rows]
        spread = covariance[np.ix_(rows, rows)]
        found = beta - covariance[:, rows] @ solve(spread, beta[rows] - wanted)
    return found, np.flatnonzero(held)


def prior(configured: Drive) -> tuple[Floats, Floats]:
    """Centre and width of the prior, shape (p,) each; displacements are centred on zero."""
    center = vector(configured, configured)
    center[_SIGNS[: center.size] < 0.0] = 0.0
    return center, np.array([scale.prior for scale in SCALES[: center.size]])


@dataclass(frozen=True, eq=False)
class DriveAlong:
    """A drive along a record: its transmission error and derivatives by the parameters, at any torques.

    They are exact if samples are few. Otherwise :class:`hd_diag.model.torsion.TorsionAlong` gives them. It is
    solved once for all torques near those of the record.

    Parameters
    ----------
    drive, configured : Drive
    input_angle : ndarray, shape (n,)
        [rad]
    torque : ndarray, shape (n,)
        Of the record [N m].
    steps : int
        Steps per tooth pitch; by default four for one section, three for three and two for five.
    """

    drive: Drive
    configured: Drive
    input_angle: Floats
    torque: Floats
    steps: int = 0

    def __call__(self, torque: Floats) -> tuple[Floats, Floats, Floats]:
        """Evaluate at torques (n,) [N m].

        Returns
        -------
        error : ndarray, shape (n,)
            [rad]; accurate to 0.02 arcsec rms for a gear of ratio 100, to 0.1 for one of ratio 50.
        jacobian : ndarray, shape (n, p)
            [rad] per unit, see :func:`units`.
        slope : ndarray, shape (n,)
            dTE/dT [rad/(N m)].
        """
        drive, configured = self.drive, self.configured
        beta, gradient = self._torsion(drive.frame.cup_torque(torque))
        by_x, by_y, by_datum, by_compliance, by_torque, *by_tilt = gradient.T
        cosine, sine = self._direction
        scale = -drive.frame.torque_sign * units(configured)
        jacobian = np.empty((torque.size, scale.size))
        jacobian[:, 0], jacobian[:, 1] = scale[0] * by_x, scale[1] * by_y
        jacobian[:, 2] = scale[2] * (by_x * cosine + by_y * sine)
        jacobian[:, 3] = scale[3] * (by_y * cosine - by_x * sine)
        jacobian[:, DATUM] = scale[DATUM] * by_datum
        jacobian[:, COMPLIANCE] = scale[COMPLIANCE] * configured.mesh.tooth_compliance * by_compliance
        jacobian[:, CUP] = -np.abs(scale[CUP]) * torque
        for index, column in zip(range(TILT.start, scale.size), by_tilt, strict=False):
            jacobian[:, index] = scale[index] * column
        return drive.frame.transmission_error(beta, torque), jacobian, -by_torque - drive.cup_compliance

    def _torsion(self, torque: Floats) -> tuple[Floats, Floats]:
        """Torsion [rad] and its derivatives, at torques on the cup (n,) [N m]."""
        mesh, steps = self.drive.mesh, self._steps
        if torque.size < _NODES_PAY * (steps + 1) * torsion.teeth_along(mesh, steps, torque.size)[0]:
            return torsion.torsion_and_gradient(mesh, self._angle, torque)
        if self._along.covers(torque):
            return self._along(torque)
        return torsion.torsion_along(mesh, self._angle, torque, steps)

    @cached_property
    def _along(self) -> torsion.TorsionAlong:
        """The torsion, solved for torques about those of the record."""
        torque = self.drive.frame.cup_torque(self.torque)
        low, high = float(torque.min()), float(torque.max())
        more = torsion.BEYOND + _MORE_TORQUE * self.configured.rated_torque
        return torsion.TorsionAlong(self.drive.mesh, self._angle, low - more, high + more, self._steps)

    @property
    def _steps(self) -> int:
        sections = self.drive.mesh.geometry.sections
        return self.steps or max(_STEPS_PER_TOOTH - sections // 2, _LEAST_STEPS)

    @cached_property
    def _angle(self) -> Floats:
        return self.drive.frame.wave_generator_angle(self.input_angle)

    @cached_property
    def _direction(self) -> tuple[Floats, Floats]:
        """Cosine and sine of the wave generator's angle."""
        return np.cos(self._angle), np.sin(self._angle)


def along(
    drive: Drive,
    configured: Drive,
    input_angle: Floats,
    torque: Floats,
    steps: int = 0,
) -> tuple[Floats, Floats, Floats]:
    """:class:`DriveAlong` a record at its own torque."""
    return DriveAlong(drive, configured, input_angle, torque, steps)(torque)


def physical(parameters: Floats, covariance: Floats, configured: Drive) -> dict[str, dict[str, Any]]:
    """Fitted parameters as people state them, with standard deviations.

    Parameters
    ----------
    parameters : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    configured : Drive

    Returns
    -------
    dict
        By name: value, std, unit, configured. All displacements turned by pi together are the same drive:
        the eccentricity's direction is given in [0, pi). The tilt of a ring may be turned by pi alone, and
        its direction is given in [0, pi), too. The std of a parameter at a bound is nan.
    """
    covariance = covariance.copy()
    covariance[list(at_bound(parameters, configured))] = np.nan
    p, own = max(alike(parameters, configured), key=_upright), units(configured)
    mesh, found = configured.mesh, dict[str, dict[str, Any]]()
    for name, pair in _PAIRS.items():
        if pair.start >= p.size:
            continue
        before, unit = complex(getattr(mesh, name)), float(own[pair.start])
        (x, y), block = p[pair], covariance[pair, pair]
        size = max(float(np.hypot(x, y)), 1e-9)
        turned = np.array([x, y]) / size if size > 1e-9 else np.array([1.0, 0.0])
        along, across = turned, np.array([-turned[1], turned[0]])
        length, turn = (float(np.sqrt(way @ block @ way)) for way in (along, across))
        most = float(np.pi / np.sqrt(12.0))  # std of an unknown direction
        found[f"{name}.magnitude"] = _entry(size * unit, length * unit, SCALES[pair.start].unit, abs(before))
        found[f"{name}.direction"] = _entry(
            float(np.arctan2(y, x)), float(np.minimum(turn / size, most)), "rad", cmath.phase(before)
        )
    start = vector(configured, configured)
    for index in range(_SINGLE.start, _SINGLE.stop):
        scale = SCALES[index]
        si = float(own[index]) * (
            configured.mesh.tooth_compliance if scale.name == "tooth_compliance" else 1.0
        )
        spread = float(np.sqrt(covariance[index, index]))
        found[scale.name] = _entry(float(p[index]) * si, spread * si, scale.unit, float(start[index]) * si)
    return found


def _upright(parameters: Floats) -> tuple[bool, ...]:
    """Whether the directions of the eccentricity and of the tilt are in [0, pi), in this order."""
    pairs = parameters[:2], parameters[TILT]
    return tuple((pair[1], pair[0]) >= (0.0, 0.0) for pair in pairs if pair.size)


def _entry(value: float, std: float, unit: str, configured: float) -> dict[str, Any]:
    return {"value": value, "std": std, "unit": unit, "configured": configured}
