"""The display of a watcher: one table of joints, and a line on each."""

from __future__ import annotations

import io
import math
from typing import TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from hd_diag.formatting import visible
from hd_diag.watch.state import JointView, Watch

PERIOD, _REFRESH = 1.0, 0.25
"""Time between tables in a pipe if no fault changes, and between tables in a terminal [s]."""
_UNWRAPPED, _LONGEST, _LARGE = 10_000, 500, 1e5  # width of a pipe; longest text; least number with exponent
_TITLE = Text("hd-diag watch  d: diagnose, q: quit", "bold")
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
        """Leave the error to the caller; rich would end the program."""
        raise


class Display(Live):
    """Context that shows a watch: a terminal is updated in place and has the whole table at the end."""

    def __init__(self, watch: Watch, file: TextIO) -> None:
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
            transient=not console.is_interactive,  # a pipe already has the last table
        )

    def show(self, now: float) -> None:
        """Show the state at a time [s] if a fault has changed or the period is over."""
        self._now, is_live = now, self.console.is_interactive
        faults = [(view.fault_code, view.silent) for view in self._watch.view(now)]
        has_come = is_live or self._watch.messages > self._messages
        if faults != self._faults or (has_come and now >= self._due):
            self._faults, self._messages = faults, self._watch.messages
            self._due = now + (_REFRESH if is_live else PERIOD)
            self.refresh() if is_live else self.console.print(picture(self._watch, now))


def picture(watch: Watch, now: float) -> Group:
    """Missing reports and answers, then the table of joints, then a line on each joint."""
    views = watch.view(now)
    table = Table(box=None, pad_edge=False)
    for place, heading in enumerate(("joint", "fault", *(heading for heading, *_ in _NUMBERS))):
        table.add_column(heading, justify="right" if place > 1 else "left", overflow="fold")
    for view in views:
        names = (_text(name, _style(view)) for name in (view.joint, view.fault_code))
        numbers = (_number(view, key, places) for _, key, places in _NUMBERS)
        table.add_row(*names, *numbers, style=_GREY if view.stale else "")
    remarks = (watch.lack("yet"), *(f"{node} {answer}" for node, answer in sorted(watch.answers.items())))
    said = (Text(in_words(view), _style(view)) for view in views)
    return Group(*(_text(each, "yellow") for each in remarks if each), *([table] if views else []), *said)


def _text(words: str, style: str) -> Text:
    return Text(visible(words, _LONGEST), style)


def _style(view: JointView) -> str:
    return _GREY if view.silent else _STYLES.get(view.level, "magenta")


def _number(view: JointView, key: str, places: int) -> str:
    """A value with `places` decimals, with an exponent if it is large; a dash if it is not finite."""
    value = view.number(key)
    shown = f"{value:.{places}f}" if abs(value) < _LARGE else f"{value:.0e}"
    return shown if math.isfinite(value) else "-"


def in_words(view: JointView) -> str:
    """Everything about a joint except for its numbers, in one line without control characters."""
    values, code = view.values, view.fault_code
    others = " ".join(each for each in str(values.get("fault_codes", "")).split() if each != code)
    silent = f"no report for {view.age:.0f} s; the last:" if view.silent else ""
    size, limit = (_number(view, f"residual_order_{key}_arcsec", 1) for key in ("amplitude", "limit"))
    repeats = view.level == "ok" and values.get("residual_order_repeats") is True
    state, verdict = str(values.get("diagnosis_state", "none")), values.get("verdict")
    parts = (
        " ".join(filter(None, dict.fromkeys((silent, code, view.message, others and f"(also {others})")))),
        repeats and f"residual repeats with {values.get('residual_order')}: {size} of {limit} arcsec allowed",
        f"{values.get('samples', '-')} samples",
        f"latency {_number(view, 'latency_p99_us', 0)} µs",
        f"log {values.get('log_state', '-')}",
        not state.startswith(("none", "done")) and f"diagnosis {state}",
        verdict and f"verdict of {values.get('verdict_time', '-')}: {verdict}",
    )
    told = "; ".join(visible(part, _LONGEST) for part in parts if part)
    return f"{visible(f'{view.node} {view.joint}', _LONGEST)}: {told}"
