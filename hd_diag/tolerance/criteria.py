"""What an assembly is judged by: one number per criterion, too much of which is bad."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats
from hd_diag.drive import Drive
from hd_diag.formatting import ARCSEC
from hd_diag.tolerance.evaluation import Evaluation


@dataclass(frozen=True)
class Criterion:
    """One criterion.

    Name and its short form; SI unit; unit that people read and how many of it make one; whether it jumps
    where a pair comes into load.
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
"""All but the last are of a moment; the last is of a turn of the wave generator."""

NAMES = tuple(criterion.name for criterion in CRITERIA)


def cup_torques(drive: Drive, torque: Floats) -> Floats:
    """Torques on the cup for torques that the drive exerts on the link [N m].

    Raises ValueError if one is zero or not finite: stiffness and load distribution are those under load.
    """
    for value in torque:
        if value == 0.0 or not math.isfinite(value):
            raise ValueError(f"torque must be finite and not zero, not {value:g} N m")
    return drive.frame.cup_torque(torque)


def of_moments(found: Evaluation, cup_compliance: float, reference: Floats) -> Floats:
    """Criteria of n moments at q torques (5, n, q); infinite where no flank can bear the torque.

    A loss of stiffness counts against a reference (q,) [N m/rad].
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
    """Worst of every criterion over each of several turns of the wave generator (6, turns, q).

    The moments evaluated are those of one turn after the other, as many of each.
    """
    values = of_moments(found, cup_compliance, reference)
    worst = values.reshape(len(values), turns, -1, reference.size).max(axis=2)
    width: Floats = np.ptp(found.torsion.reshape(turns, -1, reference.size), axis=1)
    return np.concatenate((worst, np.where(np.isnan(width), np.inf, width)[None]))
