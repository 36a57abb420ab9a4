"""SIGINT and SIGTERM: raised if work can be left anywhere, noted if it must be finished first."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import weakref
from collections.abc import Iterator
from types import FrameType
from typing import Any

from hd_diag.memory import causes

_STOPPING = (signal.SIGINT, signal.SIGTERM)
_SOON = 0.02  # between checks whether a raised signal got lost [s]
_noted: list[int] = []
_raised: list[tuple[threading.Event, int]] = []  # of each signal: whether it was seen, its number

SIGNALLED = 128
"""Added to a signal's number it is the exit code of a process ended by that signal, as in shells."""


class Stopped(KeyboardInterrupt):
    """A signal came, by default Ctrl-C: open files are closed, unfinished ones removed."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(number)
        self.number = number


def raise_signals() -> None:
    """Raise `Stopped` for signals from now on; ignored signals stay ignored, as under nohup.

    Imports and compiled code lose some exceptions: a signal is raised again until `signalled` has seen it.
    """
    for number in (*_STOPPING, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _raise)
    sys.unraisablehook = _lost


def signalled(error: BaseException | None) -> int:
    """Exit code for an error that a signal has caused, as in shells; 0 if no signal has.

    click, numba's compiled code and imports turn a KeyboardInterrupt into errors of their own, some without
    a cause. An error after a signal that nobody has seen therefore counts as the signal's.
    """
    came = next((number for seen, number in _raised if not seen.is_set()), 0)
    for each in causes(error):
        if isinstance(each, KeyboardInterrupt):
            came = getattr(each, "number", signal.SIGINT)
    for seen, _ in _raised:
        seen.set()
    return SIGNALLED + came if came else 0


def _raise(number: int, frame: FrameType | None) -> None:
    raise _watched(Stopped(number))


def _watched(error: Stopped) -> Stopped:
    seen = threading.Event()  # set by the code that ends the program
    _raised.append((seen, error.number))
    with contextlib.suppress(RuntimeError):  # the interpreter is shutting down
        threading.Thread(target=_raise_again, args=(weakref.ref(error), *_raised[-1]), daemon=True).start()
    return error


def _raise_again(error: weakref.ref[Stopped], seen: threading.Event, number: int) -> None:
    """Send the signal once more if the error is gone and nobody has seen it."""
    while not seen.wait(_SOON):
        if error() is None:
            os.kill(os.getpid(), number)
            return


def _lost(what: Any) -> None:
    """Report exceptions that nobody can catch, except for signals, which are sent again."""
    if not isinstance(what.exc_value, Stopped):
        sys.__unraisablehook__(what)


def note_signals() -> list[int]:
    """List of signals since the first call, for the life of the process; its readers then end their work."""
    for number in _STOPPING:
        signal.signal(number, lambda received, frame: _noted.append(received))
    return _noted


def ignore_signals() -> None:
    """Ignore signals while the interpreter shuts down: it notes no more, and a late one would kill it."""
    for number in _STOPPING:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def noted_signals() -> Iterator[list[int]]:
    """Note signals inside a ``with`` statement; a second one ends the program at once.

    A KeyboardInterrupt at any place, or SIGTERM, could leave a terminal without a cursor, a running process
    or a half-written file.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        signal.signal(number, signal.SIG_DFL)

    before = [signal.signal(number, note) for number in _STOPPING]
    try:
        yield came
    finally:
        for number, handler in zip(_STOPPING, before, strict=True):
            signal.signal(number, handler)
