"""Fit of the slots' place and of the compliances, so that a similar mesh has its page's torsion curve.

A page gives the torsion from zero torque on: no backlash, then K1, K2, K3. Slopes alone do not determine the
place of the slots: with the known drive's clearance, other drives would have 8 to 27 arcsec of lost motion,
which no page has.
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

_PROBED = 4e-6  # shift of the slots to measure the overlap's slope, for the known drive's module [m]
_AROUND = (-40e-6, 10e-6)  # search range of the slots' place, from where teeth come free [m]
_PLACES = 14  # places tried first: sections that come to bear one by one make several good places
_FARTHEST = 120e-6  # greatest shift from the place by the module; beyond it the profile is another [m]
_FINE = 0.02e-6  # resolution of a place; 0.1 % of the torsion at T1/10 [m]
_FEW = 4  # phases of the teeth at which the first places are tried
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_POWER = 8  # even power of relative errors in a miss: nearly only the largest error counts

_DIGITS_KEPT = 4  # significant digits of a compliance
_SOFTER = 10.0  # most change of the teeth's compliance from the start of the search, as a logarithm [-]
_SOFTEST_CUP = 0.95  # most compliance of the cup over 1 / K1: the teeth need the rest [-]
_TRIALS, _CLOSE = 65, 1e-6  # compliances per round; resolution of their logarithm and of the cup's share [-]


Width = tuple[tuple[str, Any], ...]


class PageFit(NamedTuple):
    """Misfit of the torsion to the page's, mesh, and compliance of the cup [rad/(N m)].

    `miss` is the sum of high powers of the relative errors, including that of the lost motion, so that the
    largest errors count.
    """

    miss: float
    mesh: Mesh
    cup_compliance: float


def of_page(known: Mesh, scale: float, teeth: int, page: Page, width: Width = ()) -> PageFit:
    """A mesh similar to a known one that has the page's torsion curve.

    Parameters
    ----------
    known : Mesh
        Mesh without eccentricity; the search begins at its tooth compliance.
    scale : float
        Pitch diameter over the known one's [-].
    teeth : int
        Number of teeth of the flexspline.
    page : Page
    width : tuple of (str, number)
        Known face width [m], cup length [m] or number of sections, by name.

    Raises
    ------
    ValueError
        If there is none; the message says why.
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
    """Shift of the slots that gives neither overlap nor clearance [m]; slope of overlap over shift [-]."""

    def overlap(shift: float) -> float:
        mesh = replace(start, geometry=moved(start.geometry, shift))
        return MeshOverTurn(mesh, slot_phases(mesh.geometry)).overlap()

    slope = (overlap(step) - overlap(0.0)) / step
    return round(-overlap(0.0) / slope / step, 1) * step, slope


def _nearest(start: Mesh, page: Page, low: float, high: float, fine: float) -> PageFit:
    """The fit with the slots at the best place of a range [m]: best of a grid, then golden section."""

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
    """The fit with the best compliances of a tooth pair, found by grids that narrow, and of the cup.

    Teeth that are softer by a factor have the torsion that these have at that factor times the torque.
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
    """The cup's best compliance times K1 for each trial compliance of the teeth (trials,), by bisection.

    `reached` (trials, 8) is the teeth's torsion over the wanted one. `share` (8,) is the torsion of a cup of
    stiffness K1 over the wanted one.
    """
    low, high = np.zeros(len(reached)), np.full(len(reached), _SOFTEST_CUP)
    while np.max(high - low) > _CLOSE:
        middle = 0.5 * (low + high)
        off = reached + middle[:, None] * share - 1.0
        falling = (off ** (_POWER - 1) * share).sum(axis=1) < 0.0
        low, high = np.where(falling, middle, low), np.where(falling, high, middle)
    return low
