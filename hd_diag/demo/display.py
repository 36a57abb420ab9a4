"""What the demo shows: the steps of the model's eccentricity as they go, and what came of it at the end."""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Group
from rich.text import Text

from hd_diag.watch import JointView
from hd_diag.watch.numbers import heading, row
from hd_diag.watch.terminal import Terminal

_PLAIN_PERIOD = 1.0  # between plain lines [s]
_NUMBERS = (
    "eccentricity_um",
    "minimum_backlash_um",
    "lost_motion_arcmin",
    "predicted_te_pp_arcsec",
    "loaded_pairs",
    "peak_tooth_load_N",
    "residual_rms_arcsec",
    "sample_rate_hz",
)
_TEXTS = ("log_state", "fault_code")


@dataclass
class Step:
    """The time during which the model has one eccentricity [um], and what the diagnostics said meanwhile."""

    eccentricity: float
    reports: list[JointView] = field(default_factory=list)

    def take(self, report: JointView) -> bool:
        """Keep a report if it is of this step."""
        own = abs(report.number("eccentricity_um") - self.eccentricity) < 1e-3
        if own:
            self.reports.append(report)
        return own

    def number(self, key: str) -> float:
        """One number of all reports: least backlash, largest load, usual residual, else the last one.

        The first of several residuals is left out: its window reaches back into the step before.
        """
        values = [report.number(key) for report in self.reports]
        if key == "residual_rms_arcsec" and values:
            return statistics.median(values[1:] or values)
        extremes = {"minimum_backlash_um": min, "peak_tooth_load_N": max}
        return extremes.get(key, lambda every: every[-1])(values) if values else math.nan

    def text(self, key: str) -> str:
        """The most frequent text of all reports."""
        return statistics.mode(report.text(key) for report in self.reports)

    def summary(self) -> dict[str, Any]:
        """Values by diagnostics key, None where there is none."""
        numbers = {key: self.number(key) for key in _NUMBERS} | {"eccentricity_um": self.eccentricity}
        texts = {key: self.text(key) if self.reports else None for key in _TEXTS}
        return {key: None if math.isnan(value) else value for key, value in numbers.items()} | texts


class DemoDisplay(Terminal):
    """Shows steps as they go, inside a ``with`` statement."""

    def __init__(self) -> None:
        super().__init__()
        self._steps: Sequence[Step] = ()
        self._next_line = -math.inf

    def show(self, steps: Sequence[Step]) -> None:
        """Show the steps, the last of which has a new report."""
        is_first, self._steps = not self._steps, steps
        if self.is_live:
            self.draw(Group(*map(Text, _lines(steps))))
        elif time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + _PLAIN_PERIOD
            self.say(*_lines([Step(steps[-1].eccentricity, steps[-1].reports[-1:])])[0 if is_first else 3 :])

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        super().__exit__(kind, exc, trace)
        if not self.is_live and self._steps:
            self.say("", *_lines(self._steps), "")

    def conclude(self, summary: Mapping[str, Any], true_eccentricity: float) -> None:
        """Say what the log holds, what it shows and what to do next."""
        residuals = {
            step["residual_rms_arcsec"]: step["eccentricity_um"]
            for step in summary["steps"]
            if step["residual_rms_arcsec"]
        }
        if residuals:
            least = min(residuals)
            self.say(
                f"Measured and predicted error differ least, by {least:.1f} arcsec rms, with "
                f"{residuals[least]:g} um in the model; the simulated joint has {true_eccentricity:g} um."
            )
        self.say("", "messages  topic in the log                       type")
        self.say(*(f"{e['count']:8}  {e['topic']:37}  {e['type']}" for e in summary["topics"]), "")
        self.say(f"Log: {summary['log']} ({summary['log_size'] / 1e6:.1f} MB; rosbag2 folder, MCAP)")
        if summary["verdict"]:
            equal = f"{summary['replayed']} messages, each equal to the byte to what the node published"
            self.say(f"Replay: {equal}.", f"Verdict: {summary['verdict']}", f"Report: {summary['report']}")
        if not summary["complete"]:
            self.say("NOT COMPLETE: " + "; ".join(summary["missing"]))
            return
        command, file = _command(), f"{summary['folder']}/node.yaml"
        self.say(
            "Complete: both processes ended with code 0, every message was logged and decoded, replayed and "
            "diagnosed.",
            "Next:",
            f"  {command} mesh --config {file} --torque 14   every tooth at one moment",
            f"  {command} check {file}                       its values are yours to change",
            f"  {command} node --config {file}               beside your own robot's /joint_states",
        )


def _command() -> str:
    """How the command is called: by its path where it is below this folder, as in an environment of make."""
    place, here = Path(sys.argv[0]).absolute(), Path.cwd()
    is_below = place.name == "hd-diag" and place.is_relative_to(here)
    return str(place.relative_to(here)) if is_below else "hd-diag"


def _lines(steps: Sequence[Step]) -> list[str]:
    """Heading of three lines, then a line for each step that has reports."""
    lines = [f"{row(step.number)}  {step.text('fault_code')}" for step in steps if step.reports]
    return [*(f"{line}{label}" for line, label in zip(heading(), ("", "", "  fault"), strict=True)), *lines]
