"""Preparation of a monitor before its first sample."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import hd_diag
from hd_diag.config.configuration import Config, resolve
from hd_diag.messages import encoding
from hd_diag.model import torsion
from hd_diag.monitor.all_joints import warm_up

_PATIENCE = 0.05  # between checks of the compiling process [s]


def prepare(config: Config) -> None:
    """Compute in advance what samples would wait for: constants, imports, machine code, also for maps."""
    warm_up(config)
    torsion.warm_up()
    encoding.warm_up()


def entry_points() -> list[Any]:
    """Entry points that `prepare` compiles; the one that it compiles last comes last."""
    from hd_diag.messages.kernel import read, write  # it imports numba
    from hd_diag.model.kernel.entry import curves, mesh_state, torsion, torsion_table
    from hd_diag.model.kernel.interpolation import columns, interpolate
    from hd_diag.monitor.kernel import compare
    from hd_diag.monitor.kernel_orders import follow, look
    from hd_diag.streams.kernel import align, begin_after, begun, messages

    streams = [begin_after, align, messages, begun]
    model = [torsion, torsion_table, mesh_state, curves, columns, interpolate]
    return [*streams, *model, compare, follow, look, write, read]


def changed_since(kernel: Any) -> bool:
    """Whether any kernel file is newer than the cached machine code of an entry point."""
    package = Path(hd_diag.__file__).parent
    kernels = [*package.glob("*/kernel*.py"), *package.glob("*/kernel/*.py")]
    changed = max(file.stat().st_mtime for file in kernels)
    return any(file.stat().st_mtime < changed for file in _kept(kernel))


def _kept(kernel: Any) -> list[Path]:
    folder = kernel.stats.cache_path
    return [] if folder is None else [*Path(folder).glob(f"*.{kernel.py_func.__qualname__}-*.nbi")]


def compile_apart(stopped: Sequence[int], tell: Callable[[str], object]) -> None:
    """Compile missing machine code in a child process.

    Compiling takes 400 MB, which numba and LLVM keep. The child is killed as soon as `stopped` holds a
    signal.
    """
    from hd_diag.model.kernel.compiler import is_kept

    *others, read = entry_points()  # other verbs may have compiled some of them
    if all(map(is_kept, (read, *others))) and not changed_since(read):
        return
    tell("preparing the model: the first time on a machine this takes half a minute")
    child = os.fork()
    if not child:
        try:
            prepare(resolve({}))
            for file in _kept(read):  # it may be older than a kernel that was compiled now
                file.touch()
        finally:
            os._exit(0)
    while not os.waitpid(child, os.WNOHANG)[0]:
        if stopped:
            os.kill(child, signal.SIGKILL)
        time.sleep(_PATIENCE)
