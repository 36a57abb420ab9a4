"""Long columns in blocks, so that intermediate results need little memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from hd_diag.arrays import Floats, Integers
from hd_diag.diagnosis.noise import bounds

Kind = TypeVar("Kind", bound=np.generic)

BLOCK = 1 << 18
"""Rows of a block."""


def blocks(begin: int, end: int, margin: int = 0) -> Iterator[tuple[slice, slice, slice]]:
    """Blocks of the rows from `begin` to before `end`.

    Yields three slices: the rows of a block; these rows with up to `margin` rows before and after; and the
    place of the block within the second slice.
    """
    for first in range(begin, end, BLOCK):
        last = min(first + BLOCK, end)
        low, high = max(first - margin, begin), min(last + margin, end)
        yield slice(first, last), slice(low, high), slice(first - low, last - low)


def filtered(
    result: npt.NDArray[Kind],
    segment: Integers,
    function: Callable[[slice], npt.NDArray[Kind]],
    margin: int,
) -> None:
    """Fill `result` (n,) block by block with a function of rows, within segments numbered by `segment` (n,).

    Each value depends on `margin` rows on either side.
    """
    for begin, end in bounds(segment):
        for rows, around, inner in blocks(begin, end, margin):
            result[rows] = function(around)[inner]


def unwrapped(angle: Floats) -> Floats:
    """Angles without jumps of whole turns [rad], shape (n,)."""
    result = np.empty_like(angle)
    for rows, _, _ in blocks(0, angle.size):
        before = result[max(rows.start - 1, 0) : rows.start]
        result[rows] = np.unwrap(np.concatenate((before, angle[rows])))[before.size :]
    return result
