"""What ``hd-diag node`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("node --config arm.yaml -- --ros-args -r joint_states:=/js", ignore_unknown_options=True)
@options.CONFIG
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
def node() -> None:
    """Run the node: joint states in, diagnostics, tooth arrays and transmission error out.

    Needs ROS 2 Jazzy. Arguments after -- go to ROS. Ends with code 0 on SIGINT and SIGTERM.
    """
