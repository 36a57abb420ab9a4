"""What a watcher shows: one table of joints, and what is said of each; the keys that are pressed."""

from __future__ import annotations

import contextlib
import io
import math
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from typing import TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from hd_diag.formatting import visible
from hd_diag.watch.state import JointView, Watch

PERIOD = 1.0
"""Between tables of a pipe without another fault [s]."""

_REFRESH = 0.25  # between two tables in a terminal [s]
_UNWRAPPED, _LONGEST = 10_000, 500  # width of a pipe, longest text [characters]
_TITLE = Text("hd-diag watch  d: diagnose, q: quit", "bold")
_LARGE = 1e5  # written with an exponent from here on
_STYLES, _GREY = {"ok": "green", "warn": "yellow", "error": "bold red"}, "bright_black"

# Heading, key in the diagnostics, decimals.
_NUMBERS = (
    ("ecc.\nµm", "eccentricity_um", 1),
    ("at\ndeg", "eccentricity_direction_deg", 0),
    ("least\nbackl.\nµm", "minimum_backlash_um", 1),
    ("lost\nmotion\narcmin", "lost_motion_arcmin", 2),
    ("loaded\npairs", "loaded_pairs", 0),
    ("peak\nload\nN", "peak_tooth_load_N", 1),
    ("pred.\nerror\narcsec", "predicted_te_pp_arcsec", 1),
    ("resid.\nrms\narcsec", "residual_rms_arcsec", 2),
    ("rate\nHz", "sample_rate_hz", 0),
)


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to the caller; rich would end the program with an error."""
        raise


class Display(Live):
    """Shows a watch inside a ``with`` statement, on stdout by default: in a terminal all in one place.

    What is shown last is whole, also where the terminal had no room for it.
    """

    def __init__(self, watch: Watch, stream: TextIO | None = None) -> None:
        file = stream or sys.stdout
        if isinstance(file, io.TextIOWrapper):
            file.reconfigure(errors="backslashreplace")
        width = None if file.isatty() else _UNWRAPPED
        console = _Console(file=file, highlight=False, force_terminal=file.isatty(), width=width)
        self._watch, self._now, self._due = watch, 0.0, -math.inf
        self._messages, self._faults = 0, [("", True)]
        super().__init__(
            console=console,
            get_renderable=lambda: Group(_TITLE, picture(watch, self._now)),
            auto_refresh=False,
            transient=not console.is_interactive,  # a pipe has had it
        )

    def show(self, now: float) -> None:
        """Show the present state [s] where a fault is another, or where it is time to."""
        self._now, is_live = now, self.console.is_interactive
        faults = [(view.fault_code, view.silent) for view in self._watch.view(now)]
        is_due = now >= self._due and (is_live or self._watch.messages > self._messages)
        if faults != self._faults or is_due:
            self._faults, self._messages = faults, self._watch.messages
            self._due = now + (_REFRESH if is_live else PERIOD)
            self.refresh() if is_live else self.console.print(picture(self._watch, now))


def picture(watch: Watch, now: float) -> Group:
    """What is missing or answered, then the table of joints, then what is said of each."""
    views = watch.view(now)
    table = Table("joint", "fault", box=None, pad_edge=False)
    for heading, *_ in _NUMBERS:
        table.add_column(heading, justify="right")
    for column in table.columns:
        column.overflow = "fold"
    for view in views:
        names = (Text(visible(text, _LONGEST), _style(view)) for text in (view.joint, view.fault_code))
        numbers = (_number(view, key, places) for _, key, places in _NUMBERS)
        table.add_row(*names, *numbers, style=_GREY if view.stale else "")
    of, missing = (", ".join(joints) for joints in (watch.joints, watch.missing()))
    remarks = [f"not reported: {missing}"] if missing else []
    if not views:
        remarks = [f"waiting for diagnostics{of and f' of {of}'} ...; {watch.explanation()}"]
    remarks += [f"{node} {answer}" for node, answer in sorted(watch.answers.items())]
    return Group(
        *(Text(visible(remark, _LONGEST), "yellow") for remark in remarks),
        *([table] if views else []),
        *(Text(in_words(view), _style(view)) for view in views),
    )


def _style(view: JointView) -> str:
    return _GREY if view.silent else _STYLES.get(view.level, "magenta")


def _number(view: JointView, key: str, places: int) -> str:
    """A value with so many decimals, without where it is large; a dash where it is not finite."""
    value = view.number(key)
    if not math.isfinite(value):
        return "-"
    return f"{value:.{places}f}" if abs(value) < _LARGE else f"{value:.0e}"


def in_words(view: JointView) -> str:
    """What is known of a joint beside its numbers, in one line without control characters.

    Its node, fault, the order that repeats where nothing is wrong, bookkeeping, diagnosis and last verdict.
    """
    values, code = view.values, view.fault_code
    silent = f"no report for {view.age:.0f} s; the last: " if view.silent else ""
    message = f" {view.message}" if view.message not in ("", code) else ""
    also = " ".join(each for each in str(values.get("fault_codes", "")).split() if each != code)
    parts = [f"{silent}{code}{message}{f' (also {also})' if also else ''}"]
    if view.level == "ok" and values.get("residual_order_repeats") is True:
        size, limit = (_number(view, f"residual_order_{key}_arcsec", 1) for key in ("amplitude", "limit"))
        parts.append(
            f"residual repeats with {values.get('residual_order')}: {size} of {limit} arcsec allowed"
        )
    parts.append(f"{values.get('samples', '-')} samples")
    parts.append(f"latency {_number(view, 'latency_p99_us', 0)} µs")
    parts.append(f"log {values.get('log_state', '-')}")
    if not (state := str(values.get("diagnosis_state", "none"))).startswith(("none", "done")):
        parts.append(f"diagnosis {state}")
    if verdict := values.get("verdict"):
        parts.append(f"verdict of {values.get('verdict_time', '-')}: {verdict}")
    told = "; ".join(visible(part, _LONGEST) for part in parts)
    return f"{visible(f'{view.node} {view.joint}', _LONGEST)}: {told}"


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
