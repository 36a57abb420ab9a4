"""Which tolerance matters: shares of the variance of each criterion, first and total order (Sobol)."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hd_diag.arrays import Floats

_INTERVAL = 100.0 * np.array([0.5 * (1.0 - 0.95), 0.5 * (1.0 + 0.95)])  # [%]
_RESAMPLES = 200


@dataclass(frozen=True)
class SobolEstimate:
    """Shares of the variance, and the bounds of their bootstrap intervals (95 %), each (outputs, factors).

    Zero where an output never changes; nan where it is not finite in some sample. Estimates of small shares
    may be below zero.
    """

    value: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True)
class Indices:
    """Sobol indices: first order, of the factor alone; total order, with its interactions."""

    first: SobolEstimate
    total: SobolEstimate


def evaluations(samples: int, factors: int) -> int:
    """Number of evaluations of a model."""
    return samples * (factors + 2)


def indices(
    model: Callable[[Floats], Floats], factors: int, samples: int, rng: np.random.Generator
) -> Indices:
    """Sobol indices of a model of independent numbers between 0 and 1.

    The model takes numbers (n, factors) and gives outputs (n, outputs); samples are a power of two.

    Saltelli et al., "Variance based sensitivity analysis of model output", Computer Physics Communications
    181, 2010, in scipy.stats.sobol_indices; intervals are percentiles over bootstrap resamples.
    """
    from scipy.stats import qmc  # imported here: it takes half a second

    generator = "rng" if "rng" in inspect.signature(qmc.Sobol).parameters else "seed"  # by version of scipy
    points = qmc.Sobol(2 * factors, **{generator: rng}).random(samples)
    first, second = points[:, :factors], points[:, factors:]
    mixed = np.repeat(first[None], factors, axis=0)
    for k in range(factors):
        mixed[k, :, k] = second[:, k]
    output = model(np.concatenate((first, second, mixed.reshape(-1, factors))))
    blocks = np.moveaxis(output.reshape(factors + 2, samples, -1), 2, 1)  # (2 + factors, outputs, samples)
    finite = np.asarray(np.isfinite(blocks).all(axis=(0, 2)))
    blocks = np.where(finite[:, None], blocks, 0.0)
    again = [_estimate(blocks[:, :, rng.integers(samples, size=samples)]) for _ in range(_RESAMPLES)]
    low, high = np.percentile(again, _INTERVAL, axis=0)
    found = np.stack((_estimate(blocks), low, high), axis=1)
    first_order, total_order = np.where(finite[:, None], found, math.nan)
    return Indices(SobolEstimate(*first_order), SobolEstimate(*total_order))


def _estimate(blocks: Floats) -> Floats:
    """First and total order (2, outputs, factors) of outputs (2 + factors, outputs, samples)."""
    from scipy.stats import sobol_indices

    found = sobol_indices(func={"f_A": blocks[0], "f_B": blocks[1], "f_AB": blocks[2:]}, n=blocks.shape[2])
    shape = blocks.shape[1], blocks.shape[0] - 2
    return np.stack((found.first_order.reshape(shape), found.total_order.reshape(shape)))
