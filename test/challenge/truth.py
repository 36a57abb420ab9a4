"""What a record was made from: the parameters of the drive, and the arcsecond."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

ARCSEC = np.pi / 180 / 3600  # [rad]
RATIO = 100.0


@dataclass(frozen=True)
class Base:
    """Parameters of a drive without faults; the defaults are the drive as configured.

    Attributes
    ----------
    e, psi : displacement of the wave generator fixed in the housing [m], its direction [rad]
    runout, runout_psi : part that turns with the wave generator [m], direction at theta_W = 0 [rad]
    datum : radius from which the slots are measured [m]
    compliance : of one tooth pair [m/N]
    cup : torsion of the cup beyond the teeth's [rad/(N m)]
    offset : constant added to the output angle [rad]
    """

    e: float = 0.0
    psi: float = 0.0
    runout: float = 0.0
    runout_psi: float = 0.0
    datum: float = 29.868e-3
    compliance: float = 1e-6
    cup: float = 0.0
    offset: float = 0.0

    def as_dict(self) -> dict[str, float]:
        """All parameters by name [SI]."""
        return dataclasses.asdict(self)


NOMINAL = Base()


def drawn(rng: np.random.Generator) -> Base:
    """Draw a drive as it may come from assembly: every parameter off, in the ranges of size 25."""
    return Base(
        e=rng.uniform(0, 25e-6),
        psi=rng.uniform(-np.pi, np.pi),
        runout=rng.uniform(0, 6e-6),
        runout_psi=rng.uniform(-np.pi, np.pi),
        datum=rng.uniform(29.862e-3, 29.884e-3),
        compliance=rng.uniform(0.8e-6, 1.2e-6),
        cup=rng.uniform(0, 5e-6),
        offset=rng.uniform(-5e-4, 5e-4),
    )
