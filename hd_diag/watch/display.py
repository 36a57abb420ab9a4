"""What a watcher shows: joints in a live table in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from types import TracebackType
from typing import NamedTuple, TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from hd_diag.formatting import visible
from hd_diag.watch.seen import LEVELS, JointView, Watch

REFRESH_PERIOD = 0.25
"""Shortest time between two pictures in a terminal [s]."""

PLAIN_PERIOD = 1.0
"""Shortest time between two plain lines of a joint [s]."""

_WIDEST = 120  # of the table [columns]
_LONGEST_CURVE = 40
_BARS = "▁▂▃▄▅▆▇█"
_PLAIN_BARS = ".:-=+*#@"  # where the terminal has no others
_LARGEST_WIDTH = 15  # of a number in words
_STYLES = ("green", "yellow", "bold red", "magenta")
_GREY = "bright_black"
_LEAST_NAME = 8
_LONGEST = 500  # of a text that is shown [characters]
_NAMES_SHOWN = 40  # characters of the nodes' names in the title
_LINES_ABOUT = 6  # title, heading, remark and the terminal's own last line


class Column(NamedTuple):
    """A column of numbers: key in the diagnostics, heading of three lines, digits, width."""

    key: str
    head: tuple[str, str, str]
    digits: int
    width: int


_COLUMNS = (
    Column("eccentricity_um", ("eccen-", "tricity", "um"), 1, 7),
    Column("eccentricity_direction_deg", ("at", "", "deg"), 0, 5),
    Column("minimum_backlash_um", ("least", "backl.", "um"), 1, 7),
    Column("lost_motion_arcmin", ("lost", "motion", "arcmin"), 2, 6),
    Column("loaded_pairs", ("loaded", "pairs", ""), 0, 6),
    Column("peak_tooth_load_N", ("peak", "load", "N"), 1, 6),
    Column("predicted_te_pp_arcsec", ("TE p-p", "pred.", "arcsec"), 1, 6),
    Column("residual_rms_arcsec", ("resid.", "rms", "arcsec"), 2, 6),
    Column("sample_rate_hz", ("rate", "", "Hz"), 0, 6),
)
_NUMBERS_WIDTH = sum(column.width + 1 for column in _COLUMNS)


def spark(values: Sequence[float], width: int, bars: str = _BARS) -> str:
    """The last values as a row of bars from zero to the largest of them.

    Parameters
    ----------
    values : sequence of float
        Those that are not finite leave a gap.
    width : int
        Bars at most.
    bars : str
        Characters from the lowest to the highest.

    Returns
    -------
    str
    """
    shown = list(values)[-width:] if width > 0 else []
    largest = max((abs(value) for value in shown if math.isfinite(value)), default=0.0)
    top = len(bars) - 1
    return "".join(
        bars[min(top, int(len(bars) * (abs(value) / largest))) if largest > 0.0 else 0]
        if math.isfinite(value)
        else " "
        for value in shown
    )


def shown_number(value: float, digits: int, width: int = _LARGEST_WIDTH) -> str:
    """A number with as many of its digits as a width allows; a dash where it is not finite."""
    if not math.isfinite(value):
        return "-"
    for places in range(digits, -1, -1):
        if len(text := f"{value:.{places}f}") <= width:
            return text
    text = f"{value:.0e}".replace("e+", "e")
    return text if len(text) <= width else "*" * width


def table(
    watch: Watch, now: float, width: int, height: int = sys.maxsize, bars: str = _BARS, mark: str = "…"
) -> Group:
    """All joints: a line of numbers and one or two of words each.

    Parameters
    ----------
    watch : Watch
    now : float
        [s]
    width, height : int
        Of the terminal; where not all joints fit, the worst are shown.
    bars : str
        Characters of the curve of residuals.
    mark : str
        Ends what was cut short.

    Returns
    -------
    rich.console.Group
        Of lines that are no longer than the width.
    """
    width = min(width, _WIDEST)
    views = watch.view(now)
    if not views:
        return Group(*waiting(watch, width, mark))
    names = [view.name for view in views]
    blocks = [_joint_lines(view, names.count(view.name) > 1, width, bars, mark) for view in views]
    kept = _fitting(views, blocks, height - _LINES_ABOUT)
    lines = [_title(views, width, mark), *_heading(width, mark)]
    for index in kept:
        lines += blocks[index]
    return Group(*lines, *_remarks(watch, len(views) - len(kept), width, mark))


def waiting(watch: Watch, width: int, mark: str = "…") -> list[Text]:
    """What is waited for and what was seen instead."""
    what = f" of {', '.join(watch.joints)}" if watch.joints else ""
    topics = ", ".join(sorted({node.topic for node in watch.wanted_nodes()})) or "/diagnostics"
    lines = [_fit(Text(_shown(f"waiting for {topics}{what} ..."), "bold"), width, mark)]
    return lines + [
        _fit(Text(_shown(f"  {sentence}"), _GREY), width, mark) for sentence in watch.explanation()
    ]


def plain_line(view: JointView) -> str:
    """A joint in one line without control characters, for a pipe."""
    direction = shown_number(view.number("eccentricity_direction_deg"), 0)
    parts = [
        f"eccentricity {_value(view, 'eccentricity_um', 1)} um at {direction} deg",
        f"least backlash {_value(view, 'minimum_backlash_um', 1)} um",
        f"lost motion {_value(view, 'lost_motion_arcmin', 2)} arcmin",
        f"{_value(view, 'loaded_pairs', 0)} loaded pairs",
        f"peak load {_value(view, 'peak_tooth_load_N', 1)} N",
        f"predicted TE {_value(view, 'predicted_te_pp_arcsec', 1)} arcsec p-p",
        f"residual {_value(view, 'residual_rms_arcsec', 2)} arcsec rms",
        f"{_value(view, 'sample_rate_hz', 0)} Hz",
        *_bookkeeping(view),
    ]
    return "; ".join((f"{_shown(_whole_name(view))}: {_shown(_verdict(view))}", *map(_shown, parts)))


class Display:
    """Shows a watch as it goes, inside a ``with`` statement.

    Parameters
    ----------
    stream : file, optional
        stdout by default. A terminal gets a live table, everything else plain lines.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._console = Console(file=self._stream, highlight=False)
        is_live = self._stream.isatty() and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False) if is_live else None
        self._bars, self._mark = _marks(self._console.encoding)
        self._next = -math.inf
        self._told: dict[tuple[str, str, str], tuple[float, str, bool]] = {}
        self._waiting = ""

    def __enter__(self) -> Display:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, watch: Watch, now: float, is_last: bool = False) -> None:
        """Show the present state, if it is time to or never will be again."""
        if now < self._next and not is_last:
            return
        self._next = now + REFRESH_PERIOD
        if self._live is not None:
            size = self._console.size
            self._live.update(self._table(watch, now, size.width, size.height), refresh=True)
        else:
            self._tell(watch, now)

    def show_once(self, watch: Watch, now: float) -> None:
        """Show the present state and leave it there."""
        if self._live is not None:
            self._live.update(self._table(watch, now, self._console.width, sys.maxsize), refresh=True)
        else:
            self._write([plain_line(view) for view in watch.view(now)])

    def _table(self, watch: Watch, now: float, width: int, height: int) -> Group:
        return table(watch, now, width, height, self._bars, self._mark)

    def _tell(self, watch: Watch, now: float) -> None:
        """A line for each joint with news, and some where there is nothing to see."""
        views = watch.view(now)
        lines = [] if views else [line.plain for line in waiting(watch, sys.maxsize)]
        if lines and "\n".join(lines) != self._waiting:
            self._waiting = "\n".join(lines)
            self._write(lines)
        self._write([plain_line(view) for view in views if self._is_news(view, now - view.age)])

    def _is_news(self, view: JointView, arrived: float) -> bool:
        """Whether a report has another fault than the last that was told, or came long after it."""
        key = (view.topic, view.hardware_id, view.name)
        told, code, was_silent = self._told.get(key, (-math.inf, "", False))
        is_due = arrived >= told + PLAIN_PERIOD
        if not is_due and (view.code, view.is_silent) == (code, was_silent):
            return False
        self._told[key] = arrived, view.code, view.is_silent
        return True

    def _write(self, lines: Sequence[str]) -> None:
        encoding = self._console.encoding
        for line in lines:
            self._stream.write(line.encode(encoding, "backslashreplace").decode(encoding) + "\n")
        self._stream.flush()


