"""SIGINT and SIGTERM noted instead of obeyed: what is being written is finished first."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator, Sequence
from types import FrameType

_STOPPING = (signal.SIGINT, signal.SIGTERM)


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
def noted_signals(numbers: Sequence[signal.Signals] = _STOPPING) -> Iterator[list[int]]:
    """Note signals inside a ``with`` statement; a second one ends the program at once.

    A KeyboardInterrupt at any place could leave a terminal without a cursor, a process running or a file
    half written; so would SIGTERM.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        signal.signal(number, signal.SIG_DFL)

    before = [signal.signal(number, note) for number in numbers]
    try:
        yield came
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
