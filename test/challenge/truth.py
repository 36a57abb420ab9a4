"""True parameters of a record's drive, and the arcsecond."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from challenge.design import CUP_SPREAD, SIZE_25, Design

ARCSEC = np.pi / 180 / 3600  # [rad]


@dataclass(frozen=True)
class Base:
    """Parameters of a drive without faults; the defaults are the drive as configured.

    Attributes
    ----------
    e, psi : displacement of the wave generator fixed in the housing [m], its direction [rad]
    runout, runout_psi : part that turns with the wave generator [m], direction at theta_W = 0 [rad]
    datum : radius from which the slots are measured [m]
    compliance : of one tooth pair [m/N]
    cup : torsion of the cup in addition to the teeth's [rad/(N m)]
    offset : constant added to the output angle [rad]
    design : the drive as its maker intends it
    """

    e: float = 0.0
    psi: float = 0.0
    runout: float = 0.0
    runout_psi: float = 0.0
    datum: float = 29.868e-3
    compliance: float = 1e-6
    cup: float = 0.0
    offset: float = 0.0
    design: Design = SIZE_25

    def as_dict(self) -> dict[str, float]:
        """All parameters by name [SI]."""
        return {name: value for name, value in vars(self).items() if name != "design"}


def as_configured(design: Design) -> Base:
    """The drive of a design without faults."""
    shape = design.shape
    return Base(
        datum=shape.circular_spline_datum, compliance=shape.tooth_compliance, cup=design.cup, design=design
    )


NOMINAL = as_configured(SIZE_25)


def drawn(rng: np.random.Generator, design: Design = SIZE_25) -> Base:
    """Draw a drive as assembled: every parameter deviates, within ranges that scale with the size."""
    meant, k = as_configured(design), design.module
    return Base(
        e=rng.uniform(0, 25e-6) * k,
        psi=rng.uniform(-np.pi, np.pi),
        runout=rng.uniform(0, 6e-6) * k,
        runout_psi=rng.uniform(-np.pi, np.pi),
        datum=meant.datum + rng.uniform(-6e-6, 16e-6) * k,
        compliance=meant.compliance * rng.uniform(0.8, 1.2),
        cup=meant.cup + rng.uniform(0, CUP_SPREAD) / design.strength,
        offset=rng.uniform(-5e-4, 5e-4),
        design=design,
    )


def faultless(rng: np.random.Generator, design: Design = SIZE_25) -> Base:
    """Draw a drive without eccentricity: as configured, or with other dimensions and stiffness."""
    whole = drawn(rng, design)
    if rng.random() < 0.5:
        return dataclasses.replace(whole, e=0.0, runout=0.0)
    return dataclasses.replace(as_configured(design), offset=whole.offset)
