"""What a watcher shows: one table of joints in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import TextIO

from rich.console import Console, ConsoleOptions, Group, OverflowMethod, RenderResult
from rich.constrain import Constrain
from rich.live import Live
from rich.text import Text

from hd_diag.watch.numbers import NUMBERS_WIDTH, heading, row, sentence, shown_number, shown_text, spark
from hd_diag.watch.state import DEFAULT_TOPIC, JointView, Watch

REFRESH_PERIOD = 0.25
"""Shortest time between two pictures in a terminal [s]."""
PLAIN_PERIOD = 1.0
"""Shortest time between two plain lines of a joint [s]."""

_WIDEST = 120  # of the table [columns]
_LONGEST_CURVE, _SHORTEST_CURVE, _LEAST_NAME, _NAMES_SHOWN = 40, 8, 8, 40  # [characters]
_STYLES, _GREY = ("green", "yellow", "bold red", "magenta"), "bright_black"
_MOST_STATEMENTS = 4  # of a message, a line each
_LINES_ABOUT = 6  # title, heading, remark and the terminal's own last line


class Display:
    """Shows a watch inside a ``with`` statement, on stdout by default: a live table or, elsewhere, lines."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._console = Console(file=self._stream, highlight=False)
        is_live = self._stream.isatty() and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False) if is_live else None
        self._next = -math.inf
        self._shown: dict[tuple[str, str, str], tuple[float, str, bool]] = {}
        self._waiting: list[str] = []

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
        self._next = now + REFRESH_PERIOD
        if self._live is not None:
            table = JointTable(watch, now, math.inf if is_last else self._console.height)
            self._live.update(table, refresh=True)
            return
        views = watch.view(now)
        if not views and (lines := _waiting(watch)) != self._waiting:
            self._waiting = lines
            self._write(lines)
        self._write([plain_line(view) for view in views if self._is_news(view, now - view.age)])

    def _write(self, lines: Sequence[str]) -> None:
        """Write lines without rich, which would end the program when the reader of a pipe has gone."""
        self._stream.writelines(_encodable(line, self._console.encoding) + "\n" for line in lines)
        self._stream.flush()

    def _is_news(self, view: JointView, arrived: float) -> bool:
        """Whether a report has another fault than the last one shown, or came long after it."""
        key, state = (view.topic, view.status.hardware_id, view.name), (view.code, view.is_silent)
        before, *last = self._shown.get(key, (-math.inf, "", False))
        is_news = arrived >= before + PLAIN_PERIOD or state != tuple(last)
        if is_news:
            self._shown[key] = arrived, *state
        return is_news


class JointTable:
    """All joints as rich renders them: a line of numbers and some of words each.

    Narrow terminals show the numbers in words. Where not all joints fit the height [lines], the worst are
    shown.
    """

    def __init__(self, watch: Watch, now: float, height: float = math.inf) -> None:
        self._watch, self._views, self._height = watch, watch.view(now), height

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        self._console, self._width, self._is_ascii = (
            console,
            min(options.max_width, _WIDEST),
            options.ascii_only,
        )
        self._name_width = max(_LEAST_NAME, self._width - NUMBERS_WIDTH)
        self._is_narrow = self._width < NUMBERS_WIDTH + _LEAST_NAME
        self._overflow: OverflowMethod = "crop" if self._is_ascii else "ellipsis"
        lines = self._lines() if self._views else [Text(line) for line in _waiting(self._watch)]
        for line in lines:
            line.plain = _encodable(line.plain, options.encoding)
            line.no_wrap, line.overflow = True, self._overflow
        yield Constrain(Group(*lines), self._width)

    def _lines(self) -> list[Text]:
        names = [view.name for view in self._views]
        blocks = [self._joint(view, names.count(view.name) > 1) for view in self._views]
        kept = self._fitting(blocks)
        labels = (label.ljust(self._name_width) for label in ("", "", "joint"))
        above = [Text(label + line, _GREY) for label, line in zip(labels, heading(), strict=True)]
        shown = [line for index in kept for line in blocks[index]]
        remarks = self._wrapped(self._remarks(len(blocks) - len(kept)))
        return [*self._wrapped([self._title()]), *([] if self._is_narrow else above), *shown, *remarks]

    def _wrapped(self, lines: Sequence[Text]) -> list[Text]:
        return [part for line in lines for part in line.wrap(self._console, self._width)]

    def _fitting(self, blocks: Sequence[Sequence[Text]]) -> list[int]:
        """Indices of the joints shown: the worst that fit, at least one."""
        room, kept = self._height - _LINES_ABOUT, list[int]()
        for index in sorted(range(len(blocks)), key=lambda i: -self._views[i].level):
            room -= len(blocks[index])
            if room < 0 and kept:
                break
            kept.append(index)
        return sorted(kept)

    def _title(self) -> Text:
        nodes = sorted({name for view in self._views for name in view.nodes})
        faulty = sum(view.level != 0 or view.is_silent for view in self._views)
        title = Text().append(f"hd-diag watch {shown_text(', '.join(nodes))[:_NAMES_SHOWN]}", "bold")
        title.append(f"  {len(self._views)} joint{'s' * (len(self._views) != 1)}, ")
        return title.append(f"{faulty} with a fault" if faulty else "no fault", _STYLES[2 if faulty else 0])

    def _joint(self, view: JointView, is_shared: bool) -> list[Text]:
        """Numbers, what is wrong, bookkeeping with the curve, the last verdict.

        The node stands first in the bookkeeping where the joint's name is shared.
        """
        if self._is_narrow:
            return self._wrapped([Text(plain_line(view), _style(view))])
        line = Text().append(shown_text(_shown_name(view)), "bold")
        line.truncate(self._name_width, overflow=self._overflow, pad=True)
        line.append(row(view.number), _GREY if view.is_stale else "")
        if view.is_silent:
            line.stylize(_GREY)
        first, *rest = view.status.message.split("; ", _MOST_STATEMENTS - 1)
        words = [Text("  ").append(shown_text(t), _style(view)) for t in (_verdict(view, first), *rest)]
        details = ", ".join(map(shown_text, [_node(view)] * is_shared + _order(view) + _bookkeeping(view)))
        words.append(Text("  ").append(details, _GREY))
        if not (view.level or view.is_silent):
            words = [words[0].append(words[-1])]
        if (room := min(_LONGEST_CURVE, self._width - words[-1].cell_len - 2)) >= _SHORTEST_CURVE:
            curve = spark(view.residuals, room, self._is_ascii)
            words[-1].append("  ").append(curve, _GREY if view.is_stale else "cyan")
        words += [Text("  ").append(shown_text(text)) for text in _diagnosed(view)]
        return [line, *self._wrapped(words)]

    def _remarks(self, hidden: int) -> list[Text]:
        found = [f"{hidden} more joints have no room here: --joint chooses"] * (hidden > 0)
        found += [f"{node} {answer}" for node, answer in sorted(self._watch.answers.items())]
        if missing := self._watch.missing():
            found.append(f"not reported: {', '.join(missing)}")
        if shared := sorted({view.name for view in self._views if len(view.nodes) > 1}):
            found.append(f"several nodes report {', '.join(shared)} on one topic and cannot be distinguished")
        return [Text(shown_text(remark), "yellow") for remark in found]


