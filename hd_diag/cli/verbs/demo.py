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
    """Run the real node beside a simulated joint over DDS, then replay and diagnose its log.

    Starts both as separate processes, changes the eccentricity while they run, shows the diagnostics, replays
    the log, diagnoses it and writes the report. Needs ROS 2 Jazzy. Exit codes: 0 every step gave the expected
    result, 1 a step did not, 130 after Ctrl-C.
    """
