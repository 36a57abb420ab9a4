"""SIGINT and SIGTERM: raised where work can be left at any place, noted where it is finished first."""

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
_SOON = 0.02  # [s]
_noted: list[int] = []
_raised: list[tuple[threading.Event, int]] = []  # signals: who has seen one, and its number

SIGNALLED = 128
"""Plus the number of a signal: exit code of what it has ended, as shells have it."""


class Stopped(KeyboardInterrupt):
    """A signal came, by default Ctrl-C: what is open is closed, files begun are taken away."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(number)
        self.number = number


def raise_signals() -> None:
    """Raise `Stopped` for signals from now on; one that is ignored stays so, as below nohup.

    Imports and compiled code lose some of what is raised in them: it is raised again until `signalled` has
    seen it.
    """
    for number in (*_STOPPING, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _raise)
    sys.unraisablehook = _lost


def signalled(error: BaseException | None) -> int:
    """Exit code of what a signal has ended, as shells have it; 0 where none has.

    Others make their own errors of a KeyboardInterrupt: click, numba's compiled code, imports. Some of these
    do not say what they come from: an error soon after a signal that nobody has seen is the signal's.
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
    seen = threading.Event()  # by who ends the program for it
    _raised.append((seen, error.number))
    with contextlib.suppress(RuntimeError):  # the interpreter ends
        threading.Thread(target=_raise_again, args=(weakref.ref(error), *_raised[-1]), daemon=True).start()
    return error


def _raise_again(error: weakref.ref[Stopped], seen: threading.Event, number: int) -> None:
    """Send the signal once more where the error is gone and nobody has seen it."""
    while not seen.wait(_SOON):
        if error() is None:
            os.kill(os.getpid(), number)
            return


def _lost(what: Any) -> None:
    """Tell of what was raised where nobody can catch it, except for signals, which come again."""
    if not isinstance(what.exc_value, Stopped):
        sys.__unraisablehook__(what)


def note_signals() -> list[int]:
    """Signals that come from the first call on, as long as the process lives: who sees one ends its work."""
    for number in _STOPPING:
        signal.signal(number, lambda received, frame: _noted.append(received))
    return _noted


def ignore_signals() -> None:
    """Ignore signals while the interpreter ends: it notes no more, and one that came then would kill it."""
    for number in _STOPPING:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def noted_signals() -> Iterator[list[int]]:
    """Note signals inside a ``with`` statement; a second one ends the program at once.

    A KeyboardInterrupt at any place could leave a terminal without a cursor, a process running or a file
    half written; so would SIGTERM.
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
