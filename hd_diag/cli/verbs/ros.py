"""Options and help of the verbs with a running node."""

from __future__ import annotations

import click

from hd_diag.cli import options


@options.verb("demo --out demo", "ros")
@click.option(
    "--out",
    "folder",
    type=click.Path(file_okay=False),
    help="Folder for log, replay and report. [default: a new one among the temporary files]",
)
@options.shown("--seconds", 24.0, "How long node and joint run [s].", type=click.FloatRange(5.0, 600.0))
@options.JSON
def demo() -> None:
    """Run the node beside a simulated joint, then replay and diagnose its log.

    Starts both as separate processes that meet over DDS, changes the eccentricity while they run, shows the
    diagnostics, replays the log, diagnoses it and writes the report. Needs ROS 2 Jazzy. Exit codes: 0 every
    step gave the expected result, 1 a step did not, 130 after Ctrl-C.
    """


@options.verb(
    "node --config arm.yaml -- --ros-args -r __ns:=/arm -r joint_states:=/js",
    "ros",
    ignore_unknown_options=True,
)
@options.CONFIG
@click.argument("ros_arguments", nargs=-1, type=click.UNPROCESSED)
def node() -> None:
    """Run the ROS node.

    Joint states in, diagnostics, tooth arrays and transmission error out. Needs ROS 2 Jazzy. Arguments after
    -- --ros-args go to ROS, such as a namespace. Ends with code 0 on SIGINT and SIGTERM.
    """


@options.verb("watch --once --joint joint_1 --fail-on-fault")
@click.option("--joint", "joints", multiple=True, help="Joint; repeatable. [default: all]")
@click.option(
    "--namespace",
    "namespaces",
    multiple=True,
    help="Nodes in this namespace, or below it; repeatable. [default: all]",
)
@click.option(
    "--once",
    is_flag=True,
    help="Show one report of every joint and end; finding all nodes takes 3 s, less with --joint.",
)
@options.shown("--timeout", 10.0, "With --once: longest wait [s].", type=click.FloatRange(0.1, 3600.0))
@click.option("--fail-on-fault", is_flag=True, help="End with code 1 once a joint has a fault.")
@click.option(
    "--json",
    "json_file",
    is_flag=False,
    flag_value="-",
    metavar="[FILE]",
    type=options.Target(stdout=True),
    help="Everything reported as JSON, to stdout or a file; without --once a line a second.",
)
def watch() -> None:
    """Show the values and faults of a running node in the terminal.

    A table in a terminal, where the key d asks the nodes for a diagnosis and q ends; in a pipe one line a
    second for each joint. Needs ROS 2 Jazzy. Exit codes: 0 done, 1 a fault with --fail-on-fault, 2 nothing
    came within --timeout, 130 after Ctrl-C.
    """
