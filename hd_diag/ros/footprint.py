"""Memory that the start of a node needs and its run does not."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence

from rclpy.logging import get_logger

_PATIENCE = 0.05  # between looks at the process that compiles [s]


def compile_apart(prepare: Callable[[], None], stopped: Sequence[int]) -> None:
    """Have machine code that is not on the disk yet made by a process of its own.

    Compiling takes 400 MB, which numba and LLVM keep. The process ends when a signal has come.
    """
    from hd_diag.messages.kernel import read  # it imports numba; compiled last
    from hd_diag.model.kernel.compiler import is_kept

    if not is_kept(read):
        get_logger("hd_diag").info(
            "preparing the model: the first time on a machine this takes half a minute"
        )
        child = os.fork()
        if not child:
            try:
                prepare()
            finally:
                os._exit(0)
        while not os.waitpid(child, os.WNOHANG)[0]:
            if stopped:
                os.kill(child, signal.SIGKILL)
            time.sleep(_PATIENCE)
