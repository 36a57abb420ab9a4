"""Torsion tabulated over a turn of the wave generator and torque, so that a prediction is an interpolation.

With exact tooth numbers the mesh repeats after one turn of the wave generator, so the torsion is a function
on a cylinder (theta_W, M). It is piecewise linear in torque, and the table keeps the breakpoints of each
angle, so only the step between two wave generator angles is an approximation. Where a true gap makes the
torsion jump at zero torque, the table holds both ends and gives the middle.

Torques and torsions are stored as 16-bit steps: steps of the torque's root, and of the curve's departure from
a line. Breakpoints are moved along the curve to the nearest torque step, so only the torsion is rounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from hd_diag.arrays import Floats, Singles, Steps
from hd_diag.formatting import ARCSEC as ARCSEC  # effects of others import it from here
from hd_diag.model import kernel
from hd_diag.model.kernel import STEPS
from hd_diag.model.mesh import Mesh, contiguous, moments
from hd_diag.model.threads import spread
from hd_diag.model.torsion import torsion_table

TOLERANCE = 0.01 * ARCSEC
"""Target error of a map [rad]."""

# Wave generator angles per tooth passing. The torsion's slope has a kink where a pair comes into load. With
# fewer teeth each pair has more of the stiffness and moves further per angle, so the steps per tooth go as
# 1 / Z_G^2. TOLERANCE needs 64 at ratio 100, 250 at ratio 50 and 25 at ratio 160. With sections half as many
# are enough, because each section brings only a share of a pair's stiffness.
STEPS_PER_TOOTH = 64
_IN_SECTIONS = 0.5
_FINE_TEETH = 202
_CHECKED_ANGLES = 512
_CHECKED_TORQUES = 64
_MISSED = 2.0  # checks rarely meet a cell's worst place, but they find half the greatest error [-]
_SAMPLES = 10_000  # samples that a thread takes at a time
_LEAST_STEP = 1e-30  # torsion step where a curve is a line [rad]
_CHUNK = 256  # angles per call: between calls a build can be cancelled and other threads run


class BuildCancelled(Exception):
    """The caller no longer wants the map."""


@dataclass(frozen=True)
class TorsionMap:
    """Torsion on a grid of wave generator angles, with each angle's own torque breakpoints.

    Attributes
    ----------
    mesh : Mesh
        Mesh that the map was built for.
    torque, torsion : ndarray of int16, shape (n + 1, breakpoints)
        The rising piecewise-linear curve of every angle of a period; the last angle repeats the first. Torque
        steps count the signed root of the torque: `STEPS` of them are the root of the requested limit.
    lines : ndarray of float32, shape (n + 1, 3)
        Line that each angle's torsions are counted from: torsion at zero torque [rad], slope [rad/(N m)];
        and the torsion step [rad].
    repeats : int
        Periods in a turn of the wave generator.
    requested_limit : float
        Greatest |M| asked for [N m].
    torque_limit : float
        Greatest |M| that the map covers [N m]; less than the requested limit if the torsion jumps.
    error_bound : float
        Twice the greatest difference from the exact solution that checks found between the angles [rad].
    """

    mesh: Mesh
    torque: Steps
    torsion: Steps
    lines: Singles
    repeats: int
    requested_limit: float
    torque_limit: float
    error_bound: float

    @cached_property
    def place(self) -> tuple[float, ...]:
        """Addresses for kernels of breakpoints, torsions, lines, index; then size, periods, limits."""
        *arrays, repeats, limit, greatest = self._table
        return *(array.ctypes.data for array in arrays), *self.torque.shape, repeats, limit, greatest

    @cached_property
    def _table(self) -> tuple[Any, ...]:
        """The table and its index in the form that kernels read."""
        torque, torsion = (np.require(each, np.int16, ["C", "W"]) for each in (self.torque, self.torsion))
        lines, limits = (
            np.require(self.lines, np.float32, ["C", "W"]),
            (self.torque_limit, self.requested_limit),
        )
        return torque, torsion, lines, kernel.entry.columns(torque), self.repeats, *limits

    def __call__(self, wave_generator_angle: Floats, torque: Floats) -> Floats:
        """Torsion (n,) [rad] at wave generator angles (n,) [rad] and torques on the cup (n,) [N m].

        It is linear between angles, and nan beyond `torque_limit`. Every element depends only on its own
        inputs, to the last bit, whatever the size of the batch.
        """
        turn, load = contiguous(wave_generator_angle), contiguous(torque)
        if turn.shape != load.shape:
            raise ValueError(f"{turn.size} wave generator angles, but {load.size} torques")
        beta = np.empty(turn.size)
        spread(partial(kernel.entry.interpolate, *self._table, turn, load, beta), beta.size, _SAMPLES)
        return beta


def build(
    mesh: Mesh,
    torque_limit: float,
    wanted: Callable[[float], bool] = lambda fraction: True,
    steps_per_tooth: int = STEPS_PER_TOOTH,
    threads: int = 1,
) -> TorsionMap:
    """Build the map of a mesh and check it against the exact solution.

    Parameters
    ----------
    mesh : Mesh
    torque_limit : float
        Greatest |M| of the map [N m]. Where pairs enter with their tip corners under load, the torsion jumps
        and no table can follow: the map then ends below that torque.
    wanted : callable
        Called with the fraction done; returning False cancels the build.
    steps_per_tooth : int
        Wave generator angles per tooth passing of a gear with 202 slots in one section; the error falls with
        the square of this number.
    threads : int
        Number of threads that solve angles; it does not change the map.

    Returns
    -------
    TorsionMap

    Raises
    ------
    BuildCancelled
        If `wanted` returned False.
    """
    teeth = mesh.geometry.circular_spline_teeth
    share = 1.0 if mesh.geometry.sections == 1 else _IN_SECTIONS
    steps = teeth * round(share * steps_per_tooth * (_FINE_TEETH / teeth) ** 2)
    repeats = math.gcd(_repeats(mesh), steps)
    angle = 2.0 * np.pi / steps * np.arange(steps // repeats, dtype=np.float64)
    limit = float(torque_limit)
    table = TorsionMap(mesh, *_curves(mesh, angle, limit, wanted, threads), repeats, limit, limit, np.inf)
    return _checked(table, 2.0 * TOLERANCE * (STEPS_PER_TOOTH / steps_per_tooth) ** 2)


def _repeats(mesh: Mesh) -> int:
    """Number of periods of the torsion within a turn of the wave generator.

    A displacement that turns with it meets every slot alike. With a displacement fixed in the housing, one
    lobe repeats what the other did half a turn before.
    """
    if mesh.arc_offset:
        return 1
    if not (mesh.eccentricity or mesh.tilt):
        return mesh.geometry.circular_spline_teeth
    return 1 if mesh.runout else 2


def _curves(
    mesh: Mesh, angle: Floats, torque_limit: float, wanted: Callable[[float], bool], threads: int
) -> tuple[Steps, Steps, Singles]:
    """Rising piecewise-linear curves of a period, shape (angles + 1, breakpoints), and their lines.

    The last angle repeats the first; a true gap has two breakpoints at zero torque. Rows with fewer
    breakpoints are padded with the limit. Raises ValueError where no flank can bear the limit.
    """
    turn, center, _ = moments(mesh, angle)
    parts = [slice(begin, min(begin + _CHUNK, angle.size)) for begin in range(0, angle.size, _CHUNK)]
    found: list[tuple[Any, ...]] = []

    def curves(part: slice) -> tuple[Any, ...]:
        torque, torsion = kernel.entry.curves(mesh.data, turn[part], center[part], torque_limit)
        return _in_steps(torque, torsion, torque_limit)

    with ThreadPoolExecutor(threads, thread_name_prefix="torsion map") as pool:
        solved = pool.map(curves, parts)
        for part in parts:
            if not wanted(part.start / angle.size):
                pool.shutdown(cancel_futures=True)
                raise BuildCancelled
            found.append(next(solved))
    if not all(np.isfinite(lines).all() for *_, lines in found):
        raise ValueError(f"the teeth cannot bear {torque_limit:g} N m at every wave generator angle")
    inside = [np.flatnonzero((np.abs(own) < STEPS).any(axis=0)) for own, *_ in found]
    used = np.unique(np.concatenate(inside))
    first, last = int(used[0]) - 1, int(used[-1]) + 1
    both = [np.empty((angle.size + 1, last + 1 - first), np.int16) for _ in range(2)]
    lines = np.concatenate([*(lines for *_, lines in found), found[0][-1][:1]])
    for part in parts:
        for whole, own in zip(both, found.pop(0), strict=False):  # pop: no second copy of large arrays stays
            whole[part] = own[:, -1:]
            whole[part, : own.shape[1] - first] = own[:, first : last + 1]
    for whole in both:
        whole[-1] = whole[0]
    return both[0], both[1], lines


def _in_steps(torque: Floats, torsion: Floats, limit: float) -> tuple[Steps, Steps, Singles]:
    """Curves (n, k) [N m], [rad] in a map's steps; each breakpoint moves along the piece it moves into."""
    slope = (torsion[:, -1:] - torsion[:, :1]) / (2.0 * limit)
    place = np.copysign(np.rint(STEPS * np.sqrt(np.abs(torque) / limit)), torque)
    moved = place * np.abs(place) * (limit / STEPS**2) - torque
    with np.errstate(all="ignore"):  # pieces of no length; nan where no flank can bear the limit
        rise = np.diff(torsion) / np.diff(torque)
    rise = np.where(np.isfinite(rise), rise, slope)
    along = np.where(moved > 0.0, np.hstack((rise, slope)), np.hstack((slope, rise)))
    rest = torsion + along * moved - slope * (torque + moved)
    low, high = rest.min(axis=1, keepdims=True), rest.max(axis=1, keepdims=True)
    lines = np.hstack((0.5 * (low + high), slope, np.maximum((high - low) / (2 * STEPS), _LEAST_STEP)))
    with np.errstate(invalid="ignore"):
        steps = np.rint((rest - lines[:, :1]) / lines[:, 2:])
        return place.astype(np.int16), steps.astype(np.int16), lines.astype(np.float32)


