"""What ``hd-diag watch`` takes, and its help."""

from __future__ import annotations

import click

from hd_diag.cli import options


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

    A table in a terminal; in a pipe one line a second for each joint. Needs ROS 2 Jazzy. Exit codes: 0
    done, 1 a fault with --fail-on-fault, 2 nothing came within --timeout, 130 after Ctrl-C.
    """
