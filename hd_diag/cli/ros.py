"""``hd-diag node`` and ``demo``: the ROS node, and the whole work flow on a simulated joint."""

from __future__ import annotations

from pathlib import Path

from hd_diag.cli.examples import load_example
from hd_diag.cli.options import needing_ros
from hd_diag.cli.targets import Problem, write_json
from hd_diag.config.configuration import load
from hd_diag.ros.stop_signals import SIGNALLED, note_signals


def node(config_file: str | None, ros_arguments: tuple[str, ...]) -> int:
    """Run ``hd-diag node``."""
    if config_file:
        load(config_file)
    with needing_ros("the node"):
        from hd_diag.ros.node import main as run
    parameter_file = ["--ros-args", "--params-file", config_file, "--"] if config_file else []
    return run(["hd_diag_node", *parameter_file, *ros_arguments], note_signals(), config_file or "")


def demo(folder: str | None, seconds: float, json_file: str | None) -> int:
    """Run ``hd-diag demo``."""
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
