"""``hd-diag node``: the ROS node."""

from __future__ import annotations

from hd_diag.cli.options import needing_ros
from hd_diag.config.configuration import load
from hd_diag.ros.stop_signals import note_signals


def node(config_file: str | None, ros_arguments: tuple[str, ...]) -> int:
    """Do what ``hd-diag node`` is asked for."""
    if config_file:
        load(config_file)
    with needing_ros("the node"):
        from hd_diag.ros.node import main as run
    parameter_file = ["--ros-args", "--params-file", config_file, "--"] if config_file else []
    return run(["hd_diag_node", *parameter_file, *ros_arguments], note_signals())
