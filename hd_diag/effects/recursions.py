"""Recursions over samples that no array operation replaces, compiled where numba is there.

Both ways do the same operations in the same order, so they agree to the last bit.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from hd_diag.model import compiled

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


def slip(state: float, change: Floats) -> Floats:
    """Maxwell slip element ``z <- clip(z + change, -1, 1)``.

    Parameters
    ----------
    state : float
        z before the first change.
    change : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        z after every change.
    """
    found: Floats = _fast(_slip)(float(state), np.ascontiguousarray(change))
    return found


def relax(state: complex, decay: Complexes, added: Complexes) -> Complexes:
    """First-order recursion ``q <- decay q + added``.

    Parameters
    ----------
    state : complex
        q before the first step.
    decay, added : ndarray of complex, shape (n,)

    Returns
    -------
    ndarray of complex, shape (n,)
        q after every step.
    """
    found: Complexes = _fast(_relax)(complex(state), np.ascontiguousarray(decay), np.ascontiguousarray(added))
    return found


def _slip(state: float, change: Floats) -> Floats:
    result = np.empty(change.size)
    for index in range(change.size):
        state = min(1.0, max(-1.0, state + change[index]))
        result[index] = state
    return result


def _relax(state: complex, decay: Complexes, added: Complexes) -> Complexes:
    result = np.empty(decay.size, dtype=np.complex128)
    for index in range(decay.size):
        state = decay[index] * state + added[index]
        result[index] = state
    return result


@functools.cache
def _fast(function: Callable[..., Any]) -> Callable[..., Any]:
    if not compiled.available():
        return function
    from hd_diag.model.kernel import entry_point

    return entry_point(function)
