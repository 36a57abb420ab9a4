"""Interpolation in a torsion map.

A map takes far more memory than a core has near it, so that samples anywhere in it wait for their rows. Hence
an index, small enough to stay near, tells about where in a row a torque is; and the places of a whole block
of samples are found and asked for before any is read.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from hd_diag.arrays import Floats, Integers, Table
from hd_diag.model.kernel.compiler import entry_point, inline, part

Columns = npt.NDArray[np.int16]
Single = np.float32

BLOCK = 32
"""Samples whose places are found at once."""

_TURN = 2.0 * math.pi
_BELOW_ZERO = -5e-324  # the float before zero
_ROWS = 64  # from one row of the index to the next; breakpoints move by a few columns meanwhile
_BINS = 256  # of torque in the index
_READ, _KEEP, _DATA = 0, 3, 1  # as LLVM's prefetch has them: for reading, in all caches, not instructions


def _fetch(typing: Any, rows: Any, row: Any, column: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code: Any = cgutils  # without types
        kind = signature.args[0]
        table = context.make_array(kind)(context, builder, arguments[0])
        address = code.get_item_pointer(context, builder, kind, table, arguments[1:])
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        form = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        prefetch = code.get_or_insert_function(builder.module, form, "llvm.prefetch.p0i8")
        how = [number(value) for value in (_READ, _KEEP, _DATA)]
        builder.call(prefetch, [builder.bitcast(address, byte), *how])
        return context.get_dummy_value()

    return types.void(rows, types.intp, types.intp), generate


fetch: Any = intrinsic(_fetch)
"""Have one place of a table (array, row, column) on its way to the core, without waiting for it."""


def _pointer(typing: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.intp), generate


_at: Any = intrinsic(_pointer)
"""What lies at an address."""

_array: Any = numba.carray  # type: ignore[attr-defined]


class Cells(NamedTuple):
    """Places of a block's samples: row (-1: no answer), share of the way to the next, about which column."""

    share: Floats
    row: Integers
    column: Integers


@part
def cells() -> Cells:
    """Room for the places of one block."""
    return Cells(np.empty(BLOCK), np.empty(BLOCK, dtype=np.int64), np.empty(BLOCK, dtype=np.int64))


@entry_point
def columns(breakpoints: Table) -> Columns:
    """The index that a table needs: about which column holds each bin of torque, for every so many rows."""
    rows, last = breakpoints.shape[0], breakpoints.shape[1] - 2
    found = np.empty((1 + (rows - 1) // _ROWS, _BINS), dtype=np.int16)
    lowest, step = breakpoints[0, 0], (breakpoints[0, -1] - breakpoints[0, 0]) / _BINS
    for i in range(found.shape[0]):
        row, column = min(i * _ROWS + _ROWS // 2, rows - 1), 0
        for k in range(_BINS):
            while column < last and breakpoints[row, column + 1] <= lowest + (k + 0.5) * step:
                column += 1
            found[i, k] = column
    return found


@part
def locate(
    breakpoints: Table,
    values: Table,
    near: Columns,
    repeats: int,
    limit: float,
    turn: Floats,
    torque: Floats,
    begin: int,
    end: int,
    cells: Cells,
) -> None:
    """Set the places of the samples from ``begin`` to before ``end``, and have what is there fetched."""
    period, lowest = breakpoints.shape[0] - 1, breakpoints[0, 0]
    steps = repeats * period
    scale, bins = steps / _TURN, _BINS / (breakpoints[0, -1] - lowest)
    for i in range(begin, end):
        place, k = _within_turn(turn[i]) * scale, i - begin
        cells.row[k] = -1
        if abs(torque[i]) <= limit and not math.isnan(place):
            whole, above = min(int(place), steps - 1), (torque[i] - lowest) * bins
            row = whole % period
            cells.share[k], cells.row[k] = place - whole, row
            column = near[row // _ROWS, int(min(above, _BINS - 1.0)) if above > 0.0 else 0]
            cells.column[k] = column
            for r in range(row, row + 2):
                fetch(breakpoints, r, column)
                fetch(values, r, column)


@inline
def _within_turn(turn: float) -> float:
    rest: float = np.fmod(turn, _TURN)
    return rest + (_TURN if rest < 0.0 else 0.0)


@part
def read(
    breakpoints: Table, values: Table, torque: Floats, begin: int, end: int, cells: Cells, beta: Floats
) -> None:
    """Set the torsions of the samples from ``begin`` to before ``end``.

    Each is in the column of the last breakpoint that is not above its torque, at most the last but one. The
    rows are read in place: numba counts a reference for every array that a function is given, and for one
    sample that takes as long as the rest.
    """
    x, y, last = breakpoints, values, breakpoints.shape[1] - 2
    below_end = np.nextafter(np.float64(breakpoints[0, -1]), 0.0)
    for i in range(begin, end):
        row, column, load = cells.row[i - begin], cells.column[i - begin], torque[i]
        value, low, high = min(load, below_end), math.nan, math.nan
        for r in range(row, row + 2 if row >= 0 else row):
            while column > 0 and x[r, column] > value:
                column -= 1
            while column < last and x[r, column + 1] <= value:
                column += 1
            low, high = high, _line(x[r, column], x[r, column + 1], y[r, column], y[r, column + 1], load)
            if load == 0.0:  # the middle of a true gap
                c = column
                while c > 0 and x[r, c] > _BELOW_ZERO:
                    c -= 1
                high = 0.5 * (high + _line(x[r, c], x[r, c + 1], y[r, c], y[r, c + 1], load))
        beta[i] = low + cells.share[i - begin] * (high - low)


@inline
def _line(start: Single, end: Single, beta: Single, end_beta: Single, torque: float) -> float:
    slope = (np.float64(end_beta) - beta) / (np.float64(end) - start)
    return beta + slope * (torque - start)


@entry_point
def interpolate(
    breakpoints: Table,
    values: Table,
    near: Columns,
    repeats: int,
    limit: float,
    turn: Floats,
    torque: Floats,
    beta: Floats,
    first: int,
    last: int,
) -> None:
    """Torsion (n,) by a table; nan beyond its limit."""
    found = cells()
    for begin in range(first, last, BLOCK):
        end = min(begin + BLOCK, last)
        locate(breakpoints, values, near, repeats, limit, turn, torque, begin, end, found)
        read(breakpoints, values, torque, begin, end, found, beta)


@part
def interpolate_at(place: Any, turn: Floats, torque: Floats, beta: Floats, count: int) -> None:
    """As `interpolate` for the first of the samples, by a table whose place and size a record has."""
    shape = place.rows, place.columns
    breakpoints = _array(_at(place.breakpoints), shape, np.float32)
    values = _array(_at(place.values), shape, np.float32)
    near = _array(_at(place.near), (1 + (place.rows - 1) // _ROWS, _BINS), np.int16)
    interpolate(breakpoints, values, near, place.repeats, place.limit, turn, torque, beta, 0, count)
