"""Greatest value of a function on a circle or torus: local maxima of a grid, finer grids around them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from hd_diag.arrays import Floats, Integers

_HILLS = 8  # local maxima that are climbed
_ROUNDS, _CLOSER, _BESIDE = 6, 3, 3  # of a climb: so many grids, each so much finer, points to either side

NARROWING = _CLOSER**_ROUNDS
"""By how much a climb refines the grid that it starts from."""


def hills(values: Floats) -> Integers:
    """Flat indices of the greatest local maxima.

    Parameters
    ----------
    values : ndarray
        On a grid over a circle or a torus.

    Returns
    -------
    ndarray of int
        At most eight, the greatest first.
    """
    beside = ndimage.generate_binary_structure(values.ndim, 1)
    index = np.flatnonzero(values >= ndimage.maximum_filter(values, footprint=beside, mode="wrap"))
    order = np.argsort(-values.ravel()[index], kind="stable")
    return np.asarray(index[order[:_HILLS]], dtype=np.int64)


def climbed(function: Callable[[Floats], Floats], centers: Floats, step: Floats) -> tuple[Floats, float]:
    """The greatest value near some places.

    Parameters
    ----------
    function : callable
        Of points (n, d); gives values (n,).
    centers : ndarray, shape (m, d)
    step : ndarray, shape (d,)
        How far around the centres to look.

    Returns
    -------
    place : ndarray, shape (d,)
    value : float
        There: the greatest to a step :data:`NARROWING` times as fine.
    """
    dimensions = centers.shape[1]
    side = np.linspace(-1.0, 1.0, 2 * _BESIDE + 1)
    offsets = np.stack(np.meshgrid(*[side] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)
    for _ in range(_ROUNDS):
        points = centers[:, None, :] + offsets * step
        values = function(points.reshape(-1, dimensions)).reshape(points.shape[:2])
        best = np.argmax(values, axis=1)
        centers = points[np.arange(best.size), best]
        step = step / _CLOSER
    top = int(np.argmax(values.max(axis=1)))
    return centers[top], float(values[top].max())
