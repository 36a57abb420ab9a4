"""SIGINT and SIGTERM: raised where work can be left at any place, noted where it is finished first."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType

_STOPPING = (signal.SIGINT, signal.SIGTERM)


class Stopped(KeyboardInterrupt):
    """A signal came, by default Ctrl-C: what is open is closed, files begun are taken away."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(number)
        self.number = number


def raise_signals() -> None:
    """Raise `Stopped` for signals from now on; one that is ignored stays so, as below nohup."""
    for number in (*_STOPPING, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _raise)


def _raise(number: int, frame: FrameType | None) -> None:
    raise Stopped(number)


def note_signals() -> list[int]:
    """Signals that come from now on, for as long as the process lives: who sees one ends its work."""
    came: list[int] = []
    for number in _STOPPING:
        signal.signal(number, lambda received, frame: came.append(received))
    return came


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
