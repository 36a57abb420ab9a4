"""``hd-diag demo``: the main job end to end on a simulated joint."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hd_diag.cli.examples import load_example
from hd_diag.cli.options import JSON, Problem, needing_ros, shown, verb, write_json
from hd_diag.cli.verbs import SIGNALLED


@verb("demo --out demo")
@click.option(
    "--out",
    "folder",
    type=click.Path(file_okay=False),
    help="Folder for log, replay and report. [default: a new one among the temporary files]",
)
@shown("--seconds", 24.0, "How long node and joint run [s].", type=click.FloatRange(5.0, 600.0))
@JSON
def demo(folder: str | None, seconds: float, json_file: str | None) -> None:
    """The main job end to end: the real node beside a simulated joint, over DDS, its log, replay and verdict.

    Starts both as processes of their own, changes the eccentricity while they run, shows what the diagnostics
    say, replays the log, diagnoses it and writes the report. Needs ROS 2 Jazzy. Exit codes: 0 all held, 1
    something did not, 130 after Ctrl-C.
    """
    with needing_ros("the demo"):
        demo_run = load_example("demo.run")
    try:
        summary = demo_run.run(Path(folder) if folder else None, seconds)
    except demo_run.DemoError as error:
        raise Problem(str(error)) from error
    if json_file:
        write_json(json_file, summary)
    if summary["signal"] is not None:
        sys.exit(SIGNALLED + summary["signal"])
    sys.exit(0 if summary["complete"] else 1)
