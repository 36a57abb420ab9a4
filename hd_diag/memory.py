"""Return of memory that a process needed for a while, and detection of too little memory."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import errno
import gc
import os
import re
import resource
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

_DONT_NEED = 4  # MADV_DONTNEED
_MMAP_THRESHOLD, _LARGE = -3, 1 << 15  # M_MMAP_THRESHOLD [byte]
_LLVM = re.compile(r"^(\w+)-(\w+) r-.p .*libllvmlite\.so\n(?:[A-Z]\w+:.*\n)*?Anonymous: +0 kB$", re.MULTILINE)

_LEAST = 250_000 << 10  # address space [byte] for OpenBLAS, which numpy and scipy each load
# Messages of the loader of libraries, of LLVM and of a thread's start.
_NO_ROOM = "cannot allocate memory", "failed to map segment", "can't start new thread", "out of memory"


def give_back() -> None:
    """Return free memory and the pages of LLVM's code, which are read again if they are needed."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError):  # another libc than GNU's, or no /proc
        libc = ctypes.CDLL(None)
        libc.malloc_trim(0)
        for begin, end in _unchanged():
            libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _DONT_NEED)


def map_large_arrays() -> None:
    """Return freed arrays of 32 KiB and more to the system: GNU's libc keeps them once one was freed."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGE)


def _unchanged() -> Iterator[tuple[int, int]]:
    """Address ranges of LLVM's code and constants that equal its file; its tables of addresses do not."""
    for found in _LLVM.finditer(Path("/proc/self/smaps").read_text()):
        yield int(found[1], 16), int(found[2], 16)


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """An error and its chain of causes; an error that was raised again may be its own context."""
    passed: list[BaseException] = []
    while error is not None and error not in passed:
        passed.append(error)
        yield error
        error = error.__cause__ or error.__context__


def is_memory(error: BaseException) -> bool:
    """Whether an error, or one in its chain of causes, reports too little memory or a limit of it."""
    return any(map(_is_memory, causes(error)))


def _is_memory(error: BaseException) -> bool:
    text = str(error).lower()
    is_refused = isinstance(error, OSError) and error.errno == errno.ENOMEM
    return isinstance(error, MemoryError) or is_refused or any(words in text for words in _NO_ROOM)


def watch_limit() -> None:
    """Under ``ulimit -v`` continue in a child process; exit with 2 if the limit is too low.

    Libraries then end a process in their own ways: OpenBLAS by ``exit(1)``, the loader by 127, LLVM by an
    abort, each with its own message on descriptor 2. The child therefore leads descriptor 2 to the null
    device. OpenBLAS asks for memory without end when little is left, so it is loaded first.
    """
    if (limit := resource.getrlimit(resource.RLIMIT_AS)[0]) < 0:
        return
    if limit < _LEAST:
        sys.exit(_too_little(limit))
    watched = {signal.SIGCHLD, signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    signal.pthread_sigmask(signal.SIG_BLOCK, watched)
    seen, told = os.pipe()
    if child := os.fork():
        os.close(told)
        code = _code_of(child, watched)
        sys.exit(code if code > 128 or os.read(seen, 1) else _too_little(limit))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, watched)
    sys.stderr = open(os.dup(2), "w", buffering=1, errors="backslashreplace")  # noqa: SIM115
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    atexit.register(os.write, told, b".")  # does not run if C ends the process
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # each thread takes memory of its own
    with contextlib.suppress(Exception):
        import_module("scipy.linalg")


def _code_of(child: int, watched: set[signal.Signals]) -> int:
    """Exit code of a process; signals are passed on to it."""
    while (came := signal.sigwaitinfo(watched)).si_signo != signal.SIGCHLD:
        if came.si_code <= 0:  # sent by a process; a terminal's signal reaches both
            os.kill(child, came.si_signo)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return 128 - code if -code in (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGHUP) else code


def _too_little(limit: int) -> int:
    told = f"hd-diag: there is not enough memory: ulimit -v is {limit >> 10} kB"
    print(told, file=sys.stderr)  # noqa: T201
    return 2