def _checked(built: TorsionMap, jump: float) -> TorsionMap:
    """Measure the error between the angles; end the map below the torque where it exceeds `jump` [rad]."""
    steps = built.repeats * (built.torque.shape[0] - 1)
    count = np.arange(_CHECKED_ANGLES)
    # Golden-section sequences meet every tooth passing and every phase of the cells evenly.
    cell = np.floor(steps * ((count * 0.6180339887498949) % 1.0))
    angle = 2.0 * np.pi / steps * (cell + 0.1 + 0.8 * ((count * 0.7548776662466927) % 1.0))
    torque = built.torque_limit * (np.arange(1, _CHECKED_TORQUES + 1) / _CHECKED_TORQUES) ** 2
    both = np.concatenate((-torque[::-1], [0.0], torque))
    tabulated = built(np.repeat(angle, both.size), np.tile(both, angle.size)).reshape(angle.size, -1)
    error = np.abs(tabulated - torsion_table(built.mesh, angle, both)).max(axis=0)
    idle = error[_CHECKED_TORQUES]
    error = np.maximum(error[_CHECKED_TORQUES + 1 :], error[:_CHECKED_TORQUES][::-1])
    jumps = np.flatnonzero(~(error <= jump))
    kept = int(jumps[0]) if jumps.size else torque.size
    limit = float(torque[kept - 1]) if kept else 0.0
    return replace(built, torque_limit=limit, error_bound=_MISSED * float(error[:kept].max(initial=idle)))
