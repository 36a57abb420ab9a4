"""Recursions over samples that no array operation replaces, compiled when first called."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from hd_diag.arrays import Complexes, Floats

_BENT = 1e-7  # distance of |z| from 1 at which bending stops


def warm_up() -> None:
    """Compile all recursions now, or read them from the disk."""
    nothing = np.zeros(1, dtype=np.complex128)
    slip(0.0, np.zeros(1))
    bend(0.0, np.zeros(1), 1.0)
    relax(nothing, nothing, nothing[:, None])


def slip(state: float, change: Floats) -> Floats:
    """Maxwell slip element ``z <- clip(z + change, -1, 1)`` from z = `state`: z after every change (n,)."""
    found: Floats = _compiled(_slip)(float(state), np.ascontiguousarray(change))
    return found


def bend(state: float, change: Floats, sharpness: float) -> Floats:
    """Bouc and Wen: ``dz = dx (1 - |z|^n)`` if dx has the sign of z, else ``dz = dx``.

    Returns z after every change of x (n,); z starts at `state`, and `sharpness` is n.
    """
    found: Floats = _compiled(_bend)(float(state), np.ascontiguousarray(change), float(sharpness))
    return found


def relax(state: Complexes, decay: Complexes, added: Complexes) -> Complexes:
    """First-order recursion ``q <- decay q + added`` of k columns: q after every step (n, k).

    `state` (k,) is q before the first step, `decay` is (n,) or (1,), `added` (n, k).
    """
    every = np.array(np.broadcast_to(decay, added.shape[0]))
    found: Complexes = _compiled(_relax)(np.array(state), every, np.ascontiguousarray(added))
    return found


def lag(state: float, decay: Floats, added: Floats) -> Floats:
    """As `relax` for one real column: `decay`, `added` and q after every step have shape (n,)."""
    decays, column = decay.astype(np.complex128), added.astype(np.complex128)[:, None]
    return relax(np.array([state + 0j]), decays, column)[:, 0].real


def _slip(state: float, change: Floats) -> Floats:
    result = np.empty(change.size)
    for index in range(change.size):
        state = min(1.0, max(-1.0, state + change[index]))
        result[index] = state
    return result


def _bend(state: float, change: Floats, sharpness: float) -> Floats:
    result = np.empty(change.size)
    for index in range(change.size):
        parts = int(8.0 * abs(change[index])) + 1  # substeps by the midpoint rule
        if parts > 200:
            parts = 200
        way = change[index] / parts
        for _ in range(parts):
            if state * way > 0.0 and 1.0 - abs(state) < _BENT:
                break
            middle = state
            for share in (0.5, 1.0):
                slope = 1.0 - abs(middle) ** sharpness if middle * way > 0.0 else 1.0
                middle = min(1.0, max(-1.0, state + share * way * slope))
            state = middle
        result[index] = state
    return result


def _relax(state: Complexes, decay: Complexes, added: Complexes) -> Complexes:
    result = np.empty(added.shape, dtype=np.complex128)
    for i in range(added.shape[0]):
        for j in range(added.shape[1]):
            state[j] = decay[i] * state[j] + added[i, j]
            result[i, j] = state[j]
    return result


@functools.cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    from hd_diag.model.kernel.compiler import entry_point  # late: importing numba is slow

    return entry_point(function)
