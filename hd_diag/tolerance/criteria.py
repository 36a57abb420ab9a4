"""What an assembly is judged by: one number per criterion, too much of which is bad."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import Drive
from hd_diag.model.torsion_map import ARCSEC
from hd_diag.tolerance.evaluation import Evaluation, evaluate

_PHASES = 32  # tooth phases over which the reference stiffness is the mean


@dataclass(frozen=True)
class Criterion:
    """One criterion.

    Name, in brief, meaning, SI unit; unit that people read and how many of it make one; whether it jumps
    where a pair comes into load.
    """

    name: str
    brief: str
    meaning: str
    unit: str
    shown: str
    scale: float
    jumps: bool = False


CRITERIA = (
    Criterion("interference", "interf.", "overlap of teeth and slots at one lobe", "m", "um", 1e6),
    Criterion("overlap", "overlap", "both lobes pressed against each other, no torque", "m", "um", 1e6),
    Criterion("peak_tooth_load", "load", "largest force on a flank", "N", "N", 1.0),
    Criterion(
        "load_concentration", "conc.", "largest over mean force of the loaded flanks", "-", "-", 1.0, True
    ),
    Criterion(
        "stiffness_loss",
        "stiff.",
        "torsional stiffness lost against a perfect assembly",
        "-",
        "%",
        100.0,
        True,
    ),
    Criterion("transmission_error", "TE", "peak to peak over a turn", "rad", "arcsec", 1.0 / ARCSEC),
)
"""All but the last are of a moment; the last is of a turn of the wave generator."""

NAMES = tuple(criterion.name for criterion in CRITERIA)


def cup_torques(drive: Drive, torque: Floats) -> Floats:
    """Torques on the cup [N m] for torques that the drive exerts on the link, checked.

    Raises
    ------
    ValueError
        If one is zero or not finite: stiffness and load distribution are those under load.
    """
    for value in torque:
        if value == 0.0 or not math.isfinite(value):
            raise ValueError(f"torque must be finite and not zero, not {value:g} N m")
    return drive.frame.cup_torque(torque)


def total_stiffness(moments: Evaluation, cup_compliance: float) -> Floats:
    """Torsional stiffness of teeth and cup [N m/rad], shape (n, q); zero where no tooth bears."""
    return np.asarray(moments.stiffness / (1.0 + cup_compliance * moments.stiffness))


def reference_stiffness(drive: Drive, cup_torque: Floats) -> Floats:
    """Mean torsional stiffness of a drive without eccentricity and runout.

    Parameters
    ----------
    drive : Drive
    cup_torque : ndarray, shape (q,)
        [N m]

    Returns
    -------
    ndarray, shape (q,)
        [N m/rad]
    """
    turn = drive.mesh.geometry.slot_pitch * np.arange(_PHASES) / _PHASES
    moments = evaluate(drive.mesh, turn, np.zeros(_PHASES, dtype=np.complex128), cup_torque)
    mean: Floats = np.mean(total_stiffness(moments, drive.cup_compliance), axis=0)
    if not np.isfinite(moments.torsion).all():
        raise ValueError(f"the teeth cannot bear {_numbers(cup_torque)} N m even without eccentricity")
    return mean


def of_moments(moments: Evaluation, cup_compliance: float, reference: Floats) -> Floats:
    """Values of the criteria of a moment.

    Parameters
    ----------
    moments : Evaluation
        n moments, q torques.
    cup_compliance : float
        [rad/(N m)]
    reference : ndarray, shape (q,)
        Stiffness against which a loss counts [N m/rad].

    Returns
    -------
    ndarray, shape (5, n, q)
        In the order of :data:`CRITERIA`; infinite where no flank can bear the torque.
    """
    shape = moments.torsion.shape
    loss = 1.0 - total_stiffness(moments, cup_compliance) / reference
    values = np.stack(
        (
            np.broadcast_to(moments.interference[:, None], shape),
            np.broadcast_to(moments.overlap[:, None], shape),
            moments.peak_load,
            moments.load_concentration,
            loss,
        )
    )
    return np.where(np.isnan(values), np.inf, values)


def over_turn(moments: Evaluation, cup_compliance: float, reference: Floats) -> Floats:
    """Worst of every criterion over moments of one turn of the wave generator.

    Parameters
    ----------
    moments, cup_compliance, reference
        As for :func:`of_moments`.

    Returns
    -------
    ndarray, shape (6, q)
        In the order of :data:`CRITERIA`.
    """
    worst = of_moments(moments, cup_compliance, reference).max(axis=1)
    width: Floats = np.ptp(moments.torsion, axis=0)
    return np.concatenate((worst, np.where(np.isnan(width), np.inf, width)[None, :]))


def _numbers(values: Floats) -> str:
    return ", ".join(f"{value:g}" for value in values)