def _marks(encoding: str) -> tuple[str, str]:
    """Characters of curves and the mark of what was cut, as the encoding has them."""
    try:
        f"{_BARS}…".encode(encoding)
    except (UnicodeEncodeError, LookupError):
        return _PLAIN_BARS, "~"
    return _BARS, "…"


def _fitting(views: Sequence[JointView], blocks: Sequence[Sequence[Text]], height: int) -> list[int]:
    """Which joints are shown: all, or the worst for which there is room, in their order."""
    kept: list[int] = []
    left = height
    for index in sorted(range(len(views)), key=lambda i: -views[i].level):
        left -= len(blocks[index])
        if left < 0 and kept:
            break
        kept.append(index)
    return sorted(kept)


def _title(views: Sequence[JointView], width: int, mark: str) -> Text:
    nodes = sorted({name for view in views for name in view.nodes})
    faulty = sum(view.is_faulty or view.is_silent for view in views)
    names = Text(_shown(", ".join(nodes)))
    names.truncate(_NAMES_SHOWN, overflow="crop")
    title = Text().append("hd-diag watch ", "bold")
    title.append(names.plain, "bold")
    title.append(f"  {len(views)} joint{'s' * (len(views) != 1)}, ")
    title.append(f"{faulty} with a fault" if faulty else "no fault", _STYLES[2] if faulty else _STYLES[0])
    return _fit(title, width, mark)


