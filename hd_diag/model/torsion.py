"""Torsion of a mesh: pose, contact and load solved exactly, for any number of moments, with derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.model import kernel
from hd_diag.model.mesh import Mesh, contiguous, moments
from hd_diag.model.threads import MOMENTS, spread

BEYOND = 1.0
"""Margin of the solved torques beyond those asked for [N m]; even at zero torque both signs are solved."""

# Change of displacement that the gradient may bridge, in modules: this over the squared steps of a pitch, as
# both errors go with the square, times the sections, which bear one by one. Costs 0.02 arcsec at ratio 100.
_CARRIED = 0.004
# Factor by which two gradients need fewer teeth for the same error, and the least number per turn: measured.
_FEWER, _LEAST = 1.75, 5
# Samples for which two gradients cost as much as solving one section at one angle: measured.
_SAMPLES = 100


def warm_up(gradient: bool = False) -> None:
    """Compile the kernels of predictions and maps, or load them from disk; with `gradient` also of fits."""
    kernel.entry.warm_up(gradient)


def torsion(mesh: Mesh, wave_generator_angle: Floats, torque: float | Floats) -> Floats:
    """Exact torsion beta (moments,) [rad] at theta_W (moments,) [rad] and torques M on the cup [N m].

    At zero torque in a true gap it is the gap's middle; it is nan if no flank can bear the torque. Every
    element depends only on its own inputs, to the last bit. A large batch is spread over the cores.
    """
    rows = moments(mesh, wave_generator_angle, torque)
    beta = np.empty(rows[0].size)
    spread(partial(kernel.entry.torsion, mesh.data, *rows, beta), beta.size, MOMENTS)
    return beta


def torsion_table(mesh: Mesh, wave_generator_angle: Floats, torque: Floats) -> Floats:
    """Exact torsion (moments, torques) [rad] at every pair of wave generator angle and torque on the cup.

    Contacts are solved and sorted once per moment; values are those of :func:`torsion`.
    """
    order = np.argsort(torque)
    turn, center, _ = moments(mesh, wave_generator_angle)
    table: Floats = kernel.entry.torsion_table(mesh.data, turn, center, contiguous(torque[order]))
    return table[:, np.argsort(order)]


def torsion_and_gradient(mesh: Mesh, wave_generator_angle: Floats, torque: Floats) -> tuple[Floats, Floats]:
    """Exact :func:`torsion` (moments,) [rad] and its derivatives (moments, 7), in one pass.

    The derivatives are by E_x, E_y in the housing [rad/m], r_0 [rad/m], K1 + K2 [rad N/m], M [rad/(N m)]
    (infinite in a true gap) and the tilt's x and y [-] (zero with one section).

    Notes
    -----
    With K the stiffness of the loaded flanks, ``d beta / d M = 1 / K`` and ``d beta / d (K1 + K2) =
    M / (K1 + K2) / K``; the others: :mod:`hd_diag.model.kernel.sensitivity`.
    """
    turn, center, load = moments(mesh, wave_generator_angle, torque)
    beta, gradient = kernel.entry.torsion_and_gradient(mesh.data, turn, center, load)
    return beta, _with_compliance(mesh, load, gradient)


@dataclass(frozen=True, eq=False)
class TorsionAlong:
    """As :func:`torsion_and_gradient` for many samples at any torques, solved only at steps of some teeth.

    One tooth further, the drive differs only in the direction of its displacement. The gradient extrapolates
    to samples at other teeth; between two steps the torsion is linear. Nodes are exact at every torque. A
    kink where a pair comes into load is blurred by one step. nan where no flank can bear the torques.

    Parameters
    ----------
    mesh : Mesh
    wave_generator_angle : ndarray, shape (n,)
        Wave generator angles of the samples [rad].
    low, high : float
        Range of torques on the cup that it covers [N m].
    steps : int
        Steps per tooth pitch.
    """

    mesh: Mesh
    wave_generator_angle: Floats
    low: float
    high: float
    steps: int

    def covers(self, torque: Floats) -> bool:
        """Whether all torques (n,) are within the range [N m]."""
        return bool(self.low <= np.min(torque, initial=math.inf)) and bool(
            np.max(torque, initial=-math.inf) <= self.high
        )

    def __call__(self, torque: Floats) -> tuple[Floats, Floats]:
        """Torsion (n,) [rad] and its derivatives (n, 7) at torques on the cup (n,) [N m]."""
        order, where, pieces = self._samples
        found = np.empty((order.size, 5 if self.mesh.geometry.sections == 1 else 7))
        found[order] = kernel.entry.torsion_along(*where, *pieces, contiguous(torque[order]))
        return found[:, -1], _with_compliance(self.mesh, torque, found[:, :-1])

    @cached_property
    def _samples(self) -> tuple[Integers, tuple[Any, ...], tuple[Any, ...]]:
        """Samples sorted by cell, their places in the cells, and the solved nodes around them."""
        mesh, steps, teeth = self.mesh, self.steps, self.mesh.geometry.circular_spline_teeth
        solved, blends = teeth_along(mesh, steps, self.wave_generator_angle.size)
        pitch, first = 2.0 * np.pi / teeth, (2 * np.arange(solved) + 1) * teeth // (2 * solved)
        nodes = pitch * (first[:, None] + np.linspace(0.0, 1.0, steps + 1)).ravel()
        every = np.arange(teeth)
        own, across = every * solved // teeth, np.zeros(teeth)
        if blends:
            own = np.searchsorted(first, every, side="right") - 1  # -1: the last tooth
            across = (every - first[own]) % teeth / ((np.roll(first, -1) - first) % teeth)[own]
        place = np.mod(self.wave_generator_angle, 2.0 * np.pi) * (teeth / (2.0 * np.pi))
        tooth = np.minimum(place.astype(np.int64), teeth - 1)
        phase = (place - tooth) * steps
        step = np.minimum(phase.astype(np.int64), steps - 1)
        cell = (own % solved * steps)[tooth] + step
        order = np.argsort(cell.astype(np.int32), kind="stable")
        begin = np.searchsorted(cell[order], np.arange(solved * steps + 1))
        turn, center, _ = moments(mesh, nodes)
        share, turned = (phase - step)[order], np.exp(1j * self.wave_generator_angle[order])
        given = steps, blends, begin
        pieces = kernel.entry.pieces_along(mesh.data, turn, center, *given, self.low, self.high)
        fixed = complex(mesh.tilt), complex(mesh.eccentricity)
        return order, (turn, *fixed, *given, share, across[tooth[order]], turned), pieces


def torsion_along(
    mesh: Mesh, wave_generator_angle: Floats, torque: Floats, steps: int
) -> tuple[Floats, Floats]:
    """:class:`TorsionAlong`, built for given torques and called with them."""
    low, high = float(np.min(torque)) - BEYOND, float(np.max(torque)) + BEYOND
    return TorsionAlong(mesh, wave_generator_angle, low, high, steps)(torque)


def teeth_along(mesh: Mesh, steps: int, samples: int) -> tuple[int, bool]:
    """Number of teeth at which :func:`torsion_along` solves, and whether it blends two of them for a sample.

    The number rises with the wave generator's displacement. Blending two gradients needs fewer teeth but more
    time per sample, so it pays if there are few samples.
    """
    farthest, geometry = abs(mesh.eccentricity) + mesh.lean, mesh.geometry
    needed = math.ceil(math.pi * farthest * steps**2 / (_CARRIED * geometry.sections * geometry.module))
    alone = min(max(needed, 1), geometry.circular_spline_teeth)
    blended = max(math.ceil(alone / _FEWER), _LEAST)
    saved = (alone - blended) * (steps + 1) * geometry.sections
    return (blended, True) if saved * _SAMPLES > samples else (alone, False)


def _with_compliance(mesh: Mesh, torque: Floats, gradient: Floats) -> Floats:
    """Derivatives by E_x, E_y, r_0, K1 + K2, M, tilt from those by E_x, E_y, r_0, tilt (if any), M."""
    by_torque, tilt = gradient[:, -1], np.zeros((torque.size, 2))
    tilt[:, : gradient.shape[1] - 4] = gradient[:, 3:-1]
    with np.errstate(invalid="ignore"):  # in a true gap there is no torque
        by_compliance = torque / mesh.tooth_compliance * by_torque
    by_compliance = np.where(torque == 0.0, 0.0, by_compliance)
    return np.column_stack((gradient[:, :3], by_compliance, by_torque, tilt))
