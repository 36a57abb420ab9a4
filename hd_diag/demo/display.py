"""What the demo shows: a live table in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from rich import box
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

_PLAIN_WIDTH = 100  # of tables where there is no terminal
_PLAIN_PERIOD = 1.0  # between plain lines [s]


@dataclass(frozen=True)
class Reading:
    """What the diagnostics said at one moment: the values of a joint's status."""

    values: Mapping[str, str]

    def number(self, key: str) -> float:
        """A value as a number; nan where there is none."""
        return float(self.values.get(key, "nan"))

    @property
    def samples(self) -> int:
        """Samples that the node has taken."""
        return int(self.number("samples"))


@dataclass
class Step:
    """The time during which the model has one eccentricity [um], and what the diagnostics said meanwhile."""

    eccentricity: float
    readings: list[Reading] = field(default_factory=list)

    def take(self, reading: Reading) -> bool:
        """Keep a reading if it speaks of this step."""
        own = abs(reading.number("eccentricity_um") - self.eccentricity) < 1e-3
        if own:
            self.readings.append(reading)
        return own

    def summary(self) -> dict[str, Any]:
        """Values of the columns by diagnostics key, None where there is none."""
        values = {column.key: column.of(self.readings) if self.readings else math.nan for column in _COLUMNS}
        values["eccentricity_um"] = self.eccentricity
        return {key: None if isinstance(v, float) and math.isnan(v) else v for key, v in values.items()}


def _last(readings: Sequence[Reading], key: str) -> float:
    return readings[-1].number(key)


def _least(readings: Sequence[Reading], key: str) -> float:
    return min(reading.number(key) for reading in readings)


def _largest(readings: Sequence[Reading], key: str) -> float:
    return max(reading.number(key) for reading in readings)


def _usual(readings: Sequence[Reading], key: str) -> float:
    """Median; the first of several is left out, whose window reaches back into the step before."""
    return statistics.median(reading.number(key) for reading in readings[1:] or readings)


def _text(readings: Sequence[Reading], key: str) -> str:
    return statistics.mode(reading.values.get(key, "") for reading in readings)


class Column(NamedTuple):
    """A column of the table: key in the diagnostics, heading, unit, how a step's readings make one value."""

    key: str
    heading: str
    unit: str
    form: str
    make: Callable[[Sequence[Reading], str], float | str]

    @property
    def head(self) -> list[str]:
        """Heading of three lines."""
        return [*self.heading.split("\n"), f"[{self.unit}]"]

    def of(self, readings: Sequence[Reading]) -> float | str:
        """Value of some readings."""
        return self.make(readings, self.key)

    def shown(self, readings: Sequence[Reading]) -> str:
        """The same for people."""
        value = self.of(readings)
        return value.split(" ")[0] if isinstance(value, str) else format(value, self.form)


_COLUMNS = (
    Column("eccentricity_um", "eccen-\ntricity", "um", ".0f", _last),
    Column("minimum_backlash_um", "least\nbacklash", "um", ".1f", _least),
    Column("lost_motion_arcmin", "lost\nmotion", "arcmin", ".2f", _last),
    Column("predicted_te_pp_arcsec", "predicted\nTE p-p", "arcsec", ".1f", _last),
    Column("loaded_pairs", "loaded\npairs", "-", ".0f", _last),
    Column("peak_tooth_load_N", "peak\nload", "N", ".1f", _largest),
    Column("residual_rms_arcsec", "residual\nrms", "arcsec", ".1f", _usual),
    Column("sample_rate_hz", "sample\nrate", "Hz", ".0f", _last),
    Column("log_state", "log\n", "-", "", _text),
    Column("fault_code", "fault\ncode", "-", "", _text),
)


