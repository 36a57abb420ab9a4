"""Criteria of a mesh, evaluated at many moments and torques at once: one number per criterion."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.drive import Drive
from hd_diag.formatting import ARCSEC
from hd_diag.model import torsion
from hd_diag.model.kernel.mesh_data import blank
from hd_diag.model.mesh import Mesh, contiguous
from hd_diag.streams.columns import LARGEST_TORQUE

_PHASES = 32  # tooth phases over which the reference stiffness is the least


@dataclass(frozen=True)
class Criterion:
    """A criterion of an assembly; larger values are worse.

    Name and its short form; SI unit; displayed unit and its number per SI unit; whether the value jumps where
    a pair comes into load.
    """

    name: str
    brief: str
    unit: str
    shown: str
    scale: float
    jumps: bool = False


CRITERIA = (
    Criterion("interference", "interf.", "m", "µm", 1e6),  # overlap of teeth and slots at one lobe
    Criterion("overlap", "overlap", "m", "µm", 1e6),  # of both lobes with each other, without torque
    Criterion("peak_tooth_load", "load", "N", "N", 1.0),  # largest force on a flank
    Criterion("load_concentration", "conc.", "-", "-", 1.0, jumps=True),  # largest over mean force
    Criterion("stiffness_loss", "stiff.", "-", "%", 100.0, jumps=True),  # against a perfect assembly
    Criterion("transmission_error", "TE", "rad", "arcsec", 1.0 / ARCSEC),  # peak to peak over a turn
)
"""All except the last apply to a moment; the last applies to a turn of the wave generator."""

NAMES = tuple(criterion.name for criterion in CRITERIA)

# Criteria that need of a moment: the first lobe with its tooth held, all flanks, loads on the flanks.
_OF_LOBE, _OF_FLANKS, _OF_LOADS = frozenset(NAMES[:2]), frozenset(NAMES[1:]), frozenset(NAMES[2:])


@dataclass(frozen=True)
class Evaluation:
    """Quantities of n moments, those under load at q torques.

    `interference` (n,): least backlash at lobe 0 with the opposite sign [m], see :func:`evaluate`. `overlap`
    (n,): circumferential distance by which both lobes press against each other at zero torque [m]; negative
    is clearance; above zero no rotation of the cup frees all teeth. With shape (n, q): torsion beta [rad],
    stiffness dM/dbeta of the teeth [N m/rad], largest force on a flank [N], largest over mean force of the
    loaded flanks [-], which is 1 without loaded flanks.
    """

    interference: Floats
    overlap: Floats
    torsion: Floats
    stiffness: Floats
    peak_load: Floats
    load_concentration: Floats

    def total_stiffness(self, cup_compliance: float) -> Floats:
        """Torsional stiffness of teeth and cup [N m/rad], shape (n, q); zero where no tooth bears."""
        return np.asarray(self.stiffness / (1.0 + cup_compliance * self.stiffness))


def evaluate(
    mesh: Mesh,
    wave_generator_angle: Floats,
    displacement: Complexes,
    torque: Floats,
    slot_angle: Floats | None = None,
    tilt: Complexes | None = None,
    wanted: Collection[str] = NAMES,
) -> Evaluation:
    """Quantities of a mesh at any number of moments; nan where no flank can bear the torque.

    Quantities that no `wanted` criterion needs are nan, too.

    The moments are wave generator angles theta_W [rad] and displacements of its centre in the housing, x + iy
    [m], each (n,); the mesh's own eccentricity and runout are ignored. Torques are M on the cup (q,) [N m];
    `slot_angle` (Z_G,) is the counter-clockwise deviation of each slot from its place [rad]. A `tilt` (n,)
    replaces the mesh's own [rad].

    Notes
    -----
    Interference as in Dong et al. (2019), section 4.2: tooth 0 stays on the axis although the wave generator
    is displaced across it (eq. 1), so the arc offset is ``s_0 = -E_across``. A tooth's backlash is the lesser
    of its two flanks. Only the least backlash of the lobe at tooth 0 counts, because the displacement points
    the other way at the other lobe.
    """
    from hd_diag.tolerance import kernel  # imported here, because numba takes long to load

    turn, center = contiguous(wave_generator_angle), np.ascontiguousarray(displacement, dtype=np.complex128)
    across: Floats = np.imag(center * np.exp(-1j * turn))
    slots = np.zeros(mesh.geometry.circular_spline_teeth) if slot_angle is None else contiguous(slot_angle)
    leaning = np.full(turn.size, mesh.tilt) if tilt is None else np.ascontiguousarray(tilt)
    leaning = leaning.astype(np.complex128, copy=False)
    loads = np.full((4, turn.size, torque.size), np.nan)
    gap, least, radius = np.full((3, turn.size), np.nan)
    if not _OF_LOBE.isdisjoint(wanted):
        least, radius = kernel.lobes(mesh.data, turn, center, leaning, -across, slots).T
    if not _OF_FLANKS.isdisjoint(wanted):
        borne = contiguous(torque if not _OF_LOADS.isdisjoint(wanted) else torque[:0])
        gap, found = kernel.loads(mesh.data, turn, center, leaning, slots, borne)
        loads = np.moveaxis(found, 2, 0) if borne.size else loads
    return Evaluation(-least, -gap * radius, *loads)


def reference_stiffness(drive: Drive, cup_torque: Floats) -> Floats:
    """Least torsional stiffness of a drive without eccentricity and runout (q,) [N m/rad].

    The stiffness varies as pairs come into load, by 1 % for 200 teeth and 3 % for 100; this is no loss.
    Raises ValueError if the teeth cannot bear one of the torques on the cup (q,) [N m].
    """
    turn = drive.mesh.geometry.slot_pitch * np.arange(_PHASES) / _PHASES
    found = evaluate(drive.mesh, turn, np.zeros(_PHASES, dtype=np.complex128), cup_torque)
    if not np.isfinite(found.torsion).all():
        torques = ", ".join(f"{value:g}" for value in cup_torque)
        raise ValueError(f"the teeth cannot bear {torques} N m even without eccentricity")
    least: Floats = np.min(found.total_stiffness(drive.cup_compliance), axis=0)
    return least


def cup_torques(drive: Drive, torque: Floats) -> Floats:
    """Torques on the cup for torques that the drive exerts on the link [N m].

    Raises ValueError if a torque is zero or not finite, because stiffness and load distribution need a load,
    or if its magnitude exceeds :data:`LARGEST_TORQUE`.
    """
    for value in torque:
        if value == 0.0 or not math.isfinite(value):
            raise ValueError(f"torque must be finite and not zero, not {value:g} N m")
        if abs(value) > LARGEST_TORQUE:
            raise ValueError(f"torque must be at most {LARGEST_TORQUE:g} N m, not {value:g}")
    return drive.frame.cup_torque(torque)


def of_moments(found: Evaluation, cup_compliance: float, reference: Floats) -> Floats:
    """Criteria of n moments at q torques (5, n, q); infinite where no flank can bear the torque.

    The loss of stiffness is relative to a reference (q,) [N m/rad].
    """
    shape = found.torsion.shape
    values = np.stack(
        (
            np.broadcast_to(found.interference[:, None], shape),
            np.broadcast_to(found.overlap[:, None], shape),
            found.peak_load,
            found.load_concentration,
            1.0 - found.total_stiffness(cup_compliance) / reference,
        )
    )
    return np.where(np.isnan(values), np.inf, values)


def over_turns(found: Evaluation, turns: int, cup_compliance: float, reference: Floats) -> Floats:
    """Worst value of every criterion over each of several turns of the wave generator (6, turns, q).

    The moments are ordered turn by turn, with equally many in each.
    """
    values = of_moments(found, cup_compliance, reference)
    worst = values.reshape(len(values), turns, -1, reference.size).max(axis=2)
    width: Floats = np.ptp(found.torsion.reshape(turns, -1, reference.size), axis=1)
    return np.concatenate((worst, np.where(np.isnan(width), np.inf, width)[None]))


def warm_up() -> None:
    """Compile the model's kernels and those of :func:`evaluate`, or load them from disk."""
    from hd_diag.tolerance import kernel

    torsion.warm_up()
    row = np.empty(0)
    center = row.astype(np.complex128)
    kernel.loads(blank(), row, center, center, row, row)
    kernel.lobes(blank(), row, center, center, row, row)
