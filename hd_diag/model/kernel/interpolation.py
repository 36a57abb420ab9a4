"""Interpolation in a torsion map.

A map is far larger than a core's cache, so every sample has to wait for its rows. A small index, which stays
in the cache, gives the approximate column of a torque. The places of a whole block of samples are located and
prefetched before any is read.

Tables hold whole steps. Torque steps are of the torque's root, `STEPS` up to the greatest torque, because
breakpoints are close to each other near zero. Torsions are counted from a line: each row has the line's
torsion at zero torque [rad], its slope [rad/(N m)], and the torsion step [rad].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from hd_diag.arrays import Floats, Integers, Singles, Steps
from hd_diag.model.kernel import STEPS
from hd_diag.model.kernel.compiler import entry_point, inline, part

BLOCK = 32
"""Samples whose places are located at once."""

_TURN = 2.0 * math.pi
_BELOW_END = np.nextafter(float(STEPS**2), 0.0)  # [squared steps of torque]
_LINE = 3  # numbers of a line
_ROWS = 64  # rows of the table per row of the index; breakpoints move by a few columns over them
_BINS = 256  # torque bins of the index
_READ, _KEEP, _DATA = 0, 3, 1  # arguments of LLVM's prefetch: for reading, in all caches, not instructions


def _fetch(typing: Any, rows: Any, row: Any, column: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code: Any = cgutils  # has no type hints
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
"""Prefetch one place of a table (array, row, column) without waiting for it."""


def _pointer(typing: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.intp), generate


_at: Any = intrinsic(_pointer)
"""Pointer to an address."""

_array: Any = numba.carray  # type: ignore[attr-defined]


class Cells(NamedTuple):
    """Places of a block's samples: share of the way to the next row, row (-1: no answer), rough column."""

    share: Floats
    row: Integers
    column: Integers


@part
def cells() -> Cells:
    """Room for the places of one block."""
    return Cells(np.empty(BLOCK), np.empty(BLOCK, dtype=np.int64), np.empty(BLOCK, dtype=np.int64))


@entry_point
def columns(breakpoints: Steps) -> Steps:
    """Index of a table: approximate column of each torque bin, for every `_ROWS` rows."""
    rows, last = breakpoints.shape[0], breakpoints.shape[1] - 2
    found = np.empty((1 + (rows - 1) // _ROWS, _BINS), dtype=np.int16)
    step = 2.0 * STEPS**2 / _BINS
    for i in range(found.shape[0]):
        row, column = min(i * _ROWS + _ROWS // 2, rows - 1), 0
        for k in range(_BINS):
            while column < last and _squared(breakpoints[row, column + 1]) <= (k + 0.5) * step - STEPS**2:
                column += 1
            found[i, k] = column
    return found


@inline
def _squared(step: int) -> float:
    """Signed square of a torque step, which is proportional to the torque."""
    return float(step) * abs(step)


@part
def locate(
    breakpoints: Steps,
    values: Steps,
    near: Steps,
    repeats: int,
    limit: float,
    greatest: float,
    turn: Floats,
    torque: Floats,
    begin: int,
    end: int,
    cells: Cells,
) -> None:
    """Set the places of the samples from ``begin`` to before ``end``, and prefetch the table there."""
    period = breakpoints.shape[0] - 1
    steps = repeats * period
    scale, bins = steps / _TURN, 0.5 * _BINS / greatest
    for i in range(begin, end):
        place, k = _within_turn(turn[i]) * scale, i - begin
        cells.row[k] = -1
        if abs(torque[i]) <= limit and not math.isnan(place):
            whole, above = min(int(place), steps - 1), (torque[i] + greatest) * bins
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
    breakpoints: Steps,
    values: Steps,
    lines: Singles,
    greatest: float,
    torque: Floats,
    begin: int,
    end: int,
    cells: Cells,
    beta: Floats,
) -> None:
    """Set the torsions of the samples from ``begin`` to before ``end``.

    A sample's column is that of the last breakpoint not above its torque, at most the last but one. Rows are
    read in place: numba counts a reference for every array argument, which for one sample takes as long as
    the rest.
    """
    x, y, last, scale = breakpoints, values, breakpoints.shape[1] - 2, STEPS**2 / greatest
    for i in range(begin, end):
        row, column, load = cells.row[i - begin], cells.column[i - begin], torque[i] * scale
        value, low, high = min(load, _BELOW_END), math.nan, math.nan
        for r in range(row, row + 2 if row >= 0 else row):
            while column > 0 and _squared(x[r, column]) > value:
                column -= 1
            while column < last and _squared(x[r, column + 1]) <= value:
                column += 1
            above = _line(x[r, column], x[r, column + 1], y[r, column], y[r, column + 1], load)
            if load == 0.0:  # the middle of a true gap
                c = column
                while c > 0 and x[r, c] >= 0:
                    c -= 1
                above = 0.5 * (above + _line(x[r, c], x[r, c + 1], y[r, c], y[r, c + 1], load))
            low, high = high, lines[r, 0] + np.float64(lines[r, 1]) * torque[i] + lines[r, 2] * above
        beta[i] = low + cells.share[i - begin] * (high - low)


@inline
def _line(start: int, end: int, first: int, second: int, place: float) -> float:
    begin = _squared(start)
    return first + (place - begin) * (float(second - first) / (_squared(end) - begin))


@entry_point
def interpolate(
    breakpoints: Steps,
    values: Steps,
    lines: Singles,
    near: Steps,
    repeats: int,
    limit: float,
    greatest: float,
    turn: Floats,
    torque: Floats,
    beta: Floats,
    first: int,
    last: int,
) -> None:
    """Set the torsion (n,) from a table up to torque `greatest`; nan beyond `limit`."""
    found = cells()
    for begin in range(first, last, BLOCK):
        end = min(begin + BLOCK, last)
        locate(breakpoints, values, near, repeats, limit, greatest, turn, torque, begin, end, found)
        read(breakpoints, values, lines, greatest, torque, begin, end, found, beta)


@part
def interpolate_at(place: Any, turn: Floats, torque: Floats, beta: Floats, count: int) -> None:
    """As `interpolate` for the first `count` samples, with the table's addresses and size from a record."""
    shape = place.rows, place.columns
    breakpoints = _array(_at(place.breakpoints), shape, np.int16)
    values = _array(_at(place.values), shape, np.int16)
    lines = _array(_at(place.lines), (place.rows, _LINE), np.float32)
    near = _array(_at(place.near), (1 + (place.rows - 1) // _ROWS, _BINS), np.int16)
    given = place.repeats, place.limit, place.greatest
    interpolate(breakpoints, values, lines, near, *given, turn, torque, beta, 0, count)
