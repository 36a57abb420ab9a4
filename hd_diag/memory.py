"""Memory that a process needed for a while, given back."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import gc
import re
from collections.abc import Iterator
from pathlib import Path

_DONT_NEED = 4  # MADV_DONTNEED
_MMAP_THRESHOLD, _LARGE = -3, 1 << 15  # M_MMAP_THRESHOLD [byte]
_LLVM = re.compile(r"^(\w+)-(\w+) r-.p .*libllvmlite\.so\n(?:[A-Z]\w+:.*\n)*?Anonymous: +0 kB$", re.MULTILINE)

# What the loader of libraries, LLVM and a thread's start say.
_NO_ROOM = "cannot allocate memory", "failed to map segment", "can't start new thread", "out of memory"


def give_back() -> None:
    """Give back free memory, and the pages of LLVM's code, which are read again should they be needed."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError):  # another libc than GNU's, or no /proc
        libc = ctypes.CDLL(None)
        libc.malloc_trim(0)
        for begin, end in _unchanged():
            libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _DONT_NEED)


def map_large_arrays() -> None:
    """Have arrays from 32 KiB on given back when they are freed: GNU's libc keeps such rooms once one was."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGE)


def _unchanged() -> Iterator[tuple[int, int]]:
    """Where code and constants of LLVM lie that are as in its file; tables of addresses there are not."""
    for found in _LLVM.finditer(Path("/proc/self/smaps").read_text()):
        yield int(found[1], 16), int(found[2], 16)


def is_memory(error: BaseException) -> bool:
    """Whether an error, or what caused it, says that the memory or a limit of it does not suffice."""
    while True:
        text = str(error).lower()
        is_refused = isinstance(error, OSError) and error.errno == errno.ENOMEM
        if isinstance(error, MemoryError) or is_refused or any(words in text for words in _NO_ROOM):
            return True
        if (cause := error.__cause__ or error.__context__) is None:
            return False
        error = cause
