"""The model's own parameters as numbers to fit: the drive they make, its error and derivatives."""

from __future__ import annotations

import cmath
from dataclasses import dataclass, replace
from functools import lru_cache
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


@dataclass(frozen=True)
class Scale:
    """One fitted number: name, size of one unit in SI, prior width in such units, how people write it."""

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
)
"""The fitted parameters, in units near the precision that matters to a gear of size 25, ratio 100."""

COUNT = len(SCALES)
DATUM, COMPLIANCE, CUP = 4, 5, 6
"""Numbers of the datum and of the two compliances."""

_MOST_SHIFTED = (45.0, 20.0)  # eccentricity and runout
_DATUM = (-40.0, 45.0)  # from the configured one
_HALVINGS = 12  # towards the last datum that makes a gear

MIRRORED = np.array([-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
"""What the parameters of the same drive with its lobes swapped are multiplied with."""

_STEPS_PER_TOOTH = 8  # nodes along a record
_NODES_PAY = 1.5  # samples per node from which they do


def warm_up() -> None:
    """Compile now, or read from the disk, what a diagnosis needs."""
    from hd_diag.diagnosis import kernel  # late: it imports numba

    torsion.warm_up(gradient=True)
    recursions.warm_up()
    kernel.warm_up()


def units(configured: Drive) -> Floats:
    """What one of each parameter is in SI, shape (7,): lengths go with the module, the cup with torque."""
    scales = unit_scales(configured)
    return np.array([scale.si * scales.get(scale.unit, 1.0) for scale in SCALES])


def vector(drive: Drive, configured: Drive) -> Floats:
    """A drive's parameters in its own units, see :func:`units`, shape (7,)."""
    mesh = drive.mesh
    compliance = mesh.tooth_compliance / configured.mesh.tooth_compliance
    displaced = [mesh.eccentricity.real, mesh.eccentricity.imag, mesh.runout.real, mesh.runout.imag]
    values = [*displaced, mesh.geometry.circular_spline_datum, compliance, drive.cup_compliance]
    return np.asarray(np.array(values) / units(configured))


def drive_of(parameters: Floats, configured: Drive) -> Drive:
    """The drive with these parameters; they are first moved into what a mesh can be.

    Parameters
    ----------
    parameters : ndarray, shape (7,)
        See :func:`units`.
    configured : Drive
        Gives everything that is not fitted.

    Returns
    -------
    Drive
    """
    x, y, runout_x, runout_y, datum, compliance, cup = (
        admissible(parameters, configured) * units(configured)
    ).tolist()
    mesh = replace(
        configured.mesh,
        geometry=replace(configured.mesh.geometry, circular_spline_datum=datum),
        eccentricity=complex(x, y),
        runout=complex(runout_x, runout_y),
        tooth_compliance=compliance * configured.mesh.tooth_compliance,
    )
    return replace(configured, mesh=mesh, cup_compliance=cup)


def admissible(parameters: Floats, configured: Drive) -> Floats:
    """Parameters moved into bounds wide enough for any drive worth assembling."""
    p = parameters.copy()
    for pair, most in zip((slice(0, 2), slice(2, 4)), _MOST_SHIFTED, strict=True):
        size = float(np.hypot(*p[pair]))
        if size > most:
            p[pair] *= most / size
    low, high = bounds(configured)
    p[4:] = np.clip(p[4:], low[4:], high[4:])
    return p


def at_bound(parameters: Floats, configured: Drive) -> tuple[int, ...]:
    """Numbers of the parameters that are as far off as they can be: nothing is known of these.

    A cup without compliance is one that may be.
    """
    low, high = bounds(configured)
    wide, edge = 1e-3 * (high - low)[4:], np.zeros(COUNT, dtype=np.bool_)
    edge[4:] = parameters[4:] > high[4:] - wide
    edge[4:-1] |= parameters[4:-1] < (low[4:] + wide)[:-1]
    for pair, most in zip((slice(0, 2), slice(2, 4)), _MOST_SHIFTED, strict=True):
        edge[pair] = float(np.hypot(*parameters[pair])) > 0.999 * most
    return tuple(np.flatnonzero(edge).tolist())


def bounds(configured: Drive) -> tuple[Floats, Floats]:
    """Least and greatest value of every parameter, shape (7,) each; displacements have none of their own."""
    low, high = np.full(COUNT, -np.inf), np.full(COUNT, np.inf)
    unit = float(units(configured)[4])
    datum = [end / unit for end in _datums(configured.mesh.geometry, unit)]
    low[4:], high[4:] = (datum[0], 4.0, 0.0), (datum[1], 25.0, 20.0)
    return low, high


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
    """Standard deviation of a factor of all compliances, and of the torque's inverse, by the prior [-]."""
    center, width = prior(configured)
    return float(width[COMPLIANCE] / center[COMPLIANCE])


def scaling(parameters: Floats, held: tuple[int, ...], configured: Drive) -> Floats:
    """Covariance (7, 7) of compliances that are off by one factor, where that of the teeth is held."""
    step = np.zeros(COUNT)
    if COMPLIANCE in held:
        step[[COMPLIANCE, CUP]] = parameters[[COMPLIANCE, CUP]] * common_factor(configured)
    return np.outer(step, step)


def bounded(
    beta: Floats, covariance: Floats, parameters: Floats, configured: Drive
) -> tuple[Floats, Integers]:
    """The best coefficients of a fit whose parameters a drive can have: those beyond a bound lie on it.

    Parameters
    ----------
    beta : ndarray, shape (k,)
        Steps from the parameters, then other coefficients.
    covariance : ndarray, shape (k, k)
    parameters : ndarray, shape (7,)
    configured : Drive

    Returns
    -------
    beta : ndarray, shape (k,)
    held : ndarray of int64
        Numbers of the parameters that lie on a bound.
    """
    held = np.zeros(COUNT, dtype=np.bool_)
    found = beta
    for _ in range(COUNT):
        at = parameters + found[:COUNT]
        beyond = (np.abs(admissible(at, configured) - at) > 1e-9) & ~held
        if not beyond.any():
            break
        held |= beyond
        rows = np.flatnonzero(held)
        wanted = (admissible(parameters + beta[:COUNT], configured) - parameters)[rows]
        spread = covariance[np.ix_(rows, rows)]
        found = beta - covariance[:, rows] @ solve(spread, beta[rows] - wanted)
    return found, np.flatnonzero(held)


def prior(configured: Drive) -> tuple[Floats, Floats]:
    """Centre and width of the prior, shape (7,) each; displacements are centred on zero."""
    center = vector(configured, configured)
    center[:4] = 0.0
    return center, np.array([scale.prior for scale in SCALES])


def along(
    drive: Drive,
    configured: Drive,
    input_angle: Floats,
    torque: Floats,
    steps: int = _STEPS_PER_TOOTH,
) -> tuple[Floats, Floats, Floats]:
    """Transmission error and its derivatives by the parameters, along a record.

    They are exact where samples are few; else solved at nodes of the wave generator's turn, straight between.

    Returns
    -------
    error : ndarray, shape (n,)
        To 0.01 arcsec rms with eight `steps` a tooth [rad].
    jacobian : ndarray, shape (n, 7)
        [rad] per unit, see :func:`units`.
    slope : ndarray, shape (n,)
        dTE/dT [rad/(N m)].
    """
    nodes = steps * drive.mesh.geometry.circular_spline_teeth
    angle = drive.frame.wave_generator_angle(input_angle)
    given = drive.mesh, angle, drive.frame.cup_torque(torque)
    few = angle.size < _NODES_PAY * nodes
    beta, gradient = torsion.torsion_and_gradient(*given) if few else torsion.torsion_along(*given, nodes)
    by_x, by_y, by_datum, by_compliance, by_torque, *_ = gradient.T
    cosine, sine = np.cos(angle), np.sin(angle)
    scale = -drive.frame.torque_sign * units(configured)
    jacobian = np.empty((angle.size, COUNT))
    jacobian[:, 0], jacobian[:, 1] = scale[0] * by_x, scale[1] * by_y
    jacobian[:, 2] = scale[2] * (by_x * cosine + by_y * sine)
    jacobian[:, 3] = scale[3] * (by_y * cosine - by_x * sine)
    jacobian[:, DATUM] = scale[DATUM] * by_datum
    jacobian[:, COMPLIANCE] = scale[COMPLIANCE] * configured.mesh.tooth_compliance * by_compliance
    jacobian[:, CUP] = -np.abs(scale[CUP]) * torque
    return drive.frame.transmission_error(beta, torque), jacobian, -by_torque - drive.cup_compliance


def physical(parameters: Floats, covariance: Floats, configured: Drive) -> dict[str, dict[str, Any]]:
    """Fitted parameters as people state them, with standard deviations.

    Parameters
    ----------
    parameters : ndarray, shape (7,)
    covariance : ndarray, shape (7, 7)
    configured : Drive

    Returns
    -------
    dict
        By name: value, std, unit, configured. Eccentricity and runout together may be turned by pi: they are
        given with the eccentricity's direction in [0, pi). What lies at a bound has no deviation: nan.
    """
    covariance = covariance.copy()
    covariance[list(at_bound(parameters, configured))] = np.nan
    p = parameters if (parameters[1], parameters[0]) >= (0.0, 0.0) else parameters * MIRRORED
    found: dict[str, dict[str, Any]] = {}
    sizes, own = (configured.mesh.eccentricity, configured.mesh.runout), units(configured)
    for name, first, before in zip(("eccentricity", "runout"), (0, 2), sizes, strict=True):
        pair, unit = slice(first, first + 2), float(own[first])
        (x, y), block = p[pair], covariance[pair, pair]
        size = max(float(np.hypot(x, y)), 1e-9)
        turned = np.array([x, y]) / size if size > 1e-9 else np.array([1.0, 0.0])
        along, across = turned, np.array([-turned[1], turned[0]])
        length, turn = (float(np.sqrt(way @ block @ way)) for way in (along, across))
        most = float(np.pi / np.sqrt(12.0))  # of a direction that is not known at all
        found[f"{name}.magnitude"] = _entry(size * unit, length * unit, "m", abs(before))
        found[f"{name}.direction"] = _entry(
            float(np.arctan2(y, x)), float(np.minimum(turn / size, most)), "rad", cmath.phase(before)
        )
    start = vector(configured, configured)
    for index, scale in enumerate(SCALES[4:], 4):
        si = float(own[index]) * (
            configured.mesh.tooth_compliance if scale.name == "tooth_compliance" else 1.0
        )
        spread = float(np.sqrt(covariance[index, index]))
        found[scale.name] = _entry(float(p[index]) * si, spread * si, scale.unit, float(start[index]) * si)
    return found


def _entry(value: float, std: float, unit: str, configured: float) -> dict[str, Any]:
    return {"value": value, "std": std, "unit": unit, "configured": configured}
