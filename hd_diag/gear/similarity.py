"""A geometry similar to a known one, and the compliances that give it the torsional stiffness of a page.

A catalogue tells size, ratio and stiffness, never teeth. Teeth go with the module, and so does the radial
deformation of the flexspline; the neutral curve's perimeter goes with the pitch circle. The circular spline's
slots are then moved along the radius until the least backlash, too, is that of the known drive times the
module's scale. What follows from the profile rather than from the stiffness stays assumed: backlash of single
teeth, the eccentricity of the first interference, forces on teeth.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.formatting import rounded
from hd_diag.gear.characteristics import PHASES, MeshOverTurn, slot_phases, stiffness_steps
from hd_diag.model.contact import contacts
from hd_diag.model.geometry import Geometry
from hd_diag.model.mesh import Mesh
from hd_diag.model.neutral_curve import mean_radius
from hd_diag.model.tooth_profile import DoubleArc

LEAST_TEETH = 60
"""Of a flexspline: below a ratio of 30 no gear with the teeth of ratio 100 has been seen."""

_SHIFTS = (
    -40e-6,
    120e-6,
)  # of the slots, of a drive with the known one's module; beyond, teeth are others [m]
_DIGITS = 10  # decimals of a length: a tenth of a nanometre, so that every machine has the same numbers [m]
_DIGITS_KEPT = 4  # significant, of a compliance
_SOFTER = 10.0  # logarithm of how much softer or stiffer teeth may be than where the search begins [-]
_SOFTEST_CUP = 0.95  # of 1 / K1: as soft as all of it would leave nothing to the teeth [-]
_STEPS, _LAST_STEP = 12, 2e-9  # of a solution; each leaves a fiftieth of the error, or less [m]
_TRIALS, _CLOSE = 65, 1e-6  # compliances beside each other; of their logarithm, and of the cup's share [-]


def module_scale(known: Geometry, scale: float, teeth: int) -> float:
    """Module of a drive over that of a known one [-], for a pitch circle `scale` times as large."""
    return scale * known.flexspline_teeth / teeth


def similar(known: Geometry, scale: float, teeth: int) -> Geometry:
    """Geometry with a pitch circle `scale` times that of a known one, and so many teeth.

    Parameters
    ----------
    known : Geometry
    scale : float
        Pitch diameter over the known one's [-].
    teeth : int
        Of the flexspline, even; the circular spline has as many more as the known one's.

    Raises
    ------
    ValueError
        Saying why no drive with these teeth runs.
    """
    if teeth < LEAST_TEETH:
        raise ValueError(
            f"{teeth} teeth of the flexspline are fewer than {LEAST_TEETH} (ratio {LEAST_TEETH // 2}): such "
            "gears have another profile and deformation, which similarity does not tell: give them all"
        )
    k, start = module_scale(known, scale, teeth), _by_module(known, scale, teeth)
    wanted = k * least_backlash(known)[0]
    low, high = (k * shift for shift in _SHIFTS)
    shift = 0.0
    for _ in range(_STEPS):  # Newton
        backlash, slope = least_backlash(_shifted(start, shift))
        step = (wanted - backlash) / slope
        shift += step
        if not low <= shift <= high:
            break
        if abs(step) < _LAST_STEP:
            return _shifted(start, shift, _DIGITS)
    raise ValueError(
        f"no place of the slots between {low * 1e6:.0f} and {high * 1e6:.0f} µm from where the module "
        f"has them gives {teeth} teeth their clearance: no similar profile; give all the geometry"
    )


@lru_cache(maxsize=64)  # that of the known one stays
def least_backlash(geometry: Geometry) -> tuple[float, float]:
    """Least backlash of all teeth without eccentricity and torque [m], and its change with the slots' [-].

    Teeth are even in number. Over half a slot pitch: what - flanks do there, + flanks do in the other half.
    """
    found = contacts(Mesh(geometry), slot_phases(geometry)[: PHASES // 2 + 1], lobes=1)
    backlash = found.rotation * found.radius
    least = np.nanargmin(backlash)
    return float(backlash.flat[least]), float(found.opening.flat[least] * found.radius.flat[least])


def compliances(mesh: Mesh, t1: float, t2: float, wanted: Floats) -> tuple[float, float]:
    """Compliance of a tooth pair [m/N] and of the cup [rad/(N m)] that come nearest to K1, K2, K3.

    Parameters
    ----------
    mesh : Mesh
        Without eccentricity; its tooth compliance is where the search begins.
    t1, t2 : float
        Torques of the three steps [N m].
    wanted : ndarray, shape (3,)
        K1, K2, K3 [N m/rad].

    Notes
    -----
    Least squares of the logarithms of reached over wanted stiffness. Teeth that are softer by a factor
    turn as far at a torque as these do at that factor times it.
    """
    teeth, steps, share = (
        MeshOverTurn(mesh, slot_phases(mesh.geometry)),
        stiffness_steps(t1, t2),
        wanted / wanted[0],
    )
    low, high = -_SOFTER, _SOFTER
    while high - low > _CLOSE:
        trial = np.linspace(low, high, _TRIALS)
        beta = teeth.torsion(np.outer(np.exp(trial), steps).ravel()).mean(axis=0).reshape(_TRIALS, -1)
        reached = np.diff(beta) / np.diff(steps) * wanted
        cup = _cup_shares(reached, share)
        miss = (np.log(reached + cup[:, None] * share) ** 2).sum(axis=1)
        best = int(np.argmin(miss))
        low, high = trial[max(best - 1, 0)], trial[min(best + 1, _TRIALS - 1)]
    tooth, softness = mesh.tooth_compliance * math.exp(trial[best]), float(cup[best])
    of_cup = rounded(softness / wanted[0], _DIGITS_KEPT) if softness > 1e-6 else 0.0
    return rounded(tooth, _DIGITS_KEPT), of_cup


def _cup_shares(reached: Floats, share: Floats) -> Floats:
    """The cup's best compliance times K1 beside each of some teeth (trials,), by bisection.

    `reached` (trials, 3) are the teeth's compliances and `share` (3,) that of such a cup, over those wanted.
    """
    low, high = np.zeros(len(reached)), np.full(len(reached), _SOFTEST_CUP)
    while np.max(high - low) > _CLOSE:
        middle = 0.5 * (low + high)
        whole = reached + middle[:, None] * share
        falling = (np.log(whole) * share / whole).sum(axis=1) < 0.0
        low, high = np.where(falling, middle, low), np.where(falling, high, middle)
    return low


def _by_module(known: Geometry, scale: float, teeth: int) -> Geometry:
    """Geometry by similarity, with the slots where the module has them."""
    k, radius = module_scale(known, scale, teeth), scale * known.curve.radius
    major = radius + k * (known.semi_major - known.curve.radius)
    minor = 2.0 * radius - major
    for _ in range(_STEPS):  # the perimeter hardly differs from that of a circle of the semi-axes' mean
        minor += 2.0 * (radius - mean_radius(major, minor))
    return Geometry(
        teeth,
        teeth + known.circular_spline_teeth - known.flexspline_teeth,
        round(major, _DIGITS),
        round(minor, _DIGITS),
        _scaled(known.flexspline_tooth, k),
        round(k * known.flexspline_root, _DIGITS),
        round(k * known.flexspline_tip, _DIGITS),
        _scaled(known.circular_spline_slot, k),
        major + k * (known.circular_spline_datum - known.semi_major),
        major + k * (known.circular_spline_tip_radius - known.semi_major),
    )


def _shifted(geometry: Geometry, shift: float, digits: int = 17) -> Geometry:
    """Geometry with the slots further out [m], to so many decimals."""
    places = (geometry.circular_spline_datum, geometry.circular_spline_tip_radius)
    datum, tip = (round(place + shift, digits) for place in places)
    return replace(geometry, circular_spline_datum=datum, circular_spline_tip_radius=tip)


def _scaled(flank: DoubleArc, k: float) -> DoubleArc:
    def point(center: tuple[float, float]) -> tuple[float, float]:
        return round(k * center[0], _DIGITS), round(k * center[1], _DIGITS)

    return DoubleArc(
        round(k * flank.addendum_radius, _DIGITS),
        round(k * flank.dedendum_radius, _DIGITS),
        point(flank.addendum_center),
        point(flank.dedendum_center),
    )
