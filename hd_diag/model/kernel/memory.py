"""Memory brought near before it is read: what the processor does not foresee, a kernel may know."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

code: Any = cgutils  # without types
_READ, _KEEP, _DATA = 0, 3, 1  # as LLVM's prefetch has them: for reading, in all caches, not instructions


def _fetch(typing: Any, rows: Any, row: Any, column: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
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
"""Have one place of a table (array, row, column) on its way, without waiting for it."""