def _heading(width: int, mark: str) -> list[Text]:
    name = _name_width(width)
    rows = zip(*(column.head for column in _COLUMNS), strict=True)
    first = ("", "", "joint")
    lines = []
    for label, row in zip(first, rows, strict=True):
        cells = (f" {text:>{column.width}}" for text, column in zip(row, _COLUMNS, strict=True))
        lines.append(_fit(Text(label.ljust(name) + "".join(cells), _GREY), width, mark))
    return lines


def _joint_lines(view: JointView, is_shared: bool, width: int, bars: str, mark: str) -> list[Text]:
    """Numbers; what is wrong; bookkeeping with the curve. Where nothing is wrong the last two are one.

    Where the joint's name is shared, the bookkeeping begins with its node.
    """
    name = Text().append(_shown(_shown_name(view)), "bold")
    _truncate(name, _name_width(width), mark)
    numbers = "".join(
        f" {shown_number(view.number(column.key), column.digits, column.width):>{column.width}}"
        for column in _COLUMNS
    )
    line = name.append(numbers, _GREY if view.is_stale else "")
    if view.is_silent:
        line.stylize(_GREY)
    verdict = Text("  ").append(_shown(_verdict(view)), _style(view))
    bookkeeping = [_node(view), *_bookkeeping(view)] if is_shared else _bookkeeping(view)
    details = Text("  ").append(", ".join(map(_shown, bookkeeping)), _GREY)
    if not view.is_faulty and not view.is_silent:
        return [_fit(line, width, mark), _with_curve(verdict.append(details), view, width, bars, mark)]
    return [
        _fit(line, width, mark),
        _fit(verdict, width, mark),
        _with_curve(details, view, width, bars, mark),
    ]


def _with_curve(words: Text, view: JointView, width: int, bars: str, mark: str) -> Text:
    """Words, and the residuals of the last reports in what is left of the line."""
    room = min(_LONGEST_CURVE, width - words.cell_len - 2)
    curve = spark(view.residuals, room, bars) if room >= len(bars) else ""
    return _fit(words.append("  ").append(curve, _GREY if view.is_stale else "cyan"), width, mark)


def _remarks(watch: Watch, hidden: int, width: int, mark: str) -> list[Text]:
    found = []
    if hidden:
        found.append(f"{hidden} more joints have no room here: --joint chooses")
    if missing := watch.missing():
        found.append(f"not reported: {', '.join(missing)}")
    shared = sorted({view.name for view in watch.view(0.0) if len(view.nodes) > 1})
    if shared:
        found.append(f"several nodes report {', '.join(shared)} on one topic: not to be told apart")
    return [_fit(Text(_shown(remark), "yellow"), width, mark) for remark in found]


def _verdict(view: JointView) -> str:
    """Fault code, its message, the other codes, and whether reports have stopped."""
    silent = f"no report for {view.age:.0f} s; the last: " if view.is_silent else ""
    others = [code for code in view.values.get("fault_codes", "").split() if code != view.code]
    also = f" (also {' '.join(others)})" if others else ""
    told = f" {view.message}" if view.message not in ("", view.code) else ""
    return f"{silent}{view.code}{told}{also}"


def _bookkeeping(view: JointView) -> list[str]:
    return [
        f"{_value(view, 'samples', 0)} samples",
        f"latency {_value(view, 'latency_p99_us', 0)} us",
        f"log {view.values.get('log_state', '-')}",
    ]


def _value(view: JointView, key: str, digits: int) -> str:
    return shown_number(view.number(key), digits)


def _style(view: JointView) -> str:
    if view.is_silent:
        return _GREY
    return _STYLES[view.level] if 0 <= view.level < len(LEVELS) else _STYLES[-1]


def _shown_name(view: JointView) -> str:
    """The joint; its node only where there may be another such joint."""
    namespace = view.nodes[0].rpartition("/")[0].strip("/") if len(view.nodes) == 1 else ""
    return f"{namespace}/{view.name}" if namespace else view.name


def _node(view: JointView) -> str:
    """Who reports it, as far as that is known."""
    return " or ".join(view.nodes) or view.hardware_id or view.topic


def _whole_name(view: JointView) -> str:
    return f"{_node(view)} {view.name}"


def _name_width(width: int) -> int:
    return max(_LEAST_NAME, width - _NUMBERS_WIDTH)


def _shown(text: str) -> str:
    """Text of others, without anything that a terminal obeys, and not without end."""
    return visible(text[:_LONGEST])


def _fit(text: Text, width: int, mark: str) -> Text:
    """Text that stays on one line of a width."""
    text.no_wrap = True
    if text.cell_len > width:
        _truncate(text, width, mark)
    return text


def _truncate(text: Text, width: int, mark: str) -> None:
    """Cut a text to a width, or pad it."""
    if text.cell_len > width:
        text.truncate(width - 1, overflow="crop")
        text.append(mark)
    text.truncate(width, pad=True)
