"""Compilation of kernels: entry points are cached on disk, parts are compiled into the entry points."""

from __future__ import annotations

import importlib
import itertools
import os
import secrets
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.bytecode import FunctionIdentity
from numba.extending import overload, register_jitable

import hd_diag.model.kernel.chain  # noqa: F401  (with contact it has all formulas)
from hd_diag.model.kernel import formula


def _name_apart() -> None:
    """Start numba's count of functions at a random number, because it names their machine code by the count.

    By default the count starts at 1, so code that two processes compile and cache gets the same names. For an
    argsort and a sort (closures of one name and type) the code that was loaded first then ran for both.
    """
    identity: Any = FunctionIdentity
    identity._unique_ids = itertools.count(secrets.randbits(48))


_name_apart()
os.register_at_fork(after_in_child=_name_apart)


def _import_arrays() -> None:
    """Import numba's array functions without scipy.linalg, which takes 17 MB and a third of the start.

    numba looks there for a BLAS, which no kernel uses. Other modules can still import scipy.linalg.
    """
    modules: dict[str, Any] = sys.modules
    found = modules.setdefault("scipy.linalg", None)
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        if found is None:
            del modules["scipy.linalg"]


_import_arrays()

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

# Covers all kernels: numba's cache checks only the entry point's own file and misses changes in the others.
_CHECKSUM = zlib.crc32(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))))


def entry_point(function: Kernel) -> Kernel:
    """Compile at the first call; cache the machine code on disk if any cache folder can be written."""
    function.__qualname__ = f"{function.__name__}_{_CHECKSUM:08x}"  # the file on disk is named after it
    try:
        return cast(Kernel, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:  # numba can write neither beside the package nor in the user's cache folder
        return part(function)


def is_kept(function: Any) -> bool:
    """Whether an entry point's machine code is cached on disk; also True if it cannot be cached."""
    folder, python = function.stats.cache_path, f"py{sys.version_info.major}{sys.version_info.minor}"
    name = f"*.{function.py_func.__qualname__}-*.{python}*.nbi"
    return folder is None or any(Path(folder).glob(name))


def part(function: Kernel) -> Kernel:
    """Compile as part of entry points, whose machine code is cached."""
    return cast(Kernel, numba.njit(nogil=True, error_model="numpy")(function))


_INLINE: Any = {"nogil": True, "error_model": "numpy", "forceinline": True}


def inline(function: Kernel) -> Kernel:
    """Compile inline into a loop over flanks: the compiler can vectorise only a loop that it sees whole."""
    return cast(Kernel, numba.njit(**_INLINE)(function))


def _one(condition: Any, yes: Any, no: Any) -> Any:
    return yes if condition else no


def _choose(condition: Any, yes: Any, no: Any) -> Any:
    return _one


overload(formula.choose, jit_options=_INLINE)(_choose)
for _each in formula.FORMULAS:
    register_jitable(**_INLINE)(_each)
