"""The place of the slots and the compliances that give a similar mesh the torsion curve of its page.

A page promises torsion from zero torque on: no backlash, then K1, K2, K3. Slopes alone do not tell where the
slots lie: with the known drive's clearance others would have 8 to 27 arcsec of lost motion that no page has.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.formatting import rounded
from hd_diag.gears.characteristics import PHASES, MeshOverTurn, slot_phases
from hd_diag.gears.page import Page
from hd_diag.gears.similarity import module_scale, moved, similar
from hd_diag.model.mesh import Mesh

_PROBED = 4e-6  # shift of the slots that shows the overlap's change, for the known drive's module [m]
_AROUND = (-40e-6, 10e-6)  # in which a page's place is looked for, from where teeth come free [m]
_PLACES = 14  # tried first: where sections come to bear one after the other there are several good ones
_FARTHEST = 120e-6  # from the place that the module gives; beyond, teeth are others [m]
_FINE = 0.02e-6  # resolution of a place; 0.1 % of the torsion at T1/10 [m]
_FEW = 4  # phases of the teeth at which these are
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_POWER = 8  # of relative errors in a miss: the largest alone nearly counts; even

_DIGITS_KEPT = 4  # significant, of a compliance
_SOFTER = 10.0  # logarithm of how much softer or stiffer teeth may be than where the search begins [-]
_SOFTEST_CUP = 0.95  # of 1 / K1: as soft as all of it would leave nothing to the teeth [-]
_TRIALS, _CLOSE = 65, 1e-6  # compliances beside each other; of their logarithm, and of the cup's share [-]


Width = tuple[tuple[str, Any], ...]


class PageFit(NamedTuple):
    """A mesh with its cup's compliance [rad/(N m)], and how far its torsion misses the page's.

    The miss is the sum of high powers of the relative errors, that of a lost motion among them: the largest
    count.
    """

    miss: float
    mesh: Mesh
    cup_compliance: float


def of_page(known: Mesh, scale: float, teeth: int, page: Page, width: Width = ()) -> PageFit:
    """A mesh similar to a known one that has the page's torsion curve.

    Parameters
    ----------
    known : Mesh
        Without eccentricity; its tooth compliance is where the search begins.
    scale : float
        Pitch diameter over the known one's [-].
    teeth : int
        Of the flexspline.
    page : Page
    width : tuple of (str, number)
        What is known of face width and cup length [m], or of the number of sections, by name.

    Raises
    ------
    ValueError
        Saying why there is none.
    """
    start = replace(known, geometry=replace(similar(known.geometry, scale, teeth), **dict(width)))
    k = module_scale(known.geometry, scale, teeth)
    place, slope = _free(start, k * _PROBED)
    if not abs(place) <= k * _FARTHEST:
        raise ValueError(
            f"slots would have to lie {place * 1e6:.0f} µm further out than the module has them for {teeth} "
            f"teeth to come free, more than {k * _FARTHEST * 1e6:.0f} µm: no similar profile; give all the "
            "geometry"
        )
    gap = page.lost_motion * start.geometry.semi_major / -slope
    return _nearest(start, page, place + k * _AROUND[0], place + k * _AROUND[1] + gap, k * _FINE)


def _free(start: Mesh, step: float) -> tuple[float, float]:
    """Shift of the slots that gives neither overlap nor clearance [m]; overlap by shift [-]."""

    def overlap(shift: float) -> float:
        mesh = replace(start, geometry=moved(start.geometry, shift))
        return MeshOverTurn(mesh, slot_phases(mesh.geometry)).overlap()

    slope = (overlap(step) - overlap(0.0)) / step
    return round(-overlap(0.0) / slope / step, 1) * step, slope


def _nearest(start: Mesh, page: Page, low: float, high: float, fine: float) -> PageFit:
    """The fit with the slots at the best place of a range [m]: of some, then by golden section about it."""

    def fitted(shift: float, phases: int = PHASES) -> PageFit:
        try:
            mesh = replace(start, geometry=moved(start.geometry, shift))
        except ValueError:  # teeth do not engage there
            return PageFit(math.inf, start, 0.0)
        return _with_compliances(mesh, page, phases)

    places = np.linspace(low, high, _PLACES).tolist()
    best = min(range(_PLACES), key=lambda index: fitted(places[index], _FEW).miss)
    low, high = places[max(best - 1, 0)], places[min(best + 1, _PLACES - 1)]
    inner, outer = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_inner, at_outer = fitted(inner), fitted(outer)
    while high - low > fine:
        if at_inner.miss < at_outer.miss:
            high, outer, at_outer = outer, inner, at_inner
            inner = high - _GOLDEN * (high - low)
            at_inner = fitted(inner)
        else:
            low, inner, at_inner = inner, outer, at_outer
            outer = low + _GOLDEN * (high - low)
            at_outer = fitted(outer)
    return min(at_inner, at_outer, key=lambda fit: fit.miss)


def _with_compliances(mesh: Mesh, page: Page, phases: int) -> PageFit:
    """The fit with the best compliance of a tooth pair, found by trials side by side, and of the cup.

    Teeth that are softer by a factor turn as far at a torque as these do at that factor times it.
    """
    teeth, torque = MeshOverTurn(mesh, slot_phases(mesh.geometry, phases)), page.torques
    wanted = page.torsion(torque)
    share, low, high = torque / page.k1 / wanted, -_SOFTER, _SOFTER
    while high - low > _CLOSE:
        trial = np.linspace(low, high, _TRIALS)
        beta = teeth.torsion(np.outer(np.exp(trial), torque).ravel()).mean(axis=0).reshape(_TRIALS, -1)
        cup = _cup_shares(beta / wanted, share)
        off = beta / wanted + cup[:, None] * share - 1.0
        miss = (off**_POWER).sum(axis=1)
        best = int(np.argmin(miss))
        low, high = trial[max(best - 1, 0)], trial[min(best + 1, _TRIALS - 1)]
    tooth = rounded(mesh.tooth_compliance * math.exp(trial[best]), _DIGITS_KEPT)
    softness = float(cup[best])
    of_cup = rounded(softness / page.k1, _DIGITS_KEPT) if softness > 1e-6 else 0.0
    lost = teeth.lost_motion() / page.lost_motion - 1.0 if page.lost_motion else 0.0
    return PageFit(float(miss[best]) + lost**_POWER, replace(mesh, tooth_compliance=tooth), of_cup)


def _cup_shares(reached: Floats, share: Floats) -> Floats:
    """The cup's best compliance times K1 beside each of some teeth (trials,), by bisection.

    `reached` (trials, 8) are the teeth's torsions and `share` (8,) that of a cup as soft as K1, over those
    wanted.
    """
    low, high = np.zeros(len(reached)), np.full(len(reached), _SOFTEST_CUP)
    while np.max(high - low) > _CLOSE:
        middle = 0.5 * (low + high)
        off = reached + middle[:, None] * share - 1.0
        falling = (off ** (_POWER - 1) * share).sum(axis=1) < 0.0
        low, high = np.where(falling, middle, low), np.where(falling, high, middle)
    return low
