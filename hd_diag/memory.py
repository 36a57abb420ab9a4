"""Memory that a process needed to start, given back."""

from __future__ import annotations

import contextlib
import ctypes
import gc
from pathlib import Path

_DONT_NEED = 4  # MADV_DONTNEED


def give_back() -> None:
    """Give back free memory, and the pages of LLVM's code, which are read again should they be needed."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError):  # another libc than GNU's, or no /proc
        libc = ctypes.CDLL(None)
        libc.malloc_trim(0)
        for line in Path("/proc/self/maps").read_text().splitlines():
            place, rights, *rest = line.split()
            if rights == "r-xp" and rest[-1].endswith("libllvmlite.so"):
                begin, end = (int(address, 16) for address in place.split("-"))
                libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _DONT_NEED)
