"""Regressions without a gear model: with group means removed, and deviations from clustered residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.record import Record

_CLUSTERS = 24
_NEAR_ZERO = 0.05  # torque range of a flank change, over the rated torque


class Regression(NamedTuple):
    """Coefficients with their standard deviations, shape (k,), and the rms of the residual."""

    value: Floats
    deviation: Floats
    rest: float


def centered(values: Floats, group: Integers) -> Floats:
    """Values (n,) less the mean of their group (n,), a run or a recording."""
    return np.asarray(values - (np.bincount(group, values) / np.maximum(np.bincount(group), 1))[group])


def regression(columns: Sequence[Floats], values: Floats, group: Integers) -> Regression:
    """Regression of values on columns, all of shape (n,), after removal of the group means.

    The deviations allow for residuals that are correlated within each of `_CLUSTERS` stretches.
    """
    parts, target = [centered(column, group) for column in columns], centered(values, group)
    scale = np.array([max(float(np.linalg.norm(column)), 1e-300) for column in parts])
    matrix = np.stack(parts, axis=1) / scale
    inverse = np.linalg.pinv(matrix, rcond=1e-6)
    beta = inverse @ target
    rest = target - matrix @ beta
    cluster = np.arange(values.size) * _CLUSTERS // values.size
    sums = np.stack([np.bincount(cluster, pull) for pull in inverse * rest])
    deviation = np.sqrt(np.sum(sums**2, axis=1)) / scale
    return Regression(beta / scale, deviation, float(np.sqrt(np.mean(rest**2))))


def usual_laws(record: Record, rated_torque: float) -> list[Floats]:
    """Dimensionless regressors (n,) of order one for torsion and friction of any joint."""
    load = record.torque / rated_torque
    torsion = [load, load * np.abs(load), load**3, np.tanh(load / _NEAR_ZERO)]
    return [*torsion, record.speed / record.top_speed, record.way]
