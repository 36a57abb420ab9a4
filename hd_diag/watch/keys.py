"""Keys pressed while a terminal shows something."""

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
    """A function that gives the keys pressed since its last call. The terminal is left as it was.

    None where stdin is no terminal or the program is in the background, which reading would stop.
    """
    fd = sys.stdin.fileno() if sys.stdin.isatty() else -1
    if fd < 0 or os.tcgetpgrp(fd) != os.getpgrp():
        yield str
        return
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd)
        yield lambda: os.read(fd, 64).decode(errors="replace") if select.select([fd], [], [], 0.0)[0] else ""
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)
