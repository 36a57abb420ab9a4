"""SIGINT and SIGTERM noted instead of obeyed: what is being written is finished first."""

from __future__ import annotations

import signal

_STOPPING = (signal.SIGINT, signal.SIGTERM)


def noted() -> list[int]:
    """From now on a list of the signals that came; whoever looks at it ends when it is no longer empty."""
    came: list[int] = []
    for number in _STOPPING:
        signal.signal(number, lambda received, frame: came.append(received))
    return came


def ignored() -> None:
    """All is done; the interpreter notes no more while it ends, and one that came then would kill it."""
    for number in _STOPPING:
        signal.signal(number, signal.SIG_IGN)
