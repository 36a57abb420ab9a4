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
    """Flat indices of the greatest local maxima on a grid over a circle or a torus: at most eight."""
    beside = ndimage.generate_binary_structure(values.ndim, 1)
    index = np.flatnonzero(values >= ndimage.maximum_filter(values, footprint=beside, mode="wrap"))
    order = np.argsort(-values.ravel()[index], kind="stable")
    return np.asarray(index[order[:_HILLS]], dtype=np.int64)


def climbed(function: Callable[[Floats], Floats], centers: Floats, step: Floats) -> tuple[Floats, float]:
    """Place (d,) of the greatest value near some places (m, d), and the value.

    The function takes points (n, d) and gives values (n,). Grids of so many steps (d,) around the centres
    narrow to steps :data:`NARROWING` times as fine.
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
