"""``hd-diag demo``: the main job end to end on a simulated joint."""

from __future__ import annotations

from pathlib import Path

from hd_diag.cli.examples import load_example
from hd_diag.cli.options import needing_ros
from hd_diag.cli.targets import Problem, write_json
from hd_diag.ros.stop_signals import SIGNALLED


def demo(folder: str | None, seconds: float, json_file: str | None) -> int:
    """Do what ``hd-diag demo`` is asked for."""
    with needing_ros("the demo"):
        demo_run = load_example("demo.run")
    try:
        summary = demo_run.run(Path(folder) if folder else None, seconds)
    except demo_run.DemoError as error:
        raise Problem(str(error)) from error
    write_json(json_file, summary)
    if summary["signal"] is not None:
        return SIGNALLED + int(summary["signal"])
    return 0 if summary["complete"] else 1
