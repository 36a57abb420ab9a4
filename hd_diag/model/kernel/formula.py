"""Formulas: plain functions of numbers, or of arrays of them, which compiled kernels take in as their own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, cast

import numpy as np

Result = TypeVar("Result")
Value = TypeVar("Value")

FORMULAS: list[Callable[..., Any]] = []
"""In the order in which they are written."""


def formula(function: Callable[..., Result]) -> Callable[..., Result]:
    """Make a function part of compiled kernels, unchanged; its choices use `choose`."""
    FORMULAS.append(function)
    return function


def choose(condition: bool, yes: Value, no: Value) -> Value:
    """``yes if condition else no``, of arrays element by element, of named tuples field by field."""
    make: Any = getattr(yes, "_make", None)
    if make is None:
        return cast(Value, np.where(condition, cast(Any, yes), cast(Any, no)))
    return cast(Value, make(map(partial(choose, condition), cast(Any, yes), cast(Any, no))))


@formula
def larger(a: float, b: float) -> float:
    """The larger of two; the first where one is nan."""
    return choose(b > a, b, a)


@formula
def smaller(a: float, b: float) -> float:
    """The smaller of two; the first where one is nan."""
    return choose(b < a, b, a)
