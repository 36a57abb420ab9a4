"""Long work on bags: progress with rate and time left, and Ctrl-C where the work can end."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import NoReturn

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hd_diag.bag import BagReader
from hd_diag.cli.options import tell
from hd_diag.cli.verbs import INTERRUPTED
from hd_diag.ros.stop_signals import noted_signals

Advance = Callable[[float, float], None]
"""Takes what is done, and what there is in all."""


@contextmanager
def bar() -> Iterator[Progress]:
    """Progress with rate and time left, on stderr, gone when done; silent where stderr is no terminal."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    # Older releases of rich print an empty line at the end of a bar that never showed.
    with progress if console.is_terminal else nullcontext(progress):
        yield progress


@contextmanager
def working() -> Iterator[Callable[[str, str], Advance]]:
    """A function that takes what is to be done and its unit, and gives what is to be called meanwhile.

    A bar shows from the first call on. A call raises KeyboardInterrupt where Ctrl-C has come since the last.
    """
    with bar() as bars, noted_signals([signal.SIGINT]) as came:

        def part(what: str, unit: str) -> Advance:
            begin = time.monotonic()
            task = bars.add_task(what, total=None, rate="", visible=False)

            def advance(done: float, total: float) -> None:
                rate = done / max(time.monotonic() - begin, 1e-9)
                shown = f"{rate:,.0f}" if rate >= 100.0 else f"{rate:,.1f}"
                bars.update(task, completed=done, total=total, rate=f"{shown} {unit}/s", visible=True)
                if came:
                    raise KeyboardInterrupt

            return advance

        yield part


def interrupted(out: Path, kept: bool, content: str = "") -> NoReturn:
    """End after Ctrl-C with a line on what `out` holds; `kept` where it was there before, and still is."""
    left = f"nothing was written, {out} is as it was" if kept else "nothing was written"
    if out.exists() and not kept:
        if not content:
            with BagReader(out) as reader:
                content = f"the first {reader.message_count} messages"
        left = f"{out} holds {content}"
    tell(f"hd-diag: interrupted: {left}", err=True)
    sys.exit(INTERRUPTED)