def _style(view: JointView) -> str:
    return _GREY if view.is_silent else _STYLES[min(view.level, len(_STYLES) - 1)]


def _encodable(text: str, encoding: str) -> str:
    """A text as a terminal of an encoding can show it."""
    known = text if "µ".encode(encoding, "ignore") else text.replace("µ", "u")
    return known.encode(encoding, "backslashreplace").decode(encoding)


def _waiting(watch: Watch) -> list[str]:
    """Topic and joints that are awaited, and what was seen instead."""
    what = f" of {', '.join(watch.joints)}" if watch.joints else ""
    topics = ", ".join(sorted({node.topic for node in watch.wanted_nodes()})) or DEFAULT_TOPIC
    lines = [f"waiting for {topics}{what} ...", *(f"  {found}" for found in watch.explanation())]
    return [shown_text(line) for line in lines]


def plain_line(view: JointView) -> str:
    """A joint in one line without control characters, for a pipe."""
    parts = (
        _verdict(view, view.status.message),
        *_order(view),
        sentence(view.number),
        *_bookkeeping(view),
        *_diagnosed(view),
    )
    return f"{shown_text(f'{_node(view)} {view.name}')}: {'; '.join(map(shown_text, parts))}"


def _verdict(view: JointView, said: str) -> str:
    """Fault code, message, the other codes, and whether reports have stopped."""
    silent = f"no report for {view.age:.0f} s; the last: " if view.is_silent else ""
    message = f" {said}" if said not in ("", view.code) else ""
    others = [code for code in view.text("fault_codes").split() if code != view.code]
    also = f" (also {' '.join(others)})" if others else ""
    return f"{silent}{view.code}{message}{also}"


def _order(view: JointView) -> list[str]:
    """The order that repeats in the residual of a joint without a fault."""
    if view.level or view.text("residual_order_repeats") != "true":
        return []
    values = (view.number(f"residual_order_{key}_arcsec") for key in ("amplitude", "limit"))
    size, limit = (shown_number(value, 1) for value in values)
    frame, _, number = view.text("residual_order").partition(" ")
    return [f"residual repeats {number}x per {frame} turn: {size} of {limit} arcsec allowed"]


def _bookkeeping(view: JointView) -> list[str]:
    samples, latency = (shown_number(view.number(key), 0) for key in ("samples", "latency_p99_us"))
    return [f"{samples} samples", f"latency {latency} µs", f"log {view.text('log_state', '-')}"]


def _diagnosed(view: JointView) -> list[str]:
    """What a diagnosis does, and what the last one has found of the joint."""
    state, found = view.text("diagnosis_state", "none"), view.text("verdict")
    is_told = state == "none" or state.startswith("done")
    told = [] if is_told else [f"diagnosis {state}"]
    return [*told, *([f"verdict of {view.text('verdict_time', '-')}: {found}"] if found else [])]


def _shown_name(view: JointView) -> str:
    """The joint, with its namespace where its node is known."""
    namespace = view.nodes[0].rpartition("/")[0].strip("/") if len(view.nodes) == 1 else ""
    return f"{namespace}/{view.name}" if namespace else view.name


def _node(view: JointView) -> str:
    """Nodes that may report it, or else the hardware_id or topic."""
    return " or ".join(view.nodes) or view.status.hardware_id or view.topic
