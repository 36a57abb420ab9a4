"""Progress and remaining time of long work, and Ctrl-C at points where the work can end.

A terminal shows a bar; in a pipe stderr gets a line every 10 s, none for shorter work.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from hd_diag.bag import BagReader
from hd_diag.cli.lines import tell
from hd_diag.ros.stop_signals import Stopped, noted_signals, signalled

_PERIOD = 10.0  # between lines in a pipe [s]


Advance = Callable[..., None]
"""Called with the work done, the total work (0: not known) and, as a third, the present step."""

Part = Callable[..., Advance]
"""Begins a part of the work, given its name and its unit; without a unit it is shown in per cent."""


class _Work:
    """A part of the work, named in words; its clock starts with the first `advance`."""

    def __init__(self, what: str, unit: str) -> None:
        self._what, self._unit, self._note = what, unit, ""
        self.done = self.total = self._first = self._begin = self._now = 0.0

    def advance(self, done: float, total: float, note: str) -> None:
        self._now = time.monotonic()
        if not self._begin:
            self._begin, self._first = self._now, done
        self.done, self.total, self._note = done, total, note

    @property
    def name(self) -> str:
        return f"{self._what}: {self._note}" if self._note else self._what

    def __str__(self) -> str:
        spent, since = self._now - self._begin, time.monotonic() - self._now
        if not self.total > 0.0:
            return f"{duration(spent + since)} so far"
        parts = [f"{self.done:,.0f} of {self.total:,.0f} {self._unit}"]
        if not self._unit:
            parts = [f"{100.0 * self.done / self.total:.0f} %"]
        if spent > 0.0 and self.done > self._first:
            rate = (self.done - self._first) / spent
            if self._unit:
                parts.append(f"{rate:,.0f}/s" if rate >= 10.0 else f"{60.0 * rate:,.1f}/min")
            left = (self.total - self.done) / rate - since
            parts += [f"about {duration(left)} left"] if left >= 1.0 else []
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """A time [s] as people say it: 40 s, 5 min, 2 h 10 min."""
    minutes = round(seconds / 60.0)
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


@contextmanager
def showing(came: Sequence[int] = ()) -> Iterator[Part]:
    """Give a function that begins parts of the work; each is shown from the first call of its `Advance` on.

    That call raises `Stopped` if `came` holds a signal.
    """
    with _bars() if _on_terminal() else _lines() as show:

        def part(what: str, unit: str = "") -> Advance:
            work = _Work(what, unit)

            def advance(done: float, total: float, note: str = "") -> None:
                work.advance(done, total, note)
                show(work)
                if came:
                    raise Stopped(came[0])

            return advance

        yield part


@contextmanager
def working() -> Iterator[Part]:
    """As `showing`, for work that a signal ends at the next call of an `Advance`."""
    with noted_signals() as came, showing(came) as part:
        yield part


def _on_terminal() -> bool:
    return sys.stderr.isatty() and os.environ.get("TERM") not in (None, "dumb", "unknown")


@contextmanager
def _lines() -> Iterator[Callable[[_Work], None]]:
    """Shows work as a line every `_PERIOD`."""
    latest: list[_Work] = []
    ended = threading.Event()

    def write() -> None:
        while not ended.wait(_PERIOD):
            for work in latest:
                tell(f"hd-diag: {work.name}: {work}", err=True)

    def show(work: _Work) -> None:
        latest[:] = [work]

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    try:
        yield show
    finally:
        ended.set()


@contextmanager
def _bars() -> Iterator[Callable[[_Work], None]]:
    """Shows work as bars on a terminal, and removes them at the end."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn

    tasks: dict[_Work, TaskID] = {}
    columns = [
        TextColumn("{task.fields[work].name}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[work]}"),
    ]
    console = Console(stderr=True)
    try:
        with Progress(*columns, console=console, transient=True) as bars:

            def show(work: _Work) -> None:
                if work not in tasks:
                    tasks[work] = bars.add_task("", total=None, work=work)
                bars.update(tasks[work], completed=work.done, total=work.total or None)

            yield show
    finally:
        console.show_cursor()  # a signal may come when the cursor is hidden already, before the bars


def interrupted(error: KeyboardInterrupt, out: Path, kept: bool, content: str = "") -> NoReturn:
    """Exit after a signal with a line on what `out` holds; `kept`: it existed before and is unchanged."""
    left = f"nothing was written, {out} is as it was" if kept else "nothing was written"
    if out.exists() and not kept:
        if not content:
            with BagReader(out) as reader:
                content = f"the first {reader.message_count} messages"
        left = f"{out} holds {content}"
    tell(f"hd-diag: interrupted: {left}", err=True)
    sys.exit(signalled(error))
