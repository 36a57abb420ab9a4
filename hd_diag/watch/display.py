"""What a watcher shows: one table of joints in a terminal, plain lines elsewhere."""

from __future__ import annotations

import io
import math
import sys
from typing import TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.table import Column, Table
from rich.text import Text

from hd_diag.formatting import visible
from hd_diag.watch.state import JointView, Watch

PERIOD = 1.0
"""Between plain lines of a joint without another fault [s]."""

_REFRESH = 0.25  # shortest time between two pictures in a terminal [s]
_NARROW, _LONGEST = 80, 500  # least width of the table, longest text [characters]
_LARGE = 1e5  # written with an exponent from here on
_STYLES, _GREY = ("green", "yellow", "bold red", "magenta"), "bright_black"

# Key in the diagnostics, name, unit, decimals, heading.
_NUMBERS = (
    ("eccentricity_um", "configured eccentricity", "µm", 1, "ecc. µm"),
    ("eccentricity_direction_deg", "direction", "deg", 0, "at deg"),
    ("minimum_backlash_um", "least backlash", "µm", 1, "least backl. µm"),
    ("lost_motion_arcmin", "lost motion", "arcmin", 2, "lost motion arcmin"),
    ("loaded_pairs", "loaded tooth pairs", "", 0, "loaded pairs"),
    ("peak_tooth_load_N", "largest load", "N", 1, "peak load N"),
    ("predicted_te_pp_arcsec", "predicted error peak to peak", "arcsec", 1, "pred. error arcsec"),
    ("residual_rms_arcsec", "residual rms", "arcsec", 2, "resid. rms arcsec"),
    ("sample_rate_hz", "rate", "Hz", 0, "rate Hz"),
)


class Display:
    """Shows a watch inside a ``with`` statement, on stdout by default: a live table or, elsewhere, lines."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        if isinstance(self._stream, io.TextIOWrapper):
            self._stream.reconfigure(errors="backslashreplace")
        self._console = Console(file=self._stream, highlight=False)
        is_live = self._stream.isatty() and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False) if is_live else None
        self._next = self._due = -math.inf
        self._messages, self._faults = 0, [("", True)]

    def __enter__(self) -> Display:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, watch: Watch, now: float, is_last: bool = False) -> None:
        """Show the present state if it is time to. The last table has all joints and stays there."""
        if now < self._next and not is_last:
            return
        self._next = now + _REFRESH
        if self._live is not None:
            self._live.update(picture(watch, now, self._console, is_last), refresh=True)
            return
        views = watch.view(now)
        faults = [(view.code, view.is_silent) for view in views]
        if faults != self._faults or (now >= self._due and watch.messages > self._messages):
            self._faults, self._due, self._messages = faults, now + PERIOD, watch.messages
            lines = map(plain_line, views) if views else [_awaited(watch)]
            self._stream.writelines(f"{line}\n" for line in lines)  # rich exits where its reader has gone
            self._stream.flush()


def picture(watch: Watch, now: float, console: Console, is_whole: bool = False) -> Group:
    """The table of all joints, the worst first, or of those that the terminal has room for."""
    views = sorted(watch.view(now), key=lambda view: -view.level)
    room, shown = sys.maxsize if is_whole else console.height - 1, len(views)
    shown = min(shown, max(1, room // 2))  # a joint has two lines at least
    while True:
        group = _group(watch, views[:shown], len(views) - shown, console.width)
        if shown <= 1 or len(console.render_lines(group)) <= room:
            return group
        shown -= 1


def _group(watch: Watch, views: list[JointView], hidden: int, width: int) -> Group:
    """Numbers of joints, then what is said of each, then remarks."""
    remarks = [f"{node} {answer}" for node, answer in sorted(watch.answers.items())]
    remarks += [f"not reported: {', '.join(missing)}"] if (missing := watch.missing()) else []
    remarks += [f"{hidden} more joints have no room here: --joint chooses"] if hidden else []
    title = Text.assemble(("hd-diag watch", "bold"), "  d: diagnose, q: quit")
    words = [Text(plain_line(view, is_whole=width < _NARROW), _style(view)) for view in views]
    below = [
        Text(visible(remark, _LONGEST), "yellow") for remark in (remarks if views else [_awaited(watch)])
    ]
    return Group(title, *([_table(views)] if views and width >= _NARROW else []), *words, *below)


def _table(views: list[JointView]) -> Table:
    table = Table(
        Column("joint", overflow="fold"), Column("fault", overflow="fold"), box=None, pad_edge=False
    )
    for *_, heading in _NUMBERS:
        table.add_column(heading.replace(" ", "\n"), justify="right", no_wrap=True)
    for view in views:
        numbers = (_number(view.number(key), places) for key, _, _, places, _ in _NUMBERS)
        joint, code = (Text(visible(text, _LONGEST), _style(view)) for text in (view.joint, view.code))
        table.add_row(joint, code, *numbers, style=_GREY if view.is_stale else "")
    return table


def _style(view: JointView) -> str:
    return _GREY if view.is_silent else _STYLES[min(view.level, len(_STYLES) - 1)]


def plain_line(view: JointView, is_whole: bool = True) -> str:
    """What is known of a joint in one line without control characters, whole with its numbers.

    Its node, fault, the order that repeats where nothing is wrong, bookkeeping, diagnosis and last verdict.
    """
    silent = f"no report for {view.age:.0f} s; the last: " if view.is_silent else ""
    message = f" {view.message}" if view.message not in ("", view.code) else ""
    also = " ".join(code for code in view.text("fault_codes").split() if code != view.code)
    parts = [f"{silent}{view.code}{message}{f' (also {also})' if also else ''}"]
    if view.level == 0 and view.text("residual_order_repeats") == "true":
        size, limit = (view.number(f"residual_order_{key}_arcsec") for key in ("amplitude", "limit"))
        parts.append(
            f"residual repeats with {view.text('residual_order')}: {size:.1f} of {limit:.1f} arcsec allowed"
        )
    if is_whole:
        parts += [
            f"{name} {_number(view.number(key), places)} {unit}" for key, name, unit, places, _ in _NUMBERS
        ]
    parts.append(f"{view.text('samples', '-')} samples")
    parts.append(f"latency {_number(view.number('latency_p99_us'), 0)} µs")
    parts.append(f"log {view.text('log_state', '-')}")
    if (state := view.text("diagnosis_state", "none")) != "none" and not state.startswith("done"):
        parts.append(f"diagnosis {state}")
    if verdict := view.text("verdict"):
        parts.append(f"verdict of {view.text('verdict_time', '-')}: {verdict}")
    told = "; ".join(visible(part.strip(), _LONGEST) for part in parts)
    return f"{visible(f'{view.node} {view.joint}', _LONGEST)}: {told}"


def _awaited(watch: Watch) -> str:
    """What is waited for, and what was seen instead."""
    of = f" of {', '.join(watch.joints)}" if watch.joints else ""
    return visible(f"waiting for diagnostics{of} ...; {watch.explanation()}", _LONGEST)


def _number(value: float, places: int) -> str:
    """A number with so many decimals, without where it is large; a dash where it is not finite."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.{places}f}" if abs(value) < _LARGE else f"{value:.0e}"
