"""What is pressed while a terminal shows something."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def pressed_keys() -> Iterator[Callable[[], str]]:
    """What gives the keys pressed since it was last asked; none where stdin is no terminal of this program.

    The terminal is left as it was.
    """
    fd = sys.stdin.fileno() if sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty() else -1
    if fd < 0 or os.tcgetpgrp(fd) != os.getpgrp():  # in the background it would be stopped
        yield lambda: ""
        return
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd)
        yield lambda: os.read(fd, 64).decode(errors="replace") if select.select([fd], [], [], 0.0)[0] else ""
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)
