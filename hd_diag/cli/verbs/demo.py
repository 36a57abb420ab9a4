"""What ``hd-diag demo`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("demo --out demo")
@click.option(
    "--out",
    "folder",
    type=click.Path(file_okay=False),
    help="Folder for log, replay and report. [default: a new one among the temporary files]",
)
@options.shown("--seconds", 24.0, "How long node and joint run [s].", type=click.FloatRange(5.0, 600.0))
@options.JSON
def demo() -> None:
    """The main job end to end: the real node beside a simulated joint, over DDS, its log, replay and verdict.

    Starts both as processes of their own, changes the eccentricity while they run, shows what the diagnostics
    say, replays the log, diagnoses it and writes the report. Needs ROS 2 Jazzy. Exit codes: 0 all held, 1
    something did not, 130 after Ctrl-C.
    """
