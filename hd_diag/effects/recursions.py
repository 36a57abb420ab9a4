"""Recursions over samples that no array operation replaces, compiled where numba is there.

Both ways do the same operations in the same order, so they agree to the last bit.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from hd_diag.arrays import Complexes, Floats
from hd_diag.model import compiled


def warm_up() -> None:
    """Compile now, or read from the disk, all of them; nothing where numba is missing."""
    nothing = np.zeros(1, dtype=np.complex128)
    slip(0.0, np.zeros(1))
    relax(0j, nothing, nothing)
    follow(nothing, (nothing, nothing, nothing), np.zeros((2, 1)))


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


def follow(state: Complexes, steps: tuple[Complexes, Complexes, Complexes], values: Floats) -> Floats:
    """Real part of ``q <- decay q + constant v + rising dv`` for many columns that start from `state`.

    Parameters
    ----------
    state : ndarray of complex, shape (k,)
        q at the first row.
    steps : tuple of ndarray of complex, shape (n - 1,) or (1,)
        decay, constant and rising of the step from every row to the next.
    values : ndarray, shape (n, k)
        v; dv is the change from a row to the next.

    Returns
    -------
    ndarray, shape (n, k)
        Real part of q at every row.
    """
    if not values.size:
        return np.empty(values.shape)
    every = [np.broadcast_to(one, values.shape[0] - 1) for one in steps]
    # The state is written to: a copy.
    parts = [np.array(part) for one in (*every, state) for part in (one.real, one.imag)]
    way: Callable[..., Any] = _fast(_follow) if compiled.available() else _follow_rows
    found: Floats = way(*parts, np.ascontiguousarray(values))
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


def _follow(
    decay: Floats,
    turn: Floats,
    constant: Floats,
    constant_turn: Floats,
    rising: Floats,
    rising_turn: Floats,
    real: Floats,
    imaginary: Floats,
    values: Floats,
) -> Floats:
    """Real and imaginary parts apart: so both ways round alike."""
    result = np.empty(values.shape)
    for j in range(values.shape[1]):
        result[0, j] = real[j]
    for i in range(values.shape[0] - 1):
        for j in range(values.shape[1]):
            value, change = values[i, j], values[i + 1, j] - values[i, j]
            q, p = real[j], imaginary[j]
            real[j] = (decay[i] * q - turn[i] * p) + (constant[i] * value + rising[i] * change)
            imaginary[j] = (turn[i] * q + decay[i] * p) + (constant_turn[i] * value + rising_turn[i] * change)
            result[i + 1, j] = real[j]
    return result


def _follow_rows(
    decay: Floats,
    turn: Floats,
    constant: Floats,
    constant_turn: Floats,
    rising: Floats,
    rising_turn: Floats,
    real: Floats,
    imaginary: Floats,
    values: Floats,
) -> Floats:
    """The same, all columns of a row at once: without a compiler a loop over them takes too long."""
    result = np.empty(values.shape)
    result[:1] = real
    change = np.diff(values, axis=0)
    added = constant[:, None] * values[:-1] + rising[:, None] * change
    added_turn = constant_turn[:, None] * values[:-1] + rising_turn[:, None] * change
    for i in range(values.shape[0] - 1):
        real, imaginary = (
            (decay[i] * real - turn[i] * imaginary) + added[i],
            (turn[i] * real + decay[i] * imaginary) + added_turn[i],
        )
        result[i + 1] = real
    return result


@functools.cache
def _fast(function: Callable[..., Any]) -> Callable[..., Any]:
    if not compiled.available():
        return function
    from hd_diag.model.kernel import entry_point

    return entry_point(function)
