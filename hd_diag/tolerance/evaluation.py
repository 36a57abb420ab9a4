"""Everything that is judged of a mesh, at many moments and torques at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.drive import Drive
from hd_diag.model import torsion
from hd_diag.model.kernel.mesh_data import blank
from hd_diag.model.mesh import Mesh, contiguous

_PHASES = 32  # tooth phases over which the reference stiffness is the mean


@dataclass(frozen=True)
class Evaluation:
    """Quantities of n moments, those under load at q torques.

    `interference` (n,): how far the teeth at lobe 0 overlap with the slots, circumferential [m], the least
    backlash of their flanks with the opposite sign, the tooth at the lobe held on the axis (see
    :func:`evaluate`). `overlap` (n,): how far both lobes press against each other at zero torque,
    circumferential [m]; negative: clearance; above zero no rotation of the cup frees all teeth. With shape
    (n, q): torsion beta [rad], stiffness dM/dbeta of the teeth [N m/rad], largest force on a flank [N],
    largest over mean force of the loaded flanks [-], 1 where none is.
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
) -> Evaluation:
    """Quantities of a mesh at any number of moments; nan where no flank can bear the torque.

    The moments are wave generator angles theta_W [rad] and displacements of its centre in the housing, x + iy
    [m], each (n,); the mesh's own eccentricity and runout do not count. Torques are M on the cup (q,) [N m];
    `slot_angle` (Z_G,) is by how much each slot stands counter-clockwise of its place [rad].

    Notes
    -----
    Interference as in Dong et al. (2019), section 4.2: tooth 0 stays on the axis although the wave generator
    is displaced across it (eq. 1), hence the arc offset ``s_0 = -E_across``; a tooth's backlash is the lesser
    of its two flanks; the least of the lobe at tooth 0 counts, for at the other lobe the displacement points
    the other way.
    """
    from hd_diag.tolerance import kernel  # here, because numba takes its time

    turn, center = contiguous(wave_generator_angle), np.ascontiguousarray(displacement, dtype=np.complex128)
    across: Floats = np.imag(center * np.exp(-1j * turn))
    slots = np.zeros(mesh.geometry.circular_spline_teeth) if slot_angle is None else contiguous(slot_angle)
    geometry, loads = kernel.evaluate(mesh.data, turn, center, -across, slots, contiguous(torque))
    gap, least, radius = geometry.T
    return Evaluation(-least, -gap * radius, *np.moveaxis(loads, 2, 0))


def reference_stiffness(drive: Drive, cup_torque: Floats) -> Floats:
    """Least torsional stiffness of a drive without eccentricity and runout (q,) [N m/rad].

    It goes up and down as pairs come into load, by 1 % for 200 teeth and 3 % for 100: no loss, whatever the
    gear. Raises ValueError if the teeth cannot bear one of the torques on the cup (q,) [N m].
    """
    turn = drive.mesh.geometry.slot_pitch * np.arange(_PHASES) / _PHASES
    found = evaluate(drive.mesh, turn, np.zeros(_PHASES, dtype=np.complex128), cup_torque)
    if not np.isfinite(found.torsion).all():
        torques = ", ".join(f"{value:g}" for value in cup_torque)
        raise ValueError(f"the teeth cannot bear {torques} N m even without eccentricity")
    least: Floats = np.min(found.total_stiffness(drive.cup_compliance), axis=0)
    return least


def warm_up() -> None:
    """Compile now, or read from the disk, the model's kernels and that of :func:`evaluate`."""
    from hd_diag.tolerance import kernel

    torsion.warm_up()
    row = np.empty(0)
    kernel.evaluate(blank(), row, row.astype(np.complex128), row, row, row)