class Display:
    """Shows steps as they go, inside a ``with`` statement."""

    def __init__(self) -> None:
        console = Console()
        self._console = console if console.is_terminal else Console(width=_PLAIN_WIDTH)
        self._live = Live(console=self._console, auto_refresh=False) if console.is_terminal else None
        self._steps: Sequence[Step] = ()
        self._next_line = 0.0

    def __enter__(self) -> Display:
        if self._live is not None:
            self._live.start()
        else:
            self._say_all(_lines([]))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
        elif self._steps:
            self._console.print(_table(self._steps))

    def say(self, text: str) -> None:
        """Print a line, above the live table."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _say_all(self, lines: Sequence[str]) -> None:
        for line in lines:
            self.say(line)

    def show(self, steps: Sequence[Step]) -> None:
        """Show the steps, the last of which has a new reading."""
        self._steps = steps
        if self._live is not None:
            self._live.update(_table(steps), refresh=True)
        elif time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + _PLAIN_PERIOD
            self._say_all(_lines(steps[-1].readings[-1:]))

    def conclude(self, summary: Mapping[str, Any], true_eccentricity: float) -> None:
        """Tell what the log holds, what it shows and what to do next."""
        self._tell_residual(summary["steps"], true_eccentricity)
        table = Table("topic in the log", "type", box=box.SIMPLE_HEAD)
        table.add_column("messages", justify="right")
        for entry in summary["topics"]:
            table.add_row(entry["topic"], entry["type"], str(entry["count"]))
        self._console.print(table)
        self.say(f"Log: {summary['log']} ({summary['log_size'] / 1e6:.1f} MB; rosbag2 folder, MCAP)")
        if summary["verdict"]:
            self.say(
                f"Replay: {summary['replayed']} messages, each equal to the byte to what the node published."
            )
            self.say(f"Verdict: {summary['verdict']}")
            self.say(f"Report: {summary['report']}")
        if summary["complete"]:
            self.say(
                "Complete: both processes ended with code 0, every message was logged and decoded twice, "
                "replayed and diagnosed."
            )
        else:
            self.say("NOT COMPLETE: " + "; ".join(summary["missing"]))
            return
        places = {"folder": summary["folder"], "command": _command()}
        self._say_all([line.format(**places) for line in _NEXT])

    def _tell_residual(self, steps: Sequence[Mapping[str, Any]], true_eccentricity: float) -> None:
        residuals = {
            s["residual_rms_arcsec"]: s["eccentricity_um"] for s in steps if s["residual_rms_arcsec"]
        }
        if residuals:
            least = min(residuals)
            self.say(
                f"Measured and predicted error differ least, by {least:.1f} arcsec rms, with "
                f"{residuals[least]:g} um in the model; the simulated joint has {true_eccentricity:g} um."
            )


_NEXT = (
    "Next:",
    "  {command} mesh --config {folder}/node.yaml --torque 14   every tooth at one moment",
    "  {command} check {folder}/node.yaml                       its values are yours to change",
    "  {command} node --config {folder}/node.yaml               beside your own robot's /joint_states",
)


def _command() -> str:
    """How the command is called: by its path where it is below this folder, as in an environment of make."""
    place, here = Path(sys.argv[0]).absolute(), Path.cwd()
    is_below = place.name == "hd-diag" and place.is_relative_to(here)
    return str(place.relative_to(here)) if is_below else "hd-diag"


def _table(steps: Sequence[Step]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in _COLUMNS:
        table.add_column(Text("\n".join(column.head)), justify="left" if column.make is _text else "right")
    for step in steps:
        if step.readings:
            style = "bold" if step is steps[-1] else ""
            table.add_row(*(column.shown(step.readings) for column in _COLUMNS), style=style)
    return table


def _lines(readings: Sequence[Reading]) -> list[str]:
    """Heading of three lines where there is no reading, otherwise one line, in columns."""
    cells = [[column.shown(readings)] if readings else column.head for column in _COLUMNS]
    return ["  ".join(cell.rjust(9) for cell in row).rstrip() for row in zip(*cells, strict=True)]
