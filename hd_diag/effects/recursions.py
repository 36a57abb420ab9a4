"""Recursions over samples that no array operation replaces, compiled when first called."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from hd_diag.arrays import Complexes, Floats


def warm_up() -> None:
    """Compile all of them now, or read them from the disk."""
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
    found: Floats = _compiled(_slip)(float(state), np.ascontiguousarray(change))
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
    steps = np.ascontiguousarray(decay), np.ascontiguousarray(added)
    found: Complexes = _compiled(_relax)(complex(state), *steps)
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
    found: Floats = _compiled(_follow)(*parts, np.ascontiguousarray(values))
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
    """Real and imaginary parts apart, so that the compiler works on several columns at once."""
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


@functools.cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    from hd_diag.model.kernel.compiler import entry_point  # here, because numba takes its time

    return entry_point(function)
