"""Formulas: plain functions of numbers or arrays that are also compiled into kernels."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, cast

import numpy as np

Result = TypeVar("Result")
Value = TypeVar("Value")

FORMULAS: list[Callable[..., Any]] = []
"""All formulas in the order of their definition."""


def formula(function: Callable[..., Result]) -> Callable[..., Result]:
    """Register a function for compiled kernels and return it unchanged; it must branch by `choose`."""
    FORMULAS.append(function)
    return function


def choose(condition: bool, yes: Value, no: Value) -> Value:
    """``yes if condition else no``, for arrays element by element, for named tuples field by field."""
    make: Any = getattr(yes, "_make", None)
    if make is None:
        return cast(Value, np.where(condition, cast(Any, yes), cast(Any, no)))
    return cast(Value, make(map(partial(choose, condition), cast(Any, yes), cast(Any, no))))


@formula
def larger(a: float, b: float) -> float:
    """The larger of two; the first if either is nan."""
    return choose(b > a, b, a)


@formula
def smaller(a: float, b: float) -> float:
    """The smaller of two; the first if either is nan."""
    return choose(b < a, b, a)
