"""``hd-diag node``: the ROS node."""

from __future__ import annotations

import sys

import click

from hd_diag.cli.options import CONFIG, needing_ros, verb
from hd_diag.config.configuration import load
from hd_diag.ros.stop_signals import note_signals


@verb("node --config arm.yaml -- --ros-args -r joint_states:=/js", ignore_unknown_options=True)
@CONFIG
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
def node(config_file: str | None, ros_arguments: tuple[str, ...]) -> None:
    """Run the node: joint states in, diagnostics, tooth arrays and transmission error out.

    Needs ROS 2 Jazzy. Arguments after -- go to ROS. Ends with code 0 on SIGINT and SIGTERM.
    """
    if config_file:
        load(config_file)
    stopped = note_signals()
    with needing_ros("the node"):
        from hd_diag.ros.node import main as run
    parameter_file = ["--ros-args", "--params-file", config_file, "--"] if config_file else []
    sys.exit(run(["hd_diag_node", *parameter_file, *ros_arguments], stopped))
